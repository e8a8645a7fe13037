"""A policy of a mended model as something that a robot's own loop can call.

    controller = read_controller("robot")          # the folder of `adaptsim robot`
    torque = controller([q1, q2, v1, v2], t)       # every 5 ms, from the moment that the pendulum
    is let go

Such a policy is more than a gain: it may add a constant torque, cancel the forces that it knows of,
and predict across a late command, for which it keeps its own last commands.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mend.pendulum_model import ModelFile, read_model
from adaptsim_jax.tasks.pendulum.augmented_policy import (
    DT,
    MendedPolicy,
    MendedWorld,
    command,
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

    effects: the catalogue where the model has effects of your own. Raises BadInput where a file is
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
