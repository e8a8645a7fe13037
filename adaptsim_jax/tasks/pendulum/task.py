"""Swing-up of the linearized double pendulum (paper, section 5.1): the task policy is an LQR gain.

The gain is the optimal one at the mean of E, solved and not learned. Costs are sums over 1000
samples of 2.5 s; the return is minus the cost, and the reward `1 - gain (cost / reference - 1)`.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.double_pendulum import linear as model
from adaptsim_jax.space import Space
from adaptsim_jax.tasks.base import Task, space_of, tables

SETTINGS = tables()["pendulum"]["settings"]


@dataclass(frozen=True)
class PendulumConfig:
    """Options of the task.

    observation: 12 points over the whole trajectory (`full`) or in its last 0.5 s (`late`, the
        paper's state-only variant).
    scaling: `paper` ((q1 + pi) / pi and q2 as they are) or `whitened` (principal components of
        simulated trajectories, each to unit variance, and compressed where they are far out).
        components: How many of those.
    reference: Rewards relative to the target's own optimal cost (`optimum`) or to the best that a
        gain from Omega reaches there (`omega`, as the paper's Table 1 normalises). reward_gain:
        cost 1/gain above the reference gives 0.
    targets: Phase 1 draws targets from Omega (the paper), or from a box around it (`wide`).
    m1, m2, b1, b2: Omega.
    """

    observation: Literal["full", "late"] = "full"
    scaling: Literal["paper", "whitened"] = "whitened"
    components: int = 12
    reference: Literal["optimum", "omega"] = "omega"
    reward_gain: float = 10.0
    targets: Literal["omega", "wide"] = "wide"
    m1: tuple[float, float] = (1.0, 2.0)
    m2: tuple[float, float] = (1.0, 2.0)
    b1: tuple[float, float] = (1.0, 2.0)
    b2: tuple[float, float] = (1.0, 2.0)


class PendulumTrajectory(NamedTuple):
    """angles: `[12, 2]` rad at the observed samples; cost: `[]`; code: `[]`, a code of
    `double_pendulum.linear`.
    """

    angles: Array
    cost: Array
    code: Array


class PendulumPolicy(NamedTuple):
    """gain: `[2, 4]`, torque = -gain @ state; code: `[]`, the Riccati solver's."""

    gain: Array
    code: Array


def pendulum_space(config: PendulumConfig = PendulumConfig()) -> Space:
    """Omega: two masses and two joint dampings."""
    return space_of("pendulum", "omega", config)


def wide_space() -> Space:
    """A box around Omega for Phase-1 targets that Omega cannot reproduce.

    Masses are logarithmic; dampings are not, so that targets with two large ones are not rare.
    """
    return space_of("pendulum", "wide")


def make_pendulum(config: PendulumConfig = PendulumConfig()) -> Task:
    """The pendulum as a `Task`; everything in it is exact, deterministic and differentiable."""
    if config.reward_gain <= 0 or not 1 <= config.components <= 24:
        raise BadInput(f"reward_gain must be positive and components in 1..24, got {config}")
    space = pendulum_space(config)
    if config.observation == "full":
        indices = model.SNAPSHOTS
    else:
        indices = model.LATE_SNAPSHOTS

    def train(key, dist, policy):
        gain, code = model.optimal_gain(space.physical(dist.mean))
        return PendulumPolicy(gain, code)

    def rollout(key, policy, params):
        out = model.rollout(params, policy.gain, indices)
        return PendulumTrajectory(out.points[:, :2], out.cost, out.code)

    def optimum(params):
        return model.rollout(params, model.optimal_gain(params).gain, indices).cost

    search = best_in_space(space) if config.reference == "omega" else None
    if search is None:
        reference = optimum
    else:

        def reference(params):
            return search(params)[1]

    if config.scaling == "paper":
        observe, obs_dim = paper_scaling, 24
    else:
        observe, obs_dim = _whitening(space, indices, config.components), config.components
    return Task(
        name="pendulum",
        space=space,
        targets=space if config.targets == "omega" else wide_space(),
        obs_dim=obs_dim,
        settings=SETTINGS,
        init_policy=lambda key: PendulumPolicy(jnp.zeros((2, 4)), jnp.zeros((), jnp.int32)),
        train=train,
        rollout=rollout,
        observe=observe,
        score=lambda trajectory: -trajectory.cost,
        reference=reference,
        reward=lambda trajectory, best: 1.0 - config.reward_gain * (trajectory.cost / best - 1.0),
    )


def best_in_space(space: Space, halvings: int = 4):
    """A search of Omega for the mean whose gain is cheapest in a target: `params [D] -> (u [D],
    cost [])`.

    The gains of a grid of three values a parameter are solved here, once. The cheapest of them, or
    the target itself clipped into the box, starts a pattern search whose step halves from a quarter
    of the range. Within 2e-3 of a dense search for 99 % of wide targets (`tests/tasks`): enough to
    scale rewards, not to report them.
    """
    line = np.linspace(0.0, 1.0, 3, dtype=np.float32)
    grid = np.stack(np.meshgrid(*[line] * space.dim, indexing="ij"), -1).reshape(-1, space.dim)

    def solve(u):
        return model.optimal_gain(space.physical(u)).gain

    gains = jax.jit(jax.vmap(solve))(grid)
    moves = np.concatenate([np.eye(space.dim), -np.eye(space.dim)]).astype(np.float32)

    def search(params):
        cost = jax.vmap(lambda gain: model.rollout(params, gain, (0,)).cost)

        def better_of(best, us, costs):
            k = jnp.argmin(costs)
            cheapest = (us[k], costs[k])
            return jax.tree.map(lambda a, b: jnp.where(costs[k] < best[1], a, b), cheapest, best)

        def refine(best, size):
            us = jnp.clip(best[0][None] + moves * size, 0.0, 1.0)
            return better_of(best, us, cost(jax.vmap(solve)(us))), None

        clipped = jnp.clip(space.unit(params), 0.0, 1.0)[None]
        best = better_of(
            (clipped[0], cost(solve(clipped[0])[None])[0]), jnp.asarray(grid), cost(gains)
        )
        return jax.lax.scan(refine, best, 0.25 * 0.5 ** jnp.arange(halvings, dtype=jnp.float32))[0]

    return search


def paper_scaling(trajectory: PendulumTrajectory) -> Array:
    """`[24]`: q1 by pi about the start, q2 in rad."""
    q1, q2 = trajectory.angles[:, 0], trajectory.angles[:, 1]
    return jnp.stack([(q1 + jnp.pi) / jnp.pi, q2], -1).reshape(-1)


def _squash(x: Array) -> Array:
    """Near enough linear to 1, logarithmic far out: what a diverging target shows must not swamp a
    network.
    """
    return jnp.sign(x) * jnp.log1p(jnp.abs(x))


def _whitening(space: Space, indices: tuple[int, ...], components: int):
    """Principal components of the observed angles over random pairs of E and target within Omega,
    to unit variance.

    Only simulation enters: 4000 pairs with a fixed seed, computed when the task is made.
    """
    rng = np.random.default_rng(0)
    pairs = space.physical(jnp.asarray(rng.uniform(size=(2, 4000, space.dim)), jnp.float32))

    @jax.jit
    @jax.vmap
    def angles(sim, target):
        return (
            model.rollout(target, model.optimal_gain(sim).gain, indices).points[:, :2].reshape(-1)
        )

    data = np.asarray(angles(*pairs), np.float64)
    centre = data.mean(0)
    _, spread, axes = np.linalg.svd(data - centre, full_matrices=False)
    scale = axes[:components] / (spread[:components, None] / np.sqrt(len(data)))
    scale, centre = jnp.asarray(scale, jnp.float32), jnp.asarray(centre, jnp.float32)
    return lambda trajectory: _squash(scale @ (trajectory.angles.reshape(-1) - centre))
