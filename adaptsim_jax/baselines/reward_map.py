"""The reward that parameters earn in one target, over a plane of Omega and around it (paper, figure
5).
"""

from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.problem import Problem


class RewardMap(NamedTuple):
    """`reward [Y, X]`: the largest normalised reward in the target at `x [X]`, `y [Y]` (physical)
    over the other parameters.

    `low, high [2]`: the range of Omega of both; the map may reach beyond, where no method may go.
    """

    names: tuple[str, str]
    x: np.ndarray
    y: np.ndarray
    reward: np.ndarray
    low: np.ndarray
    high: np.ndarray


def reward_map(
    problem: Problem,
    target: np.ndarray,
    lower: float,
    upper: float,
    *,
    names: tuple[str, str] = ("m1", "m2"),
    limits: tuple[tuple[float, float], tuple[float, float]] | None = None,
    points: int = 31,
    others: int = 5,
) -> RewardMap:
    """Evaluate in double precision; `lower`, `upper` are the costs of UDR and of the best in Omega
    in `target [D]`.

    `limits` are physical; the other parameters take `others` values each within Omega.
    """
    space = problem.space
    axes = [space.names.index(name) for name in names]
    boxes = np.array([(space.parameters[a].low, space.parameters[a].high) for a in axes])
    x, y = (np.linspace(low, high, points) for low, high in (boxes if limits is None else limits))
    rest = [i for i in range(space.dim) if i not in axes]
    with jax.enable_x64(True):
        u = np.array(list(product(np.linspace(0, 1, others), repeat=len(rest))))
        inner = np.asarray(
            space.physical(jnp.full((len(u), space.dim), 0.5).at[:, np.array(rest, int)].set(u))
        )
        params = np.tile(inner, (points, points, 1, 1))
        params[..., axes[0]], params[..., axes[1]] = x[None, :, None], y[:, None, None]

        def cost(p):
            return problem.cost(jnp.asarray(target, jnp.float64), problem.policy(p))

        flat = jax.jit(jax.vmap(cost))(jnp.asarray(params.reshape(-1, space.dim)))
    best = np.asarray(flat).reshape(points, points, -1).min(axis=-1)
    return RewardMap(names, x, y, (lower - best) / (lower - upper), boxes[:, 0], boxes[:, 1])
