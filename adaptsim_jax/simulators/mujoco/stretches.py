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
from adaptsim_jax.simulators.mujoco.build import Stepped
from adaptsim_jax.simulators.mujoco.criteria import SIMULATION
from adaptsim_jax.simulators.mujoco.sensed import oriented, standing


@dataclass(frozen=True)
class MujocoStretches:
    """W stretches of S steps of a model. trial [W]; time [W, L] s since the trial began, of L rows
    with `seen` [W, L, C] readings `measured` [W, L, C] of C channels (angles in the log's order,
    then speeds where they are logged, sensors, the seven of a base); at [W, L]: rows in steps since
    the start; control [W, S, nu]; past [W, B, nu]: commands of the B steps before; qpos [W, nq],
    qvel [W, nv], act [W, na]: where each begins, from the measured motion; before [W, nv]: its
    speeds by the rows just before.
    """

    trial: np.ndarray
    time: np.ndarray
    measured: np.ndarray
    seen: np.ndarray
    at: np.ndarray
    control: np.ndarray
    past: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    before: np.ndarray
    names: tuple[str, ...]

    @property
    def count(self) -> int:
        return len(self.trial)

    @property
    def steps(self) -> int:
        return self.control.shape[1]


def cut(made: Stepped, log: Log, horizon: float, most: int) -> MujocoStretches:
    """Stretches of `horizon` s of all trials; see `stretch_rows`.

    Raises BadInput where no trial holds a whole one.
    """
    model, trials = made.model, log.trials
    spans = []
    for trial in trials:
        last = np.searchsorted(trial.time, trial.time + horizon - 0.5 * trial.dt)
        spans.append(TrialSpans(trial.time, trial.q, last))
    chosen = stretch_rows(spans, horizon, most, f"{log.path}: ")
    ends = zip(chosen.trial, chosen.first, chosen.last, strict=True)
    seconds = [trials[k].time[last] - trials[k].time[first] for k, first, last in ends]
    steps = max(1, int(np.ceil(max(seconds) / float(model.opt.timestep) - 0.25)))
    motion = {k: _motion(trials[k]) for k in np.unique(chosen.trial)}
    felt = _felt(made, log)
    inputs = [inputs_of(model, log, trial) for trial in trials]
    lanes = []
    for k, rows, own in zip(chosen.trial, *chosen.compared(), strict=True):
        moving = (*motion[k], felt.get(k))
        lanes.append(_lane(made, trials[k], moving, inputs[k], (rows, own), steps))

    def stack(key):
        return np.stack([lane[key] for lane in lanes])

    keys = ("time", "measured", "seen", "at", "control", "past", "qpos", "qvel", "act", "before")
    return MujocoStretches(
        chosen.trial, **{k: stack(k) for k in keys}, names=tuple(t.name for t in trials)
    )


def _felt(made: Stepped, log: Log) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """By trial the orientation [T, 4] and rate [T, 3] of a base that only its IMU tells of. Empty
    where its pose is logged.
    """
    if made.free < 0 or made.base >= 0:
        return {}
    read = {
        k: np.stack([t.channels[r.name] for r in made.read], 1) for k, t in enumerate(log.trials)
    }
    return {
        k: oriented(made.model, made.read, log.trials[k].time, values) for k, values in read.items()
    }


