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
    if (system := _system(tracks)) is None:
        return float("nan")
    a, columns, _ = system
    x, *_ = np.linalg.lstsq(columns, a, rcond=1e-9)
    return _share(a - columns @ x, a)


def servo_gain(tracks: Sequence[Track]) -> tuple[float, float, float] | None:
    """Acceleration by unit of a joint's command, its standard error, and the share of the
    acceleration that is left; None where the motion is too short. Rows beside one another are not
    independent, which the error allows for.
    """
    if (system := _system(tracks)) is None:
        return None
    a, columns, size = system
    gram = columns.T @ columns + 1e-9 * len(a) * np.eye(columns.shape[1])
    x = np.linalg.solve(gram, columns.T @ a)
    residual = a - columns @ x
    free_rows = max(len(a) / COMMAND.n_correlated_rows - columns.shape[1], 1.0)
    spread = float(np.sum(residual**2)) / free_rows / COMMAND.n_correlated_rows
    error = np.sqrt(spread * COMMAND.n_correlated_rows * np.linalg.inv(gram)[0, 0])
    return float(x[0] / size[0]), float(error / size[0]), _share(residual, a)


def pulls_away(tracks: Sequence[Track], joint: int) -> bool:
    """Whether a servo pulls away from its target, which counts against the angle."""
    fit = servo_gain([single_joint(t, joint) for t in evenly_chosen(tracks)])
    if fit is None:
        return False
    gain, error, share = fit
    return gain < -COMMAND.min_gain_errors * error and share < COMMAND.max_believed_share


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


def _share(residual: np.ndarray, a: np.ndarray) -> float:
    """Share of the square of `a [K]` that is left."""
    return float(np.sum(residual**2) / np.sum((a - a.mean()) ** 2))


