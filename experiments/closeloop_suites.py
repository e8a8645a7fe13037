"""Score `adaptsim diagnose` on data sets whose truth is known.

    python -m experiments.closeloop_suites --suite null single --count 200 --seed 10000 --out \\
        DIR --workers 2

Seeds 0-9999 are for tuning, from 10000 on for scoring. Every data set goes through files. Finished
cases are kept in `DIR/cases`, so a stopped run goes on where it was; `DIR/results.json` and
`DIR/results.md` hold the scores, `DIR/cases.csv` a row for each case. `--count 0` scores what is
there.
"""

import argparse
import csv
import itertools
import json
import shutil
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import jax
import jax.numpy as jnp

from adaptsim_jax.core import process
from adaptsim_jax.diagnosis import Effect, Quantity, catalogue
from experiments.closeloop_scores import row, score_case, summarise, table
from tests.generators import make_datasets, write_dataset
from tests.generators.suites import SUITES, Case, disguise

BATCH = 24
# diagnoses of one process after which its compiled programs go: each holds memory maps, of which a
# process has 65530
FRESH = 8
_diagnosed = itertools.count()


def diagnose_folder(folder: str, exclude: tuple[str, ...], variant: str) -> tuple[dict, float]:
    """The report of one folder (without its follow-up) and the seconds it took; a crash is a
    report, verdict `error`.
    """
    from adaptsim_jax import diagnose

    options: dict = {"exclude": exclude} if exclude else {}
    if variant == "irrelevant":
        options["effects"] = (*catalogue("mechanism"), useless())
    if next(_diagnosed) % FRESH == FRESH - 1:
        jax.clear_caches()
    start = time.perf_counter()
    try:
        report = diagnose(folder, **options)
    except Exception as problem:
        report = {"verdict": "error", "message": f"{problem}", "traceback": traceback.format_exc()}
    return report, time.perf_counter() - start


def useless() -> Effect:
    """A candidate that explains nothing: a force that follows the square of an hour-long cosine."""
    size = Quantity("size", "N m", -1.0, 1.0, 0.0)

    def force(p, m):
        return p["size"] * jnp.cos(37.0 * m.t + 11.0 * m.q) ** 3

    return Effect("irrelevant", "force", (size,), force, "nothing physical", "nothing shows it")


def pending(cases: list[Case], out: Path) -> list[Case]:
    return [c for c in cases if not (out / "cases" / f"{c.name}.json").exists()]


def write_batch(cases: list[Case], out: Path) -> list[tuple[Case, Path, dict]]:
    """Make the data sets of a batch and write each to its folder."""
    jobs = []
    for c, ds in zip(cases, make_datasets([c.spec for c in cases]), strict=True):
        ds = disguise(ds, c.variant, c.spec.seed)
        jobs.append((c, write_dataset(ds, out / "data" / c.name), ds.truth))
    return jobs


def run_suite(
    suite: str, cases: list[Case], out: Path, pool: ProcessPoolExecutor | None, keep: bool
) -> None:
    """Diagnose whatever is not done yet, batch by batch."""
    todo = pending(cases, out)
    for at in range(0, len(todo), BATCH):
        jobs = write_batch(todo[at : at + BATCH], out)
        if pool is None:
            results = ((j, diagnose_folder(str(j[1]), j[0].exclude, j[0].variant)) for j in jobs)
        else:
            futures = {
                pool.submit(diagnose_folder, str(j[1]), j[0].exclude, j[0].variant): j for j in jobs
            }
            results = ((futures[f], f.result()) for f in as_completed(futures))
        for (case, folder, truth), (report, seconds) in results:
            record = score_case(suite, case, truth, report) | {"seconds": seconds}
            (out / "cases" / f"{case.name}.json").write_text(
                json.dumps(record, indent=1, default=float)
            )
            (out / "reports" / f"{case.name}.json").write_text(
                json.dumps(report, indent=1, default=str)
            )
            if not keep:
                shutil.rmtree(folder)
            print(f"{case.name:24s} {record['brief']}  {seconds:.1f} s", flush=True)


def main() -> None:
    p = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("--suite", nargs="+", default=["null", "single"], choices=sorted(SUITES))
    p.add_argument("--count", type=int, default=40)
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--out", type=Path, required=True)
    p.add_argument("--workers", type=int, default=1)
    p.add_argument("--keep-data", action="store_true")
    p.add_argument(
        "--generate-only",
        action="store_true",
        help="write the data sets and their truths, no diagnosis",
    )
    a = p.parse_args()
    process.keep_freed()
    process.small_steps()  # as the command does; workers inherit them
    for name in ("cases", "data", "reports"):
        (a.out / name).mkdir(parents=True, exist_ok=True)
    pool = (
        ProcessPoolExecutor(a.workers, get_context("spawn"), process.keep_freed)
        if a.workers > 1
        else None
    )
    suites = {s: SUITES[s](a.count, a.seed) for s in a.suite}
    for suite, cases in suites.items():
        if a.generate_only:
            for c, _, truth in write_batch(cases, a.out):
                (a.out / "data" / f"{c.name}.truth.json").write_text(json.dumps(truth, indent=1))
        else:
            run_suite(suite, cases, a.out, pool, a.keep_data)
    if pool:
        pool.shutdown()
    if not a.generate_only:
        records = [json.loads(f.read_text()) for f in sorted((a.out / "cases").glob("*.json"))]
        if not records:
            return
        results = summarise(records)
        with (a.out / "cases.csv").open("w", newline="") as file:
            rows = csv.DictWriter(file, fieldnames=list(row(records[0])))
            rows.writeheader()
            rows.writerows(map(row, records))
        (a.out / "results.json").write_text(json.dumps(results, indent=1))
        (a.out / "results.md").write_text(table(results))
        print(table(results))


if __name__ == "__main__":
    main()
