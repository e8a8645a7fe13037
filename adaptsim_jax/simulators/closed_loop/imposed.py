"""What the other joints' motion puts on one joint, tabulated along a recording.

In the joint's own deviation x from the imposed motion its inertia, the others' coupling and gravity
A cos x + B sin x are known, so one equation of second order is left, which is exact at x = 0.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np

from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.law import Scales, Servo, ServoLaw
from adaptsim_jax.simulators.closed_loop.pieces import (
    Trial,
    TrialMotion,
    begins_at_rest,
    groups_of,
    pieces_of,
)


class Dynamics(NamedTuple):
    """Along rows [T], by joint [n]: own inertia, force by the others' motion, and gravity's force
    at the angle and a quarter turn on, [T, n] each.
    """

    inertia: np.ndarray
    coupling: np.ndarray
    gravity: np.ndarray
    turned: np.ndarray


class Lanes(NamedTuple):
    """One joint over P pieces of S steps with R rows, ready to be simulated.

    Args:
        tables: [S, 9, P]: inertia, coupling, gravity, turned gravity, the same four of 1 kg more at
            the hand, and the imposed angle.
        area: [P, H + S + 2] the target's running integral, from H steps before the piece.
        begin: [2, P] angle and speed.
        row, share: [P, R] steps before rows, and how far beyond.
        measured: [P, R] rad.
        counted: [P, R] 1 where a row is compared.
    """

    tables: Any
    area: Any
    begin: Any
    row: Any
    share: Any
    measured: Any
    counted: Any


@dataclass(frozen=True)
class JointProblem:
    """A servo's joint over pieces.

    Args:
        servo: The file's.
        lanes: Its motion.
        step: s.
        ease: MuJoCo's inverse weight of the joint, by which its dry friction creeps, 1/(kg m^2).
        scales: Sizes of its numbers.
        noise: Of its encoder, rad.
        top_speed: The largest, rad/s.
        needed: The largest torque that the motion needs, N m.
        groups: Pieces that are left out together.
    """

    servo: Servo
    lanes: Lanes
    step: float
    ease: float
    scales: Scales
    noise: float
    top_speed: float
    needed: float
    groups: tuple[np.ndarray, ...]

    @property
    def ends(self) -> np.ndarray:
        """Positions where the joint stops [2], rad: the ends of a range that the motion comes to,
        or beyond them how far it came; infinite elsewhere.
        """
        measured = np.asarray(self.lanes.measured)[np.asarray(self.lanes.counted) > 0]
        lowest, highest, (low, high) = measured.min(), measured.max(), self.servo.ends
        near = CLOSED_LOOP.near_end
        return np.array(
            [
                min(low, lowest) if lowest < low + near else -np.inf,
                max(high, highest) if highest > high - near else np.inf,
            ]
        )

    @property
    def rows(self) -> np.ndarray:
        """Rows [P] that are compared of each piece."""
        return np.maximum(np.asarray(self.lanes.counted).sum(1), 1)

    def only(self, which: np.ndarray) -> "JointProblem":
        """Return the problem of some pieces alone, each left out by itself."""
        lane = self.lanes
        chosen = Lanes(
            lane.tables[..., which],
            lane.area[which],
            lane.begin[:, which],
            *(z[which] for z in lane[3:]),
        )
        groups = tuple(np.array([i]) for i in range(len(which)))
        return replace(self, lanes=chosen, groups=groups)


def dynamics_along(model: mujoco.MjModel, servos: Sequence[Servo], motion: TrialMotion) -> Dynamics:
    """The dynamics of the servos' joints along a motion, by MuJoCo."""
    data = mujoco.MjData(model)
    dof, qpos = ([getattr(s, k) for s in servos] for k in ("dof", "qpos"))
    out = np.zeros((4, len(motion.q), len(servos)))
    full, product, force = np.zeros((model.nv, model.nv)), np.zeros(model.nv), np.zeros(model.nv)
    acceleration = np.zeros(model.nv)

    def bias(speeds):
        data.qvel[:] = 0.0
        data.qvel[dof] = speeds
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, force)
        return force[dof].copy()

    def place():
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)

    for k in range(len(motion.q)):
        data.qpos[qpos] = motion.q[k]
        place()
        gravity = bias(0.0)
        mujoco.mj_crb(model, data)
        mujoco.mj_fullM(model, data, full)
        own = full[dof, dof]
        acceleration[dof] = motion.a[k]
        np.matmul(full, acceleration, out=product)
        coupling = product[dof] - own * motion.a[k] + bias(motion.v[k]) - gravity
        out[:3, k] = own, coupling, gravity
        for j, s in enumerate(servos):
            if s.slides:
                continue
            data.qpos[s.qpos] = motion.q[k, j] + 0.5 * np.pi
            place()
            out[3, k, j] = bias(0.0)[j]
            data.qpos[s.qpos] = motion.q[k, j]
    return Dynamics(*out)


