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
from adaptsim_jax.simulators.mujoco.acting import (
    IMU_BIAS,
    IMU_DELAY,
    IMU_TURN,
    READING_OFFSET,
    SHIFT,
)
from adaptsim_jax.simulators.mujoco.build import SteppedModel
from adaptsim_jax.simulators.mujoco.criteria import CANDIDATE
from adaptsim_jax.simulators.mujoco.fields import (
    DELAY,
    STRENGTH,
    ModelNumber,
    make_number,
    model_number,
)
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
    fields: ModelNumber | Iterable[ModelNumber],
    texts: tuple[str, str],
    same: tuple[str, ...] = (),
) -> Effect:
    """Make an effect at a place. texts: its physics, and what shows it; same: effects that no such
    recording distinguishes from it.
    """
    fields = (fields,) if isinstance(fields, ModelNumber) else tuple(fields)
    name = f"{effect} at {where}" if where else effect
    separated_by = "a look at the machine" if same else ""
    return Effect(name, where, fields, of_the_engine, *texts, same=same, separated_by=separated_by)


def rows(stepped_model: SteppedModel, joints: Sequence[str]) -> list[Effect]:
    """All that joints, drives and bodies may lack. joints: those that were logged."""
    model = stepped_model.model
    return [
        *_of_joints(stepped_model, joints),
        *_of_drives(model),
        *_of_bodies(
            model,
            CANDIDATE.payload_share if stepped_model.free < 0 else CANDIDATE.payload_share_moving,
        ),
    ]


def _of_joints(stepped_model: SteppedModel, joints: Sequence[str]) -> Iterable[Effect]:
    model, force_scale = stepped_model.model, _scales(stepped_model.model, joints)

    for k, name in enumerate(joints):
        inertia = 1.0 / max(
            float(model.dof_invweight0[model.jnt_dofadr[model.joint(name).id]]), 1e-9
        )

        sizes = {
            "frictionloss": force_scale[name],
            "damping": force_scale[name],
            "armature": inertia,
        }
        for what, size in sizes.items():
            model_value = model_number(model, f"joint:{name}.{what}")
            number = model_value.by(max(model_value.step, 0.01 * size))
            for effect in (e for e in MACHINE if _is_joint_number(e, what)):
                yield row(effect.name, name, number, (effect.physics, effect.excitation))
        offset = make_number(
            f"reading:{name}.offset", READING_OFFSET, (k,), 0, 0.0, (-1.0, 1.0), CANDIDATE.turn
        )
        yield row(
            "angle offset",
            name,
            offset,
            ("the angle is read from another zero", "gravity, stops, and where it is driven to"),
        )


def _is_joint_number(effect: Effect, what: str) -> bool:
    """Whether an effect is that number of a joint, and nothing else."""
    return [p.mjcf for p in effect.parameters] == [what] and not effect.on_actuator


def _of_drives(model: mujoco.MjModel) -> Iterable[Effect]:
    for k in range(model.nu):
        name = model.actuator(k).name or f"actuator{k}"
        if not np.any(model.actuator_gainprm[k, :3]):
            continue
        strength = (model_number(model, f"actuator:{name}.{STRENGTH}"),)
        if model.actuator_biasprm[k, 1] < 0 and model.actuator_biasprm[k, 2] < 0:
            strength += (model_number(model, f"actuator:{name}.kv"),)
        yield row(
            "gain", name, strength, ("the drive gives more or less than told", "large commands")
        )
        if model.actuator_biasprm[k, 1] < 0 and model.actuator_trntype[k] == 0:
            shift = make_number(
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
            "delay",
            "all joints",
            model_number(model, DELAY),
            ("commands act late", "fast commands"),
        )


def _of_bodies(model: mujoco.MjModel, share: float) -> Iterable[Effect]:
    total = float(model.body_mass.sum())
    for b in range(1, model.nbody):
        if model.body_mass[b] > share * total and _is_moving(model, b):
            name = model.body(b).name or f"body{b}"
            place = [
                model_number(model, f"body:{name}.ipos[{i}]").by(CANDIDATE.shift) for i in range(3)
            ]
            mass = model_number(model, f"body:{name}.mass")
            yield row(
                "payload",
                name,
                (mass, *place),
                ("a body of another mass", "motion against gravity"),
            )


def sensor_rows(stepped_model: SteppedModel, first: int) -> Iterable[Effect]:
    """Make the effects of sensor errors. first: place of the sensors among the channels."""
    sensors_found = [
        (kind, axes)
        for kind in ("gyro", "accelerometer")
        if (axes := triple(stepped_model.sensors, kind)) is not None
    ]
    for kind, axes in sensors_found:
        step, max_bias = SENSED[kind]
        places = tuple(first + k for k in axes)
        biases = [
            make_number(
                f"imu.{kind}_bias[{i}]", IMU_BIAS, places, i, 0.0, (-max_bias, max_bias), step
            )
            for i in range(3)
        ]
        yield row(
            f"{kind} bias", "imu", biases, ("it reads more or less than there is", "any motion")
        )
    if sensors_found:
        starts = tuple(first + axes[0] for _, axes in sensors_found)
        turns = [
            make_number(f"imu.turn[{i}]", IMU_TURN, starts, i, 0.0, (-0.5, 0.5), CANDIDATE.turn)
            for i in range(3)
        ]
        yield row("turned", "imu", turns, ("it is mounted at another angle", "turns, gravity"))
        all_channels = tuple(first + k for _, axes in sensors_found for k in axes)
        yield row(
            "late",
            "imu",
            make_number("imu.late", IMU_DELAY, all_channels, 0, 0.0, (-0.05, 0.05), 1e-3),
            ("it is read late", "fast motion"),
        )


def _is_moving(model: mujoco.MjModel, body: int) -> bool:
    return model.body_dofnum[body] > 0 or model.body_weldid[body] != 0


def _scales(model: mujoco.MjModel, joints: Sequence[str]) -> dict[str, float]:
    """Estimate a size of force, N m or N, by joint: gravity's, at least that of its own inertia at
    10 rad/s^2 (m/s^2).
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
    """Estimate the noise [C] of channels [W, L, C], where they were measured (`mask`)."""
    return sensor_noise(list(np.where(mask, measured, np.nan)))
