"""An arm of two joints in a horizontal plane that brings its hand, and the payload in it, to a goal
drawn anew in each episode.
"""

from typing import Any

import jax
import jax.numpy as jnp

from adaptsim_jax.environments.own import ModelEnvironment

MJCF = """
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
"""
FIELDS = {
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
        return self._seen(state.data.replace(mocap_pos=goal[None]), jnp.zeros(self.action_size))


def make() -> Arm:
    """Observed: cosines and sines of both angles, their speeds [rad/s], the goal [m] and the way to
    it from the hand [m].
    """

    def apart(data: Any) -> jax.Array:
        return data.mocap_pos[0, :2] - data.site_xpos[0, :2]

    def observe(data: Any) -> jax.Array:
        q = data.qpos
        return jnp.concatenate(
            [jnp.cos(q), jnp.sin(q), 0.2 * data.qvel, data.mocap_pos[0, :2], apart(data)]
        )

    def reward(data: Any, action: jax.Array) -> jax.Array:
        near = jnp.exp(-jnp.sum(jnp.square(apart(data))) / 0.02)
        still = jnp.exp(-0.05 * jnp.sum(jnp.square(data.qvel)))
        return near * (0.5 + 0.5 * still)

    return Arm(MJCF, observe, reward, length=150, fields=FIELDS)
