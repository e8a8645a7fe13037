"""Which UDR makes a lower bound: mean cost from the task's own start, or over starts (see
docs/explanation/differences.md).

python experiments/udr_bound.py
"""

from dataclasses import replace

import jax
import numpy as np
from page import parser, write_page

from adaptsim_jax.baselines.bounds import best_in_omega, pendulum_problem, udr
from adaptsim_jax.tasks.pendulum.task import SETTINGS, pendulum_space

RESTARTS = 5


def main() -> None:
    args = parser(__doc__).parse_args()
    problem = pendulum_problem(pendulum_space())
    names = list(SETTINGS)
    targets = np.array([problem.space.values(SETTINGS[name]) for name in names])
    best = best_in_omega(problem, targets).cost
    single = replace(problem, mean_cost=problem.cost)
    found = {
        "over starts (used)": udr(problem, restarts=RESTARTS),
        "task's start only": udr(single, restarts=RESTARTS),
    }
    lines = [
        "Cost of UDR over the cost of the best policy of Omega, in each setting. Below 1 the "
        "bound is above the upper one.",
        "",
        "| mean cost | " + " | ".join(names) + " | restarts, cost over the lowest | largest gain |",
        "| --- |" + " --- |" * (len(names) + 2),
    ]
    data = {}
    for name, result in found.items():
        ratios = ratio(problem, result.policy, targets, best)
        spread = result.restarts / result.restarts.min()
        data[name] = {"ratios": ratios, "restarts": result.restarts, "policy": result.policy}
        cells = " | ".join(f"{r:.4f}" if r < 1e3 else f"{r:.0e}" for r in ratios)
        ends = ", ".join(f"{s:.6f}" for s in spread)
        lines.append(f"| {name} | {cells} | {ends} | {np.abs(result.policy).max():.0f} |")
    text = (
        f"{RESTARTS} restarts of BFGS each, at most 300 iterations, 512 Sobol points of Omega, "
        "double precision."
    )
    write_page(args.out, "udr_bound", "UDR as the lower bound", [text, "\n".join(lines)], data)


def ratio(problem, policy, targets, best) -> np.ndarray:
    with jax.enable_x64(True):
        return np.array([float(problem.cost(t, policy)) for t in targets]) / best


if __name__ == "__main__":
    main()
