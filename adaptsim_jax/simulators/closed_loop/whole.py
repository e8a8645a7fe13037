"""Whole trials of the whole machine, simulated by MuJoCo with other laws than the file's.

MuJoCo takes targets and what a limit cuts as a step begins: motion is wrong by a part of the step.
So a trial is stepped twice, once twice as coarsely, and what the step itself does to the motion is
taken off (Richardson's extrapolation).
"""

import copy
import os
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import rollout
from scipy import signal

from adaptsim_jax.simulators.closed_loop.imposed import Recording, heavier
from adaptsim_jax.simulators.closed_loop.law import ServoLaw, put_law
from adaptsim_jax.simulators.closed_loop.pieces import Trial, TrialMotion
from adaptsim_jax.simulators.mujoco.rollouts import FULL, quietly

LANES = 16  # machines that are simulated at once: their paths are held in memory
MAX_ERROR = 10.0  # rad (m): an error that counts as no larger


def machine_of(recording: Recording, laws: Sequence[ServoLaw]) -> mujoco.MjModel:
    """The model whose servos have these laws."""
    payload = laws[0].payload
    if recording.hand >= 0 and payload:
        at = recording.model.body_ipos[recording.hand] + laws[0].reach * recording.outward
        model = heavier(recording.model, recording.hand, payload, at)
    else:
        model = copy.copy(recording.model)
    for servo, law in zip(recording.servos, laws, strict=True):
        put_law(servo, model, law)
    if laws[0].lift != recording.servos[0].law.lift:
        model.body_gravcomp[1:] = laws[0].lift
    return model


def filtered_targets(recording: Recording, trial: int, laws: Sequence[ServoLaw]) -> np.ndarray:
    """Targets [S, n] in rad, as means over the steps, late, filtered and shifted."""
    t, dt = recording.trials[trial], recording.whole_step
    steps = max(1, int(np.ceil(t.time[-1] / dt - 1e-9)))
    edges = np.append(t.time, t.time[-1] + 10.0)
    out = np.zeros((steps, len(laws)))
    for j, law in enumerate(laws):
        target = t.target[:, j]
        area_at_edges = np.append(0.0, np.cumsum(np.diff(edges) * target))
        at = dt * np.arange(steps + 1) - law.delay - law.shift
        area = np.where(at < 0.0, at * target[0], np.interp(at, edges, area_at_edges))
        mean = np.diff(area) / dt
        if law.lag > 1e-6:
            mean = _filter(mean, 1.0 - np.exp(-dt / law.lag))
        out[:, j] = mean + law.offset - law.zero
    return out


def _filter(u: np.ndarray, share: float) -> np.ndarray:
    out, _ = signal.lfilter([share], [1.0, share - 1.0], u, zi=[(1.0 - share) * u[0]])
    return out


def simulate(
    recording: Recording, machines: Sequence[Sequence[ServoLaw]]
) -> list[list[TrialMotion]]:
    """Motion of each trial, by machine: angles and speeds [T, n] at its rows; NaN from where a
    simulation blew up. Accelerations are those of the speeds.
    """
    fine, coarse = (
        simulate_once(recording, machines),
        simulate_once(recording.restepped(2.0), machines),
    )
    return [
        [_extrapolate(one, other) for one, other in zip(*both, strict=True)]
        for both in zip(fine, coarse, strict=True)
    ]


def _extrapolate(fine: TrialMotion, coarse: TrialMotion) -> TrialMotion:
    """Extrapolate motion to a step of 0; `fine` where the coarse motion blew up."""
    changes = (np.nan_to_num(f - c) for f, c in ((fine.q, coarse.q), (fine.v, coarse.v)))
    dq, dv = changes
    return TrialMotion(fine.q + dq, fine.v + dv, fine.a)


def simulate_once(
    recording: Recording, machines: Sequence[Sequence[ServoLaw]]
) -> list[list[TrialMotion]]:
    """Simulate in steps of the recording's model alone."""
    out: list[list[TrialMotion]] = []
    for first in range(0, len(machines), LANES):
        batch = machines[first : first + LANES]
        models = [machine_of(recording, laws) for laws in batch]
        trials = [
            _simulate_trial(recording, k, models, batch) for k in range(len(recording.trials))
        ]
        out += [[trial[b] for trial in trials] for b in range(len(batch))]
    return out


