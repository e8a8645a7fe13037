"""Adaptation step 0.05, 0.10, 0.15, 0.20 in OOD-1 (paper, figure A9): all seeds and steps in one
compiled program.

python experiments/step_size.py
"""

from dataclasses import replace

import numpy as np
from page import parser, rows_table, scored_row, train_config, write_page

from adaptsim_jax import make_task
from adaptsim_jax.adaptation.phase1 import make_phase1
from adaptsim_jax.baselines.bounds import costs, pendulum_problem
from adaptsim_jax.baselines.compare_exact import find_bounds
from adaptsim_jax.baselines.exact_methods import adaptsim_means
from adaptsim_jax.core.progress import progress
from adaptsim_jax.report import figures as look
from adaptsim_jax.report import figures_comparison as draw

STEPS = (0.05, 0.10, 0.15, 0.20)
STARTS, ITERATIONS = 2, 10


def main() -> None:
    args = parser(__doc__).parse_args()
    config = train_config(args)
    task = make_task("pendulum", config.task)
    targets = np.array([task.space.values(task.settings["ood-1"])])
    problem = pendulum_problem(task.space)
    bounds = find_bounds(problem, targets)
    hypers = [replace(config.hyper, delta=delta) for delta in STEPS]
    with progress("step sizes") as report:
        means = adaptsim_means(
            make_phase1(task, config.phase1), hypers, np.arange(args.seeds), targets, report=report
        )
    rows = [
        scored_row(
            f"δ = {d:.2f}",
            costs(problem, m, targets)[0],
            bounds.lower[0],
            bounds.upper[0],
            STARTS * (ITERATIONS + 1),
        )
        for d, m in zip(STEPS, means, strict=True)
    ]
    args.out.mkdir(parents=True, exist_ok=True)
    figure = draw.curves_by(rows, [r["method"] for r in rows], "OOD-1, adaptation step δ")
    look.save(figure, args.out / "step_size.png")
    text = (
        f"{args.seeds} seeds; Phase 1 anew for each step size and seed. Curves: median and "
        "quartiles over seeds of the better of two distributions at each iteration."
    )
    write_page(
        args.out,
        "step_size",
        "Adaptation step size",
        [text, rows_table(rows, "step")],
        rows,
        ["step_size.png"],
    )


if __name__ == "__main__":
    main()
