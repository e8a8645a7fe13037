"""Stretches stepped by MuJoCo on all cores: states from starts in tangent coordinates, and their
derivatives by differences.

A start is [2 nv + na]: a displacement of qpos along the tangent, one of qvel, one of the
activations, from where the stretch begins.
"""

import contextlib
import os
from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
from mujoco import rollout

from adaptsim_jax.mechanisms.quaternions import between
from adaptsim_jax.simulators.mujoco.acting import Acting, control_of
from adaptsim_jax.simulators.mujoco.build import SteppedModel
from adaptsim_jax.simulators.mujoco.stretches import MujocoStretches, dofs

FULL = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
# rad, m (a second): of a start, for its derivative; the solver of constraints converges to far
# less
START_STEP = 1e-5
MAX_STATE_NUMBERS = 4e7  # numbers of states that are held at once: 320 MB


def start_size(stepped_model: SteppedModel) -> int:
    return 2 * stepped_model.model.nv + stepped_model.model.na


def predict(
    stepped_model: SteppedModel,
    stretches: MujocoStretches,
    starts: np.ndarray,
    lanes: np.ndarray,
    models: Sequence[mujoco.MjModel] = (),
    acting: Acting | None = None,
) -> np.ndarray:
    """What the channels would read [B, L, C], NaN where the simulation blew up.

    starts [B, 2 nv + na]; lanes [B]: the stretch of each; models: that of each (none: the one
    made); by: what else acts on each.
    """
    size = mujoco.mj_stateSize(stepped_model.model, FULL)
    block = max(1, int(MAX_STATE_NUMBERS / (size * stretches.steps)))
    parts = []
    for i in range(0, len(lanes), block):
        part = slice(i, i + block)
        part_models = models[part] if len(models) else ()
        parts.append(
            _predict(
                stepped_model,
                stretches,
                starts[part],
                lanes[part],
                part_models,
                None if acting is None else acting.of(part),
            )
        )
    return np.concatenate(parts)


def _predict(
    stepped_model: SteppedModel, stretches: MujocoStretches, starts, lanes, models, by
) -> np.ndarray:
    model = stepped_model.model
    threads = max(1, len(os.sched_getaffinity(0)))
    states = initial_states(stepped_model, stretches, starts, lanes)
    control, spec = control_of(stepped_model, stretches, lanes, by)
    chosen = list(models) if len(models) else model
    data = [mujoco.MjData(model) for _ in range(min(threads, len(lanes)))]
    with quietly():
        path, sensed = rollout.rollout(
            chosen, data, states, control, control_spec=spec, persistent_pool=True
        )
    path = np.concatenate([states[:, None], path], 1)
    return read_channels(stepped_model, stretches, path, sensed, lanes)


@contextlib.contextmanager
def quietly() -> Iterator[None]:
    """Silence MuJoCo's warnings of runs that blow up, which it prints and writes into a file. They
    are seen in the numbers.
    """
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def initial_states(
    stepped_model: SteppedModel, stretches: MujocoStretches, starts: np.ndarray, lanes: np.ndarray
) -> np.ndarray:
    """Full states [B, nstate] of starts."""
    model, data = stepped_model.model, mujoco.MjData(stepped_model.model)
    nv = model.nv
    out = np.zeros((len(lanes), mujoco.mj_stateSize(model, FULL)))
    if model.nu and hasattr(model, "actuator_history"):
        delayed_actuators = np.flatnonzero(model.actuator_history[:, 0])
    else:
        delayed_actuators = ()
    times = {}
    for b, (w, x) in enumerate(zip(lanes, starts, strict=True)):
        qpos = stretches.qpos[w].copy()
        if np.any(x[:nv]):
            mujoco.mj_integratePos(model, qpos, np.ascontiguousarray(x[:nv]), 1.0)
        data.qpos[:] = qpos
        data.qvel[:] = stretches.qvel[w] + x[nv : 2 * nv]
        data.act[:] = stretches.act[w] + x[2 * nv :]
        for k in delayed_actuators:
            count = int(model.actuator_history[k, 0])
            if k not in times:
                times[k] = -float(model.opt.timestep) * np.arange(count, 0, -1)
            if stretches.past.shape[2] == model.nu:
                history = stretches.past[w, -count:, k]
            else:
                history = np.zeros(count)
            history = np.concatenate([np.full(count - len(history), history[0]), history])
            mujoco.mj_initCtrlHistory(
                model, data, int(k), times[k], np.ascontiguousarray(history[:, None])
            )
        mujoco.mj_getState(model, data, out[b], FULL)
    return out