def _simulate_trial(recording, k: int, models, machines) -> list[TrialMotion]:
    trial, dt, servos = recording.trials[k], recording.whole_step, recording.servos
    qpos, dof = np.array([s.qpos for s in servos]), np.array([s.dof for s in servos])
    data = mujoco.MjData(models[0])
    data.qpos[:] = recording.pose
    for name, angle in trial.begins.items():
        data.qpos[models[0].joint(name).qposadr[0]] = angle
    data.qvel[dof] = trial.start_speed()
    states, controls = [], []
    for model, laws in zip(models, machines, strict=True):
        u = filtered_targets(recording, k, laws)
        control = np.zeros((len(u), model.nu))
        control[:, [s.actuator for s in servos]] = u
        _put_others(model, trial, dt, control)
        controls.append(control)
        data.qpos[qpos] = trial.q[0] - np.array([law.zero for law in laws])
        if model.na:
            data.act[:] = 0.0
            for s, first in zip(servos, u[0], strict=True):
                if model.actuator_actadr[s.actuator] >= 0:
                    data.act[model.actuator_actadr[s.actuator]] = first
        state = np.zeros(mujoco.mj_stateSize(model, FULL))
        mujoco.mj_getState(model, data, state, FULL)
        states.append(state)
    threads = min(len(models), len(os.sched_getaffinity(0)))
    workers = [mujoco.MjData(models[0]) for _ in range(threads)]
    with quietly():
        path, _ = rollout.rollout(
            list(models), workers, np.array(states), np.array(controls), persistent_pool=True
        )
    path = np.concatenate([np.array(states)[:, None], path], 1)
    at = trial.time / dt
    row = np.clip(np.floor(at + 1e-6).astype(int), 0, path.shape[1] - 2)
    share = np.clip(at - row, 0.0, 1.0)[:, None]
    columns = 1 + np.concatenate([qpos, models[0].nq + dof])
    low, high = path[:, row][..., columns], path[:, row + 1][..., columns]
    q, v = np.split(low + share * (high - low), 2, axis=-1)
    zero = np.array([[law.zero for law in laws] for laws in machines])[:, None]
    return [TrialMotion(a, b, np.zeros_like(a)) for a, b in zip(q + zero, v, strict=True)]


def _put_others(model: mujoco.MjModel, trial: Trial, step: float, control: np.ndarray) -> None:
    """Put the commands of actuators that are no servo of a joint into `control` [S, nu], held."""
    row = np.searchsorted(trial.time, step * np.arange(len(control)) + 1e-9, side="right") - 1
    for name, command in trial.others.items():
        actuator = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
        if actuator >= 0:
            control[:, actuator] = command[row]


def trial_errors(recording: Recording, motions: Sequence[TrialMotion]) -> np.ndarray:
    """Simulated less measured angles [rows of all trials, n], each within `MAX_ERROR`."""
    off = [m.q - t.q for m, t in zip(motions, recording.trials, strict=True)]
    return np.clip(np.nan_to_num(np.concatenate(off), nan=MAX_ERROR), -MAX_ERROR, MAX_ERROR)


def blocks_of(recording: Recording) -> np.ndarray:
    """Piece [rows of all trials] of each row, -1 where it is in none."""
    first = np.cumsum([0, *(len(t.time) for t in recording.trials)])
    out = np.full(first[-1], -1)
    for i, (k, a, b) in enumerate(recording.pieces):
        out[first[k] + a : first[k] + b + 1] = i
    return out


def sums_by_piece(recording: Recording, error: np.ndarray) -> np.ndarray:
    """Sums of squares [P, n] of errors [rows of all trials, n]."""
    block = blocks_of(recording)
    out = np.zeros((len(recording.pieces), error.shape[1]))
    np.add.at(out, block[block >= 0], np.square(error[block >= 0]))
    return out
