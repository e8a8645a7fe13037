"""Scooping in Drake with hydroelastic contact and SAP: the paper's simulator, a reference, and a
stand-in for reality.

The same motion, masses and shapes as `hydro`, with Drake's own meshes of the pressure field. The
spatula is driven to the motion by stiff implicit PD control on three joints. It does not touch the
table, above which the motion keeps it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.engine import DrakeWorld, EngineKind, drake_modules, in_threads, steps_a_row
from adaptsim_jax.tasks.scooping import hydro_shapes as shapes
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping import motion as spatula
from adaptsim_jax.tasks.scooping.model import ScoopOptions

SPATULA_MASS = 1.0  # kg on each joint; the controller holds it whatever it meets
GAINS = ((1e7, 1e5), (1e7, 1e5), (1e6, 1e4))  # N/m and N s/m along x and z, N m and N m s in pitch


@dataclass(frozen=True)
class ScoopContact:
    """Numerics of Drake. relaxation s: of piece and surface together. resolution m: of the piece's
    pressure field.

    The release has 5 ms and 0.2 s.
    """

    dt: float = 0.0025
    relaxation: float = 0.2
    resolution: float = 0.01


class ScoopDrakeSettings(NamedTuple):
    """contact: numerics. threads: Cores to run on (None: all)."""

    contact: ScoopContact = ScoopContact()
    threads: int | None = None


def make_drake(options: ScoopOptions, contact: ScoopContact, threads: int | None):
    """`simulate` in Drake on `threads` cores (all); a plant is built for each sample. BadInput
    where Drake is absent.
    """
    drake = drake_modules()
    every = steps_a_row("backend drake", contact.dt, model.ROW, 0.0025)
    if contact.relaxation < 0 or contact.resolution <= 0:
        raise BadInput(
            f"backend drake: relaxation at least 0 and resolution positive, got {contact}"
        )

    def one(*sample):
        return _one(drake, contact, every, *sample)

    def simulate(params, commands, initial):
        params, actions, starts = model.checked_trials(params, commands, initial)
        poses = [_poses(action, options, contact.dt) for action in actions]
        rows = in_threads(threads, one, params, poses)
        if rows:
            state = np.stack(rows)
        else:
            state = np.zeros((0, round(model.SECONDS / model.ROW), model.STATE))
        lost = np.logical_not(np.all(np.isfinite(state), axis=(1, 2)))
        fit = _fit(params, actions)
        codes = np.where(fit, np.where(lost, model.DIVERGED, model.FINE), model.UNFIT)
        return model.placed(np.where(np.expand_dims(lost, (1, 2)), 0.0, state), codes, starts)

    return simulate


def _poses(action: np.ndarray, options: ScoopOptions, dt: float) -> np.ndarray:
    """The tip's poses `[steps + 1, 3]`."""
    return np.asarray(
        spatula.motion(jnp.asarray(action, jnp.float32), round(model.SECONDS / dt), options), float
    )


def _fit(params: np.ndarray, actions: np.ndarray) -> np.ndarray:
    inside = (params >= np.array(model.PHYSICAL_LOW)) & (params <= np.array(model.PHYSICAL_HIGH))
    return np.all(inside, axis=1) & np.all(np.isfinite(actions), axis=1)


