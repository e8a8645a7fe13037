"""An environment of one's own: an MJCF, what is observed, and a reward; and two that come with the
package.

* A cart-pole to swing up: a pole hangs from a cart on a rail, and a motor pushes the cart.
* An arm of two joints in a horizontal plane that brings its hand, and the payload in it, to a goal
  drawn anew in each episode.
"""

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
        inline = text.startswith("<")
        if inline:
            read = mujoco.MjModel.from_xml_string
        else:
            read = mujoco.MjModel.from_xml_path
        try:
            self.mj_model = read(str(mjcf))
        except ValueError as error:
            where, words = "MJCF" if inline else mjcf, " ".join(str(error).split())
            raise BadInput(f"{where}: {words}") from None
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
        self.observe, self.reward_of, self.done_of = observe, reward, done
        self.start = start or self._near
        self.dt, self.length, self.action_size = control_dt, length, self.mj_model.nu
        low, high = self.mj_model.actuator_ctrlrange.T
        self._middle = (low + high).astype(np.float32) / 2
        self._half = (high - low).astype(np.float32) / 2
        self._blank = mjx.make_data(self.mj_model, impl="jax")

    def _near(self, key, qpos):
        return qpos + 0.01 * jax.random.normal(key, qpos.shape), jnp.zeros(self.mj_model.nv)

    def reset(self, key: jax.Array) -> State:
        """The start of an episode."""
        qpos, qvel = self.start(key, jnp.asarray(self.mj_model.qpos0, self._blank.qpos.dtype))
        data = mjx.forward(self.mjx_model, self._blank.replace(qpos=qpos, qvel=qvel))
        return self._moment(data, jnp.zeros(self.action_size))

    def step(self, state: State, action: jax.Array) -> State:
        """One action [nu] for `control_dt` s."""
        ctrl = self._middle + self._half * jnp.clip(action, -1.0, 1.0)
        return self._moment(advance(self.mjx_model, state.data, ctrl, self.substeps), action)

    def _moment(self, data, action) -> State:
        if self.done_of is None:
            over = jnp.zeros(())
        else:
            over = jnp.asarray(self.done_of(data), jnp.float32)
        return State(data, self.observe(data), self.reward_of(data, action), over)


CARTPOLE = """
<mujoco model="cartpole">
  <option timestep="0.01" iterations="1" ls_iterations="4"><flag contact="disable"/></option>
  <asset><texture type="skybox" builtin="flat" rgb1="1 1 1" width="8" height="8"/></asset>
  <worldbody>
    <camera name="side" pos="0 -3.4 0.1" xyaxes="1 0 0 0 0 1"/>
    <light pos="0 -2 3" dir="0 1 -1"/>
    <geom name="rail" type="capsule" fromto="-2 0 0 2 0 0" size="0.02" rgba="0.4 0.4 0.4 1"/>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" range="-1.8 1.8" damping="0.5"/>
      <geom name="cart" type="box" size="0.15 0.1 0.08" mass="1" rgba="0.2 0.3 0.7 1"/>
      <body name="pole">
        <joint name="hinge" type="hinge" axis="0 1 0" damping="0.01"/>
        <geom name="pole" type="capsule" fromto="0 0 0 0 0 0.8" size="0.03" mass="0.2" rgba="0.8 0.4 0.1 1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="slide" gear="10" ctrlrange="-1 1"/></actuator>
</mujoco>
"""  # noqa: E501


CARTPOLE_FIELDS = {
    "body:pole.mass": (0.1, 0.5),
    "body:cart.mass": (0.6, 1.6),
    "actuator:motor.gear": (6.0, 14.0),
}


