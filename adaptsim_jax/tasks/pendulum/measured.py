"""A trial of a real pendulum as the trajectory that the task's observation and return are made
of.
"""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter1d

from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.angles import TURN, without_turns
from adaptsim_jax.logs.criteria import BLOCK, CONTRADICTION
from adaptsim_jax.logs.quality.consistency import velocity_agreement
from adaptsim_jax.logs.quality.contradictions import AS_DECLARED, contradiction
from adaptsim_jax.logs.quality.hypotheses import Track, linear_fit, motion_of
from adaptsim_jax.logs.quality.pendulum_design import WORDS, design
from adaptsim_jax.logs.table_checks import check_clock, check_time_unit
from adaptsim_jax.mechanisms.double_pendulum.linear import (
    HORIZON,
    LATE_SNAPSHOTS,
    SAMPLES,
    SNAPSHOTS,
)
from adaptsim_jax.tasks import camera_record as record
from adaptsim_jax.tasks.camera_record import Columns
from adaptsim_jax.tasks.pendulum.task import PendulumTrajectory

NEEDED = ("time", "q1", "q2", "tau1", "tau2")
COLUMNS = (*NEEDED, "v1", "v2")
START = (-np.pi, 0.0)
SHORT = (
    f"run the policy for {HORIZON} s; where the robot cannot, tell that: adaptsim robot record "
    "--failed"
)
GAP = 0.06
"""s without a row that can be filled: the arm strays some 0.02 rad from the line between two rows
then.
"""
REST = 0.3
"""s that the arm may rest after it was let go: the task's policies move it at once."""
MOST_TURNS = 3
"""Whole turns that an encoder may have counted before the start."""
USUAL, WILD = np.array([3.0, 1.0, 2.0, 1.0]), 30.0
"""p1, p3 (kg m^2), h1, h2 (kg m) of links of 1 m and 1 kg; times that the torques of a trial may be
off from theirs.
"""
STILL = 0.01
"""rad within which it rests, beside the readings' noise."""


def measured_trajectory(
    columns: Columns,
    where: str,
    observation: Literal["full", "late"] = "full",
    *,
    lines: np.ndarray | None = None,
    row_word: str = "row",
) -> PendulumTrajectory:
    """The trajectory of a trial measured from the moment that the policy was let go, hanging
    straight down.

    `columns` of `[T]`: `time` s, `q1`, `q2` rad with zero upright, `tau1`, `tau2` N m (each held to
    the next row), and optionally `v1`, `v2` rad/s, else differences of the angles. It must last the
    task's 2.5 s. The cost is the task's sum over 1000 samples, of angles and velocities
    interpolated. Whole turns are taken out of the angles, and +pi is the same start as -pi. `lines
    [T]`: what rows are called in messages. Raises BadInput that names `where`.
    """
    record.check_columns(columns, NEEDED, where, ", ".join(NEEDED))
    columns = {name: np.asarray(values, float) for name, values in columns.items()}
    time, rows = columns["time"], np.arange(1, len(columns["time"]) + 1)
    check_clock(where, time, rows if lines is None else lines, row_word)
    check_time_unit(where, time, 1.0, "write seconds")
    time = time - time[0]

    def row(k):
        return f"{where}: {row_word} {(rows if lines is None else lines)[k]}"

    record.check_gaps(time, GAP, HORIZON, row, "run that trial again")
    step = float(np.median(np.diff(time)))
    if time[-1] < HORIZON - 1.5 * step:
        raise BadInput(f"{where}: lasts {time[-1]:.3g} s; {SHORT}")
    columns = columns | _whole_angles(time, columns)
    _check_release(time, columns, where)
    _check_speeds(time, columns, where)
    grid = np.linspace(0.0, HORIZON, SAMPLES)

    def at_grid(pair):
        return np.stack([np.interp(grid, time, pair[:, j]) for j in range(2)], 1)

    q, v = _pair(columns, "q"), _speeds(columns)
    angles = at_grid(q)
    _check_start(angles[0], where)
    velocities = at_grid(np.gradient(q, time, axis=0) if v is None else v)
    held = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, len(time) - 1)
    torques = _pair(columns, "tau")[held]
    cost = sum(float(np.sum(np.square(x))) for x in (angles, velocities, torques))
    indices = SNAPSHOTS if observation == "full" else LATE_SNAPSHOTS
    points = jnp.asarray(angles[np.asarray(indices)], jnp.float32)
    return PendulumTrajectory(points, jnp.float32(cost), jnp.zeros((), jnp.int32))


