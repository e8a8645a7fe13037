"""The push in Drake with hydroelastic contact: the paper's simulator, and a reference for the
others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.engine import DrakeWorld, EngineKind, drake_modules, in_threads
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.engines import scene
from adaptsim_jax.tasks.pushing.model import PushOptions

SOLVERS = ("lagged", "tamsi", "similar", "sap")
PUSHER_MASS = 1000.0  # kg on each joint: the motion is prescribed, and a bottle must not slow it
GRIPPY = (
    1e6  # a friction that leaves a pair its partner's: 2ab/(a+b) -> 2b, so partners are given half
)


@dataclass(frozen=True)
class PushContact:
    """Numerics of Drake; the release uses tamsi at 10 ms, where the bounce depends on the step."""

    solver: str = "lagged"
    dt: float = 0.002  # s
    dissipation: float = 1.0  # s/m, Hunt and Crossley's
    resolution: float = 0.01  # m, of the bottle's pressure field


class PushDrakeSettings(NamedTuple):
    """contact: numerics. threads: Cores to run on (None: all); gravity m/s2, turned where the table
    is not level.
    """

    contact: PushContact = PushContact()
    threads: int | None = None
    gravity: tuple[float, float, float] = pushing.LEVEL


def make_drake(
    options: PushOptions,
    contact: PushContact,
    threads: int | None,
    gravity: tuple[float, float, float],
):
    """`simulate` in Drake on `threads` cores (all); a plant is built for each sample. BadInput
    where Drake is absent.
    """
    drake = drake_modules()
    _check(contact, options)

    def one(*sample):
        return _one(drake, options, contact, gravity, *sample)

    def simulate(params, commands, initial):
        batch = scene.checked(params, commands, initial)
        rows = in_threads(threads, one, *batch[:3])
        empty = np.zeros((0, pushing.rows(options), scene.STATE))
        return scene.finished(np.stack(rows) if rows else empty, batch)

    return simulate


def _check(contact: PushContact, options: PushOptions) -> None:
    if contact.solver not in SOLVERS:
        raise BadInput(
            f"backend drake, solver = {contact.solver!r}: unknown; use one of {', '.join(SOLVERS)}"
        )
    if (
        not 0 < contact.dt <= 0.01
        or abs(options.row / contact.dt - round(options.row / contact.dt)) > 1e-6
    ):
        raise BadInput(
            f"backend drake, dt = {contact.dt} s: must divide the row of {options.row} s and be at "
            "most 0.01 s; use 0.002"
        )


def _one(
    drake: Any, options: PushOptions, contact: PushContact, gravity, params, action, start
) -> np.ndarray:
    """Rows `[T, 13]` of one push; not-a-number from where Drake's solver gave up."""
    world = PushWorld(drake, options, contact, gravity, params, action)
    every, steps = round(options.row / contact.dt), round(options.duration / contact.dt)
    slope = pushing.slopes(contact.dt, steps)
    rows = np.full((pushing.rows(options), scene.STATE), np.nan)
    world.place(start, action[1])
    try:
        for row in range(len(rows)):
            for step in range(row * every, (row + 1) * every):
                if step == 0 or abs(slope[step] - slope[step - 1]) > 1e-9:
                    world.simulator.AdvanceTo(step * contact.dt)
                    world.push(slope[step] * world.drive)
            world.simulator.AdvanceTo((row + 1) * options.row)
            rows[row] = world.bottle_state()
    except RuntimeError:  # the solver did not converge: the caller sees a code
        pass
    return rows