def _motion(trial: LogTrial) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed angles and speeds [T, n]."""
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


def _lane(
    made: Stepped,
    trial: LogTrial,
    motion,
    u: np.ndarray,
    compared: tuple[np.ndarray, np.ndarray],
    steps: int,
) -> dict:
    """The arrays of a stretch of a trial; compared: its rows [L], and whether they are its own;
    steps: of the longest stretch.
    """
    live, here = compared
    begin, h = int(live[0]), float(made.model.opt.timestep)
    start = trial.time[begin]

    def row_of(t):
        row = np.searchsorted(trial.time, t + 0.5 * h - 1e-9, side="right") - 1
        return np.clip(row, 0, len(trial.time) - 1)

    control = u[row_of(start + h * np.arange(steps))]
    before = max(1, int(np.ceil(SIMULATION.past / h)))
    past = u[row_of(start - h * np.arange(before, 0, -1))]
    base = trial.base if made.base >= 0 else None
    channels = [trial.q[live]]
    if trial.v is not None:
        channels.append(trial.v[live])
    channels += [trial.channels[r.name][live, None] for r in made.read]
    if base is not None:
        channels.append(base[live])
    measured = np.concatenate(channels, 1)
    qpos, qvel = _start(made, trial, motion, begin)
    at = np.clip((trial.time[live] - start) / h, 0, steps)
    mask = np.isfinite(measured) & here[:, None]
    if made.read:  # a sensor is read where a step begins, and none begins at the end
        last = measured.shape[1] - (7 if made.base >= 0 else 0)
        mask[:, last - len(made.read) : last] &= (at <= steps - 1 + 1e-6)[:, None]
    return {
        "time": trial.time[live] - trial.time[0],
        "measured": np.nan_to_num(measured),
        "seen": mask,
        "at": at,
        "control": control,
        "past": past,
        "qpos": qpos,
        "qvel": qvel,
        "act": _act(made, qpos, past),
        "before": _rate_before(made, trial, begin, qpos, qvel),
    }


def _start(made: Stepped, trial: LogTrial, motion, begin: int) -> tuple[np.ndarray, np.ndarray]:
    """qpos [nq] and qvel [nv] from the measured motion. What was not logged as the loops and
    equalities of the model have it.
    """
    model, data = made.model, mujoco.MjData(made.model)
    qpos, qvel = made.pose.copy(), np.zeros(model.nv)
    q, v, felt = motion
    measured = trial.q[begin]
    qpos[made.angle] = np.where(np.isfinite(measured), measured, q[begin])
    dof = dofs(made)
    if trial.v is None:
        speed = v[begin]
    else:
        speed = np.where(np.isfinite(trial.v[begin]), trial.v[begin], v[begin])
    qvel[dof] = speed
    known = np.zeros(model.nv, bool)
    known[dof] = True
    if made.base >= 0 and trial.base is not None:
        qpos[made.base : made.base + 7] = trial.base[begin]
        k = int(np.flatnonzero(model.jnt_qposadr == made.base)[0])
        at = int(model.jnt_dofadr[k])
        known[at : at + 6] = True
        qvel[at : at + 6] = _base_rate(trial, begin)
    if felt is not None:
        at = int(model.jnt_dofadr[np.flatnonzero(model.jnt_qposadr == made.free)[0]])
        known[at : at + 6] = True
        qpos[made.free : made.free + 2] = 0.0
        qpos[made.free + 3 : made.free + 7] = felt[0][begin]
        qvel[at + 3 : at + 6] = felt[1][begin]
        standing(model, data, made.free, qpos, qvel)
    if not known.all() and model.neq:
        qpos, qvel = _consistent(model, data, qpos, qvel, ~known)
    return qpos, qvel


def _rate_before(
    made: Stepped, trial: LogTrial, begin: int, qpos: np.ndarray, qvel: np.ndarray
) -> np.ndarray:
    """Speeds [nv] by the last two rows up to a start; as they are where there is none before."""
    out = qvel.copy()
    if begin > 0:
        dt = trial.time[begin] - trial.time[begin - 1]
        change = (trial.q[begin] - trial.q[begin - 1]) / dt
        known = np.isfinite(change)
        dof = dofs(made)
        out[dof[known]] = change[known]
        if made.base >= 0:
            at = int(made.model.jnt_dofadr[np.flatnonzero(made.model.jnt_qposadr == made.base)[0]])
            out[at : at + 6] = _base_rate(trial, begin, slice(begin - 1, begin + 1))
        unknown = ~_known(made)
        if unknown.any() and made.model.neq:
            out = _consistent(made.model, mujoco.MjData(made.model), qpos.copy(), out, unknown)[1]
    return out


def _known(made: Stepped) -> np.ndarray:
    """[nv]: whether a log tells the speed."""
    out = np.zeros(made.model.nv, bool)
    out[dofs(made)] = True
    if made.free >= 0:
        at = int(made.model.jnt_dofadr[np.flatnonzero(made.model.jnt_qposadr == made.free)[0]])
        out[at : at + 6] = True
    return out


def dofs(made: Stepped) -> np.ndarray:
    """[n]: where the speed of each joint of the log is in qvel."""
    model = made.model
    return np.array(
        [int(model.jnt_dofadr[np.flatnonzero(model.jnt_qposadr == a)[0]]) for a in made.angle], int
    )


def _base_rate(trial: LogTrial, row: int, some: slice | None = None) -> np.ndarray:
    """[6] m/s in the world and rad/s in the base, by differences over some rows (None: about
    one).
    """
    assert trial.base is not None
    some = some or slice(max(0, row - 2), row + 3)
    t, place, turn = trial.time[some], trial.base[some, :3], trial.base[some, 3:]
    out = np.zeros(6)
    out[:3] = np.polyfit(t - trial.time[row], place, min(2, len(t) - 1))[-2]
    angle = between(trial.base[row, 3:], turn)
    out[3:] = np.polyfit(t - trial.time[row], angle, min(2, len(t) - 1))[-2]
    return out


def _consistent(model, data, qpos, qvel, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """With what is `free` [nv] moved until equalities hold, by Gauss and Newton's steps; the rest
    as it was measured.
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
        j, off = jacobian[rows], data.efc_pos[rows]
        step = np.zeros(model.nv)
        step[free] = -np.linalg.lstsq(j[:, free], off, rcond=1e-6)[0]
        mujoco.mj_integratePos(model, qpos, step, 1.0)
        if np.abs(step).max() < 1e-10:
            break
    if len(rows):
        qvel = qvel.copy()
        driven = j[:, ~free] @ qvel[~free]
        qvel[free] = -np.linalg.lstsq(j[:, free], driven, rcond=1e-6)[0]
    return qpos, qvel


def _act(made: Stepped, qpos: np.ndarray, past: np.ndarray) -> np.ndarray:
    """Activations [na] at a start: filters as the commands before bring them about, integrators
    where their actuators are.
    """
    model = made.model
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


def late(past: np.ndarray, control: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Commands [W, S, nu] that act so many `steps` [W] later (below zero: earlier), between steps
    as a mix of both.
    """
    both = np.concatenate([past, control], 1)
    before, last = past.shape[1], both.shape[1] - 1
    at = np.clip(before + np.arange(control.shape[1]) - steps[:, None], 0, last)
    low = np.floor(at).astype(int)
    share, row = (at - low)[..., None], np.arange(len(steps))[:, None]
    return (1.0 - share) * both[row, low] + share * both[row, np.minimum(low + 1, last)]
