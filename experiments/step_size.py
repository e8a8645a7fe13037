"""Adaptation step 0.05, 0.10, 0.15, 0.20 in OOD-1 (paper, figure A9): all seeds and steps in one
compiled program.

python experiments/step_size.py
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from curves import median_curve
from matplotlib.figure import Figure
from page import parser, rows_table, scored_row, train_config, write_page

from adaptsim_jax import make_task
from adaptsim_jax.adaptation.phase1 import make_phase1
from adaptsim_jax.baselines.bounds import costs, pendulum_problem
from adaptsim_jax.baselines.compare_exact import find_bounds
from adaptsim_jax.baselines.exact_methods import adaptsim_means
from adaptsim_jax.core.progress import progress
from adaptsim_jax.report import figures as look

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
    figure = curves_by(rows, [r["method"] for r in rows], "OOD-1, adaptation step δ")
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


def curves_by(rows: Sequence[Mapping[str, Any]], names: Sequence[str], title: str) -> Figure:
    """Reward over iterations for one row of results a curve, as the step-size figure of the
    appendix.
    """
    shades = ["#56B4E9", "#0072B2", "#E69F00", "#D55E00", "#CC79A7"]
    figure, (ax,) = look.new_figure(4.2, 3.0)
    for i, (r, name) in enumerate(zip(rows, names, strict=True)):
        line = {"color": shades[i % len(shades)], "linestyle": ["-", "--", "-.", ":"][i % 4]}
        median_curve(ax, r["curve"], line, name, -0.4)
    look.style_axes(ax)
    ax.set_ylim(-0.4, 1.08)
    ax.set_xlabel("adaptation iteration", fontsize=9)
    ax.set_ylabel(look.REWARD.replace(" (", "\n("), fontsize=9)
    ax.set_title(title, fontsize=9.5, color=look.INK)
    ax.legend(frameon=False, fontsize=8, loc="lower right")
    return figure


if __name__ == "__main__":
    main()