class PushWorld(DrakeWorld):
    """Table with a patch, bottle, and a plate on yaw, forward, rise and pitch joints that is driven
    by forces.
    """

    def __init__(
        self, drake: Any, options: PushOptions, contact: PushContact, gravity, params, action
    ):
        super().__init__(drake, contact.dt, contact.solver, contact.resolution)
        self.contact, self.options = contact, options
        friction = _material(params, options.friction)
        self._add_ground(params[3], friction)
        self._add_bottle(params[1], friction["bottle"])
        self._add_pusher(friction["plate"])
        self.plant.mutable_gravity_field().set_gravity_vector(list(gravity))
        self.plant.Finalize()
        self.built()
        third = PUSHER_MASS / 3
        carried = np.array(
            [3 * third, 2 * third, third]
        )  # what forward, rise and pitch joints move
        self.drive = carried * np.array([action[0], pushing.RISE_SPEED, pushing.PITCH_RATE])

    def place(self, start: np.ndarray, yaw: float) -> None:
        """The bottle standing still at `start`, the plate behind the nominal place and turned by
        `yaw`.
        """
        pose = self.drake.RigidTransform([*start, pushing.HEIGHT / 2])
        self.plant.SetFreeBodyPose(self.context, self.bottle, pose)
        self.yaw.set_angle(self.context, yaw)
        self.simulator.Initialize()

    def push(self, force: np.ndarray) -> None:
        self.plant.get_actuation_input_port(self.pusher).FixValue(self.context, force)

    def bottle_state(self) -> np.ndarray:
        pose = self.plant.EvalBodyPoseInWorld(self.context, self.bottle)
        motion = self.plant.EvalBodySpatialVelocityInWorld(self.context, self.bottle)
        turning = pose.rotation().matrix().T @ motion.rotational()
        quaternion = pose.rotation().ToQuaternion().wxyz()
        return np.concatenate([pose.translation(), quaternion, motion.translational(), turning])

    def _surface(self, friction: float, modulus: float | None = None) -> Any:
        return self.surface(friction, modulus, dissipation=self.contact.dissipation)

    def _add_ground(self, y_p: float, friction: dict[str, float]) -> None:
        d, side = self.drake, pushing.PATCH_SIDE

        def add(name, at, shape, mu):
            self.collide(self.plant.world_body(), at, shape, name, self._surface(mu))

        patch_at = [pushing.PATCH_X, y_p, 0.0]
        if self.options.friction == "coupled":  # as released: flush boxes that overlap
            add("table", [0.5, 0.0, -0.02], d.Box(4.0, 4.0, 0.04), friction["table"])
            add(
                "patch", np.add(patch_at, [0, 0, -0.01]), d.Box(side, side, 0.02), friction["patch"]
            )
            return
        add("table", patch_at, _sheet(d, side / 2, 3.0), friction["table"])
        add("patch", patch_at, _sheet(d, 0.0, side / 2), friction["patch"])

    def _add_bottle(self, modulus: float, friction: float) -> None:
        d, o = self.drake, self.options
        inertia = d.SpatialInertia.MakeFromCentralInertia(
            o.mass, list(o.com), d.RotationalInertia(*o.inertia)
        )
        self.bottle = self.plant.AddRigidBody(
            "bottle", self.plant.AddModelInstance("bottle"), inertia
        )
        shape = d.Cylinder(pushing.RADIUS, pushing.HEIGHT)
        self.collide(self.bottle, [0, 0, 0], shape, "bottle", self._surface(friction, modulus))

    def _add_pusher(self, friction: float) -> None:
        d, plant = self.drake, self.plant
        self.pusher = plant.AddModelInstance("pusher")
        inertia = d.SpatialInertia(PUSHER_MASS / 3, np.zeros(3), d.UnitInertia(1, 1, 1))
        heading, forward, rise, plate = self.bodies(
            self.pusher, inertia, "heading", "forward", "rise", "plate"
        )

        def fixed(name, frame, at):
            return plant.AddFrame(d.FixedOffsetFrame(name, frame, d.RigidTransform(at)))

        at_start = fixed("start", plant.world_frame(), [*pushing.START, pushing.LINK_HEIGHT])
        behind = fixed("behind", heading.body_frame(), [-pushing.LINK_BACK, 0, 0])
        self.yaw = plant.AddJoint(d.RevoluteJoint("yaw", at_start, heading.body_frame(), [0, 0, 1]))
        driven = (
            d.PrismaticJoint("forward", behind, forward.body_frame(), [1, 0, 0]),
            d.PrismaticJoint("rise", forward.body_frame(), rise.body_frame(), [0, 0, 1]),
            d.RevoluteJoint("pitch", rise.body_frame(), plate.body_frame(), [0, -1, 0]),
        )
        for joint in driven:
            plant.AddJointActuator(joint.name(), plant.AddJoint(joint))
        shape = d.Box(0.005, 0.10, 0.12)
        self.collide(plate, [0, 0, -0.06], shape, "plate", self._surface(friction))
        plant.set_gravity_enabled(self.pusher, False)


def _material(params: np.ndarray, semantics: str) -> dict[str, float]:
    """Drake's coefficient for each body; it combines those of a pair as 2ab/(a+b)."""
    if semantics == "coupled":
        return {"table": params[0], "patch": params[2], "plate": 0.3, "bottle": params[2]}
    pair = pushing.frictions(params, semantics)

    def half(mu):
        return float(mu) * GRIPPY / (2 * GRIPPY - float(mu))

    return {
        "table": half(pair.table),
        "patch": half(pair.patch),
        "plate": half(pair.plate),
        "bottle": GRIPPY,
    }


def _sheet(drake: Any, inner: float, outer: float):
    """A flat square of half-width `outer` with a square hole of half-width `inner`, facing up, as a
    mesh.

    Table and patch meet along the hole's edge and nowhere overlap: each bears what stands on it.
    """
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    if inner == 0.0:
        points, faces = [(outer * x, outer * y) for x, y in corners], [(1, 2, 3), (1, 3, 4)]
    else:
        points = [(r * x, r * y) for r in (inner, outer) for x, y in corners]
        faces = [
            f
            for i in range(4)
            for f in ((5 + i, 5 + (i + 1) % 4, 1 + (i + 1) % 4), (5 + i, 1 + (i + 1) % 4, 1 + i))
        ]
    text = (
        "\n".join([f"v {x} {y} 0" for x, y in points] + [f"f {a} {b} {c}" for a, b, c in faces])
        + "\n"
    )
    return drake.Mesh(
        drake.InMemoryMesh(mesh_file=drake.MemoryFile(text, ".obj", "sheet.obj")), 1.0
    )


ENGINE = EngineKind(PushDrakeSettings, make_drake)
