"""A task and a problem so small that every answer is known: what the baselines' tests share."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.bounds import ExactProblem
from adaptsim_jax.space import Parameter, Space
from adaptsim_jax.tasks.base import Task

SPACE = Space((Parameter("a", 1.0, 2.0), Parameter("b", 10.0, 30.0)))


class ProbeTrajectory(NamedTuple):
    seen: jax.Array
    score: jax.Array


def probe_task() -> Task:
    """The policy is the mean of E; the observation mixes parameters and policy linearly, so both
    are recovered exactly.
    """

    def rollout(key, policy, params):
        u = SPACE.unit(params)
        mixed = jnp.stack([u[0] + u[1], u[0] - u[1] + 0.3 * policy[0], 0.5 * u[1] + policy[1]])
        return ProbeTrajectory(mixed, -jnp.sum((u - policy) ** 2))

    return Task(
        name="probe",
        space=SPACE,
        targets=SPACE,
        obs_dim=3,
        settings={"inside": {"a": 1.3, "b": 26.0}, "outside": {"a": 0.0, "b": 26.0}},
        init_policy=lambda key: jnp.zeros(2),
        train=lambda key, dist, policy: dist.mean,
        rollout=rollout,
        observe=lambda trajectory: trajectory.seen,
        score=lambda trajectory: trajectory.score,
        reference=lambda params: jnp.zeros(()),
        reward=lambda trajectory, reference: 1.0 + trajectory.score,
    )


def probe_problem() -> ExactProblem:
    """`cost = 1 + w (p - policy)^2`, policy = params: UDR is the centre, the best in Omega the
    target clipped to it.
    """
    weights = np.array([1.0, 0.01])

    def cost(params, policy):
        return 1.0 + jnp.sum(jnp.asarray(weights, params.dtype) * (params - policy) ** 2)

    def cost_at(u, target):
        return cost(target, SPACE.physical(u))

    return ExactProblem(
        space=SPACE,
        policy=lambda params: params,
        cost=cost,
        mean_cost=cost,
        points=lambda params, policy: jnp.stack([params, params + policy]),
        cost_at=cost_at,
        slope=jax.value_and_grad(cost_at),
    )
