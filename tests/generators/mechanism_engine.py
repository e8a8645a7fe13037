"""Trials of a true machine by MuJoCo's C engine; what its joints and actuators do beside lies in
`mechanism_forces.py`.

All trials go side by side. Accelerations are MuJoCo's forward dynamics; speeds and positions
leapfrog in steps of 0.5 ms (Verlet, second order, also in forces that follow the speed: they see it
extrapolated by half a step). A step's force acts from half a step before to half a step after, so a
command that changes at a step acts by half at it. Dry friction is MuJoCo's `frictionloss`, its
level set anew each step, with a time constant of 2 ms.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from tests.generators.mechanism_forces import COMMAND, FORCES, LEVELS, OUTPUT, WHOLE, Effect, Motion

STEP = 5e-4


@dataclass(frozen=True)
class Drive:
    """What moves K trials of R rows. rows `[K, R]`: step at which each row is taken; start `[K,
    n]`; reference, slope, feed `[K, R, n]`: wanted position and speed, force added; gains `[K, 2,
    n]` of the torque controller; noise `[K, R, 2, n]`.
    """

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
        """The first rows of the first trials."""

        def cut(z):
            return z[:trials, :rows]

        return Drive(
            cut(self.rows),
            self.start[:trials],
            cut(self.reference),
            cut(self.slope),
            cut(self.feed),
            self.gains[:trials],
            cut(self.noise),
        )


@dataclass(frozen=True)
class Plant:
    """Who drives what: mode torque or position; driven: joints with an actuator; servo `[n, 2]`: kp
    and kv as they are without effects. at `[n]`: degree of freedom of each joint in the model;
    twist: of the spring between drive and link, by joint.
    """

    model: mujoco.MjModel
    mode: str
    driven: tuple[int, ...]
    servo: np.ndarray
    at: np.ndarray
    twist: dict[int, int]


@dataclass(frozen=True)
class Run:
    """Every step s of K trials, `[S, K, n]`: q, v, a of the joints (of the drives, where one is
    elastic), u: the actuators' forces; sent: commands as they leave the computer; parts: each
    effect's own force; twist: angle and speed of the links against their drives; command `[K, R,
    n]`: by rows.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray
    sent: np.ndarray
    parts: tuple[np.ndarray, ...]
    twist: tuple[np.ndarray, np.ndarray]
    command: np.ndarray


def _sensed(effects: tuple[Effect, ...], q: np.ndarray, v: np.ndarray):
    """What servos get of the joints: their encoders' offsets and scales."""
    q, v = q.copy(), v.copy()
    for e in effects:
        for j, p in e.each():
            if e.name == "encoder_scale":
                q[:, j] *= 1 + p["scale"]
                v[:, j] *= 1 + p["scale"]
            elif e.name == "encoder_offset":
                q[:, j] += p["offset"]
    return q, v


def simulate(plant: Plant, drive: Drive, effects: tuple[Effect, ...] = ()) -> Run:  # noqa: C901, PLR0912, PLR0915
    """Step all trials to their last row."""
    m, (trials, rows) = plant.model, drive.rows.shape
    n, steps, at, on = (
        drive.start.shape[1],
        int(drive.rows.max()) + 1,
        plant.at,
        np.array(plant.driven),
    )
    run = Run(
        *(np.zeros((steps, trials, n)) for _ in range(5)),
        tuple(np.zeros((steps, trials, n)) for _ in effects),
        (np.zeros((steps, trials, n)), np.zeros((steps, trials, n))),
        np.zeros((trials, rows, n)),
    )
    datas = [mujoco.MjData(m) for _ in range(trials)]
    views = [
        (d, d.qpos, d.qvel, d.qacc, d.qfrc_applied, d.qfrc_constraint, d.xfrc_applied)
        for d in datas
    ]
    whole_q, whole_v, whole_a, friction, applied = (np.zeros((trials, m.nv)) for _ in range(5))
    whole_q[:, at] = drive.start
    for w, start in zip(views, whole_q, strict=True):
        w[1][:] = start
    dry = [(k, e) for k, e in enumerate(effects) if e.name in LEVELS]
    chain = [(k, e) for k, e in enumerate(effects) if e.name in COMMAND]
    own, losses = np.zeros((len(effects), trials, n)), m.dof_frictionloss
    reads: dict[int, list[tuple[int, int]]] = {}
    for k in range(trials):
        for r, s in enumerate(drive.rows[k]):
            reads.setdefault(int(s), []).append((k, r))
    held, last = np.zeros((trials, n)), None
    memories: list[dict] = [{} for _ in effects]
    for s in range(steps):
        now = whole_v + 0.5 * STEP * whole_a  # the speed at this step's time
        q, v = whole_q[:, at], now[:, at]
        seen_q, seen_v = _sensed(effects, q, v)
        for k, r in reads.get(s, ()):
            held[k, on] = _command(plant.mode, drive, k, r, seen_q[k], seen_v[k])[on]
            run.command[k, r] = held[k]
        run.sent[s] = held
        c = 0.5 * (held + (held if last is None else last))
        last = held.copy()
        spring = plant.servo[:, 0] if plant.mode == "position" else np.ones(n)
        for k, e in chain:
            before = c.copy()
            COMMAND[e.name](e, c, run.sent, s, memories[k], STEP)
            run.parts[k][s] = spring * (c - before)
        u = c if plant.mode == "torque" else spring * (c - seen_q) - plant.servo[:, 1] * seen_v
        motion = Motion(s * STEP, s, q, v, u, c, plant.servo)
        for k, e in enumerate(effects):
            if e.name in OUTPUT:
                motion = motion._replace(u=OUTPUT[e.name](e, u, motion))
                run.parts[k][s] = motion.u - u
                u = motion.u
        total = u.copy()
        for k, e in enumerate(effects):
            if e.name in FORCES:
                for j, p in e.each():
                    run.parts[k][s, :, j] = FORCES[e.name](p, motion, j)
                total += run.parts[k][s]
            elif e.name in WHOLE:
                run.parts[k][s] = WHOLE[e.name](e, motion)
                total += run.parts[k][s]
            elif e.name == "dropped_mass" and s * STEP >= e.params[0]["time"]:
                for w in views:
                    w[6][-1, 2] = -9.81 * e.params[0]["mass"]
        applied[:, at] = total
        _twist(plant, effects, whole_q, now, applied, run, s)
        for k, e in dry:
            for j, p in e.each():
                own[k, :, j] = LEVELS[e.name](p, motion, j)
        level = np.maximum(own.sum(0), 0.0)
        run.q[s], run.v[s], run.u[s] = q, v, u
        for k, (d, qpos, qvel, qacc, force, held_by, _) in enumerate(views):
            force[:] = applied[k]
            qvel[:] = now[k]
            if dry:
                losses[at] = level[k]
            mujoco.mj_forward(m, d)
            whole_a[k] = qacc
            whole_v[k] += STEP * whole_a[k]
            whole_q[k] += STEP * whole_v[k]
            qpos[:] = whole_q[k]
            if dry:
                friction[k] = held_by
        run.a[s] = whole_a[:, at]
        for k, _ in dry:  # each has of the friction what it has of the level
            run.parts[k][s] = friction[:, at] * own[k] / np.maximum(level, 1e-12)
    return run


def _command(mode: str, drive: Drive, k: int, r: int, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """What the computer sends at row r of trial k: a target, or the torque of a controller that
    sees the noise as well.
    """
    if mode == "position":
        return drive.reference[k, r]
    x, y = q + drive.noise[k, r, 0], v + drive.noise[k, r, 1]
    gains = drive.gains[k]
    return (
        drive.feed[k, r]
        + gains[0] * (drive.reference[k, r] - x)
        + gains[1] * (drive.slope[k, r] - y)
    )


def _twist(
    plant: Plant, effects, q: np.ndarray, v: np.ndarray, applied: np.ndarray, run: Run, s: int
) -> None:
    """The spring, or the play with stiff ends, between a drive and its link."""
    for e in effects:
        if e.name in ("drive_elasticity", "drive_play"):
            for j, p in e.each():
                i = plant.twist[j]
                bent = q[:, i] - np.clip(q[:, i], -0.5 * p["gap"], 0.5 * p["gap"])
                applied[:, i] = -p["stiffness"] * bent - p["damping"] * v[:, i] * (bent != 0)
                run.twist[0][s, :, j], run.twist[1][s, :, j] = q[:, i], v[:, i]
