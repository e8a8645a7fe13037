"""N = 1..4 initial distributions in Phase 2 (paper, figure A8, there for pushing): reward against
target rollouts.

One Phase 1 a seed and one Phase 2 with four starts; the first N of them are the result for N, as
they never interact.

python experiments/initial_distributions.py
"""

import numpy as np
from curves import reward_against_trials
from page import parser, rows_table, scored_row, train_config, write_page

from adaptsim_jax import make_task
from adaptsim_jax.adaptation.phase1 import make_phase1
from adaptsim_jax.baselines.bounds import costs, pendulum_problem
from adaptsim_jax.baselines.compare_exact import find_bounds
from adaptsim_jax.baselines.exact_methods import adaptsim_means
from adaptsim_jax.core.progress import progress
from adaptsim_jax.report import figures as look

MOST, ITERATIONS = 4, 10


def main() -> None:
    args = parser(__doc__).parse_args()
    config = train_config(args)
    task = make_task("pendulum", config.task)
    names = list(task.settings)
    targets = np.array([task.space.values(task.settings[name]) for name in names])
    problem = pendulum_problem(task.space)
    bounds = find_bounds(problem, targets)
    with progress("initial distributions") as report:
        means = adaptsim_means(
            make_phase1(task, config.phase1),
            [config.hyper],
            np.arange(args.seeds),
            targets,
            starts=MOST,
            report=report,
        )
    cost = costs(problem, means[0], targets)
    panels = {
        name: rows_of(cost[i], bounds.lower[i], bounds.upper[i]) for i, name in enumerate(names)
    }
    args.out.mkdir(parents=True, exist_ok=True)
    look.save(reward_against_trials(panels), args.out / "initial_distributions.png")
    parts = [f"{args.seeds} seeds. Curves: mean over seeds of the best reward found so far."]
    for name, rows in panels.items():
        parts += [f"## {look.SETTINGS[name]}", rows_table(rows, "N")]
    write_page(
        args.out,
        "initial_distributions",
        "Number of initial distributions",
        parts,
        panels,
        ["initial_distributions.png"],
    )


def rows_of(cost: np.ndarray, lower: float, upper: float) -> list[dict]:
    """A row for each N from costs `[S, 4, I + 1]`, with the best reward so far against target
    rollouts.
    """
    rows = []
    for n in range(1, MOST + 1):
        found = scored_row(f"N = {n}", cost[:, :n], lower, upper, n * (ITERATIONS + 1))
        so_far = np.minimum.accumulate(cost[:, :n].min(axis=1), axis=1)
        found["so_far"] = ((lower - so_far) / (lower - upper)).mean(axis=0).tolist()
        found["trials"] = [n * (i + 1) for i in range(ITERATIONS + 1)]
        rows.append(found)
    return rows


if __name__ == "__main__":
    main()
