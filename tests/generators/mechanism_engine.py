"""Trials of a true machine, stepped by MuJoCo's C engine; what its joints and actuators do beside lies in `mechanism_forces.py`.

All trials go side by side. Accelerations are MuJoCo's forward dynamics, speeds and positions leapfrog in steps of 0.5 ms (Verlet,
second order, also in forces that follow the speed: they see the speed extrapolated by half a step). A command that changes at a
step acts by half before it, since a step's force acts from half a step before it to half a step after. Dry friction is
MuJoCo's `frictionloss`, its level set anew each step, with a time constant of 2 ms.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from tests.generators.mechanism_forces import COMMAND, FORCES, LEVELS, OUTPUT, WHOLE, Effect, Motion

STEP = 5e-4


@dataclass(frozen=True)
class Drive:
    """What moves K trials of R rows. rows `[K, R]`: step at which each row is taken; start `[K, n]` rad; reference,
    slope, feed `[K, R, n]`: wanted angle and speed, torque added; gains `[K, 2, n]` of the torque controller; noise `[K, R, 2, n]`."""

    rows: np.ndarray
    start: np.ndarray
    reference: np.ndarray
    slope: np.ndarray
    feed: np.ndarray
    gains: np.ndarray
    noise: np.ndarray

    @property
    def times(self) -> np.ndarray:
        return self.rows * STEP

    def first(self, trials: int, rows: int) -> "Drive":
        return Drive(*(z[:trials, :rows] if z.ndim > 2 and z.shape[1] != 2 else z[:trials] for z in (
            self.rows[:, :rows], self.start, self.reference, self.slope, self.feed, self.gains, self.noise)))  # fmt: skip


@dataclass(frozen=True)
class Plant:
    """Who drives what: mode torque or position; driven: joints with an actuator; servo `[n, 2]`: kp and kv as they are
    without effects."""

    model: mujoco.MjModel
    mode: str
    driven: tuple[int, ...]
    servo: np.ndarray


@dataclass(frozen=True)
class Run:
    """Every step s of K trials: q, v, a, u `[S, K, n]` (true angles, speeds, accelerations, actuators' forces); plain: what the
    actuators would give without effects, for the same motion; parts: each effect's own force; command `[K, R, n]` by rows."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray
    plain: np.ndarray
    parts: tuple[np.ndarray, ...]
    command: np.ndarray


def _sensed(effects: tuple[Effect, ...], q: np.ndarray, v: np.ndarray):
    """Angles and speeds as the encoders have them, without noise and lateness."""
    for e in effects:
        for j, p in zip(e.joints, e.params, strict=True):
            if e.name == "encoder_offset":
                q[:, j] += p["offset"]
            elif e.name == "encoder_scale":
                q[:, j] *= 1 + p["scale"]
                v[:, j] *= 1 + p["scale"]
    return q, v


def simulate(plant: Plant, drive: Drive, effects: tuple[Effect, ...] = ()) -> Run:
    """Step all trials to their last row."""
    m, (trials, rows) = plant.model, drive.rows.shape
    n, steps = drive.start.shape[1], int(drive.rows.max()) + 1
    datas = [mujoco.MjData(m) for _ in range(trials)]
    for d, start in zip(datas, drive.start, strict=True):
        d.qpos[:n] = start
        mujoco.mj_forward(m, d)
    views = [(d, d.qpos, d.qvel, d.qacc, d.qfrc_applied, d.qfrc_constraint, d.xfrc_applied) for d in datas]
    q_all, v_all, a_all, u_all, plain_all = (np.zeros((steps, trials, n)) for _ in range(5))
    parts = tuple(np.zeros((steps, trials, n)) for _ in effects)
    dry = [(k, e) for k, e in enumerate(effects) if e.name in LEVELS]
    level_own, losses = np.zeros((len(effects), trials, n)), m.dof_frictionloss
    command_rows, held = np.zeros((trials, rows, n)), np.zeros((trials, n))
    history = np.zeros((steps, trials, n))
    at: dict[int, list[tuple[int, int]]] = {}
    for k in range(trials):
        for r, s in enumerate(drive.rows[k]):
            at.setdefault(int(s), []).append((k, r))
    on = np.array(plant.driven)
    q, v, a = (np.array([w[i][:n] for w in views]) for i in (1, 2, 3))
    friction, applied = np.zeros((trials, n)), np.zeros((trials, n))
    memory: dict = {}
    last = None
    for s in range(steps):
        now = v + 0.5 * STEP * a  # the speed at this step's time
        seen_q, seen_v = _sensed(effects, q.copy(), now.copy())
        for k, r in at.get(s, ()):
            if plant.mode == "torque":
                x, y = seen_q[k] + drive.noise[k, r, 0], seen_v[k] + drive.noise[k, r, 1]
                pull = drive.gains[k, 0] * (drive.reference[k, r] - x) + drive.gains[k, 1] * (drive.slope[k, r] - y)
                held[k, on] = (drive.feed[k, r] + pull)[on]
            else:
                held[k, on] = drive.reference[k, r, on]
            command_rows[k, r] = held[k]
        history[s] = held
        c = 0.5 * (held + (held if last is None else last))
        last = held.copy()
        for e in effects:
            if e.name in COMMAND:
                COMMAND[e.name](e, c, history, s, memory, STEP)
        if plant.mode == "torque":
            u, plain = c, held
        else:
            u = np.zeros((trials, n))
            spring, damp = plant.servo[on, 0], plant.servo[on, 1]
            u[:, on] = spring * (c[:, on] - seen_q[:, on]) - damp * seen_v[:, on]
            plain = np.zeros((trials, n))
            plain[:, on] = spring * (held[:, on] - q[:, on]) - damp * now[:, on]
        motion = Motion(s * STEP, q, now, u, c, plant.servo)
        for e in effects:
            if e.name in OUTPUT:
                u = OUTPUT[e.name](e, u, motion)
                motion = Motion(s * STEP, q, now, u, c, plant.servo)
        applied[:] = u
        for k, e in enumerate(effects):
            if e.name in FORCES:
                for j, p in zip(e.joints, e.params, strict=True):
                    parts[k][s, :, j] = FORCES[e.name](p, motion, j)
                applied += parts[k][s]
            elif e.name in WHOLE:
                parts[k][s] = WHOLE[e.name](e, motion)
                applied += parts[k][s]
        for k, e in dry:
            for j, p in zip(e.joints, e.params, strict=True):
                level_own[k, :, j] = LEVELS[e.name](p, motion, j)
        level = np.maximum(level_own.sum(0), 0.0)
        q_all[s], u_all[s], plain_all[s] = q, u, plain
        before = v.copy()
        for k, (d, qpos, qvel, qacc, force, held_by, _) in enumerate(views):
            force[:n] = applied[k]
            if dry:
                losses[:n] = level[k]
            qvel[:n] = now[k]
            mujoco.mj_forward(m, d)
            a[k] = qacc[:n]
            v[k] += STEP * a[k]
            q[k] += STEP * v[k]
            qpos[:n] = q[k]
            if dry:
                friction[k] = held_by[:n]
        v_all[s], a_all[s] = 0.5 * (before + v), a
        for k, _ in dry:  # each has of the friction what it has of the level
            parts[k][s] = friction * level_own[k] / np.maximum(level, 1e-12)
    for k, e in enumerate(effects):
        if e.name in COMMAND or e.name in OUTPUT:
            parts[k][:] = u_all - plain_all
        elif e.name == "armature":  # in the model itself
            for j, p in zip(e.joints, e.params, strict=True):
                parts[k][:, :, j] = -p["inertia"] * a_all[:, :, j]
    return Run(q_all, v_all, a_all, u_all, plain_all, parts, command_rows)
