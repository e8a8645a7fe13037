"""What the motion says of recorded commands.

They may have moved other joints than they are said to, may have been cut on their way, or do
something else in each trial. `servo_gain` and `unexplained` need no model of the mechanism, so
that servos are judged too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from adaptsim_jax.logs.criteria import COMMAND
from adaptsim_jax.logs.quality.hypotheses import Track, blocks


def unexplained(tracks: Sequence[Track]) -> float:
    """Share of the square of the acceleration that a command leaves; each track of one joint (`q
    [T, 1]`), `tau [T, 1]` the command. NaN where the motion is too short, or where nothing moves or
    is commanded.
    """
    if (found := _system(tracks)) is None:
        return float("nan")
    a, columns, _ = found
    x, *_ = np.linalg.lstsq(columns, a, rcond=1e-9)
    return _share(a - columns @ x, a)


def servo_gain(tracks: Sequence[Track]) -> tuple[float, float, float] | None:
    """Acceleration by unit of a joint's command, its standard error, and the share of the
    acceleration that is left; None where the motion is too short. Rows beside one another are not
    independent, which the error allows for.
    """
    if (found := _system(tracks)) is None:
        return None
    a, whole, size = found
    gram = whole.T @ whole + 1e-9 * len(a) * np.eye(whole.shape[1])
    x = np.linalg.solve(gram, whole.T @ a)
    left = a - whole @ x
    free = max(len(a) / COMMAND.alike - whole.shape[1], 1.0)
    spread = float(np.sum(left**2)) / free / COMMAND.alike
    error = np.sqrt(spread * COMMAND.alike * np.linalg.inv(gram)[0, 0])
    return float(x[0] / size[0]), float(error / size[0]), _share(left, a)


def against(tracks: Sequence[Track], joint: int) -> bool:
    """Whether a servo pulls away from its target, which counts against the angle."""
    found = servo_gain([one(t, joint) for t in drawn(tracks)])
    if found is None:
        return False
    gain, error, left = found
    return gain < -COMMAND.gain_errors * error and left < COMMAND.believed


def _system(tracks: Sequence[Track]) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Accelerations `[K]`, columns `[K, 6]` of unit size, and their sizes `[6]`.

    None where the motion is too short, or where nothing moves or is commanded.
    """
    rows = [_rows(track) for track in tracks]
    a, columns = (np.concatenate([r[k] for r in rows]) for k in (0, 1))
    if len(a) < COMMAND.min_blocks or np.std(a) < 1e-9 or np.std(columns[:, 0]) < 1e-12:
        return None
    size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    return a, columns / size, size


def _share(left: np.ndarray, a: np.ndarray) -> float:
    """Share of the square of `a [K]` that is left."""
    return float(np.sum(left**2) / np.sum((a - a.mean()) ** 2))


