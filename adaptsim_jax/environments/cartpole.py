"""A cart-pole to swing up: a pole hangs from a cart on a rail, and a motor pushes the cart."""

from typing import Any

import jax
import jax.numpy as jnp

from adaptsim_jax.environments.own import ModelEnvironment

MJCF = """
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
"""
FIELDS = {
    "body:pole.mass": (0.1, 0.5),
    "body:cart.mass": (0.6, 1.6),
    "actuator:motor.gear": (6.0, 14.0),
}


def make() -> ModelEnvironment:
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

    return ModelEnvironment(MJCF, observe, reward, start=start, fields=FIELDS)
