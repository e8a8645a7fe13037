"""What acts beside a model's own numbers: commands that are late or shifted, a force on the base,
readings that are off.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from adaptsim_jax.simulators.mujoco.build import SteppedModel
from adaptsim_jax.simulators.mujoco.fields import DELAY, ModelNumber
from adaptsim_jax.simulators.mujoco.stretches import MujocoStretches, delay_commands

SHIFT, WIND = "command.offset", "wind"
READING_OFFSET, IMU_BIAS, IMU_TURN, IMU_DELAY = "reading.offset", "imu.bias", "imu.turn", "imu.late"
OUTSIDE = (DELAY, SHIFT, WIND, READING_OFFSET, IMU_BIAS, IMU_TURN, IMU_DELAY)
"""Kinds of fields that are no number of the model."""


@dataclass(frozen=True)
class Acting:
    """What acts on B simulations: `delay [B]` s of all commands; `shift [B, nu]` of each; `force
    [B, nv]` that acts all the time, None: none.
    """

    delay: np.ndarray
    shift: np.ndarray
    force: np.ndarray | None

    def of(self, some: slice) -> "Acting":
        """Return the simulations `some` alone."""
        return Acting(
            self.delay[some], self.shift[some], None if self.force is None else self.force[some]
        )


def acting(
    stepped_model: SteppedModel, fields: Sequence[ModelNumber], values: np.ndarray
) -> Acting:
    """Return what acts on simulations by values [B, P] of the fields."""
    model, count = stepped_model.model, len(values)
    delay, shift, force = np.zeros(count), np.zeros((count, model.nu)), None
    for f, value in zip(fields, values.T, strict=True):
        if f.field == DELAY:
            delay = value
        elif f.field == SHIFT:
            shift[:, f.elements[0]] += value
        elif f.field == WIND and np.any(value):
            force = np.zeros((count, model.nv)) if force is None else force
            force[:, f.elements[0] + f.index] += value
    return Acting(delay, shift, force)


def control_of(
    stepped_model: SteppedModel, stretches: MujocoStretches, lanes: np.ndarray, by: Acting | None
) -> tuple[np.ndarray, int]:
    """Return controls [B, S, ...], and what of MuJoCo's state they are. Commands between steps are
    a mix of both.
    """
    model, control = stepped_model.model, stretches.control[lanes]
    command = control.shape[2] == model.nu and model.nu > 0
    if by is not None and np.any(by.delay):
        control = delay_commands(
            stretches.past[lanes], control, by.delay / float(model.opt.timestep)
        )
    if by is not None and command and np.any(by.shift):
        control = control + by.shift[:, None]
    spec = int(mujoco.mjtState.mjSTATE_CTRL if command else mujoco.mjtState.mjSTATE_QFRC_APPLIED)
    if by is not None and by.force is not None:
        force = np.broadcast_to(by.force[:, None], (*control.shape[:2], model.nv))
        if not command:  # torques were logged: they are forces, too
            return control + force, spec
        control, spec = (
            np.concatenate([control, force], 2),
            spec | int(mujoco.mjtState.mjSTATE_QFRC_APPLIED),
        )
    return control, spec


def as_read(
    fields: Sequence[ModelNumber], values: np.ndarray, read: np.ndarray, time: np.ndarray
) -> np.ndarray:
    """Return channels [B, L, C] as a sensor with errors reads them, by values [B, P]; time [B, L]
    s.
    """
    out = read
    for f, value in zip(fields, values.T, strict=True):
        if f.field not in (READING_OFFSET, IMU_BIAS, IMU_TURN, IMU_DELAY) or not np.any(value):
            continue
        out = out.copy() if out is read else out
        if f.field in (READING_OFFSET, IMU_BIAS):
            out[..., f.elements[f.index]] += value[:, None]
        elif f.field == IMU_TURN:  # each triple of axes by a small angle about one of them
            for first in f.elements:
                one, two = first + (f.index + 1) % 3, first + (f.index + 2) % 3
                c, s = np.cos(value)[:, None], np.sin(value)[:, None]
                turned_one = c * out[..., one] + s * out[..., two]
                turned_two = c * out[..., two] - s * out[..., one]
                out[..., one], out[..., two] = turned_one, turned_two
        else:
            for k in f.elements:
                slope = np.gradient(out[..., k], axis=1) / np.maximum(
                    np.gradient(time, axis=1), 1e-9
                )
                out[..., k] -= value[:, None] * slope
    return out
