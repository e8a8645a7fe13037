"""What a model that MuJoCo steps may lack, as numbers of it by name: friction, damping and rotors
of joints, weak drives, late or shifted commands, payloads, sensors that are off. What only contact
and a base that moves show is in `contact`.
"""

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from adaptsim_jax.effects.base import Effect, of_the_engine
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.effects.joints.friction import VISCOUS
from adaptsim_jax.logs.noise import sensor_noise
from adaptsim_jax.simulators.mujoco.acting import BIAS, LATE, READ, SHIFT, TURN
from adaptsim_jax.simulators.mujoco.build import Stepped
from adaptsim_jax.simulators.mujoco.criteria import CANDIDATE
from adaptsim_jax.simulators.mujoco.fields import DELAY, STRENGTH, Field, field, number
from adaptsim_jax.simulators.mujoco.sensed import triple

DECLARED = VISCOUS.name
"""What is fitted whatever is named."""
SENSED = {
    "gyro": (5e-3, 1.0),
    "accelerometer": (0.05, 10.0),
}  # rad/s, m/s^2: a bias that shows, and its bound


def row(
    effect: str,
    where: str,
    fields: Field | Iterable[Field],
    texts: tuple[str, str],
    same: tuple[str, ...] = (),
) -> Effect:
    """An effect at a place; told: its physics and what shows it; same: effects that no such
    recording tells apart from it.
    """
    fields = (fields,) if isinstance(fields, Field) else tuple(fields)
    name = f"{effect} at {where}" if where else effect
    separated_by = "a look at the machine" if same else ""
    return Effect(name, where, fields, of_the_engine, *texts, same=same, separated_by=separated_by)


def rows(made: Stepped, joints: Sequence[str]) -> list[Effect]:
    """All that joints, drives and bodies may lack. joints: those that were logged."""
    model = made.model
    return [
        *_of_joints(made, joints),
        *_of_drives(model),
        *_of_bodies(
            model, CANDIDATE.payload_share if made.free < 0 else CANDIDATE.payload_share_moving
        ),
    ]


def _of_joints(made: Stepped, joints: Sequence[str]) -> Iterable[Effect]:
    model, weight = made.model, _scales(made.model, joints)

    for k, name in enumerate(joints):
        inertia = 1.0 / max(
            float(model.dof_invweight0[model.jnt_dofadr[model.joint(name).id]]), 1e-9
        )

        sizes = {"frictionloss": weight[name], "damping": weight[name], "armature": inertia}
        for what, size in sizes.items():
            f = field(model, f"joint:{name}.{what}")
            wide = f.by(max(f.step, 0.01 * size))
            for effect in (e for e in MACHINE if _edits(e, what)):
                yield row(effect.name, name, wide, (effect.physics, effect.excitation))
        off = number(f"reading:{name}.offset", READ, (k,), 0, 0.0, (-1.0, 1.0), CANDIDATE.turn)
        yield row(
            "angle offset",
            name,
            off,
            ("the angle is read from another zero", "gravity, stops, and where it is driven to"),
        )


def _edits(effect: Effect, what: str) -> bool:
    """Whether an effect is that number of a joint, and nothing else."""
    return [p.mjcf for p in effect.parameters] == [what] and not effect.on_actuator


def _of_drives(model: mujoco.MjModel) -> Iterable[Effect]:
    for k in range(model.nu):
        name = model.actuator(k).name or f"actuator{k}"
        if not np.any(model.actuator_gainprm[k, :3]):
            continue
        weak = (field(model, f"actuator:{name}.{STRENGTH}"),)
        if model.actuator_biasprm[k, 1] < 0 and model.actuator_biasprm[k, 2] < 0:
            weak += (field(model, f"actuator:{name}.kv"),)
        yield row("gain", name, weak, ("the drive gives more or less than told", "large commands"))
        if model.actuator_biasprm[k, 1] < 0 and model.actuator_trntype[k] == 0:
            shift = number(
                f"command:{name}.offset", SHIFT, (k,), 0, 0.0, (-1.0, 1.0), CANDIDATE.turn
            )
            yield row(
                "command offset",
                name,
                shift,
                ("the drive goes to another angle than told", "any command"),
            )
    if model.nu:
        yield row(
            "delay", "all joints", field(model, DELAY), ("commands act late", "fast commands")
        )


def _of_bodies(model: mujoco.MjModel, share: float) -> Iterable[Effect]:
    total = float(model.body_mass.sum())
    for b in range(1, model.nbody):
        if model.body_mass[b] > share * total and _moves(model, b):
            name = model.body(b).name or f"body{b}"
            place = [field(model, f"body:{name}.ipos[{i}]").by(CANDIDATE.shift) for i in range(3)]
            mass = field(model, f"body:{name}.mass")
            yield row(
                "payload",
                name,
                (mass, *place),
                ("a body of another mass", "motion against gravity"),
            )


def sensor_rows(made: Stepped, first: int) -> Iterable[Effect]:
    """What sensors may read wrong. first: place of theirs among the channels."""
    found = [
        (kind, axes)
        for kind in ("gyro", "accelerometer")
        if (axes := triple(made.read, kind)) is not None
    ]
    for kind, axes in found:
        step, most = SENSED[kind]
        places = tuple(first + k for k in axes)
        off = [
            number(f"imu.{kind}_bias[{i}]", BIAS, places, i, 0.0, (-most, most), step)
            for i in range(3)
        ]
        yield row(f"{kind} bias", "imu", off, ("it reads more or less than there is", "any motion"))
    if found:
        starts = tuple(first + axes[0] for _, axes in found)
        turned = [
            number(f"imu.turn[{i}]", TURN, starts, i, 0.0, (-0.5, 0.5), CANDIDATE.turn)
            for i in range(3)
        ]
        yield row("turned", "imu", turned, ("it is mounted at another angle", "turns, gravity"))
        every = tuple(first + k for _, axes in found for k in axes)
        yield row(
            "late",
            "imu",
            number("imu.late", LATE, every, 0, 0.0, (-0.05, 0.05), 1e-3),
            ("it is read late", "fast motion"),
        )


def _moves(model: mujoco.MjModel, body: int) -> bool:
    return model.body_dofnum[body] > 0 or model.body_weldid[body] != 0


def _scales(model: mujoco.MjModel, joints: Sequence[str]) -> dict[str, float]:
    """N m, N: of gravity at a joint, at least of its own inertia at an acceleration of 10 rad/s^2
    (m/s^2).
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    out = {}
    for name in joints:
        dof = int(model.jnt_dofadr[model.joint(name).id])
        out[name] = max(
            abs(float(data.qfrc_bias[dof])),
            10.0 / max(float(model.dof_invweight0[dof]), 1e-9) * 0.1,
            1e-3,
        )
    return out


def noise_of(measured: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Noise [C] of channels [W, L, C], where they were `seen`."""
    return sensor_noise(list(np.where(mask, measured, np.nan)))
