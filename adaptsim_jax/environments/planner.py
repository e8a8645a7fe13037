"""Predictive sampling: no training, the policy is the simulator with E's mean (Howell et al. 2022,
"Predictive sampling").

At every step the plan so far and noisy copies of it are rolled out in the simulator from where the
target is. The best is gone on with, and its first action made.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.episodes import ActingPolicy, Live, Play
from adaptsim_jax.space import Space


@dataclass(frozen=True)
class PlannerConfig:
    """samples: plans tried at each step; horizon: steps ahead; knots: of a plan, between which
    actions are interpolated; noise: standard deviation of what is added to them.
    """

    samples: int = 16
    horizon: int = 40
    knots: int = 6
    noise: float = 0.5

    def __post_init__(self):
        if min(self.samples, self.horizon, self.knots) < 2 or not self.noise > 0:
            raise BadInput(
                f"planner: {self}: give at least 2 samples, steps and knots, and a noise above 0"
            )


def make_planner(play: Play, space: Space, config: PlannerConfig) -> ActingPolicy:
    """Plans by the whole state of the target, in the world at `policy.mean` (unit coordinates
    `[D]`, other fields nominal).
    """
    A, H, K = play.sim.action_dim, config.horizon, config.knots
    at = jnp.linspace(0.0, K - 1.0, H)
    knots = jnp.arange(K)[None]
    weights = jnp.clip(1.0 - jnp.abs(at[:, None] - knots), 0.0, 1.0)  # [H, K]
    moved = jnp.clip(1.0 - jnp.abs(knots.T + (K - 1.0) / (H - 1.0) - knots), 0.0, 1.0)
    moved = moved / moved.sum(1, keepdims=True)
    rest = jnp.asarray([f.nominal for f in play.fields[space.dim :]], jnp.float32)

    def start(policy):
        return jnp.zeros((K, A))

    def act(key, policy, plan, live: Live):
        world = play.world(jnp.concatenate([space.physical(policy.mean), rest]))
        noise = config.noise * jax.random.normal(key, (config.samples, K, A))
        plans = jnp.clip(plan[None] + noise.at[0].set(0.0), -1.0, 1.0)

        def worth(one):
            def step(carry, action):
                live, on = carry
                live = play.step(world, live, action)
                return (live, on * (1.0 - live.done)), on * live.reward

            return jax.lax.scan(step, (live, jnp.ones(())), weights @ one)[1].sum()

        best = plans[jnp.argmax(jnp.nan_to_num(jax.vmap(worth)(plans), nan=-jnp.inf))]
        return best[0], moved @ best

    return ActingPolicy(start, act)
