"""The double pendulum in three engines behind one signature: native MuJoCo, MJX, Drake; and these
against each other.

`simulate(params [B, 10], commands [B, T, 2], initial [B, 4])`: `PARAMETERS`; N m; rad and rad/s.
"""

from __future__ import annotations

import importlib
import os
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.lazy import mjx_module
from adaptsim_jax.core.progress import Report, silent
from adaptsim_jax.tasks.engine import (
    EngineKind,
    Engines,
    NoSettings,
    Parity,
    Trajectory,
    drake_modules,
)

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
    size = rng.normal(size=(samples, 3, 1, 2))
    rate = rng.uniform(0.5, 4.0, (samples, 3, 1, 2))
    waves = size * np.sin(rate * np.linspace(0.0, 2 * np.pi, steps)[:, None])
    initial = np.concatenate(
        [rng.uniform(-1, 1, (samples, 2)), rng.uniform(-5, 5, (samples, 2))], axis=1
    )
    return params, waves.sum(1), initial


def finished(state: Any) -> Trajectory:
    """The trajectory of states `[B, T, 4]`, with code 1 where they ceased to be finite."""
    finite = np.isfinite(np.asarray(state)).all((1, 2))
    return Trajectory(state, np.where(finite, 0, 1))


def make_native(dt: float):
    """`mujoco.rollout`, on all cores."""
    mujoco: Any = importlib.import_module("mujoco")
    rollout: Any = importlib.import_module("mujoco.rollout")

    def simulate(params, commands, initial):
        models = [model(p, dt) for p in np.asarray(params)]
        threads = min(os.cpu_count() or 1, len(models))
        data = [mujoco.MjData(models[0]) for _ in range(threads)]
        start = np.concatenate([np.zeros((len(models), 1)), np.asarray(initial)], axis=1)
        state, _ = rollout.rollout(models, data, start, control=np.asarray(commands, float))
        return finished(state[:, :, 1:5])

    return simulate


NATIVE = EngineKind(NoSettings, make_native)


def make_mjx(dt: float):
    """MJX, in the precision that JAX is set to."""
    mjx = mjx_module()

    def batched(params):
        models = [model(p, dt) for p in np.asarray(params)]
        varied = ("body_mass", "body_inertia", "body_ipos", "body_pos", "dof_damping")
        stacked = {name: jnp.stack([getattr(m, name) for m in models]) for name in varied}
        return mjx.put_model(models[0]), stacked

    @jax.jit
    def run(base, stacked, commands, initial):
        def one(values, commands, initial):
            m = base.tree_replace(values)
            data = mjx.make_data(m).replace(qpos=initial[:2], qvel=initial[2:])

            def step(data, command):
                data = mjx.step(m, data.replace(ctrl=command))
                return data, jnp.concatenate([data.qpos, data.qvel])

            return jax.lax.scan(step, data, commands)[1]

        return jax.vmap(one)(stacked, commands, initial)

    def simulate(params, commands, initial):
        # MJX relies on rank promotion, which a strict caller may have forbidden
        with jax.numpy_rank_promotion("allow"):
            return finished(run(*batched(params), jnp.asarray(commands), jnp.asarray(initial)))

    return simulate


MJX = EngineKind(NoSettings, make_mjx)


def make_drake(dt: float):
    """Drake: commands held by a fixed input between steps, error control to 1e-10."""
    drake = drake_modules()

    def simulate(params, commands, initial):
        rows = zip(
            np.asarray(params, float),
            np.asarray(commands, float),
            np.asarray(initial, float),
            strict=True,
        )
        return finished(np.stack([_drake_one(drake, *row, dt) for row in rows]))

    return simulate


def _drake_one(drake: Any, params, commands, initial, dt: float) -> np.ndarray:
    """Commands are held by a fixed input between calls of `AdvanceTo`; error control to 1e-10."""
    plant = _drake_plant(drake, params)
    simulator = drake.Simulator(plant)
    drake.ResetIntegratorFromFlags(simulator, "runge_kutta3", dt)
    integrator = simulator.get_mutable_integrator()
    integrator.set_fixed_step_mode(False)
    integrator.set_target_accuracy(1e-10)
    context = simulator.get_mutable_context()
    plant.SetPositionsAndVelocities(context, initial)
    states = []
    for row, command in enumerate(commands):
        plant.get_actuation_input_port().FixValue(context, command)
        simulator.AdvanceTo((row + 1) * dt)
        states.append(plant.GetPositionsAndVelocities(context).copy())
    return np.stack(states)


