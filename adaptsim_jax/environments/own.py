"""An environment of one's own: an MJCF, what is observed, and a reward."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.simulated import advance


class State(NamedTuple):
    """`obs [O]`, `reward []`, `done []` (1 where the episode is over) of a moment, and MuJoCo's
    `data` at it.
    """

    data: Any
    obs: jax.Array
    reward: jax.Array
    done: jax.Array


class ModelEnvironment:
    """`reset(key) -> State` and `step(state, action [nu] in [-1, 1]) -> State` over an MJCF.

    Args:
        mjcf: a file, or its text; impl "jax" of MJX, every actuator with a `ctrlrange`.
        observe: `(data) -> [O]`. reward: `(data, action) -> []`, of a step.
        start: `(key, qpos0 [nq]) -> (qpos [nq], qvel [nv])`; by default within 0.01 of `qpos0`, at
                rest.
        done: `(data) -> []`, whether the episode ends there; by default it does not.
        control_dt: s between actions, a multiple of the file's time step; length: steps of an
                episode.
        fields: Omega where nobody says otherwise.
    """

    def __init__(
        self,
        mjcf: str | Path,
        observe: Callable[[Any], jax.Array],
        reward: Callable[[Any, jax.Array], jax.Array],
        *,
        start: Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]] | None = None,
        done: Callable[[Any], jax.Array] | None = None,
        control_dt: float = 0.02,
        length: int = 250,
        fields: dict[str, Any] | None = None,
    ):
        text = str(mjcf).lstrip()
        if text.startswith("<"):
            made = mujoco.MjModel.from_xml_string
        else:
            made = mujoco.MjModel.from_xml_path
        try:
            self.mj_model = made(str(mjcf))
        except ValueError as error:
            raise BadInput(
                f"{'MJCF' if text.startswith('<') else mjcf}: {' '.join(str(error).split())}"
            ) from None
        if not self.mj_model.nu or not np.all(self.mj_model.actuator_ctrllimited):
            raise BadInput(
                "MJCF: each actuator needs a ctrlrange, which actions in [-1, 1] are laid over; "
                "there is none"
            )
        self.substeps = round(control_dt / self.mj_model.opt.timestep)
        if self.substeps < 1 or abs(self.substeps * self.mj_model.opt.timestep - control_dt) > 1e-9:
            raise BadInput(
                f"control_dt = {control_dt} s is no multiple of the file's time step "
                f"{self.mj_model.opt.timestep} s"
            )
        self.mjx_model = mjx.put_model(self.mj_model, impl="jax")
        self.fields = fields or {}
        self.observe, self.reward_of, self.start, self.done_of = (
            observe,
            reward,
            start or self._near,
            done,
        )
        self.dt, self.length, self.action_size = control_dt, length, self.mj_model.nu
        low, high = self.mj_model.actuator_ctrlrange.T
        self._middle, self._half = (
            (low + high).astype(np.float32) / 2,
            (high - low).astype(np.float32) / 2,
        )
        self._blank = mjx.make_data(self.mj_model, impl="jax")

    def _near(self, key, qpos):
        return qpos + 0.01 * jax.random.normal(key, qpos.shape), jnp.zeros(self.mj_model.nv)

    def reset(self, key: jax.Array) -> State:
        """The start of an episode."""
        qpos, qvel = self.start(key, jnp.asarray(self.mj_model.qpos0, self._blank.qpos.dtype))
        data = mjx.forward(self.mjx_model, self._blank.replace(qpos=qpos, qvel=qvel))
        return self._seen(data, jnp.zeros(self.action_size))

    def step(self, state: State, action: jax.Array) -> State:
        """One action [nu] for `control_dt` s."""
        ctrl = self._middle + self._half * jnp.clip(action, -1.0, 1.0)
        return self._seen(advance(self.mjx_model, state.data, ctrl, self.substeps), action)

    def _seen(self, data, action) -> State:
        if self.done_of is None:
            over = jnp.zeros(())
        else:
            over = jnp.asarray(self.done_of(data), jnp.float32)
        return State(data, self.observe(data), self.reward_of(data, action), over)
