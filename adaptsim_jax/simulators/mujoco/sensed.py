"""Sensors of a model as channels of a log (`[channels]` in meta.toml), and what an IMU alone tells
of where a base begins.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.quaternions import times
from adaptsim_jax.simulators.mujoco.criteria import ATTITUDE

INERTIAL = {
    mujoco.mjtSensor.mjSENS_GYRO: "gyro",
    mujoco.mjtSensor.mjSENS_ACCELEROMETER: "accelerometer",
}
UNITS = {"gyro": "rad/s", "accelerometer": "m/s^2"}
PRIOR = {
    "place": 1e-2,
    "height": 0.05,
    "turn": 0.1,
    "heading": 1e-2,
    "speed": 0.5,
    "spin": 0.5,
    "joint": 10.0,
}
"""m, m, rad, rad, m/s, rad/s, rad (a second): how far a start may be from what an IMU and standing
feet say of it.
"""


@dataclass(frozen=True)
class Reading:
    """A channel: its sensor with a number (`gyro[0]`), its place in the model's sensordata, kind
    (gyro, accelerometer, other).
    """

    name: str
    place: int
    kind: str

    @property
    def unit(self) -> str:
        return UNITS.get(self.kind, "1")


def readings(model: mujoco.MjModel, channels: Mapping[str, str], where: str) -> tuple[Reading, ...]:
    """The channels of a log as sensors of a model. Raises BadInput where a name is none of its
    sensors.
    """
    out = []
    names = [model.sensor(k).name for k in range(model.nsensor)]
    for name in channels:
        match = re.fullmatch(r"(.+?)(?:\[(\d+)\])?", name)
        if match:
            sensor, index = (match[1], int(match[2] or 0))
        else:
            sensor, index = (name, 0)
        if not match or sensor not in names:
            if names:
                hint = suggest(sensor, names)
            else:
                hint = "it has none: add a <sensor> to the model file"
            raise BadInput(
                f"{where}: [channels] {channels[name]} = {name!r}: the model has no sensor "
                f"{sensor!r}; {hint}"
            )
        k = names.index(sensor)
        if index >= model.sensor_dim[k]:
            raise BadInput(
                f"{where}: [channels] {channels[name]} = {name!r}: {sensor} has "
                f"{model.sensor_dim[k]} numbers, from 0"
            )
        out.append(
            Reading(
                name,
                int(model.sensor_adr[k]) + index,
                INERTIAL.get(int(model.sensor_type[k]), "other"),
            )
        )
    return tuple(out)


def has_imu(spec: mujoco.MjSpec, channels: Iterable[str]) -> bool:
    """Whether a gyro and an accelerometer of the model are among the channels: then a base moves
    though its pose is not logged.
    """
    kinds = {
        s.type for s in spec.sensors if s.name in {name.partition("[")[0] for name in channels}
    }
    return {mujoco.mjtSensor.mjSENS_GYRO, mujoco.mjtSensor.mjSENS_ACCELEROMETER} <= kinds


def triple(sensors: tuple[Reading, ...], kind: str) -> list[int] | None:
    """Places among the channels of the three axes of a gyro or an accelerometer, None where not all
    are logged.
    """
    places = sorted((r.place, i) for i, r in enumerate(sensors) if r.kind == kind)
    if len(places) >= 3:
        return [i for _, i in places[:3]]
    return None


def turn_of(model: mujoco.MjModel, sensors: tuple[Reading, ...], kind: str) -> np.ndarray:
    """Rotation [3, 3] from an IMU's axes to those of the body that carries it."""
    first = next(r for r in sensors if r.kind == kind)
    k = int(np.flatnonzero(model.sensor_adr <= first.place)[-1])
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, model.site_quat[int(model.sensor_objid[k])])
    return out.reshape(3, 3)