def _rows(track: Track) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations `[K]` and columns `[K, 6]` of one trial."""
    q, v, a, u, _ = blocks(track, sharp=True)
    q, v, a, u = (x[:, 0] for x in (q, v, a, u))
    table = np.stack([u, q, v, np.sin(q), np.cos(q), np.ones_like(q), a], 1)
    if len(table) < 2 * COMMAND.n_smoothed_blocks:
        return np.zeros(0), np.zeros((0, 6))
    mean = np.stack(
        [
            np.convolve(c, np.ones(COMMAND.n_smoothed_blocks) / COMMAND.n_smoothed_blocks, "valid")
            for c in table.T
        ],
        1,
    )
    return mean[:, -1], mean[:, :-1]


@dataclass(frozen=True)
class Exchanged:
    """Commands by joint: joint `i` moves as the command of `order[i]` says; `share_as_declared`,
    `share_otherwise` [n]: unexplained shares as declared, and in this order.
    """

    order: tuple[int, ...]
    share_as_declared: np.ndarray
    share_otherwise: np.ndarray


@dataclass(frozen=True)
class TargetLimit:
    """A target is limited on its way to its joint: `kind` (`rate` in rad/s, or `within` rad of the
    angle) and `size` of the limit, and the unexplained shares as declared and with it.
    """

    kind: str
    size: float
    share_as_declared: float
    share_otherwise: float


def evenly_chosen(tracks: Sequence[Track], count: int = COMMAND.max_trials) -> list[Track]:
    """Choose at most `count` of the trials, evenly."""
    keep = np.unique(np.linspace(0, len(tracks) - 1, min(count, len(tracks))).round().astype(int))
    return [tracks[k] for k in keep]


def single_joint(track: Track, joint: int, command: np.ndarray | None = None) -> Track:
    """Return one joint of a trial, under its own command or another `[T]`."""
    tau = track.tau[:, joint] if command is None else command
    v = None if track.v is None else track.v[:, joint : joint + 1]
    return Track(track.time, track.q[:, joint : joint + 1], v, tau[:, None])


def find_exchanged(tracks: Sequence[Track], joints: Sequence[int]) -> Exchanged | None:
    """Find joints whose commands look exchanged, of tracks whose torque is the command.

    Args:
        joints: Those that have one.
    """
    if not 2 <= len(joints) <= COMMAND.max_joints:
        return None
    chosen = evenly_chosen(tracks)
    shares = np.array(
        [
            [unexplained([single_joint(t, j, t.tau[:, k]) for t in chosen]) for k in joints]
            for j in joints
        ]
    )
    if not np.all(np.isfinite(shares)):
        return None
    cost = np.log(np.maximum(shares, 1e-6))
    _, order = linear_sum_assignment(cost)
    exchanged_joints = np.flatnonzero(order != np.arange(len(joints)))
    if not len(exchanged_joints):
        return None
    declared_shares, other_shares = (
        shares[exchanged_joints, exchanged_joints],
        shares[exchanged_joints, order[exchanged_joints]],
    )
    if (
        np.max(other_shares) > COMMAND.max_believed_share
        or np.mean(np.log(declared_shares / np.maximum(other_shares, 1e-6)))
        < np.log(COMMAND.min_exchange_ratio)
        or np.any(declared_shares < other_shares)
    ):
        return None
    best = tuple(joints[k] for k in order)
    return Exchanged(best, np.diag(shares), shares[np.arange(len(joints)), order])


def detect_target_limit(tracks: Sequence[Track], joint: int, damping: float) -> TargetLimit | None:
    """Whether the target of a servo's joint reached it cut: by a rate, or to within some distance
    of the angle.

    Args:
        damping: Of the servo, over its stiffness, s; a limit of force is another thing, and where
            it explains as much nothing is told.
    """
    sample = evenly_chosen(tracks, COMMAND.max_limit_trials)
    tracks_thinned = [
        _thin_rows(single_joint(t, joint)) for t in sample if np.all(np.isfinite(t.q[:, joint]))
    ]
    declared_share = unexplained(tracks_thinned) if tracks_thinned else float("nan")
    if not declared_share > COMMAND.min_doubted_share:
        return None
    offset = np.concatenate([np.abs(t.tau[:, 0] - t.q[:, 0]) for t in tracks_thinned])
    speeds = np.concatenate([np.abs(_speed(t)) for t in tracks_thinned])
    limiters: dict[str, Callable[[Track, float], np.ndarray]] = {
        "rate": lambda t, size: limit_rate(t.time, t.tau[:, 0], t.q[:, 0], size),
        "within": lambda t, size: limit_distance(t.tau[:, 0], t.q[:, 0], size),
        "force": lambda t, size: _limit_force(t, size, damping),
    }
    ends = {"rate": np.quantile(speeds, 0.99) * np.array([0.3, 3.0])}
    ends["within"] = float(offset.max()) * np.array([0.01, 0.6])
    # of a much damped joint, few rows at it look like a rate's limit
    ends["force"] = float(offset.max()) * np.array([0.01, 1.0])
    coarse = {
        kind: _best_size(tracks_thinned, limiters[kind], *ends[kind], rounds=1)[1]
        for kind in ("rate", "within")
    }
    best = min(coarse, key=lambda kind: coarse[kind])
    if coarse[best] > COMMAND.coarse_ratio * COMMAND.max_limited_ratio * declared_share:
        return None
    fine = {kind: _best_size(tracks_thinned, limiters[kind], *ends[kind]) for kind in limiters}
    best = min(coarse, key=lambda kind: fine[kind][1])
    size, share = fine[best]
    if (
        share > min(COMMAND.max_limited_ratio * declared_share, COMMAND.max_limited_share)
        or share > COMMAND.max_force_limit_ratio * fine["force"][1]
    ):
        return None
    return TargetLimit(best, size, declared_share, share)


def other_unit(
    q: Sequence[np.ndarray], target: Sequence[np.ndarray], slides: bool
) -> tuple[str, str] | None:
    """Units of a servo's angle and target, each `[T]` by trial, which follow one another but for
    their size; None where they agree.
    """
    is_finite = [np.isfinite(a) & np.isfinite(u) for a, u in zip(q, target, strict=True)]

    def centred(trials):
        finite = [x[k] for x, k in zip(trials, is_finite, strict=True) if k.any()]
        return np.concatenate([x - x.mean() for x in finite])

    a, u = centred(q), centred(target)
    power = float(a @ a) * float(u @ u)
    if power == 0.0 or float(a @ u) < np.sqrt(COMMAND.min_squared_correlation * power):
        return None
    size = float(np.sqrt((a @ a) / (u @ u)))
    if slides:
        units = ({"mm": 1e-3, "cm": 1e-2}, "m")
    else:
        units = ({"deg": np.pi / 180, "rev": 2 * np.pi}, "rad")
    for unit, scale in units[0].items():
        for units_found, times in (((units[1], unit), scale), ((unit, units[1]), 1.0 / scale)):
            if abs(np.log(size / times)) < COMMAND.log_unit_tolerance:
                return units_found
    return None


def _thin_rows(track: Track) -> Track:
    """Keep rows of about `limit_row_time` s: a limit is followed row by row, and acts over many."""
    k = max(1, round(COMMAND.limit_row_time / float(np.median(np.diff(track.time)))))
    speed = None if track.v is None else track.v[::k]
    return Track(track.time[::k], track.q[::k], speed, track.tau[::k])


def _best_size(
    tracks: Sequence[Track],
    limiter: Callable[[Track, float], np.ndarray],
    low: float,
    high: float,
    rounds: int = 3,
) -> tuple[float, float]:
    """Search the size of a limit that leaves least, and return it with that share."""

    def loss(size):
        return unexplained([single_joint(t, 0, limiter(t, float(size))) for t in tracks])

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


def _limit_force(track: Track, size: float, damping: float) -> np.ndarray:
    """Return the target under which a servo without limits pulls as one whose force is limited."""
    q, pulled = track.q[:, 0], damping * _speed(track)
    return np.clip(track.tau[:, 0] - q - pulled, -size, size) + q + pulled


def gains_by_trial(tracks: Sequence[Track], joint: int) -> np.ndarray | None:
    """What a joint's command does in each trial `[T]`, over what it does in the middle one; None
    where trials do not differ in it, or where that cannot be told. Each trial has a gain of its
    own. What else acts is alike in all, or each trial's own where the whole of it is (a load).
    """
    if len(tracks) < COMMAND.min_trials:
        return None
    fits = [servo_gain([single_joint(t, joint)]) for t in tracks]
    if any(fit is None for fit in fits):
        return None
    gain, error, share = np.array([fit for fit in fits if fit is not None]).T
    if (
        np.max(share) > COMMAND.min_doubted_share
    ):  # something else acts too, as a limit of force in the trials that reach it
        return None
    middle = float(np.median(gain))
    gain_difference = np.ptp(gain) / max(
        float(np.hypot(error[gain.argmax()], error[gain.argmin()])), 1e-12
    )
    if (
        np.min(gain) <= 0
        or np.max(gain) / np.min(gain) < COMMAND.min_gain_ratio
        or gain_difference < COMMAND.min_gain_errors
        or np.max(error / gain) > COMMAND.max_gain_error
    ):
        return None
    return gain / middle


def limit_distance(target: np.ndarray, q: np.ndarray, max_distance: float) -> np.ndarray:
    """Limit a target `[T]` to `max_distance` from where the joint is, `q [T]` (rad or m)."""
    return q + np.clip(target - q, -max_distance, max_distance)


def limit_rate(time: np.ndarray, target: np.ndarray, q: np.ndarray, rate: float) -> np.ndarray:
    """Limit a target `[T]` at `time [T]` s, sent by steps of at most `rate` (rad/s or m/s) times
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
