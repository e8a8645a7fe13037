"""What `adaptsim diagnose` says of recordings whose first link is declared too long or too short.

    python -m experiments.closeloop_lengths --out DIR                                     the cases of docs/results/closing_the_loop.md
    python -m experiments.closeloop_lengths --case null:9503:1.006 single:9665:1 --out DIR

A case is SUITE:SEED:FACTOR: the suites' recording of that seed, its `meta.toml` declaring `l1` times the factor. Nothing else is
touched, so that with a factor other than 1 the one thing missing from a null recording is the length. Finished cases are kept in
DIR, so a stopped run goes on.
"""

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path

from adaptsim_jax.core import compile_flags, memory
from experiments.closeloop_suites import diagnose_folder
from tests.generators import make_datasets, write_dataset
from tests.generators.suites import SUITES, Case

WRONG = ("null:9503:1.006", "null:9503:0.994", "null:9504:1.006", "null:9517:1.1", "null:9521:0.98", "null:9531:1.003")
RIGHT = ("single:9665:1", "single:9649:1")  # a rotor and a torque gain: what a wrong length is mistaken for
CASES = (*WRONG, *RIGHT)


def parsed(text: str) -> tuple[str, int, float]:
    """Suite, seed and factor of a case; ValueError with what is wrong about it."""
    try:
        suite, seed, factor = text.split(":")
        case = suite, int(seed), float(factor)
    except ValueError:
        raise ValueError(f"--case {text}: give SUITE:SEED:FACTOR, such as {CASES[0]}") from None
    if suite not in SUITES:
        raise ValueError(f"--case {text}: no suite {suite}; there are {', '.join(sorted(SUITES))}")
    if not (math.isfinite(case[2]) and case[2] > 0.0):
        raise ValueError(f"--case {text}: the factor must be above zero")
    return case


def misdeclared_folder(case: Case, factor: float, out: Path) -> tuple[Path, float]:
    """The recording's folder, declared with `l1` times `factor`, and the true length [m]."""
    data = make_datasets([case.spec])[0]
    true = float(data.meta["geometry"]["l1"])
    geometry = data.meta["geometry"] | {"l1": true * factor}
    return write_dataset(replace(data, meta=data.meta | {"geometry": geometry}), out), true


def judged(text: str, out: Path) -> dict:
    """One case: what was declared, what is true and what was said."""
    suite, seed, factor = parsed(text)
    case = SUITES[suite](1, seed)[0]
    folder, true = misdeclared_folder(case, factor, out / "data" / text.replace(":", "_"))
    report, seconds = diagnose_folder(str(folder), case.exclude, "")
    said = [f"{e['name']}@{e['where']}" for e in report.get("effects", [])]
    error = {k: report.get("error", {}).get(k) for k in ("before", "after", "noise_floor")}
    return {
        "case": text, "l1_declared": true * factor, "l1_true": true, "hidden": [list(e) for e in case.spec.effects],
        "verdict": report["verdict"], "said": said, "message": report["message"], "error": error, "seconds": seconds,
    }  # fmt: skip


def table(records: list[dict]) -> str:
    lines = ["| case | l1 declared, true [m] | verdict | said |", "| --- | --- | --- | --- |"]
    for r in records:
        said = ", ".join(r["said"]) or r["message"]
        lines.append(f"| {r['case']} | {r['l1_declared']:.4f}, {r['l1_true']:.4f} | `{r['verdict']}` | {said} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", nargs="+", default=list(CASES), metavar="SUITE:SEED:FACTOR")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    args = parser.parse_args()
    try:
        list(map(parsed, args.case))
    except ValueError as problem:
        parser.error(str(problem))
    memory.keep_freed()
    compile_flags.small_steps()  # as the command does
    records = []
    for text in args.case:
        kept = args.out / f"{text.replace(':', '_')}.json"
        if not kept.exists():
            record = judged(text, args.out)
            kept.write_text(json.dumps(record, indent=1, default=float))
            print(f"{text:20s} {record['verdict']}  {record['seconds']:.1f} s", flush=True)
        records.append(json.loads(kept.read_text()))
    print(table(records))


if __name__ == "__main__":
    main()