def read_channels(
    stepped_model: SteppedModel,
    stretches: MujocoStretches,
    path: np.ndarray,
    sensed: np.ndarray,
    lanes: np.ndarray,
) -> np.ndarray:
    """Channels [B, L, C] of paths [B, S+1, nstate] and sensors [B, S, nsensordata], between steps
    along straight lines.
    """
    model, row_steps = stepped_model.model, stretches.row_steps[lanes]
    low = np.minimum(np.floor(row_steps + 1e-6).astype(int), path.shape[1] - 1)
    high = np.minimum(low + 1, path.shape[1] - 1)
    share = np.clip(row_steps - low, 0.0, 1.0)
    share = np.where(share < 1e-6, 0.0, share)[..., None]

    def pick(rows, columns):
        if len(columns):
            return np.take_along_axis(path, rows[..., None], 1)[..., 1 + columns]
        return np.zeros((*rows.shape, 0))

    angle = np.asarray(stepped_model.angle)
    columns = [angle]
    if has_speeds(stepped_model, stretches):
        columns.append(model.nq + dofs(stepped_model))
    if stepped_model.base >= 0:
        columns.append(stepped_model.base + np.arange(7))
    columns = np.concatenate(columns)
    first, last = pick(low, columns), pick(high, columns)
    if stepped_model.sensors:
        sensor_values, lane = (
            sensed[..., [r.place for r in stepped_model.sensors]],
            np.arange(len(lanes))[:, None],
        )
        split = columns.size - (7 if stepped_model.base >= 0 else 0)

        def with_sensors(z, k):
            row = sensor_values[lane, np.minimum(k, sensor_values.shape[1] - 1)]
            return np.concatenate([z[..., :split], row, z[..., split:]], -1)

        first, last = with_sensors(first, low), with_sensors(last, high)
    out = first + share * (last - first)
    return np.where(np.isfinite(out) & (np.abs(out) < 1e6), out, np.nan)


def residual(
    stepped_model: SteppedModel,
    stretches: MujocoStretches,
    predicted: np.ndarray,
    lanes: np.ndarray,
) -> np.ndarray:
    """Measured less predicted [B, L, C'], 0 where nothing was read; a base's orientation as three
    angles. A run that blew up is off by a large number.
    """
    measured, is_measured = stretches.measured[lanes], stretches.is_measured[lanes]
    if stepped_model.base >= 0:
        turn = between(predicted[..., -4:], measured[..., -4:])
        difference = np.concatenate([measured[..., :-4] - predicted[..., :-4], turn], -1)
        is_measured = np.concatenate(
            [is_measured[..., :-4], is_measured[..., -4:-3].repeat(3, -1)], -1
        )
    else:
        difference = measured - predicted
    return np.where(
        is_measured, np.where(np.isfinite(difference), np.clip(difference, -1e3, 1e3), 1e3), 0.0
    )


def has_speeds(stepped_model: SteppedModel, stretches: MujocoStretches) -> bool:
    """Whether speeds of the joints are among the channels."""
    return stretches.measured.shape[2] - len(stepped_model.sensors) - (
        7 if stepped_model.base >= 0 else 0
    ) == 2 * len(stepped_model.angle)


def by_start(
    stepped_model: SteppedModel, stretches: MujocoStretches, starts: np.ndarray, lanes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(residual [B, L, C'], its derivative [B, L, C', 2 nv + na] by the starts), by forward
    differences.
    """
    width = start_size(stepped_model)
    base = residual(
        stepped_model, stretches, predict(stepped_model, stretches, starts, lanes), lanes
    )
    perturbed = np.repeat(starts, width, 0)
    perturbed[np.arange(len(perturbed)), np.tile(np.arange(width), len(starts))] += START_STEP
    perturbed_lanes = np.repeat(lanes, width)
    perturbed_residual = residual(
        stepped_model,
        stretches,
        predict(stepped_model, stretches, perturbed, perturbed_lanes),
        perturbed_lanes,
    )
    slope = (
        perturbed_residual.reshape(len(starts), width, *base.shape[1:]) - base[:, None]
    ) / START_STEP
    return base, np.moveaxis(slope, 1, -1)
