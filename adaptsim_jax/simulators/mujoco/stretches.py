"""A recording cut into stretches on the grid of a model's own time step, each with a start of its
own.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.log import Log, LogTrial
from adaptsim_jax.logs.noise import local_motion
from adaptsim_jax.logs.stretch_rows import TrialSpans, stretch_rows
from adaptsim_jax.mechanisms.quaternions import between
from adaptsim_jax.simulators.mujoco.build import SteppedModel
from adaptsim_jax.simulators.mujoco.criteria import SIMULATION
from adaptsim_jax.simulators.mujoco.sensed import oriented, standing


@dataclass(frozen=True)
class MujocoStretches:
    """W stretches of S steps of a model. trial [W]; time [W, L] s since the trial began, of L rows
    with `is_measured` [W, L, C] readings `measured` [W, L, C] of C channels (angles in the log's
    order, then speeds where they are logged, sensors, the seven of a base); `row_steps` [W, L]:
    times of rows in steps since the start; control [W, S, nu]; past [W, B, nu]: commands of the B
    steps before; qpos [W, nq], qvel [W, nv], act [W, na]: initial state of each, from the measured
    motion; `speed_before` [W, nv]: its speeds by the rows just before.
    """

    trial: np.ndarray
    time: np.ndarray
    measured: np.ndarray
    is_measured: np.ndarray
    row_steps: np.ndarray
    control: np.ndarray
    past: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    speed_before: np.ndarray
    names: tuple[str, ...]

    @property
    def count(self) -> int:
        return len(self.trial)

    @property
    def steps(self) -> int:
        return self.control.shape[1]


def cut_stretches(
    stepped_model: SteppedModel, log: Log, horizon: float, max_stretches: int
) -> MujocoStretches:
    """Cut all trials into stretches of `horizon` s; see `stretch_rows`.

    Raises BadInput where no trial holds a whole one.
    """
    model, trials = stepped_model.model, log.trials
    spans = []
    for trial in trials:
        last = np.searchsorted(trial.time, trial.time + horizon - 0.5 * trial.dt)
        spans.append(TrialSpans(trial.time, trial.q, last))
    chosen = stretch_rows(spans, horizon, max_stretches, f"{log.path}: ")
    ends = zip(chosen.trial, chosen.first, chosen.last, strict=True)
    seconds = [trials[k].time[last] - trials[k].time[first] for k, first, last in ends]
    steps = max(1, int(np.ceil(max(seconds) / float(model.opt.timestep) - 0.25)))
    motion = {k: _motion(trials[k]) for k in np.unique(chosen.trial)}
    bases_from_imu = _bases_from_imu(stepped_model, log)
    inputs = [inputs_of(model, log, trial) for trial in trials]
    stretches = []
    for k, rows, is_own in zip(chosen.trial, *chosen.compared(), strict=True):
        moving = (*motion[k], bases_from_imu.get(k))
        stretches.append(
            _stretch(stepped_model, trials[k], moving, inputs[k], (rows, is_own), steps)
        )

    def stack(key):
        return np.stack([stretch[key] for stretch in stretches])

    keys = (
        "time",
        "measured",
        "is_measured",
        "row_steps",
        "control",
        "past",
        "qpos",
        "qvel",
        "act",
        "speed_before",
    )
    return MujocoStretches(
        chosen.trial, **{k: stack(k) for k in keys}, names=tuple(t.name for t in trials)
    )


def _bases_from_imu(
    stepped_model: SteppedModel, log: Log
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Estimate by trial the orientation [T, 4] and rate [T, 3] rad/s of a base from its IMU. Empty
    where its pose is logged.
    """
    if stepped_model.free < 0 or stepped_model.base >= 0:
        return {}
    sensor_values = {
        k: np.stack([t.channels[r.name] for r in stepped_model.sensors], 1)
        for k, t in enumerate(log.trials)
    }
    return {
        k: oriented(stepped_model.model, stepped_model.sensors, log.trials[k].time, values)
        for k, values in sensor_values.items()
    }


def _motion(trial: LogTrial) -> tuple[np.ndarray, np.ndarray]:
    """Smooth angles and speeds [T, n]."""
    if trial.q.shape[1]:
        return local_motion(trial.time, trial.q, trial.v)
    return (trial.q, trial.q)


def inputs_of(model: mujoco.MjModel, log: Log, trial: LogTrial) -> np.ndarray:
    """[T, nu] commands of the model's actuators, or [T, nv] forces at its joints where torques were
    logged.
    """
    if log.input_kind == "command":
        out = np.zeros((len(trial.time), model.nu))
        for k, name in enumerate(log.input_names):
            actuator = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
            if actuator >= 0:
                out[:, actuator] = trial.u[:, k]
        return np.nan_to_num(out)
    if log.input_kind in ("voltage", "current"):
        raise BadInput(
            f"{log.path}: volts or amperes have no simulator mujoco; give torques or commands, or "
            "--simulator tree"
        )
    out = np.zeros((len(trial.time), model.nv))
    for k, name in enumerate(log.input_names):
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if joint >= 0:
            out[:, model.jnt_dofadr[joint]] = trial.u[:, k]
    return np.nan_to_num(out)


