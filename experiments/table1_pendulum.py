"""Table 1, pendulum columns: every method, five settings, 20 seeds.

python experiments/table1_pendulum.py
python experiments/table1_pendulum.py --seeds 2 --trajectories 500 --simulations 200 --out
/tmp/quick
"""

import numpy as np
from curves import reward_over_iterations
from page import parser, sysid_config, train_config, write_page

from adaptsim_jax import compare
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.core.progress import progress
from adaptsim_jax.report import figures as look
from adaptsim_jax.report.comparison import table

PAPER = {
    "adaptsim": [0.98, 0.96, 0.95, 0.95, 0.98],
    "sysid_bayes": [0.85, 0.76, 0.79, 0.23, 0.96],
    "sysid_point": [0.95, 0.60, 0.73, 0.39, 0.76],
}


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--methods", default="")
    args = arguments.parse_args()
    methods = tuple(m for m in args.methods.split(",") if m)
    config = CompareConfig(
        methods=methods, seeds=args.seeds, train=train_config(args), sysid=sysid_config(args)
    )
    with progress("Table 1") as report:
        results = compare("pendulum", config, report)
    figures = ["table1_pendulum_iterations.png"]
    out = args.out
    out.mkdir(parents=True, exist_ok=True)
    main_rows = [
        m for m in dict.fromkeys(r["method"] for r in results["rows"]) if not m.endswith("_state")
    ]
    look.save(reward_over_iterations(results, main_rows), out / figures[0])
    parts = [
        table(results).rsplit("\n\nCommand:", 1)[0],
        "The paper's values, for comparison (its UDR is not described for this task, so its zero "
        "may lie elsewhere):",
        paper_table(),
        failures(results),
    ]
    write_page(out, "table1_pendulum", "Table 1, pendulum columns", parts, results, figures)


def paper_table() -> str:
    lines = ["| method | WD | OOD-1 | OOD-2 | OOD-3 | OOD-4 |", "| --- |" + " --- |" * 5]
    lines += [
        f"| {look.label(m)} | " + " | ".join(f"{v:.2f}" for v in values) + " |"
        for m, values in PAPER.items()
    ]
    return "\n".join(lines)


def failures(results) -> str:
    bad = [
        f"{r['method']} in {r['setting']}: {r['failed']}"
        for r in results["rows"]
        if r.get("failed")
    ]
    worst = [
        f"{look.label(r['method'])} in {r['setting']}: {np.min(r['per_seed']):.2f}"
        for r in results["rows"]
        if r["method"] in VISITED and None not in r["per_seed"] and np.min(r["per_seed"]) < 0.5
    ]
    return (
        f"Visits whose cost was not finite: {'; '.join(bad) or 'none'}. Rows with a seed below 0.5 "
        f"at its best iteration (worst seed): {'; '.join(worst) or 'none'}."
    )


VISITED = (
    "adaptsim",
    "adaptsim_state",
    "adaptsim_analytic",
    "sysid_bayes",
    "sysid_bayes_state",
    "sysid_point",
    "sysid_point_state",
)

if __name__ == "__main__":
    main()
