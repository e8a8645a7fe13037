"""How the options of the SysID baselines were chosen: on random targets, none of them one of the paper's five.

Half of the targets lie in Omega, half have one or two parameters outside of it. Options: simulated-observation noise, and
pooling what all iterations inferred.

python experiments/sysid_options.py
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from page import parser, sysid_config, write_page

from adaptsim_jax import make_task
from adaptsim_jax.baselines.compare import find_bounds
from adaptsim_jax.baselines.problem import costs, pendulum_problem
from adaptsim_jax.baselines.summary import normalised
from adaptsim_jax.baselines.sysid_bayes import make_sysid_bayes
from adaptsim_jax.baselines.sysid_point import make_sysid_point

MAKERS = {"sysid_bayes": make_sysid_bayes, "sysid_point": make_sysid_point}
CHANGES = {
    "as it is": {},
    "noise 0.01": {"noise": 0.01},
    "noise 0.1": {"noise": 0.1},
    "pooled": {"pool": True},
    "noise 0.1, pooled": {"noise": 0.1, "pool": True},
}


def targets_of(count: int) -> np.ndarray:
    """`count` targets within Omega and as many outside, physical."""
    rng = np.random.default_rng(20)
    inside = rng.uniform(1, 2, (count, 4))
    outside = rng.uniform(1, 2, (count, 4))
    for row in outside:
        for i in rng.choice(4, rng.integers(1, 3), replace=False):
            low, high = ((0.35, 0.8), (2.2, 3.0)) if i < 2 else ((0.3, 0.8), (3.0, 9.0))
            row[i] = rng.uniform(*(low if rng.random() < 0.5 else high))
    return np.concatenate([inside, outside])


def main() -> None:
    arguments = parser(__doc__, seeds=1)
    arguments.add_argument("--targets", type=int, default=16, help="of each kind")
    args = arguments.parse_args()
    task = make_task("pendulum", {"scaling": "paper", "reference": "optimum"})
    problem = pendulum_problem(task.space)
    targets = targets_of(args.targets)
    bounds = find_bounds(problem, targets)
    lines = [
        "| method | options | inside: best, median | inside: last, median | outside: best, median (mean clipped) "
        "| outside: last, median (mean clipped) |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    data = {}
    for name, make in MAKERS.items():
        for title, change in CHANGES.items():
            reward = rewards(make(task, replace(sysid_config(args), **change)), problem, targets, bounds, args.seeds)
            data[f"{name}, {title}"] = reward
            lines.append(f"| {name} | {title} | {cells(reward, args.targets)} |")
            print(lines[-1], flush=True)
    text = f"{args.targets} targets of each kind, {args.seeds} seed(s); UDR is 0, the best in Omega 1."
    write_page(args.out, "sysid_options", "Options of the SysID baselines", [text, "\n".join(lines)], data)


def rewards(adapt, problem, targets, bounds, seeds) -> np.ndarray:
    """`[T, S, I + 1]` normalised."""
    run = jax.jit(jax.vmap(adapt))
    means = []
    for i, target in enumerate(targets):
        keys = jax.vmap(lambda s, i=i: jax.random.fold_in(jax.random.key(s), i))(jnp.arange(seeds))
        aims = jnp.broadcast_to(jnp.asarray(target, jnp.float32), (seeds, 4))
        means.append(np.asarray(run(keys, aims).means))
    return normalised(costs(problem, np.stack(means), targets), bounds.lower, bounds.upper)


def cells(reward: np.ndarray, count: int) -> str:
    inside, outside = reward[:count], reward[count:]
    clipped = lambda x: np.clip(x, 0, 1).mean()
    return (
        f"{np.median(inside.max(-1)):.3f} | {np.median(inside[..., -1]):.3f} "
        f"| {np.median(outside.max(-1)):.2f} ({clipped(outside.max(-1)):.2f}) "
        f"| {np.median(outside[..., -1]):.2f} ({clipped(outside[..., -1]):.2f})"
    )


if __name__ == "__main__":
    main()