def _stretch(
    stepped_model: SteppedModel,
    trial: LogTrial,
    motion,
    u: np.ndarray,
    compared_rows: tuple[np.ndarray, np.ndarray],
    steps: int,
) -> dict:
    """The arrays of a stretch of a trial; compared: its rows [L], and whether they are its own;
    steps: of the longest stretch.
    """
    rows, is_own = compared_rows
    first_row, h = int(rows[0]), float(stepped_model.model.opt.timestep)
    start = trial.time[first_row]

    def row_of(t):
        row = np.searchsorted(trial.time, t + 0.5 * h - 1e-9, side="right") - 1
        return np.clip(row, 0, len(trial.time) - 1)

    control = u[row_of(start + h * np.arange(steps))]
    n_past = max(1, int(np.ceil(SIMULATION.past / h)))
    past = u[row_of(start - h * np.arange(n_past, 0, -1))]
    base = trial.base if stepped_model.base >= 0 else None
    channels = [trial.q[rows]]
    if trial.v is not None:
        channels.append(trial.v[rows])
    channels += [trial.channels[r.name][rows, None] for r in stepped_model.sensors]
    if base is not None:
        channels.append(base[rows])
    measured = np.concatenate(channels, 1)
    qpos, qvel = _initial_state(stepped_model, trial, motion, first_row)
    row_steps = np.clip((trial.time[rows] - start) / h, 0, steps)
    is_measured = np.isfinite(measured) & is_own[:, None]
    if stepped_model.sensors:  # a sensor is read where a step begins, and none begins at the end
        n_channels = measured.shape[1] - (7 if stepped_model.base >= 0 else 0)
        is_measured[:, n_channels - len(stepped_model.sensors) : n_channels] &= (
            row_steps <= steps - 1 + 1e-6
        )[:, None]
    return {
        "time": trial.time[rows] - trial.time[0],
        "measured": np.nan_to_num(measured),
        "is_measured": is_measured,
        "row_steps": row_steps,
        "control": control,
        "past": past,
        "qpos": qpos,
        "qvel": qvel,
        "act": _initial_activations(stepped_model, qpos, past),
        "speed_before": _speeds_before(stepped_model, trial, first_row, qpos, qvel),
    }


def _initial_state(
    stepped_model: SteppedModel, trial: LogTrial, motion, first_row: int
) -> tuple[np.ndarray, np.ndarray]:
    """qpos [nq] and qvel [nv] from the measured motion. What was not logged as the loops and
    equalities of the model have it.
    """
    model, data = stepped_model.model, mujoco.MjData(stepped_model.model)
    qpos, qvel = stepped_model.pose.copy(), np.zeros(model.nv)
    q, v, base_from_imu = motion
    measured = trial.q[first_row]
    qpos[stepped_model.angle] = np.where(np.isfinite(measured), measured, q[first_row])
    dof = dofs(stepped_model)
    if trial.v is None:
        speed = v[first_row]
    else:
        speed = np.where(np.isfinite(trial.v[first_row]), trial.v[first_row], v[first_row])
    qvel[dof] = speed
    is_logged = np.zeros(model.nv, bool)
    is_logged[dof] = True
    if stepped_model.base >= 0 and trial.base is not None:
        qpos[stepped_model.base : stepped_model.base + 7] = trial.base[first_row]
        k = int(np.flatnonzero(model.jnt_qposadr == stepped_model.base)[0])
        first_dof = int(model.jnt_dofadr[k])
        is_logged[first_dof : first_dof + 6] = True
        qvel[first_dof : first_dof + 6] = _base_rate(trial, first_row)
    if base_from_imu is not None:
        first_dof = int(
            model.jnt_dofadr[np.flatnonzero(model.jnt_qposadr == stepped_model.free)[0]]
        )
        is_logged[first_dof : first_dof + 6] = True
        qpos[stepped_model.free : stepped_model.free + 2] = 0.0
        qpos[stepped_model.free + 3 : stepped_model.free + 7] = base_from_imu[0][first_row]
        qvel[first_dof + 3 : first_dof + 6] = base_from_imu[1][first_row]
        standing(model, data, stepped_model.free, qpos, qvel)
    if not is_logged.all() and model.neq:
        qpos, qvel = _satisfy_equalities(model, data, qpos, qvel, ~is_logged)
    return qpos, qvel


def _speeds_before(
    stepped_model: SteppedModel, trial: LogTrial, first_row: int, qpos: np.ndarray, qvel: np.ndarray
) -> np.ndarray:
    """Speeds [nv] by the last two rows up to a start; as they are where there is none before."""
    out = qvel.copy()
    if first_row > 0:
        dt = trial.time[first_row] - trial.time[first_row - 1]
        change = (trial.q[first_row] - trial.q[first_row - 1]) / dt
        is_read = np.isfinite(change)
        dof = dofs(stepped_model)
        out[dof[is_read]] = change[is_read]
        if stepped_model.base >= 0:
            first_dof = int(
                stepped_model.model.jnt_dofadr[
                    np.flatnonzero(stepped_model.model.jnt_qposadr == stepped_model.base)[0]
                ]
            )
            out[first_dof : first_dof + 6] = _base_rate(
                trial, first_row, slice(first_row - 1, first_row + 1)
            )
        is_unlogged = ~_is_logged(stepped_model)
        if is_unlogged.any() and stepped_model.model.neq:
            out = _satisfy_equalities(
                stepped_model.model,
                mujoco.MjData(stepped_model.model),
                qpos.copy(),
                out,
                is_unlogged,
            )[1]
    return out


