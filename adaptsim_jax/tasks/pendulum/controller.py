"""A policy of a mended model at work: called by a robot's own loop, or run in the model to see what
it is worth.

    controller = read_controller("robot")          # the folder of `adaptsim robot`
    torque = controller([q1, q2, v1, v2], t)       # every 5 ms, from the moment that the pendulum
    is let go

Such a policy is more than a gain: It may add a constant torque and cancel the forces that it knows
of. It may predict across a late command, for which it keeps its own last commands. `task_reward`
compares policies that were trained on the declared and on the mended model.
"""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.core import config
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.closed_loop import Course, Law, run_loop
from adaptsim_jax.mechanisms.stepping import Sample
from adaptsim_jax.mend.pendulum_model import ModelFile, read_model
from adaptsim_jax.tasks.pendulum.augmented_policy import (
    DT,
    ROWS,
    MendedPolicy,
    MendedWorld,
    command,
    descended,
    make_world,
)

POLICY, MODEL = "policy.toml", "model.toml"


class Controller:
    """Call it once every `period` s with the state `[4]` (q1, q2 in rad with zero upright, v1, v2
    in rad/s) and the time since the start [s]. It returns the torque `[2]` N m to hold until the
    next call. `reset()` before each trial.
    """

    period = DT

    def __init__(self, world: MendedWorld, policy: MendedPolicy):
        self.world, self.policy = world, policy
        self._law = jax.jit(lambda y, past, t: command(world, policy, y, past, t))
        self.reset()

    def reset(self) -> None:
        """Forget the commands of the last trial, and compile before the first one begins."""
        self._past = np.zeros((self.policy.recent.shape[0], 2), np.float32)
        self._law(
            jnp.asarray(self.world.start, jnp.float32), self._past, jnp.float32(0.0)
        ).block_until_ready()

    def __call__(self, state, t: float) -> np.ndarray:
        y = np.asarray(state, np.float32) + np.asarray(self.world.goal, np.float32)
        torque = np.asarray(self._law(jnp.asarray(y), self._past, jnp.float32(t)))
        self._past = np.concatenate([self._past[1:], torque[None]])
        return torque


def read_controller(folder: str | Path, policy: str = POLICY, effects=None) -> Controller:
    """The controller of `policy` (`policy.toml`, or `best.toml`) in a folder of `adaptsim robot`.

    effects: The catalogue where the model has effects of your own. Raises BadInput where a file is
    missing or bad.
    """
    folder = Path(folder)
    return make_controller(
        read_model(folder / MODEL, effects), config.read(folder / policy), str(folder / policy)
    )


def make_controller(given: ModelFile, table: dict, where: str = POLICY) -> Controller:
    """The same from the model and the table of a `policy.toml`."""
    leaves = table.get("policy")
    if not isinstance(leaves, dict) or set(leaves) != set(MendedPolicy._fields):
        raise BadInput(
            f"{where}: holds no policy of a mended model; write it again with 'adaptsim robot next'"
        )
    policy = MendedPolicy(
        *(jnp.asarray(leaves[name], jnp.float32) for name in MendedPolicy._fields)
    )
    return Controller(make_world(given, history=policy.recent.shape[0]), policy)


REWARD_GAIN = 10.0  # as the task's: cost a tenth above the best gives 0


def task_reward(before: ModelFile, after: ModelFile) -> Table | None:
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

    def law(self, y, past, t) -> Array:
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


def cost_in(target: ModelFile, law: Law, history: int) -> Array:
    """Cost `[]` of a law in a model that stands for the target."""
    world = make_world(target, history=history)
    theta, eff = _point(target, world)

    @jax.jit
    def run(theta, eff):
        start = jnp.asarray(world.start, jnp.float32)
        sample = Sample(world.model, theta, eff)
        return world.evaluated(run_loop(sample, law, start, Course(ROWS, DT, world.history))).cost

    return run(theta, eff)


def _point(given: ModelFile, world: MendedWorld) -> tuple[Array, Array]:
    theta = jnp.asarray(given.theta(world.model.plant), jnp.float32)
    return theta, jnp.asarray(given.effect_vector(world.model.layout), jnp.float32)