def _rows(track: Track) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations `[K]` and columns `[K, 6]` of one trial."""
    q, v, a, u, _ = blocks(track, sharp=True)
    q, v, a, u = (x[:, 0] for x in (q, v, a, u))
    table = np.stack([u, q, v, np.sin(q), np.cos(q), np.ones_like(q), a], 1)
    if len(table) < 2 * COMMAND.smooth:
        return np.zeros(0), np.zeros((0, 6))
    mean = np.stack(
        [np.convolve(c, np.ones(COMMAND.smooth) / COMMAND.smooth, "valid") for c in table.T], 1
    )
    return mean[:, -1], mean[:, :-1]


@dataclass(frozen=True)
class Exchanged:
    """Commands by joint: joint `i` moves as the command of `order[i]` says; `left`, `other` [n]:
    shares left as declared, and so.
    """

    order: tuple[int, ...]
    left: np.ndarray
    other: np.ndarray


@dataclass(frozen=True)
class Cut:
    """A target that reaches its joint cut: `how` (`rate` in rad/s, or `within` rad of the angle) by
    `size`, and the shares left.
    """

    how: str
    size: float
    left: float
    other: float


def drawn(tracks: Sequence[Track], count: int = COMMAND.trials) -> list[Track]:
    """Some of the trials, evenly."""
    keep = np.unique(np.linspace(0, len(tracks) - 1, min(count, len(tracks))).round().astype(int))
    return [tracks[k] for k in keep]


def one(track: Track, joint: int, command: np.ndarray | None = None) -> Track:
    """One joint of a trial, under its own command or another `[T]`."""
    tau = track.tau[:, joint] if command is None else command
    v = None if track.v is None else track.v[:, joint : joint + 1]
    return Track(track.time, track.q[:, joint : joint + 1], v, tau[:, None])


def exchanged(tracks: Sequence[Track], joints: Sequence[int]) -> Exchanged | None:
    """Which joints' commands look exchanged, of tracks whose torque is the command; None for none.

    Args:
        joints: Those that have one.
    """
    if not 2 <= len(joints) <= COMMAND.most_joints:
        return None
    some = drawn(tracks)
    left = np.array(
        [[unexplained([one(t, j, t.tau[:, k]) for t in some]) for k in joints] for j in joints]
    )
    if not np.all(np.isfinite(left)):
        return None
    cost = np.log(np.maximum(left, 1e-6))
    _, order = linear_sum_assignment(cost)
    moved = np.flatnonzero(order != np.arange(len(joints)))
    if not len(moved):
        return None
    own, other = left[moved, moved], left[moved, order[moved]]
    if (
        np.max(other) > COMMAND.believed
        or np.mean(np.log(own / np.maximum(other, 1e-6))) < np.log(COMMAND.exchanged)
        or np.any(own < other)
    ):
        return None
    best = tuple(joints[k] for k in order)
    return Exchanged(best, np.diag(left), left[np.arange(len(joints)), order])


def cut(tracks: Sequence[Track], joint: int, damping: float) -> Cut | None:
    """Whether the target of a servo's joint reached it cut: by a rate, or to within some distance
    of the angle.

    Args:
        damping: Of the servo, over its stiffness, s; a limit of force is another thing, and where
            it explains as much nothing is told.
    """
    sample = drawn(tracks, COMMAND.cut_trials)
    some = [_thinned(one(t, joint)) for t in sample if np.all(np.isfinite(t.q[:, joint]))]
    base = unexplained(some) if some else float("nan")
    if not base > COMMAND.doubted:
        return None
    off = np.concatenate([np.abs(t.tau[:, 0] - t.q[:, 0]) for t in some])
    speeds = np.concatenate([np.abs(_speed(t)) for t in some])
    read: dict[str, Callable[[Track, float], np.ndarray]] = {
        "rate": lambda t, size: limited(t.time, t.tau[:, 0], t.q[:, 0], size),
        "within": lambda t, size: within(t.tau[:, 0], t.q[:, 0], size),
        "force": lambda t, size: _forced(t, size, damping),
    }
    ends = {"rate": np.quantile(speeds, 0.99) * np.array([0.3, 3.0])}
    ends["within"] = float(off.max()) * np.array([0.01, 0.6])
    # of a much damped joint, few rows at it look like a rate's limit
    ends["force"] = float(off.max()) * np.array([0.01, 1.0])
    rough = {how: _best(some, read[how], *ends[how], rounds=1)[1] for how in ("rate", "within")}
    best = min(rough, key=lambda how: rough[how])
    if rough[best] > COMMAND.cut_coarse * COMMAND.cut * base:
        return None
    found = {how: _best(some, read[how], *ends[how]) for how in read}
    best = min(rough, key=lambda how: found[how][1])
    size, left = found[best]
    if (
        left > min(COMMAND.cut * base, COMMAND.cut_left)
        or left > COMMAND.cut_distinct * found["force"][1]
    ):
        return None
    return Cut(best, size, base, left)


def other_unit(
    q: Sequence[np.ndarray], target: Sequence[np.ndarray], slides: bool
) -> tuple[str, str] | None:
    """Units of a servo's angle and target, each `[T]` by trial, which follow one another but for
    their size; None where they agree.
    """
    here = [np.isfinite(a) & np.isfinite(u) for a, u in zip(q, target, strict=True)]

    def centred(trials):
        used = [x[k] for x, k in zip(trials, here, strict=True) if k.any()]
        return np.concatenate([x - x.mean() for x in used])

    a, u = centred(q), centred(target)
    power = float(a @ a) * float(u @ u)
    if power == 0.0 or float(a @ u) < np.sqrt(COMMAND.follows * power):
        return None
    size = float(np.sqrt((a @ a) / (u @ u)))
    if slides:
        units = ({"mm": 1e-3, "cm": 1e-2}, "m")
    else:
        units = ({"deg": np.pi / 180, "rev": 2 * np.pi}, "rad")
    for unit, scale in units[0].items():
        for pair, times in (((units[1], unit), scale), ((unit, units[1]), 1.0 / scale)):
            if abs(np.log(size / times)) < COMMAND.unit:
                return pair
    return None


def _thinned(track: Track) -> Track:
    """Rows of about `cut_row` s: a limit is followed row by row, and acts over many."""
    k = max(1, round(COMMAND.cut_row / float(np.median(np.diff(track.time)))))
    speed = None if track.v is None else track.v[::k]
    return Track(track.time[::k], track.q[::k], speed, track.tau[::k])


def _best(
    tracks: Sequence[Track],
    read: Callable[[Track, float], np.ndarray],
    low: float,
    high: float,
    rounds: int = 3,
) -> tuple[float, float]:
    """The size of a reading that leaves least, and what that is."""

    def loss(size):
        return unexplained([one(t, 0, read(t, float(size))) for t in tracks])

    grid = np.geomspace(max(low, 1e-9), max(high, 2e-9), 10)
    for _ in range(rounds):
        values = np.array([loss(size) for size in grid])
        k = int(np.argmin(np.where(np.isfinite(values), values, np.inf)))
        best = float(grid[k]), float(values[k]) if np.isfinite(values[k]) else float("inf")
        grid = np.geomspace(grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)], 7)
    return best


def _speed(track: Track) -> np.ndarray:
    if track.v is None:
        return np.gradient(track.q[:, 0], track.time)
    return track.v[:, 0]


def _forced(track: Track, size: float, damping: float) -> np.ndarray:
    """The target under which a servo without limits pulls as one does whose force is limited."""
    q, pulled = track.q[:, 0], damping * _speed(track)
    return np.clip(track.tau[:, 0] - q - pulled, -size, size) + q + pulled


def gains_by_trial(tracks: Sequence[Track], joint: int) -> np.ndarray | None:
    """What a joint's command does in each trial `[T]`, over what it does in the middle one; None
    where trials do not differ in it, or where that cannot be told. Each trial has a gain of its
    own. What else acts is alike in all, or each trial's own where the whole of it is (a load).
    """
    if len(tracks) < COMMAND.min_trials:
        return None
    fits = [servo_gain([one(t, joint)]) for t in tracks]
    if any(fit is None for fit in fits):
        return None
    gain, error, left = np.array([fit for fit in fits if fit is not None]).T
    if (
        np.max(left) > COMMAND.doubted
    ):  # something else acts too, as a limit of force in the trials that reach it
        return None
    middle = float(np.median(gain))
    separate = np.ptp(gain) / max(
        float(np.hypot(error[gain.argmax()], error[gain.argmin()])), 1e-12
    )
    if (
        np.min(gain) <= 0
        or np.max(gain) / np.min(gain) < COMMAND.gain_ratio
        or separate < COMMAND.gain_errors
        or np.max(error / gain) > COMMAND.gain_error
    ):
        return None
    return gain / middle


def within(target: np.ndarray, q: np.ndarray, most: float) -> np.ndarray:
    """A target `[T]` that is sent no farther than `most` from where the joint is, `q [T]`."""
    return q + np.clip(target - q, -most, most)


def limited(time: np.ndarray, target: np.ndarray, q: np.ndarray, rate: float) -> np.ndarray:
    """A target `[T]` at `time [T]` s that is sent by steps of at most `rate` (rad/s or m/s) times
    the time of a row, from where the joint is at first.
    """
    if len(target) < 2:
        return target
    step = rate * np.diff(time, prepend=2 * time[0] - time[1])
    out = np.empty_like(target)
    first = q[np.isfinite(q)]
    last = float(first[0]) if len(first) else float(target[0])
    for k, (u, d) in enumerate(zip(target.tolist(), step.tolist(), strict=True)):
        last = min(max(u, last - d), last + d) if u == u else last
        out[k] = last
    return out
