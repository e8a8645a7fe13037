"""What the mended model is worth for the task: policies trained on the declared and on the mended
model, compared.
"""

from typing import Any

import jax
import jax.numpy as jnp

from adaptsim_jax.mechanisms.closed_loop import Course, Law, run_loop
from adaptsim_jax.mechanisms.stepping import Sample
from adaptsim_jax.mend.pendulum_model import ModelFile
from adaptsim_jax.tasks.pendulum.augmented_policy import (
    DT,
    ROWS,
    MendedPolicy,
    MendedWorld,
    command,
    descended,
    make_world,
)

REWARD_GAIN = 10.0  # as the task's: cost a tenth above the best gives 0


def task_reward(before: ModelFile, after: ModelFile) -> dict[str, Any] | None:
    """`{before, after, oracle, cost, in}`: policies of the declared and of the mended model, both
    run in the mended one, rewards against the better of the two.

    Only of a linearized pendulum, whose task this is; None else, or where nothing was added. What
    the real rig would give, only it can say: `oracle` is null.
    """
    if after.model != "linearized" or not after.effects:
        return None
    costs = {}
    for stage, given in (("before", before), ("after", after)):
        trained = trained_policy(given)
        costs[stage] = float(cost_in(after, trained.law, trained.world.history))
    best = min(costs.values())
    rewards = {
        stage: max(0.0, 1.0 - REWARD_GAIN * (cost / best - 1.0)) for stage, cost in costs.items()
    }
    return rewards | {"oracle": None, "cost": costs, "in": "the mended model"}


class TrainedLaw:
    """A policy trained on a model, with the world that it knows."""

    def __init__(self, world: MendedWorld, policy: MendedPolicy):
        self.world, self.policy = world, policy

    def law(self, y, past, t) -> jax.Array:
        """Torque `[2]` N m for what the sensors say `[4]` and the own past commands `[H, 2]`."""
        rows = self.world.history
        if past.shape[0] >= rows:
            past = past[-rows:]
        else:
            past = jnp.pad(past, ((rows - past.shape[0], 0), (0, 0)))
        return command(self.world, self.policy, y, past, t)


def trained_policy(given: ModelFile) -> TrainedLaw:
    """The task policy of a model; where it has effects, the best that descent finds in it."""
    world = make_world(given)
    theta, eff = _point(given, world)
    return TrainedLaw(world, jax.jit(lambda theta, eff: descended(world, theta, eff))(theta, eff))


def cost_in(target: ModelFile, law: Law, history: int) -> jax.Array:
    """Cost `[]` of a law in a model that stands for the target."""
    world = make_world(target, history=history)
    theta, eff = _point(target, world)

    @jax.jit
    def run(theta, eff):
        start = jnp.asarray(world.start, jnp.float32)
        sample = Sample(world.model, theta, eff)
        return world.evaluated(run_loop(sample, law, start, Course(ROWS, DT, world.history))).cost

    return run(theta, eff)


def _point(given: ModelFile, world: MendedWorld) -> tuple[jax.Array, jax.Array]:
    theta = jnp.asarray(given.theta(world.model.plant), jnp.float32)
    return theta, jnp.asarray(given.effect_vector(world.model.layout), jnp.float32)