SPHERE = 4e-4  # m^2: moment of inertia of a payload over its mass, of a sphere of 3 cm


def heavier(
    model: mujoco.MjModel, body: int, mass: float, at: np.ndarray | None = None
) -> mujoco.MjModel:
    """A copy whose body weighs `mass` kg more, at a point [3] of its frame; None: at its centre."""
    heavier_model = copy.copy(model)
    before, centre = float(model.body_mass[body]), model.body_ipos[body].copy()
    place = centre if at is None else np.asarray(at)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    rotation = rotation.reshape(3, 3)
    centre_after = (before * centre + mass * place) / max(before + mass, 1e-9)
    moments = rotation @ np.diag(model.body_inertia[body]) @ rotation.T + SPHERE * abs(
        mass
    ) * np.eye(3)
    for m, x in ((before, centre - centre_after), (mass, place - centre_after)):
        moments += m * (x @ x * np.eye(3) - np.outer(x, x))
    size, axes = np.linalg.eigh(moments)
    axes *= np.sign(np.linalg.det(axes))
    heavier_model.body_mass[body], heavier_model.body_ipos[body] = before + mass, centre_after
    heavier_model.body_inertia[body] = np.maximum(size, 1e-12)
    mujoco.mju_mat2Quat(heavier_model.body_iquat[body], axes.ravel())
    mujoco.mj_setConst(heavier_model, mujoco.MjData(heavier_model))
    return heavier_model


@dataclass(frozen=True)
class Recording:
    """Trials of servos cut into pieces.

    Args:
        model: What is stepped.
        pose: [nq] in which what no log has is held.
        servos: In the log's order of joints.
        trials: What was recorded.
        pieces: (trial, first row, last row).
        noise: [n] of the encoders, rad.
        hand: The body that carries a payload, -1: none does.
        outward: [3] in its frame: from its joint to its centre of mass, of length 1.
        step: Of the simulation of one joint, s.
        stretch: s, where trials are cut into stretches of about that length; 0: they are whole.
    """

    model: mujoco.MjModel
    pose: np.ndarray
    servos: tuple[Servo, ...]
    trials: tuple[Trial, ...]
    pieces: tuple[tuple[int, int, int], ...]
    noise: np.ndarray
    hand: int
    outward: np.ndarray
    step: float
    stretch: float = 0.0

    @property
    def whole_step(self) -> float:
        """Step of the simulation of whole trials, s."""
        return float(self.model.opt.timestep)

    def in_pieces_of(self, seconds: float) -> "Recording":
        """Return the recording with other pieces."""
        return replace(self, pieces=pieces_of(self.trials, seconds), stretch=seconds)

    def cut(self) -> "Recording":
        """Return the recording with each piece as a trial of its own."""
        trials = tuple(self.trials[k].between(a, b) for k, a, b in self.pieces)
        pieces = tuple((k, 0, len(t.time) - 1) for k, t in enumerate(trials))
        return replace(self, trials=trials, pieces=pieces)

    def restepped(self, times: float) -> "Recording":
        """Return the recording with whole trials in steps so many times as long."""
        model = copy.copy(self.model)
        model.opt.timestep = times * self.whole_step
        return replace(self, model=model)


def joint_problems(
    recording: Recording, motions: Sequence[TrialMotion], laws: Sequence[ServoLaw]
) -> tuple[JointProblem, ...]:
    """Each joint by itself, the others moving as `motions` of the trials have it. laws: by joint,
    whose kp gives the size of forces.
    """
    model, servos = recording.model, recording.servos
    file_dynamics = [dynamics_along(model, servos, m) for m in motions]
    if recording.hand >= 0:
        loaded = heavier(model, recording.hand, 1.0)
        loaded_dynamics = [dynamics_along(loaded, servos, m) for m in motions]
    else:
        loaded_dynamics = file_dynamics
    steps, rows = _sizes(recording)
    groups = groups_of(recording.pieces, len(recording.trials))
    hand = 1.0
    if recording.hand >= 0:
        hand = max(float(model.body_mass[recording.hand]), 0.02 * float(model.body_mass.sum()))
    out = []
    for j, servo in enumerate(servos):
        lanes = [
            _lane(recording, (j, piece), motions, (file_dynamics, loaded_dynamics), (steps, rows))
            for piece in recording.pieces
        ]
        lane = _stack_lanes(lanes)
        out.append(
            JointProblem(
                servo,
                lane,
                recording.step,
                float(model.dof_invweight0[servo.dof]),
                _scales(lane, recording, j, laws[j], hand),
                float(recording.noise[j]),
                max(float(np.percentile(np.abs(m.v[:, j]), 99.5)) for m in motions),
                max(_required_torque(d, m, j) for d, m in zip(file_dynamics, motions, strict=True)),
                groups,
            )
        )
    return tuple(out)