def _drake_plant(drake: Any, params: np.ndarray) -> Any:
    m1, m2, l1, _, c1, c2, i1, i2, b1, b2 = params
    plant = drake.MultibodyPlant(0.0)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -GRAVITY])
    parent, offset = plant.world_body(), 0.0
    for k, (mass, com, inertia, damping) in enumerate(((m1, c1, i1, b1), (m2, c2, i2, b2)), 1):
        about_com = drake.UnitInertia.TriaxiallySymmetric(inertia / mass)
        point = np.array([0.0, 0.0, -com])
        spatial = drake.SpatialInertia(mass, point, about_com.ShiftFromCenterOfMass(point))
        body = plant.AddRigidBody(f"link{k}", spatial)
        frame = drake.RigidTransform([0.0, 0.0, offset])
        place = plant.AddFrame(drake.FixedOffsetFrame(f"at{k}", parent.body_frame(), frame))
        joint = plant.AddJoint(
            drake.RevoluteJoint(
                f"q{k}",
                place,
                body.body_frame(),
                [0.0, 1.0, 0.0],
                damping=damping,
            )
        )
        plant.AddJointActuator(f"tau{k}", joint)
        parent, offset = body, -l1
    plant.Finalize()
    return plant


DRAKE = EngineKind(NoSettings, make_drake)


def check_step(engine: str, dt: float) -> float:
    """A step of `dt` s; BadInput where it is out of range."""
    if not 0 < dt <= 0.01:
        raise BadInput(
            f"backend {engine}: a step of {dt} s is out of range; use one above 0 and up to 0.01 s"
        )
    return dt


OURS = {
    "native": f"{__name__}:NATIVE",
    "mjx": f"{__name__}:MJX",
    "drake": f"{__name__}:DRAKE",
}
BACKENDS = Engines("pendulum", OURS, 1e-3, check_step, called="dt")
make_backend = BACKENDS.make


REFERENCE = "native"


def pendulum_parity(samples: int, seed: int, progress: Report = silent, steps: int = 500) -> Table:
    """Final states of every backend against native MuJoCo, after `steps` steps of 1 ms, in double
    precision.

    Returns `{task, samples, seconds, reference, rows}`. A row has the median and largest difference
    over samples of angles (rad) and velocities (rad/s), how many samples diverged, or why it did
    not run.
    """
    inputs = draw(seed, samples, steps)
    rows, reference = [], None
    order = (REFERENCE, *(name for name in BACKENDS if name != REFERENCE))
    for done, name in enumerate(order):
        progress(done, len(order), name)
        try:
            with jax.enable_x64(True):
                end = np.asarray(make_backend(name).simulate(*inputs).state)[:, -1]
        except BadInput as error:
            rows.append({"backend": name, "ran": False, "why": error.coded})
            continue
        reference = end if reference is None else reference
        rows.append({"backend": name, "ran": True, **_differences(end, reference)})
    return {
        "schema": 1,
        "task": "pendulum",
        "samples": samples,
        "seconds": steps * 1e-3,
        "reference": REFERENCE,
        "rows": rows,
    }


def _differences(end: np.ndarray, reference: np.ndarray) -> Table:
    finite = np.isfinite(end).all(1) & np.isfinite(reference).all(1)
    gap = np.abs(end - reference)[finite]
    if not len(gap):
        return {"diverged": len(end)}
    sizes = {"angle": gap[:, :2].max(1), "velocity": gap[:, 2:].max(1)}
    numbers = {
        f"{k}_{f.__name__}": float(f(v)) for k, v in sizes.items() for f in (np.median, np.max)
    }
    return {"diverged": int((~finite).sum()), **numbers}


def parity_lines(found: Table) -> list[str]:
    """The results of `pendulum_parity` for a person."""
    lines = [
        f"{found['task']}: {found['samples']} random samples of {found['seconds']:g} s, double "
        "precision;",
        f"differences of the final state from {found['reference']} MuJoCo, median and largest",
        "",
        f"{'backend':12} {'angle [rad]':>19} {'velocity [rad/s]':>19} {'diverged':>9}",
    ]
    for row in found["rows"]:
        if not row["ran"]:
            words = f"did not run: {row['why']}"
        elif "angle_median" not in row:
            words = f"all {row['diverged']} samples diverged"
        else:
            pairs = [
                f"{row[f'{k}_median']:9.1e} {row[f'{k}_max']:9.1e}" for k in ("angle", "velocity")
            ]
            words = f"{pairs[0]} {pairs[1]} {row['diverged']:9}"
        lines.append(f"{row['backend']:12} {words}")
    return lines


PARITY = Parity(pendulum_parity, parity_lines)
