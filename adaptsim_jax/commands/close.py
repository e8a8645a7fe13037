"""`adaptsim close`: diagnose, mend, train and adapt before and after, in one command.

It is a chain of commands, each in a folder of its own, so that what was done once is not done
again.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
from pathlib import Path

from adaptsim_jax.core.config import Table

EXAMPLES = """
  adaptsim close logs env.toml --out closed
  adaptsim close logs env.toml --out closed --trials 10 --seeds 10     with intervals over seeds
A run that was stopped goes on with the same command.
"""
METHODS = ("nominal", "udr", "adaptsim")
WORLDS = ("declared", "mended")


def run(args: argparse.Namespace) -> int:
    """All stages, then what they come to."""
    from adaptsim_jax.commands.parser import output, print_file
    from adaptsim_jax.core.files import one_writer, write_bytes, write_json
    from adaptsim_jax.environments.setting import read_env
    from adaptsim_jax.report.closed import page, table

    read_env(args.task)  # refused before anything is written
    with output(args.out) as out, one_writer(out):
        stages = commands_of(args, out)
        results: Table = {}
        done("diagnosis", out / "diagnosis" / "report.json", stages["diagnosis"])
        report = json.loads((out / "diagnosis" / "report.json").read_text(encoding="utf-8"))
        for world in WORLDS:
            if world == "mended" and not report["effects"]:
                results[world] = results["declared"]  # nothing was found: the same policies
                continue
            file = out / world / "results.json"
            done(world, file, stages[world])
            results[world] = json.loads(file.read_text(encoding="utf-8"))
        found = closed(report, results, args.trials)
        write_json(out / "result.json", found)
        write_bytes(out / "report.html", page(found).encode())
    if args.json:
        print_file(out / "result.json")
        return 0
    print(table(found))
    print(f"written: {out / 'result.json'}\nnext: open {out / 'report.html'}")
    return 0


def commands_of(args: argparse.Namespace, out: Path) -> dict[str, list[str]]:
    """The command line of each stage."""
    diagnosis = str(out / "diagnosis")
    first = ["diagnose", args.logs, "--out", diagnosis]
    if args.model:
        first += ["--model", args.model]
    methods = ["--methods", ",".join(METHODS), "--seeds", str(args.seeds), "--seed", str(args.seed)]
    budget = ["--set", "starts=1", "--set", f"iterations={args.trials - 1}"]
    more = [word for setting in args.set for word in ("--set", setting)]
    both = [*methods, *budget, *more]
    compare = ["compare", args.task]
    return {
        "diagnosis": first,
        "declared": [*compare, "--out", str(out / "declared"), *both],
        "mended": [*compare, "--diagnosis", diagnosis, "--out", str(out / "mended"), *both],
    }


def done(stage: str, file: Path, words: list[str]) -> None:
    """Run a stage unless its `file` is there and whole. BadInput where it fails, which has said
    why.
    """
    from adaptsim_jax.core.errors import BadInput

    shown = f"adaptsim {shlex.join(words)}"
    if file.exists() and not json.loads(file.read_text(encoding="utf-8")).get("unfinished"):
        print(f"{stage}: done before ({file})", file=sys.stderr)
        return
    print(f"{stage}: {shown}", file=sys.stderr)
    code = subprocess.run([sys.executable, "-m", "adaptsim_jax", *words], check=False).returncode
    if code:
        raise BadInput(
            f"{stage}: `{shown}` ended with {code}; mend what it says, then repeat the command"
        )


def closed(report: Table, results: dict[str, Table], trials: int) -> Table:
    """What result.json holds: of each target, simulator and method the mean return over seeds."""
    rows = []
    for world, found in results.items():
        for row in found["rows"]:
            returns = row["returns"]
            spent = row.get("target_trials") or 0
            mean = sum(returns) / len(returns)
            line = {"target": row["setting"], "simulator": world, "method": row["method"]}
            rows.append(line | {"trials": spent, "mean": mean, "returns": returns})
    names = ("verdict", "message", "effects")
    return {
        "schema": 1,
        "trials": trials,
        "found": bool(report["effects"]),
        "diagnosis": {name: report[name] for name in names},
        "bounds": {world: found["settings"] for world, found in results.items()},
        "rows": rows,
    }