def check_columns(columns: Columns, where: str) -> None:
    """BadInput where the motion of a trial that `measured_trajectory` took contradicts its columns:
    joints or torques exchanged, signs turned, one angle in another unit, torques of no such
    pendulum. Links of 1 m, whatever their masses.
    """
    time = np.asarray(columns["time"], float)
    whole = _whole_angles(time, columns)
    track = Track(time - time[0], _pair(whole, "q"), _speeds(columns), _pair(columns, "tau"))
    plain = design(1.0, GRAVITY, -1.0)
    if trials := contradiction([track], plain, WORDS, chain=(-1, 0), zeros=(1,)):
        raise BadInput(
            f"{where}: the columns contradict a double pendulum: {trials.statement}; mend the file "
            f"(rad, N m, zero upright); {AS_DECLARED}"
        )
    motion = motion_of([track])
    found = linear_fit(motion, lambda m, gravity: plain(m, gravity) * USUAL, first=len(USUAL))
    if (
        len(motion.q) >= BLOCK.min_blocks
        and found.unexplained_share < CONTRADICTION.min_doubted_share
        and not 1.0 / WILD < found.scale < WILD
    ):
        raise BadInput(
            f"{where}: the torques are {float(f'{found.scale:.2g}'):g} times those of links of 1 m "
            f"and 1 kg; write N m; {AS_DECLARED}"
        )


def check_policy(columns: Columns, gain: np.ndarray) -> str:
    """What the torques of a trial have of -gain `[2, 4]` @ (q1, q2, v1, v2), in words where it is
    too little; rows where a torque is at its largest, a drive's limit, say nothing.
    """
    time = np.asarray(columns["time"], float)
    q, v = _pair(_whole_angles(time, columns), "q"), _speeds(columns)
    if v is None:
        v = np.gradient(gaussian_filter1d(q, 1.0, axis=0), time, axis=0)
    asked = -np.concatenate([q, v], 1) @ np.asarray(gain, float).T
    for j, name in enumerate(("tau1", "tau2")):
        trials = np.asarray(columns[name], float)
        free = (np.abs(trials) < 0.97 * np.abs(trials).max()) & (time < HORIZON)
        if free.sum() < 30 or np.ptp(trials[free]) == 0.0:
            continue
        a, t = asked[free, j], trials[free]
        alike = float(np.corrcoef(a, t)[0, 1])
        share = float(a @ t / max(a @ a, 1e-12))
        if alike < 0.8 or not 0.6 < share < 1.6:
            return (
                f"{name} is not what the policy asks for (correlation {alike:.2f}, {share:.2g} "
                "times as large)"
            )
    return ""


def _pair(columns: Columns, stem: str) -> np.ndarray:
    """`[T, 2]` of both joints' columns."""
    return np.stack([np.asarray(columns[f"{stem}{j}"], float) for j in (1, 2)], 1)


def _speeds(columns: Columns) -> np.ndarray | None:
    """`[T, 2]` rad/s where they were measured."""
    if "v1" in columns and "v2" in columns:
        return _pair(columns, "v")
    return None


def _whole_angles(time: np.ndarray, columns: Columns) -> dict[str, np.ndarray]:
    """q1, q2 without jumps of whole turns, begun at the turn that the task starts at."""
    whole = {}
    for name, start in zip(("q1", "q2"), START, strict=True):
        q = without_turns(time, columns[name]).q
        # the middle of the first readings: at the start itself an encoder may read +pi and -pi in
        # turn
        first = float(np.median(q[:5]))
        turns = np.round((first - start) / TURN)
        whole[name] = q - TURN * turns if abs(turns) <= MOST_TURNS else q
    return whole


def _check_release(time: np.ndarray, columns: Columns, where: str) -> None:
    """BadInput where the arm rests long before it moves: the recording began before the release."""
    q = _pair(columns, "q")
    noise = 1.4826 * np.median(np.abs(np.diff(q, axis=0)), axis=0)
    moved = np.any(np.abs(q - np.median(q[:5], axis=0)) > STILL + 5.0 * noise, axis=1)
    if moved.any():
        release = float(time[int(np.argmax(moved))])
    else:
        release = float(time[-1])
    if release > REST:
        raise BadInput(
            f"{where}: the arm rests for its first {release:.3g} s: the recording began before it "
            "was let go; remove the rows before that"
        )


def _check_speeds(time: np.ndarray, columns: Columns, where: str) -> None:
    """BadInput where measured velocities are of another unit or sign than the angles."""
    for name in ("1", "2"):
        if f"v{name}" not in columns:
            continue
        trials = velocity_agreement(time, columns[f"q{name}"], columns[f"v{name}"])
        if trials.enough and trials.r2 > 0.9 and not 0.5 < trials.gain < 2.0:
            raise BadInput(
                f"{where}: column v{name} is {trials.gain:.3g} times the slope of q{name}; write "
                "rad and rad/s with the same sign, or leave the velocities out"
            )


def _check_start(first: np.ndarray, where: str) -> None:
    # The task starts at q1 = -pi. A start elsewhere is another task, and most often another zero of
    # the angle.
    if np.max(np.abs(first - START)) <= 0.5:
        return
    if abs(abs(first[0]) - 180.0) < 20.0:
        raise BadInput(
            f"{where}: starts at q1 = {first[0]:.3g}: degrees are suspected; write radians"
        )
    raise BadInput(
        f"{where}: starts at q1 = {first[0]:.3g}, q2 = {first[1]:.3g} rad; the task starts "
        "hanging, at q1 = -3.14, q2 = 0 with zero upright: mend the zero of the angles, their "
        "unit, or the start"
    )
