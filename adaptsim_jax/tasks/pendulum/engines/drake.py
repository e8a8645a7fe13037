"""The double pendulum in Drake: commands held by a fixed input between steps, error control to
1e-10.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.engine import EngineKind, NoSettings
from adaptsim_jax.tasks.pendulum.engines import scene
from adaptsim_jax.tasks.pendulum.engines.scene import finished


def make_drake(dt: float):
    try:
        drake: Any = importlib.import_module("pydrake.all")
    except ImportError:
        raise BadInput(
            "backend drake is not installed; pip install 'adaptsim_jax[drake]'"
        ) from None

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
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -scene.GRAVITY])
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


ENGINE = EngineKind(NoSettings, make_drake)
