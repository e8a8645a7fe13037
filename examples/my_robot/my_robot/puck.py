"""A puck on a table: one push [N s], and where it comes to rest [m]."""

from dataclasses import dataclass

import jax.numpy as jnp

from adaptsim_jax import BadInput, Parameter, Space, Task, TaskKind
from adaptsim_jax.tasks.one_action import one_action

G = 9.81


@dataclass(frozen=True)
class PuckConfig:
    """goal: m from where the puck lies."""

    goal: float = 1.0


def make_puck(config: PuckConfig) -> Task:
    """The policy is a push [N s]; parameters are mass [kg] and friction [1]. BadInput where the
    goal is not ahead.
    """
    if not config.goal > 0:
        raise BadInput(f"goal = {config.goal}: give a distance above 0 m")
    space = Space((Parameter("mass", 0.2, 0.6, "kg"), Parameter("friction", 0.1, 0.4, "1")))

    def train(key, dist, policy):
        mass, friction = space.physical(dist.mean)
        return mass * jnp.sqrt(2.0 * friction * G * config.goal)

    def rollout(key, policy, params):
        return jnp.square(policy / params[0]) / (2.0 * params[1] * G)

    return Task(
        name="puck",
        space=space,
        targets=space,
        obs_dim=1,
        settings={
            "middle": {"mass": 0.4, "friction": 0.25},
            "slick": {"mass": 0.4, "friction": 0.05},
        },
        init_policy=lambda key: jnp.zeros(()),
        train=train,
        rollout=rollout,
        observe=lambda rest: jnp.stack([rest - config.goal]),
        score=lambda rest: -jnp.abs(rest - config.goal),
        reference=lambda params: jnp.zeros(()),
        reward=lambda rest, reference: jnp.maximum(0.0, 1.0 - jnp.abs(rest - config.goal)),
    )


def one_shot(config: PuckConfig):
    """What `adaptsim compare` needs: pushes between 0 and 3 N s."""
    return one_action(make_puck(config), low=[0.0], high=[3.0])


TASK = TaskKind(PuckConfig, make_puck, one_shot)