def oriented(
    model: mujoco.MjModel, sensors: tuple[Reading, ...], time: np.ndarray, read: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Unit quaternions [T, 4] (heading 0 at first) and rates [T, 3] rad/s, both of the body that
    carries an IMU.

    Its gyro is integrated and drawn towards gravity (Mahony's complementary filter), forth, back
    and forth again, so that no guess of where it began is left. read [T, m]: all channels.
    """
    rate = read[:, triple(sensors, "gyro")] @ turn_of(model, sensors, "gyro").T
    up = read[:, triple(sensors, "accelerometer")] @ turn_of(model, sensors, "accelerometer").T
    rate, up = np.nan_to_num(rate), np.where(np.isfinite(up), up, [0.0, 0.0, 9.81])
    begin = up[time <= time[0] + ATTITUDE.settle].mean(0)
    quaternion, current = np.zeros(4), np.zeros(4)
    mujoco.mju_quatZ2Vec(quaternion, begin / max(np.linalg.norm(begin), 1e-9))
    mujoco.mju_negQuat(current, quaternion)
    forth, back = slice(None), slice(None, None, -1)
    for order in (forth, back, forth):
        out = _filter_orientation(current, time[order], rate[order], up[order])[order]
        current = out[-1] if order is forth else out[0]
    heading = np.array([out[0][0], 0.0, 0.0, -out[0][3]])
    return times(heading / np.linalg.norm(heading), out), rate


def _filter_orientation(
    initial: np.ndarray, time: np.ndarray, rate: np.ndarray, up: np.ndarray
) -> np.ndarray:
    """Orientations [T, 4] from `initial` on; time may run backwards. Where more than gravity acts,
    it does not count.
    """
    out = np.tile(initial, (len(time), 1))
    for k in range(len(time) - 1):
        back, own_up, size = np.zeros(4), np.zeros(3), np.linalg.norm(up[k])
        mujoco.mju_negQuat(back, out[k])
        mujoco.mju_rotVecQuat(own_up, np.array([0.0, 0.0, 1.0]), back)
        step = float(time[k + 1] - time[k])
        excess = (size / 9.81 - 1.0) / ATTITUDE.calm
        gain = ATTITUDE.follow * np.exp(-np.square(excess)) * np.sign(step)
        out[k + 1] = out[k]
        tilt = np.cross(up[k] / max(size, 1e-9), own_up)
        mujoco.mju_quatIntegrate(out[k + 1], rate[k] + gain * tilt, step)
    return out


def standing(
    model: mujoco.MjModel, data: mujoco.MjData, free: int, qpos: np.ndarray, qvel: np.ndarray
) -> None:
    """In place: height and speed of a free base (at `free` in qpos) whose lowest geom touches the
    ground and stands still.
    """
    joint = int(np.flatnonzero(model.jnt_qposadr == free)[0])
    dof = int(model.jnt_dofadr[joint])
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    solid = np.flatnonzero(
        (model.geom_bodyid > 0) & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    )
    low = [(data.geom_xpos[g, 2] - _below(model, data, int(g)), int(g)) for g in solid]
    if not low:
        return
    depth, lowest = min(low)
    point = data.geom_xpos[lowest] - [0.0, 0.0, data.geom_xpos[lowest, 2] - depth]
    across = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, across, None, point, int(model.geom_bodyid[lowest]))
    qpos[free + 2] -= depth
    qvel[dof : dof + 3] -= across @ qvel


def _below(model: mujoco.MjModel, data: mujoco.MjData, g: int) -> float:
    """m: how far a geom reaches below its middle."""
    down = np.abs(data.geom_xmat[g].reshape(3, 3)[2])
    size, kind = model.geom_size[g], model.geom_type[g]
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return float(size[0] + size[1] * down[2])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return float(size[0] * np.sqrt(max(1.0 - down[2] ** 2, 0.0)) + size[1] * down[2])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return float(down @ size)
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return float(np.linalg.norm(down * size))
    return float(model.geom_rbound[g])


def prior_of(model: mujoco.MjModel, free: int) -> np.ndarray:
    """Standard deviations [2 nv + na] of a start where a base's pose is not logged."""
    dof = int(model.jnt_dofadr[np.flatnonzero(model.jnt_qposadr == free)[0]])
    out = np.full(2 * model.nv + model.na, PRIOR["joint"])
    p = PRIOR
    out[dof : dof + 6] = p["place"], p["place"], p["height"], p["turn"], p["turn"], p["heading"]
    out[model.nv + dof : model.nv + dof + 6] = [p["speed"]] * 3 + [p["spin"]] * 3
    return out
