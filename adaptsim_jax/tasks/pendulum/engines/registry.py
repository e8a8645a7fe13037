"""The double pendulum in four engines behind one signature: our own, native MuJoCo, MJX, Drake."""

from __future__ import annotations

import importlib
import os
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.double_pendulum import rigid as pendulum_rigid
from adaptsim_jax.tasks.engine import Backend, Trajectory
from adaptsim_jax.tasks.pendulum.engines import scene as scenes

NAMES = ("rigid_body", "native", "mjx", "drake")


def make_backend(name: str, dt: float = 1e-3) -> Backend:
    """A backend with steps of `dt` s; BadInput where the name is unknown or the engine is not installed."""
    makers = {"rigid_body": _rigid_body, "native": _native, "mjx": _mjx, "drake": _drake}
    if name not in makers:
        raise BadInput(f"backend '{name}' is unknown; use one of {', '.join(makers)}")
    if not 0 < dt <= 0.01:
        raise BadInput(f"backend {name}: a step of {dt} s is out of range; use one above 0 and up to 0.01 s")
    return Backend(name, makers[name](dt))


def _finished(state: Any) -> Trajectory:
    finite = np.isfinite(np.asarray(state)).all((1, 2))
    return Trajectory(state, np.where(finite, 0, 1))


def _rigid_body(dt: float):
    def one(params, commands, initial):
        pair = lambda k: params[k : k + 2]
        p = pendulum_rigid.RigidPendulum(
            pair(0), pair(2), pair(4), pair(6), pair(8), jnp.zeros(2), jnp.ones(2), scenes.GRAVITY
        )
        out = pendulum_rigid.simulate(p, initial[:2], initial[2:], commands, dt)
        return jnp.concatenate([out.q[1:], out.v[1:]], -1)

    run = jax.jit(jax.vmap(one))
    return lambda params, commands, initial: _finished(run(*map(jnp.asarray, (params, commands, initial))))


def _native(dt: float):
    mujoco: Any = importlib.import_module("mujoco")
    rollout: Any = importlib.import_module("mujoco.rollout")

    def simulate(params, commands, initial):
        models = [scenes.model(p, dt) for p in np.asarray(params)]
        threads = min(os.cpu_count() or 1, len(models))
        data = [mujoco.MjData(models[0]) for _ in range(threads)]
        start = np.concatenate([np.zeros((len(models), 1)), np.asarray(initial)], axis=1)
        state, _ = rollout.rollout(models, data, start, control=np.asarray(commands, float))
        return _finished(state[:, :, 1:5])

    return simulate


def _mjx(dt: float):
    from mujoco import mjx

    def batched(params):
        models = [scenes.model(p, dt) for p in np.asarray(params)]
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
            return _finished(run(*batched(params), jnp.asarray(commands), jnp.asarray(initial)))

    return simulate


def _drake(dt: float):
    try:
        drake: Any = importlib.import_module("pydrake.all")
    except ImportError:
        raise BadInput("backend drake is not installed; pip install 'adaptsim_jax[drake]'") from None

    def simulate(params, commands, initial):
        rows = zip(np.asarray(params, float), np.asarray(commands, float), np.asarray(initial, float), strict=True)
        return _finished(np.stack([_drake_one(drake, *row, dt) for row in rows]))

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
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -scenes.GRAVITY])
    parent, offset = plant.world_body(), 0.0
    for k, (mass, com, inertia, damping) in enumerate(((m1, c1, i1, b1), (m2, c2, i2, b2)), 1):
        about_com = drake.UnitInertia.TriaxiallySymmetric(inertia / mass)
        point = np.array([0.0, 0.0, -com])
        spatial = drake.SpatialInertia(mass, point, about_com.ShiftFromCenterOfMass(point))
        body = plant.AddRigidBody(f"link{k}", spatial)
        frame = drake.RigidTransform([0.0, 0.0, offset])
        joint = plant.AddJoint(
            drake.RevoluteJoint(
                f"q{k}",
                plant.AddFrame(drake.FixedOffsetFrame(f"at{k}", parent.body_frame(), frame)),
                body.body_frame(),
                [0.0, 1.0, 0.0],
                damping=damping,
            )
        )
        plant.AddJointActuator(f"tau{k}", joint)
        parent, offset = body, -l1
    plant.Finalize()
    return plant
