"""Score the diagnosis of mechanisms on worlds made by MuJoCo whose truth is known.

    python -m experiments.mechanism_worlds --kind single --seeds 10000:10040 --jobs 2 --out \\
        single.csv

Kinds: null, single, multi. Seeds 0-999 are for tuning, from 10000 on for scoring. Each world goes
through files in a folder of its own (`--keep DIR` keeps them and the reports). A row per world is
appended as soon as it is done, and worlds that have a row are left out, so a stopped run goes on
where it was. `--seeds 0:0` prints the summary of what is there. `--machine`, `--mode` and
`--effect` fix what is drawn otherwise.
"""

import argparse
import csv
import importlib
import json
import shutil
import tempfile
import time
import traceback
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path

from experiments.mechanism_scores import FIELDS, judge, summary
from tests.generators.mechanism_worlds import SUITES, write_world

DIAGNOSE = "adaptsim_jax.attribution.diagnose:diagnose"
"""`diagnose(folder, out=None) -> report`: verdict, effects [{name, joints, class}], error {before,
after}.
"""


def function(path: str) -> Callable[..., dict]:
    """`package.module:name`."""
    module, name = path.split(":")
    return getattr(importlib.import_module(module), name)


def one(
    kind: str, seed: int, given: dict[str, str], diagnose: str, keep: str | None
) -> dict[str, object]:
    """The row of one world; a diagnosis that crashes has the verdict `crash`, a refusal
    `refused`.
    """
    folder = Path(keep) / f"{kind}_{seed}" if keep else Path(tempfile.mkdtemp(prefix="world_"))
    try:
        write_world(folder, kind, seed, **given)
        truth = json.loads((folder / "truth.json").read_text())
        start = time.perf_counter()
        try:
            report = function(diagnose)(folder / "recording", out=None)
        except Exception as problem:
            verdict = "refused" if type(problem).__name__ == "BadInput" else "crash"
            report = {
                "verdict": verdict,
                "message": f"{problem}",
                "traceback": traceback.format_exc(),
            }
        seconds = time.perf_counter() - start
        if keep:
            (folder / "report.json").write_text(json.dumps(report, indent=1, default=str))
        return judge(truth, report) | {"seconds": f"{seconds:.1f}"}
    finally:
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)


def _one(given: tuple) -> dict[str, object]:
    return one(*given)


def read(out: Path) -> list[dict[str, str]]:
    if not out.exists():
        return []
    with out.open(newline="") as file:
        return list(csv.DictReader(file))


def append(out: Path, row: dict[str, object]) -> None:
    new = not out.exists()
    with out.open("a", newline="") as file:
        writer = csv.DictWriter(file, FIELDS)
        if new:
            writer.writeheader()
        writer.writerow(row)


def main() -> None:
    p = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("--kind", choices=SUITES, default="single")
    p.add_argument("--seeds", default="0:20", help="first:end, end not among them")
    p.add_argument("--jobs", type=int, default=1)
    p.add_argument("--out", type=Path, required=True, help="CSV file")
    p.add_argument("--keep", help="folder for the worlds and their reports")
    p.add_argument("--machine")
    p.add_argument("--mode", choices=("torque", "position"))
    p.add_argument("--effect")
    p.add_argument("--diagnose", default=DIAGNOSE, help="module:function")
    a = p.parse_args()
    first, end = map(int, a.seeds.split(":"))
    done = {(r["kind"], int(r["seed"])) for r in read(a.out)}
    todo = [s for s in range(first, end) if (a.kind, s) not in done]
    given = {k: v for k in ("machine", "mode", "effect") if (v := getattr(a, k))}
    a.out.parent.mkdir(parents=True, exist_ok=True)
    if a.jobs > 1:
        # a process maps each compiled program into its memory, and the system allows only so many
        # of these; not by concurrent.futures, whose pool waits for ever where all its processes end
        # their last task together
        with get_context("spawn").Pool(a.jobs, maxtasksperchild=10) as pool:
            for row in pool.imap_unordered(
                _one, [(a.kind, s, given, a.diagnose, a.keep) for s in todo]
            ):
                tell(a.out, row)
    else:
        for s in todo:
            tell(a.out, one(a.kind, s, given, a.diagnose, a.keep))
    print(summary(read(a.out)))


def tell(out: Path, row: dict[str, object]) -> None:
    append(out, row)
    print(
        "  ".join(
            str(row[k])
            for k in (
                "kind",
                "seed",
                "machine",
                "mode",
                "hidden",
                "verdict",
                "named",
                "outcome",
                "seconds",
            )
        ),
        flush=True,
    )


if __name__ == "__main__":
    main()