def _required_torque(dynamics: Dynamics, motion: TrialMotion, j: int) -> float:
    """Torque that a joint's motion takes, exceeded by 0.5 % of the rows."""
    inertial_torque = dynamics.inertia[:, j] * motion.a[:, j] + dynamics.coupling[:, j]
    return float(np.percentile(np.abs(inertial_torque + dynamics.gravity[:, j]), 99.5)) + 1e-9


def _sizes(recording: Recording) -> tuple[int, int]:
    """Steps and rows of the longest piece; steps in whole tenths of a second, so that compiled
    programs repeat.
    """
    spans = [
        recording.trials[k].time[b] - recording.trials[k].time[a] for k, a, b in recording.pieces
    ]
    steps = int(np.ceil(max(spans) / recording.step)) + 1
    coarse = max(1, round(0.1 / recording.step))
    return -(-steps // coarse) * coarse, max(b - a for _, a, b in recording.pieces) + 1


def _lane(recording, place, motions, dynamics, sizes) -> dict[str, np.ndarray]:
    """The arrays of a piece of a joint. place: (joint, piece); dynamics: by trial, of the file and
    of 1 kg more; sizes: steps and rows.
    """
    (j, (k, a, b)), (steps, rows), dt = place, sizes, recording.step
    trial, motion = recording.trials[k], motions[k]
    time = trial.time
    grid = time[a] + dt * np.arange(steps)
    plain, loaded = ([z[:, j] for z in d[k]] for d in dynamics)
    columns = [*plain, *(y - x for x, y in zip(plain, loaded, strict=True)), motion.q[:, j]]
    history = round(CLOSED_LOOP.history / dt)
    stamps = time[a] + dt * (np.arange(history + steps + 2) - history)
    is_at_rest = a == 0 and begins_at_rest(trial.q[:, j])
    elapsed = time[a : b + 1] - time[a]
    row = np.minimum((elapsed / dt + 1e-9).astype(int), steps - 1)
    unscored = 0.02 if is_at_rest else CLOSED_LOOP.unscored
    is_counted = elapsed > unscored

    def padded(z, fill=0):
        return np.concatenate([z, np.full(rows - len(z), fill, dtype=np.asarray(z).dtype)])

    return {
        "tables": np.stack([np.interp(grid, time, z) for z in columns], 1),
        "area": _area(time, trial.target[:, j], stamps),
        "begin": np.array([trial.q[a, j], 0.0] if is_at_rest else [motion.q[a, j], motion.v[a, j]]),
        "row": padded(row),
        "share": padded(elapsed / dt - row),
        "measured": padded(trial.q[a : b + 1, j]),
        "counted": padded(is_counted.astype(float)),
        "error": padded(trial.target[a : b + 1, j] - trial.q[a : b + 1, j]),
    }


def _area(time: np.ndarray, target: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Running integral of a held target at some times; before its first row that one is held."""
    edges = np.append(time, time[-1] + 10.0)
    area_at_edges = np.append(0.0, np.cumsum(np.diff(edges) * target))
    return np.where(
        stamps < time[0], (stamps - time[0]) * target[0], np.interp(stamps, edges, area_at_edges)
    )


def _stack_lanes(lanes: list[dict[str, np.ndarray]]) -> Lanes:
    last = ("tables", "begin")
    arrays = {
        key: np.stack([lane[key] for lane in lanes], -1 if key in last else 0)
        for key in Lanes._fields
    }
    with jax.enable_x64(True):
        return Lanes(**{k: jax.numpy.asarray(z) for k, z in arrays.items()})


def _scales(lane: Lanes, recording: Recording, j: int, law: ServoLaw, hand: float) -> Scales:
    errors = []
    for k, a, b in recording.pieces:
        trial = recording.trials[k]
        errors.append(trial.target[a : b + 1, j] - trial.q[a : b + 1, j])
    error = max(float(np.std(np.concatenate(errors))), 1e-6)
    inertia = float(np.mean(np.asarray(lane.tables)[:, 0]))
    stiffness = law.damping if recording.servos[j].follows_speed else law.kp
    swing = max(float(np.std(t.q[:, j])) for t in recording.trials)
    return Scales(max(stiffness * error, 1e-9), inertia, hand, error, swing)
