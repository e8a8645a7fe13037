"""Parameters that each method found, a dot a seed, beside the target's and Omega (paper, the
figures of pushing).

Reads what `adaptsim compare` left; run one first.

python experiments/parameters_found.py --results results/results.json --out results
"""

import argparse
import json
from pathlib import Path

from adaptsim_jax import make_task
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.report import figures as look
from adaptsim_jax.report.figures_comparison import axes_of, parameters_found
from adaptsim_jax.tasks.registry import TASKS


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument(
        "--results", type=Path, required=True, help="results.json of `adaptsim compare`"
    )
    arguments.add_argument("--out", type=Path, required=True, help="folder of parameters_found.png")
    args = arguments.parse_args()
    if not args.results.is_file():
        raise SystemExit(
            f"{args.results}: no such file; run `adaptsim compare pushing --out DIR`, give "
            "DIR/results.json"
        )
    results = json.loads(args.results.read_text())
    if not any(row.get("best_params") for row in results["rows"]):
        raise SystemExit(
            f"{args.results}: no method in it adapts parameters; compare adaptsim or sysid-bayes"
        )
    space = make_task(results["task"], {}).space
    figure = parameters_found(results, axes_of(space, TASKS[results["task"]].symbols))
    print(f"written: {look.save(figure, output_folder(args.out) / 'parameters_found.png')}")


if __name__ == "__main__":
    main()
