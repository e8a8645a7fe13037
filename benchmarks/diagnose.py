"""Time of `adaptsim diagnose` on recordings of 6 trials of 6 s at 200 Hz, with an empty and with a
warm compile cache.

    python -m benchmarks.diagnose                        all four recordings, cold and then warm
    python -m benchmarks.diagnose --only null --no-cold  one of them, warm
    # a recording of the suites (SUITE:SEED) in their place
    python -m benchmarks.diagnose --case outside:17091

Each diagnosis is the command in a process of its own, everything included: import, compiling, the
next experiment, the page. Cold: a new cache folder for each; warm: that folder again. Recordings
come from the suites' generator, with seeds that are for tuning: nothing hidden, one effect (Coulomb
friction), two effects, and one effect that the catalogue is denied.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.generators import Spec, make_datasets, write_dataset
from tests.generators.suites import SUITES

SEED = 900
DRAG = ("quadratic_drag", 1, 4.0)
SPECS = {  # recording, and what the catalogue is denied
    "null": (Spec(SEED), ()),
    "one effect": (Spec(SEED + 1, effects=(("coulomb", 2, 5.0),)), ()),
    "two effects": (Spec(SEED + 2, effects=(("coulomb", 2, 5.0), ("spring", 1, 5.0))), ()),
    "not in the catalogue": (Spec(SEED + 3, effects=(DRAG,)), (DRAG[0],)),
}


def diagnose(
    folder: Path, out: Path, exclude: tuple[str, ...], cache: Path
) -> tuple[float, float, str]:
    """Wall and CPU seconds of one command, and its verdict."""
    options = ["--exclude", *exclude] if exclude else []
    command = [
        sys.executable,
        "-m",
        "adaptsim_jax",
        "diagnose",
        str(folder),
        "--out",
        str(out),
        *options,
    ]
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(cache)}
    subprocess.run(command, check=True, capture_output=True, env=environment)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall, cpu, json.loads((out / "report.json").read_text())["verdict"]


def of_suite(text: str) -> tuple[Spec, tuple[str, ...]]:
    """The suites' recording SUITE:SEED, and what the catalogue is denied; ValueError where there is
    none.
    """
    suite, _, seed = text.partition(":")
    if suite not in SUITES or not seed.isdigit():
        raise ValueError(f"{text} is no recording of the suites")
    case = SUITES[suite](1, int(seed))[0]
    return case.spec, case.exclude


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", default=list(SPECS), choices=SPECS)
    parser.add_argument(
        "--case",
        nargs="+",
        metavar="SUITE:SEED",
        help="recordings of the suites instead of those four",
    )
    parser.add_argument(
        "--no-cold", action="store_true", help="leave the first run of each untimed"
    )
    args = parser.parse_args()
    try:
        chosen = (
            {c: of_suite(c) for c in args.case}
            if args.case
            else {name: SPECS[name] for name in args.only}
        )
    except ValueError as problem:
        parser.error(
            f"--case: {problem}; give SUITE:SEED of {', '.join(sorted(SUITES))}, such as "
            "outside:17091"
        )
    print(f"{'recording':22} {'cache':6} {'wall s':>7} {'CPU s':>7}  verdict", flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        for i, (name, (spec, exclude)) in enumerate(chosen.items()):
            folder = write_dataset(make_datasets([spec])[0], Path(scratch) / f"data{i}")
            for cache in ("cold", "warm"):
                wall, cpu, verdict = diagnose(
                    folder, Path(scratch) / f"out{i}", exclude, Path(scratch) / f"cache{i}"
                )
                if cache == "warm" or not args.no_cold:
                    print(f"{name:22} {cache:6} {wall:7.1f} {cpu:7.1f}  {verdict}", flush=True)


if __name__ == "__main__":
    main()
