"""An environment of one's own: an MJCF, what is observed, and a reward; and two that come with the
package.

* A cart-pole to swing up: a pole hangs from a cart on a rail, and a motor pushes the cart.
* An arm of two joints in a horizontal plane that brings its hand, and the payload in it, to a goal
  drawn anew in each episode.
"""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.lazy import mjx_module
from adaptsim_jax.environments.simulated import advance, number_of, vector_of

mjx = mjx_module()


HERE = Path(__file__).parent


class State(NamedTuple):
    """`obs [O]`, `reward []`, `done []` (1 where the episode is over) of a moment, and MuJoCo's
    `data` at it.
    """

    data: Any
    obs: Array
    reward: Array
    done: Array


@dataclass(eq=False, repr=False)
class ModelEnvironment:
    """`reset(key) -> State` and `step(state, action [nu] in [-1, 1]) -> State` over an MJCF.

    Args:
        mjcf: A file, or its text; impl "jax" of MJX, every actuator with a `ctrlrange`.
        observe: `(data) -> [O]`. reward: `(data, action) -> []`, of a step.
        start: `(key, qpos0 [nq]) -> (qpos [nq], qvel [nv])`; by default within 0.01 of `qpos0`, at
                rest.
        done: `(data) -> []`, whether the episode ends there; by default it does not.
        control_dt: S between actions, a multiple of the file's time step.
        length: Steps of an episode.
        fields: Omega where nobody says otherwise.
    """

    mjcf: str | Path
    observe: Callable[[Any], Array]
    reward: Callable[[Any, Array], Array]
    _: KW_ONLY
    start: Callable[[Array, Array], tuple[Array, Array]] | None = None
    done: Callable[[Any], Array] | None = None
    control_dt: float = 0.02
    length: int = 250
    fields: Table | None = None

    def __post_init__(self):
        self.mj_model = _read(self.mjcf)
        if not self.mj_model.nu or not np.all(self.mj_model.actuator_ctrllimited):
            raise BadInput(
                "MJCF: each actuator needs a ctrlrange, which actions in [-1, 1] are laid over; "
                "there is none"
            )
        step = self.mj_model.opt.timestep
        self.substeps = round(self.control_dt / step)
        if self.substeps < 1 or abs(self.substeps * step - self.control_dt) > 1e-9:
            raise BadInput(
                f"control_dt = {self.control_dt} s is no multiple of the file's time step {step} s"
            )
        self.mjx_model = mjx.put_model(self.mj_model, impl="jax")
        self.dt, self.action_size = self.control_dt, self.mj_model.nu
        low, high = self.mj_model.actuator_ctrlrange.T
        self._middle = (low + high).astype(np.float32) / 2
        self._half = (high - low).astype(np.float32) / 2
        self._blank = mjx.make_data(self.mj_model, impl="jax")

    def reset(self, key: Array) -> State:
        """The start of an episode."""
        at = jnp.asarray(self.mj_model.qpos0, self._blank.qpos.dtype)
        if self.start is None:
            qpos = at + 0.01 * jax.random.normal(key, at.shape)
            qvel = jnp.zeros(self.mj_model.nv)
        else:
            qpos, qvel = (jnp.asarray(x, at.dtype) for x in self.start(key, at))
            for name, x, count in (("qpos", qpos, at.size), ("qvel", qvel, self.mj_model.nv)):
                if jnp.shape(x) != (count,):
                    raise BadInput(
                        f"start: its {name} has the shape {jnp.shape(x)}; ({count},) is wanted"
                    )
        data = mjx.forward(self.mjx_model, self._blank.replace(qpos=qpos, qvel=qvel))
        return self._moment(data, jnp.zeros(self.action_size))

    def step(self, state: State, action: Array) -> State:
        """One action [nu] for `control_dt` s."""
        ctrl = self._middle + self._half * jnp.clip(action, -1.0, 1.0)
        return self._moment(advance(self.mjx_model, state.data, ctrl, self.substeps), action)

    def _moment(self, data, action) -> State:
        if self.done is None:
            over = jnp.zeros(())
        else:
            over = number_of(self.done(data), "done(data)")
        obs = vector_of(self.observe(data), "observe(data)")
        return State(data, obs, number_of(self.reward(data, action), "reward(data, action)"), over)


def _read(mjcf: str | Path) -> mujoco.MjModel:
    """The model of a file or a text; BadInput in MuJoCo's words where it is none."""
    inline = str(mjcf).lstrip().startswith("<")
    read = mujoco.MjModel.from_xml_string if inline else mujoco.MjModel.from_xml_path
    try:
        return read(str(mjcf))
    except ValueError as error:
        where, words = "MJCF" if inline else mjcf, " ".join(str(error).split())
        raise BadInput(f"{where}: {words}") from None


CARTPOLE_FIELDS = {
    "body:pole.mass": (0.1, 0.5),
    "body:cart.mass": (0.6, 1.6),
    "actuator:motor.gear": (6.0, 14.0),
}


def cartpole() -> ModelEnvironment:
    """Observed: cart's place and speed [m, m/s], the pole's cosine, sine (1, 0 upright) and speed
    [rad/s].
    """

    def observe(data: Any) -> Array:
        x, angle = data.qpos
        return jnp.stack([x, data.qvel[0], jnp.cos(angle), jnp.sin(angle), data.qvel[1]])

    def reward(data: Any, action: Array) -> Array:
        upright = 0.5 * (1.0 + jnp.cos(data.qpos[1]))
        placed = upright * jnp.exp(-0.5 * jnp.square(data.qpos[0]))
        return placed * (1.0 - 0.1 * jnp.sum(jnp.square(jnp.clip(action, -1, 1))))

    def start(key, qpos):
        hang = jnp.array([0.0, jnp.pi]) + 0.05 * jax.random.normal(key, (2,))
        return hang, jnp.zeros(2)

    return ModelEnvironment(
        HERE / "cartpole.xml", observe, reward, start=start, fields=CARTPOLE_FIELDS
    )


ARM_FIELDS = {
    "body:payload.mass": (0.05, 1.0),
    "joint:shoulder.damping": (0.05, 0.8),
    "joint:elbow.damping": (0.05, 0.6),
    "actuator:shoulder.gear": (2.5, 6.0),
}


class Arm(ModelEnvironment):
    """The goal is where the mocap body stands: a place within reach, drawn at each reset."""

    def reset(self, key: Array):
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

    def to_goal(data: Any) -> Array:
        return data.mocap_pos[0, :2] - data.site_xpos[0, :2]

    def observe(data: Any) -> Array:
        q = data.qpos
        return jnp.concatenate(
            [jnp.cos(q), jnp.sin(q), 0.2 * data.qvel, data.mocap_pos[0, :2], to_goal(data)]
        )

    def reward(data: Any, action: Array) -> Array:
        near = jnp.exp(-jnp.sum(jnp.square(to_goal(data))) / 0.02)
        still = jnp.exp(-0.05 * jnp.sum(jnp.square(data.qvel)))
        return near * (0.5 + 0.5 * still)

    return Arm(HERE / "arm.xml", observe, reward, length=150, fields=ARM_FIELDS)
