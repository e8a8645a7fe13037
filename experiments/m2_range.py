"""OOD-1 (m2 = 0.3) as the range of m2 in Omega moves away: [1, 2] to [1.3, 2.3] (paper, figure A7).

Ranges are a traced offset, so one compiled program serves all ranges and seeds of a method.

python experiments/m2_range.py
"""

import numpy as np
from curves import against
from page import parser, rows_table, scored_row, sysid_config, train_config, write_page
from ranges import adaptsim_over_ranges, sysid_over_ranges

from adaptsim_jax.baselines.bounds import costs, pendulum_problem
from adaptsim_jax.baselines.compare_exact import find_bounds
from adaptsim_jax.baselines.sysid import mixture_estimator, point_estimator
from adaptsim_jax.core.progress import progress
from adaptsim_jax.report import figures as look
from adaptsim_jax.tasks.pendulum.task import SETTINGS, PendulumConfig, pendulum_space

SHIFTS = (0.0, 0.1, 0.2, 0.3)
TRIALS = {"adaptsim": 22, "sysid_bayes": 11, "sysid_point": 11}


def main() -> None:
    args = parser(__doc__).parse_args()
    seeds = np.arange(args.seeds)
    offsets = np.array([[0.0, shift, 0.0, 0.0] for shift in SHIFTS])
    spaces = [pendulum_space(PendulumConfig(m2=(1.0 + s, 2.0 + s))) for s in SHIFTS]
    target = np.array(spaces[0].values(SETTINGS["ood-1"]))
    means = {}
    for name, over in methods(args).items():
        with progress(f"m2 ranges, {name}") as report:
            means[name] = over(offsets, seeds, target, report=report)
    rows = {name: [] for name in means}
    for i, space in enumerate(spaces):
        problem = pendulum_problem(space)
        bounds = find_bounds(problem, target[None])
        for name in means:
            cost = costs(problem, means[name][i][None], target[None])[0]
            rows[name].append(
                scored_row(ticks()[i], cost, bounds.lower[0], bounds.upper[0], TRIALS[name])
            )
    args.out.mkdir(parents=True, exist_ok=True)
    figure = against(rows, ticks(), "range of m2 in Ω (kg); target m2 = 0.3 kg")
    look.save(figure, args.out / "m2_range.png")
    parts = [
        f"{args.seeds} seeds. Each range has its own normalisers: UDR over that Omega is 0, the "
        "best policy in it is 1. AdaptSim's Phase 1 is run anew for each range and seed."
    ]
    for name, found in rows.items():
        parts += [f"## {look.label(name)}", rows_table(found, "range of m2")]
    write_page(args.out, "m2_range", "Range of m2 in Omega, OOD-1", parts, rows, ["m2_range.png"])


def methods(args):
    config, sysid = train_config(args), sysid_config(args)
    return {
        "adaptsim": lambda *a, **k: adaptsim_over_ranges(config, *a, **k),
        "sysid_bayes": lambda *a, **k: sysid_over_ranges(mixture_estimator, sysid, *a, **k),
        "sysid_point": lambda *a, **k: sysid_over_ranges(point_estimator, sysid, *a, **k),
    }


def ticks() -> list[str]:
    return [f"[{1 + s:.1f}, {2 + s:.1f}]" for s in SHIFTS]


if __name__ == "__main__":
    main()
