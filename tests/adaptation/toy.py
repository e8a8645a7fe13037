"""A task whose best answer is known: move the mean of E onto the target, which the observation
shows with an offset.
"""

import jax.numpy as jnp

from adaptsim_jax.space import Parameter, Space
from adaptsim_jax.tasks.base import Task


def make_toy(dim: int = 2) -> Task:
    """The "task policy" is the mean itself, the observation target minus mean, the reward `1 - 2
    |target - mean|`.
    """
    space = Space(tuple(Parameter(f"p{i}", 1.0, 3.0, "kg") for i in range(dim)))
    return Task(
        name="toy",
        space=space,
        targets=space,
        obs_dim=dim,
        settings={"centre": {p: 2.0 for p in space.names}},
        init_policy=lambda key: jnp.zeros(dim),
        train=lambda key, dist, policy: dist.mean,
        rollout=lambda key, policy, params: (params - 1.0) / 2.0 - policy,
        observe=lambda trajectory: 2.0 * trajectory,
        score=lambda trajectory: -jnp.linalg.norm(trajectory),
        reference=lambda params: jnp.zeros(()),
        reward=lambda trajectory, reference: 1.0 - 2.0 * jnp.linalg.norm(trajectory),
    )