def _one(
    drake: Any, contact: ScoopContact, every: int, params: np.ndarray, poses: np.ndarray
) -> np.ndarray:
    """Rows `[T, 6]` of one trial; not-a-number from where Drake's solver gave up."""
    rows = np.full(((len(poses) - 1) // every, model.STATE), np.nan)
    if not _fit(params[None], poses[:1]).all():
        return rows
    world = ScoopWorld(drake, contact, params)
    speeds = np.diff(poses, axis=0) / contact.dt
    world.place(poses[0], speeds[0])
    try:
        for step in range(1, len(poses)):
            world.lead(poses[step], speeds[step - 1])
            world.simulator.AdvanceTo(step * contact.dt)
            if step % every == 0:
                rows[step // every - 1] = world.state()
    except RuntimeError:  # the solver did not converge: the caller sees a code
        pass
    return rows


class ScoopWorld(DrakeWorld):
    """Table, piece, and a spatula on forward, rise and pitch joints that are led along the
    motion.
    """

    def __init__(self, drake: Any, contact: ScoopContact, params: np.ndarray):
        super().__init__(drake, contact.dt, "sap", contact.resolution)
        self.contact = contact
        self.mu, self.modulus, self.g, self.height = params[0], params[1], int(params[2]), params[3]
        ground = drake.Box(2.0, 1.2, 0.08)
        self.collide(
            self.plant.world_body(), [0, 0, -0.04], ground, "table", self._surface(self.mu)
        )
        self._add_piece()
        self._add_spatula()
        self.plant.Finalize()
        self._pass_through()
        self.built()

    def place(self, pose: np.ndarray, speed: np.ndarray) -> None:
        """The piece at rest, as deep in the table as its weight asks; the spatula at its start."""
        piece = shapes.body(jnp.asarray(float(self.g)), jnp.asarray(self.height))
        depth = float(shapes.sink(piece, jnp.asarray(self.modulus), model.GRAVITY))
        at = self.drake.RigidTransform([0.0, 0.0, self.height / 2 - depth])
        self.plant.SetFreeBodyPose(self.context, self.piece, at)
        self.plant.SetPositions(self.context, self.spatula, pose)
        self.plant.SetVelocities(self.context, self.spatula, speed)
        self.lead(pose, speed)
        self.simulator.Initialize()

    def lead(self, pose: np.ndarray, speed: np.ndarray) -> None:
        self.plant.get_desired_state_input_port(self.spatula).FixValue(
            self.context, np.concatenate([pose, speed])
        )

    def state(self) -> np.ndarray:
        at = self.plant.EvalBodyPoseInWorld(self.context, self.piece).translation()
        return np.concatenate([at, self.plant.GetPositions(self.context, self.spatula)])

    def _surface(self, friction: float, modulus: float | None = None) -> Any:
        """As `surface`; Drake adds the relaxation times of a pair."""
        properties = self.surface(friction, modulus)
        properties.AddProperty("material", "relaxation_time", self.contact.relaxation / 2)
        return properties

    def _add_piece(self) -> None:
        d, r, h = self.drake, model.RADIUS, self.height
        mass = float(shapes.body(jnp.asarray(float(self.g)), jnp.asarray(h)).mass)
        unit = (
            lambda: d.UnitInertia.SolidEllipsoid(r, r, h / 2),
            lambda: d.UnitInertia.SolidCylinder(r, h, [0, 0, 1]),
            lambda: d.UnitInertia.SolidBox(2 * r, 2 * r, h),
        )[self.g]()
        shape = (d.Ellipsoid(r, r, h / 2), d.Cylinder(r, h), d.Box(2 * r, 2 * r, h))[self.g]
        self.piece = self.plant.AddRigidBody("piece", d.SpatialInertia(mass, np.zeros(3), unit))
        self.collide(self.piece, [0, 0, 0], shape, "piece", self._surface(self.mu, self.modulus))

    def _add_spatula(self) -> None:
        d, plant = self.drake, self.plant
        self.spatula = plant.AddModelInstance("spatula")
        inertia = d.SpatialInertia(SPATULA_MASS, np.zeros(3), d.UnitInertia(1e-2, 1e-2, 1e-2))
        ahead, up, self.blade = self.bodies(self.spatula, inertia, "ahead", "up", "blade")
        joints = (
            d.PrismaticJoint("x", plant.world_frame(), ahead.body_frame(), [1, 0, 0]),
            d.PrismaticJoint("z", ahead.body_frame(), up.body_frame(), [0, 0, 1]),
            d.RevoluteJoint("pitch", up.body_frame(), self.blade.body_frame(), [0, 1, 0]),
        )
        for joint, (stiffness, damping) in zip(joints, GAINS, strict=True):
            motor = plant.AddJointActuator(joint.name(), plant.AddJoint(joint), 1e9)
            motor.set_controller_gains(d.PdControllerGains(p=stiffness, d=damping))
        (x, z), (hx, hz) = model.BLADE_CENTRE, model.BLADE_HALF
        box = d.Box(2 * hx, 2 * model.BLADE_HALF_WIDTH, 2 * hz)
        self.collide(self.blade, [x, 0, z], box, "blade", self._surface(self.mu))
        (x, z), (hx, hz) = model.NECK_CENTRE, model.NECK_HALF
        tilted = d.RigidTransform(d.RollPitchYaw(0.0, model.NECK_RISE, 0.0), [x, 0, z])
        box = d.Box(2 * hx, 2 * model.NECK_HALF_WIDTH, 2 * hz)
        self.collide(self.blade, tilted, box, "neck", self._surface(model.NECK_FRICTION))
        plant.set_gravity_enabled(self.spatula, False)

    def _pass_through(self) -> None:
        """Spatula and table do not touch."""
        d, plant = self.drake, self.plant

        def of(body):
            return d.GeometrySet(plant.GetCollisionGeometriesForBody(body))

        distance = d.CollisionFilterDeclaration().ExcludeBetween(
            of(self.blade), of(plant.world_body())
        )
        self.graph.collision_filter_manager().Apply(distance)


ENGINE = EngineKind(ScoopDrakeSettings, make_drake)
