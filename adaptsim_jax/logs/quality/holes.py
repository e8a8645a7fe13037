"""Rows that a recorder dropped while it stamped the others evenly: the angles jump as they would
over a longer step, and over no other.
"""

from collections.abc import Sequence

import numpy as np

from adaptsim_jax.logs.criteria import HOLE, JITTER
from adaptsim_jax.logs.noise import encoder_step

AROUND = np.arange(-2, 4)
"""Rows beside the one after which rows may be missing."""


def holes(trials: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> list[np.ndarray] | None:
    """How many rows are missing after each row `[T - 1]`, of trials (time [T] s, q [T, n], and what
    else moves with them [T, m]); None where stamps are not even, or hardly any row is missing.
    """
    found = []
    for time, q, others in trials:
        steps = np.diff(time)
        if np.ptp(steps) > JITTER.max_uneven_share * float(np.median(steps)):
            return None
        missing, moving = np.zeros(len(q) - 1, int), _moving(q)
        if len(q) >= HOLE.min_rows and moving.shape[1]:
            missing = _missing(moving, _moving(others))
        found.append(missing)
    if sum(np.count_nonzero(missing) for missing in found) >= HOLE.min_count:
        return found
    return None


def _moving(x: np.ndarray) -> np.ndarray:
    """Columns of `x [T, n]` that are whole and move."""
    complete = x[:, np.all(np.isfinite(x), axis=0)]
    return complete[:, np.ptp(complete, axis=0) > 0]


def _missing(q: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Rows missing after each row `[T - 1]`, where angles `q [T, n]` jump: the most evident first,
    so that those beside it are judged by the times that it leaves.
    """
    rows, channels = np.arange(2, len(q) - 3), np.concatenate([q, others], 1)
    place = np.arange(len(q), dtype=float)
    n_missing = np.zeros(len(q) - 1, int)
    windows = np.lib.stride_tricks.sliding_window_view(channels, len(AROUND), axis=0)
    cubic_residual = np.sum((windows @ _misses(place[rows[:1, None] + AROUND])[0]) ** 2, axis=2)
    min_noise = [max(encoder_step(x), HOLE.min_noise_share * np.ptp(x)) ** 2 for x in channels.T]
    noise = np.maximum(np.median(cubic_residual, axis=0), min_noise)
    scaled = channels / np.sqrt(noise)
    suspects = rows[
        np.max((cubic_residual / noise)[:, : q.shape[1]], axis=1) > HOLE.min_residual_ratio
    ]
    gain, count = np.zeros(len(suspects)), np.zeros(len(suspects), int)
    to_score = np.arange(len(suspects))
    while len(suspects):
        if len(to_score):
            gain[to_score], count[to_score] = _gains(place, scaled, suspects[to_score], q.shape[1])
        k = int(np.argmax(gain))
        if gain[k] < np.log(HOLE.min_gain):
            break
        n_missing[suspects[k]], gain[k] = count[k], -np.inf
        place[suspects[k] + 1 :] += count[k]
        is_near = np.abs(suspects - suspects[k]) < len(AROUND)
        to_score = np.flatnonzero(is_near & (n_missing[suspects] == 0))
    return n_missing


def _gains(
    place: np.ndarray, scaled: np.ndarray, rows: np.ndarray, joints: int
) -> tuple[np.ndarray, np.ndarray]:
    """How much likelier `rows [K]` are with rows missing after them, and how many `[K]`; not at all
    where more than the most would be likelier yet.
    """
    beside = rows[:, None] + AROUND
    times = place[beside] - place[rows][:, None]
    score = np.stack(
        [
            _surprise(_misses(times + m * (AROUND > 0)) @ scaled[beside])
            for m in range(HOLE.max_rows + 2)
        ]
    )
    score[1:][~_passed(scaled[beside][:, :, :joints])] = np.inf
    count = 1 + np.argmin(score[1:], axis=0)
    gain = score[0] - np.min(score[1:], axis=0)
    is_none = (count > HOLE.max_rows) | _stepped(scaled[beside][:, :, joints:])
    return np.where(is_none, -np.inf, gain), count


def _stepped(x: np.ndarray) -> np.ndarray:
    """Whether a target of `x [K, 6, m]` stands, steps and stands: what joints then do tells of no
    missing row.
    """
    steps_size = np.abs(np.diff(x, axis=1))
    largest = np.max(steps_size, axis=1)
    steps = np.count_nonzero(steps_size > 1e-9 * largest[:, None], axis=1)
    return np.any((steps == 1) & (largest > HOLE.speed_tolerance), axis=1)


def _passed(q: np.ndarray) -> np.ndarray:
    """Whether angles `q [K, 6, n]` can have come from their third row to the fourth in so many rows
    more `[M, K]`: about as fast as before and after. An encoder that counts anew leaps back; where
    a target steps, or a foot strikes, no joint goes farther than it is fast.
    """
    before, after = q[:, 2] - q[:, 1], q[:, 4] - q[:, 3]
    fastest = np.maximum(np.abs(before), np.abs(after))
    wide = np.abs(after - before) + 0.5 * fastest + HOLE.speed_tolerance
    low, high = np.minimum(before, after) - wide, np.maximum(before, after) + wide
    rows = 2 + np.arange(HOLE.max_rows + 1)[:, None, None]
    jump = q[:, 3] - q[:, 2]
    leaps = np.any(np.abs(jump) > HOLE.min_leap_ratio * fastest + HOLE.speed_tolerance, axis=1)
    return leaps & np.all((low < jump / rows) & (jump / rows < high), axis=2)


def _surprise(left: np.ndarray) -> np.ndarray:
    """How unlikely `left [K, 6, m]` is, by windows `[K]`: a target that steps, which no row
    explains, counts for one of many.
    """
    return np.sum(np.log1p(np.sum(left**2, axis=1)), axis=1)


def _misses(time: np.ndarray) -> np.ndarray:
    """`[K, 6, 6]`: what a cubic leaves of values at `time [K, 6]`."""
    shape, _ = np.linalg.qr((time / time[:, -1:])[:, :, None] ** np.arange(4))
    return np.eye(len(AROUND)) - shape @ shape.transpose(0, 2, 1)
