"""A table of the paper by one command: every run that it needs, and what prints it.

    python experiments/paper_tables.py table1-pushing --out OUT
    python experiments/paper_tables.py table2-pushing --out OUT --seeds 2
    python experiments/paper_tables.py table1-scooping --out OUT --dry-run     say what would be run

A run that was stopped is gone on with; `docs/howto/reproduce.md` says how long each table takes.
"""

import argparse
import shlex
import subprocess
import sys
from pathlib import Path

PUSH, HERE = "table1_pushing.py", Path(__file__).parent
SYSID = ["adaptsim", "sysid_point", "sysid_bayes"]
TRAINED = ["udr", "learn_in_target", "udr_target"]
HEAVY = "--settings wd --target drake --bottle heavy --iterations 12 --no-oracle --tests 8".split()


def runs(table: str, out: Path, seeds: int) -> list[list[str]]:
    """The scripts of a table with their words, in order. Each engine has a folder."""

    def push(folder: str, *words: str) -> list[str]:
        return [PUSH, "--out", str(out / folder), "--seeds", str(seeds), *words]

    drake = ["--target", "drake", "--together", "1"]
    scoop = ["--task", "scooping", "--tests", "12", "--fresh", "96"]
    tables = {
        "table1-pendulum": [["table1_pendulum.py", "--out", str(out), "--seeds", str(seeds)]],
        "table1-pushing": [
            push("planar", "--methods", *SYSID, *TRAINED, "bayesopt"),
            push("native", "--simulator", "native", "--together", "2", "--methods", *SYSID),
            push("drake", *drake, "--tests", "8", "--methods", *SYSID),
        ],
        "table1-scooping": [
            push("own", *scoop, "--methods", *SYSID, *TRAINED, "bayesopt"),
            push("drake", "--task", "scooping", *drake, "--methods", *SYSID, *TRAINED, "bayesopt"),
        ],
        "table2-pushing": [
            push(
                "adaptsim", "--together", "1", *HEAVY,
                "--methods", "adaptsim", "--starts", "1", "--visits", "deployed",
            ),
            push("learned", "--together", "1", *HEAVY, "--methods", "learn_in_target"),
            ["table2_pushing.py", str(out / "adaptsim"), str(out / "learned")],
        ],
    }  # fmt: skip
    return tables[table]


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = ("table1-pendulum", "table1-pushing", "table1-scooping", "table2-pushing")
    parser.add_argument("table", choices=names)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, help="10; of the pendulum 20")
    parser.add_argument("--dry-run", action="store_true", help="say what would be run")
    args = parser.parse_args(words)
    seeds = args.seeds or (20 if args.table == "table1-pendulum" else 10)
    for script, *options in runs(args.table, args.out, seeds):
        print(shlex.join(["python", f"experiments/{script}", *options]), flush=True)
        if not args.dry_run:
            subprocess.run([sys.executable, str(HERE / script), *options], check=True)


if __name__ == "__main__":
    main()