def _is_logged(stepped_model: SteppedModel) -> np.ndarray:
    """Return by DOF [nv] whether its speed is logged."""
    is_logged = np.zeros(stepped_model.model.nv, bool)
    is_logged[dofs(stepped_model)] = True
    if stepped_model.free >= 0:
        first_dof = int(
            stepped_model.model.jnt_dofadr[
                np.flatnonzero(stepped_model.model.jnt_qposadr == stepped_model.free)[0]
            ]
        )
        is_logged[first_dof : first_dof + 6] = True
    return is_logged


def dofs(stepped_model: SteppedModel) -> np.ndarray:
    """[n]: where the speed of each joint of the log is in qvel."""
    model = stepped_model.model
    return np.array(
        [
            int(model.jnt_dofadr[np.flatnonzero(model.jnt_qposadr == a)[0]])
            for a in stepped_model.angle
        ],
        int,
    )


def _base_rate(trial: LogTrial, row: int, rows: slice | None = None) -> np.ndarray:
    """[6] m/s in the world and rad/s in the base, by differences over some rows (None: about
    one).
    """
    assert trial.base is not None
    rows = rows or slice(max(0, row - 2), row + 3)
    t, place, orientation = trial.time[rows], trial.base[rows, :3], trial.base[rows, 3:]
    out = np.zeros(6)
    out[:3] = np.polyfit(t - trial.time[row], place, min(2, len(t) - 1))[-2]
    angle = between(trial.base[row, 3:], orientation)
    out[3:] = np.polyfit(t - trial.time[row], angle, min(2, len(t) - 1))[-2]
    return out


def _satisfy_equalities(
    model, data, qpos, qvel, is_free: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Move DOFs that are free (`is_free` [nv]) until equalities hold, by Gauss and Newton's steps;
    the others stay as measured.
    """
    for _ in range(20):
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_fwdPosition(model, data)
        rows = np.flatnonzero(
            data.efc_type[: data.nefc] == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        )
        if not len(rows):
            break
        jacobian = np.zeros((data.nefc, model.nv))
        if mujoco.mj_isSparse(model):
            mujoco.mju_sparse2dense(
                jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind
            )
        else:
            jacobian[:] = data.efc_J.reshape(-1, model.nv)[: data.nefc]
        j, violation = jacobian[rows], data.efc_pos[rows]
        step = np.zeros(model.nv)
        step[is_free] = -np.linalg.lstsq(j[:, is_free], violation, rcond=1e-6)[0]
        mujoco.mj_integratePos(model, qpos, step, 1.0)
        if np.abs(step).max() < 1e-10:
            break
    if len(rows):
        qvel = qvel.copy()
        logged_rate = j[:, ~is_free] @ qvel[~is_free]
        qvel[is_free] = -np.linalg.lstsq(j[:, is_free], logged_rate, rcond=1e-6)[0]
    return qpos, qvel


def _initial_activations(
    stepped_model: SteppedModel, qpos: np.ndarray, past: np.ndarray
) -> np.ndarray:
    """Activations [na] at a start: filters as the commands before bring them about, integrators
    where their actuators are.
    """
    model = stepped_model.model
    out = np.zeros(model.na)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)
    h = float(model.opt.timestep)
    for k in range(model.nu):
        adr, kind = int(model.actuator_actadr[k]), int(model.actuator_dyntype[k])
        if adr < 0 or past.shape[1] != model.nu:
            continue
        if kind in (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT)):
            x, lag = past[0, k], max(float(model.actuator_dynprm[k, 0]), 1e-6)
            share = 1.0 - np.exp(-h / lag)
            for u in past[:, k]:
                x += share * (u - x)
            out[adr + model.actuator_actnum[k] - 1] = x
        elif kind == int(mujoco.mjtDyn.mjDYN_INTEGRATOR):
            out[adr] = data.actuator_length[k]
    return out


def delay_commands(past: np.ndarray, control: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Delay commands [W, S, nu] by `steps` [W] (below zero: earlier), between steps as a mix of
    both.
    """
    commands = np.concatenate([past, control], 1)
    n_past, last = past.shape[1], commands.shape[1] - 1
    position = np.clip(n_past + np.arange(control.shape[1]) - steps[:, None], 0, last)
    low = np.floor(position).astype(int)
    share, row = (position - low)[..., None], np.arange(len(steps))[:, None]
    return (1.0 - share) * commands[row, low] + share * commands[row, np.minimum(low + 1, last)]
