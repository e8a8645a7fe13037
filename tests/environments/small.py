"""A mass on a rail that a motor pushes to the middle, with few enough steps that a test compiles
and trains it in seconds.
"""

import jax.numpy as jnp

from adaptsim_jax.environments.own import ModelEnvironment

MJCF = """
<mujoco>
  <option timestep="0.02" gravity="0 0 0"><flag contact="disable" constraint="{constraint}"/></option>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="0.4"/>
      <geom type="box" size="0.1 0.1 0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor" joint="slide" gear="4" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""  # noqa: E501
FIELDS = {"body:cart.mass": (0.5, 2.0, "log"), "joint:slide.damping": (0.1, 2.0)}


def make(constraint: str = "enable", **options) -> ModelEnvironment:
    """It begins 0.5 m off, at rest; seen: place and speed."""
    return ModelEnvironment(
        MJCF.format(constraint=constraint),
        lambda data: jnp.concatenate([data.qpos, data.qvel]),
        lambda data, action: jnp.exp(-10.0 * jnp.square(data.qpos[0])),
        start=lambda key, qpos: (qpos + 0.5, jnp.zeros(1)),
        **({"control_dt": 0.04, "length": 25, "fields": FIELDS} | options),
    )