def cartpole() -> ModelEnvironment:
    """Observed: cart's place and speed [m, m/s], the pole's cosine, sine (1, 0 upright) and speed
    [rad/s].
    """

    def observe(data: Any) -> jax.Array:
        x, angle = data.qpos
        return jnp.stack([x, data.qvel[0], jnp.cos(angle), jnp.sin(angle), data.qvel[1]])

    def reward(data: Any, action: jax.Array) -> jax.Array:
        upright = 0.5 * (1.0 + jnp.cos(data.qpos[1]))
        return (
            upright
            * jnp.exp(-0.5 * jnp.square(data.qpos[0]))
            * (1.0 - 0.1 * jnp.sum(jnp.square(jnp.clip(action, -1, 1))))
        )

    def start(key, qpos):
        hang = jnp.array([0.0, jnp.pi]) + 0.05 * jax.random.normal(key, (2,))
        return hang, jnp.zeros(2)

    return ModelEnvironment(CARTPOLE, observe, reward, start=start, fields=CARTPOLE_FIELDS)


ARM = """
<mujoco model="arm">
  <option timestep="0.01" iterations="1" ls_iterations="4" gravity="0 0 0"><flag contact="disable"/></option>
  <worldbody>
    <camera name="top" pos="0 0 1.6" xyaxes="1 0 0 0 1 0"/>
    <light pos="0 0 3"/>
    <body name="goal" mocap="true" pos="0.3 0.2 0"><geom type="sphere" size="0.03" rgba="0.1 0.7 0.2 1"/></body>
    <body name="upper">
      <joint name="shoulder" axis="0 0 1" damping="0.2"/>
      <geom type="capsule" fromto="0 0 0 0.35 0 0" size="0.025" mass="1.0" rgba="0.2 0.3 0.7 1"/>
      <body name="fore" pos="0.35 0 0">
        <joint name="elbow" axis="0 0 1" range="-2.6 2.6" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.6" rgba="0.8 0.4 0.1 1"/>
        <body name="payload" pos="0.3 0 0"><geom type="sphere" size="0.03" mass="0.3" rgba="0.6 0.1 0.1 1"/></body>
        <site name="hand" pos="0.3 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder" joint="shoulder" gear="4" ctrlrange="-1 1"/>
    <motor name="elbow" joint="elbow" gear="2" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""  # noqa: E501


ARM_FIELDS = {
    "body:payload.mass": (0.05, 1.0),
    "joint:shoulder.damping": (0.05, 0.8),
    "joint:elbow.damping": (0.05, 0.6),
    "actuator:shoulder.gear": (2.5, 6.0),
}


class Arm(ModelEnvironment):
    """The goal is where the mocap body stands: a place within reach, drawn at each reset."""

    def reset(self, key: jax.Array):
        start_key, goal_key = jax.random.split(key)
        u = jax.random.uniform(
            goal_key, (2,), minval=jnp.array([0.25, -2.5]), maxval=jnp.array([0.6, 2.5])
        )
        goal = jnp.stack([u[0] * jnp.cos(u[1]), u[0] * jnp.sin(u[1]), 0.0])
        state = super().reset(start_key)
        return self._moment(state.data.replace(mocap_pos=goal[None]), jnp.zeros(self.action_size))


def arm() -> Arm:
    """Observed: cosines and sines of both angles, their speeds [rad/s], the goal [m] and the way to
    it from the hand [m].
    """

    def to_goal(data: Any) -> jax.Array:
        return data.mocap_pos[0, :2] - data.site_xpos[0, :2]

    def observe(data: Any) -> jax.Array:
        q = data.qpos
        return jnp.concatenate(
            [jnp.cos(q), jnp.sin(q), 0.2 * data.qvel, data.mocap_pos[0, :2], to_goal(data)]
        )

    def reward(data: Any, action: jax.Array) -> jax.Array:
        near = jnp.exp(-jnp.sum(jnp.square(to_goal(data))) / 0.02)
        still = jnp.exp(-0.05 * jnp.sum(jnp.square(data.qvel)))
        return near * (0.5 + 0.5 * still)

    return Arm(ARM, observe, reward, length=150, fields=ARM_FIELDS)
