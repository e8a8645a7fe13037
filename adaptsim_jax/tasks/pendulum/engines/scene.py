"""The rigid-body double pendulum as a MuJoCo scene, and its parameters as one vector for all
backends.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from adaptsim_jax.core.constants import GRAVITY as GRAVITY
from adaptsim_jax.tasks.engine import Trajectory

PARAMETERS = ("m1", "m2", "l1", "l2", "c1", "c2", "I1", "I2", "b1", "b2")
"""Masses kg, lengths and centres of mass m, inertias about the centres kg m^2, viscous damping N m
s/rad.
"""


def scene(params: np.ndarray, dt: float, integrator: str = "RK4") -> str:
    """MJCF of a pendulum that hangs at zero angle, with `params: [10]` in the order of
    `PARAMETERS`.
    """
    m1, m2, l1, _, c1, c2, i1, i2, b1, b2 = (repr(float(x)) for x in params)
    # Only motion about y is possible: the other two inertias are free, and chosen for MuJoCo to
    # accept.
    return f"""<mujoco>
  <option timestep="{dt!r}" integrator="{integrator}" gravity="0 0 -{GRAVITY}">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body name="link1">
      <joint name="q1" type="hinge" axis="0 1 0" damping="{b1}"/>
      <inertial pos="0 0 -{c1}" mass="{m1}" diaginertia="{i1} {i1} {i1}"/>
      <body name="link2" pos="0 0 -{l1}">
        <joint name="q2" type="hinge" axis="0 1 0" damping="{b2}"/>
        <inertial pos="0 0 -{c2}" mass="{m2}" diaginertia="{i2} {i2} {i2}"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="q1"/><motor joint="q2"/></actuator>
</mujoco>"""


def model(params: np.ndarray, dt: float) -> Any:
    """The compiled `mujoco.MjModel`."""
    mujoco: Any = importlib.import_module("mujoco")
    return mujoco.MjModel.from_xml_string(scene(params, dt))


def draw(seed: int, samples: int, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random `params [B, 10]`, smooth `commands [B, T, 2]` N m, and `initial [B, 4]`, in double
    precision.

    Sizes are those of desk-top rigs: masses 0.2 to 2 kg, links 0.2 to 0.6 m, angles within 1 rad, 5
    rad/s.
    """
    rng = np.random.default_rng(seed)
    mass, length = rng.uniform(0.2, 2.0, (2, samples)), rng.uniform(0.2, 0.6, (2, samples))
    com = rng.uniform(0.3, 1.0, (2, samples)) * length
    inertia = rng.uniform(0.02, 0.1, (2, samples)) * mass * length**2
    damping = rng.uniform(0.0, 0.3, (2, samples))
    params = np.concatenate([mass, length, com, inertia, damping]).T
    waves = rng.normal(size=(samples, 3, 1, 2)) * np.sin(
        rng.uniform(0.5, 4.0, (samples, 3, 1, 2)) * np.linspace(0.0, 2 * np.pi, steps)[:, None]
    )
    initial = np.concatenate(
        [rng.uniform(-1, 1, (samples, 2)), rng.uniform(-5, 5, (samples, 2))], axis=1
    )
    return params, waves.sum(1), initial


def finished(state: Any) -> Trajectory:
    """The trajectory of states `[B, T, 4]`, with code 1 where they ceased to be finite."""
    finite = np.isfinite(np.asarray(state)).all((1, 2))
    return Trajectory(state, np.where(finite, 0, 1))
