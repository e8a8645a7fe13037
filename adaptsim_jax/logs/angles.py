"""Joint positions of the model from logged angles: whole turns, zeros, absolute angles, joints
counted the other way round.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from adaptsim_jax.logs.criteria import WRAP
from adaptsim_jax.logs.log import ModelNames
from adaptsim_jax.logs.log_meta import LogMeta

V = TypeVar("V")
TURN = 2.0 * np.pi


def model_angles(
    logged: np.ndarray, names: ModelNames, meta: LogMeta, *, rates: bool = False
) -> np.ndarray:
    """The model's joint positions `[T, n]` (or their rates) from logged ones in SI units.

    A zero is taken off first, then an absolute angle less that of the joint before it, then a
    reversed joint turned.
    """
    zero = np.array([_declared_for(meta.zero, i, j, 0.0) for i, j in enumerate(names.joints)])
    relative_to_zero = logged if rates else logged - zero
    out = relative_to_zero.copy()
    for i, (joint, parent) in enumerate(zip(names.joints, names.parent_of, strict=True)):
        if (
            _declared_for(meta.convention, i, joint, meta.convention.get("", "relative"))
            == "absolute"
            and parent >= 0
        ):
            out[:, i] = relative_to_zero[:, i] - relative_to_zero[:, parent]
    out[:, flipped_joints(names, meta)] *= -1.0
    return out


def flipped_joints(names: ModelNames, meta: LogMeta) -> list[bool]:
    """`[n]`: joints that the log counts the other way round."""
    return [
        _declared_for(dict.fromkeys(meta.reversed, True), i, joint, False)
        for i, joint in enumerate(names.joints)
    ]


def turns_of(time: np.ndarray, q: np.ndarray) -> Turns:
    """An angle `[T]` (rad, NaN where missing) at `time [T]` s without the jumps of an encoder that
    counts within one period.
    """
    rows = np.flatnonzero(np.isfinite(q))
    turns = without_turns(time[rows], q[rows])
    out = q.copy()
    out[rows] = turns.q
    return replace(turns, q=out, unsure=tuple(int(rows[k]) for k in turns.unsure))


def _declared_for(table: Mapping[str, V], index: int, joint: str, default: V) -> V:
    """What `[angles]` gives a joint, by its name or by that of its column."""
    words = (joint, f"q_{joint}", f"q{index + 1}", *(("q",) if index == 0 else ()))
    return next((table[word] for word in words if word in table), default)


@dataclass(frozen=True)
class Turns:
    """`q [T]` without jumps of whole periods, `count` of them taken out; `unsure`: rows before a
    gap in which an encoder that wraps may have counted more than can be told.
    """

    q: np.ndarray
    count: int
    unsure: tuple[int, ...] = ()


def without_turns(time: np.ndarray, q: np.ndarray) -> Turns:
    """Take jumps of whole periods out of `q [T]` rad at `time [T]` s, both finite.

    A period is a turn, or what an encoder that starts anew elsewhere betrays: jumps alike, as far
    as its whole range.
    """
    if len(q) < 4:
        return Turns(q, 0)
    jump, dt = np.diff(q), np.diff(time)
    is_gap = dt > WRAP.min_gap_rows * np.median(dt)
    period = _other_period(q, ~is_gap) or TURN
    remainder = jump - period * np.round(jump / period)
    speed = np.where(is_gap, np.nan, remainder / dt)
    expected = _mean_of_sides(speed) * dt
    excess = jump - np.where(is_gap, expected, 0.0)
    turns = np.round(excess / period)
    miss = np.abs(excess - turns * period)
    stays_within_period = _within_one_period(q, period)
    allowed = WRAP.gap_tolerance_share * period
    is_turn_in_gap = stays_within_period & (miss < allowed) & (dt < WRAP.max_gap)
    is_counted = np.where(is_gap, is_turn_in_gap, miss < min(WRAP.turn_tolerance, allowed))
    turns_removed = np.where(is_counted, turns, 0.0)
    is_large_step = ~is_gap & (
        np.abs(remainder) > WRAP.min_jump_share * period
    )  # an encoder that wraps jumps by its period, or hardly moves
    if np.sum(is_large_step) >= np.count_nonzero(turns_removed):
        turns_removed = np.where(is_gap, turns_removed, 0.0)
    is_fast = np.abs(expected) > WRAP.min_jump_share * period
    is_unsure = (
        is_gap & stays_within_period & ~is_counted & (is_fast | (np.abs(jump) > WRAP.half * period))
    )
    steps = tuple(np.flatnonzero(is_unsure).tolist())
    if not turns_removed.any():
        return Turns(q, 0, steps)
    out = q - period * np.concatenate([[0.0], np.cumsum(turns_removed)])
    return Turns(out, int(np.count_nonzero(turns_removed)), steps)


def follow_turns(q: np.ndarray, target: np.ndarray) -> np.ndarray:
    """A target `[T]` rad with the whole turns of the angle `q [T]` that it commands, from which
    turns were taken out: it jumps where the driver counts anew, at rows of its own. Both may be
    NaN; as it is where turns do not bring it to the angle.
    """
    rows = np.flatnonzero(np.isfinite(q) & np.isfinite(target))
    if len(rows) < 4:
        return target
    angle, u = q[rows], target[rows]
    is_start = np.concatenate([[True], np.abs(np.diff(u)) > WRAP.half * TURN])
    if (
        is_start.sum() > 1 and np.ptp(u) > WRAP.max_turns * TURN
    ):  # what counts anew stays within a turn
        return target
    first = np.maximum.accumulate(np.where(is_start, np.arange(len(u)), 0))
    turns = np.round((angle - u) / TURN)[first]
    unwrapped = u + TURN * turns
    if not turns.any() or np.mean((unwrapped - angle) ** 2) > WRAP.min_gain * np.mean(
        (u - angle) ** 2
    ):
        return target
    out = target.copy()
    out[rows] = unwrapped
    return out


def _mean_of_sides(speed: np.ndarray) -> np.ndarray:
    """For each step the mean of the speeds just before and after it, of three steps each; 0 where
    there are none.
    """
    n = len(speed)
    padded = np.concatenate([np.full(3, np.nan), speed, np.full(3, np.nan)])
    before = np.stack([padded[k : k + n] for k in range(3)])
    after = np.stack([padded[4 + k : 4 + k + n] for k in range(3)])
    sides = []
    for side in (before, after):
        is_finite = np.isfinite(side)
        total = np.where(is_finite, side, 0.0).sum(0)
        mean = total / np.maximum(is_finite.sum(0), 1)
        sides.append(np.where(is_finite.any(0), mean, np.nan))
    first, second = sides
    filled = (
        np.where(np.isfinite(first), first, second),
        np.where(np.isfinite(second), second, first),
    )
    return np.nan_to_num(0.5 * (filled[0] + filled[1]))


def _within_one_period(q: np.ndarray, period: float) -> bool:
    """Whether the angle never leaves one period from -period/2 or from 0, and comes near both of
    its ends.
    """
    margin, slack = WRAP.min_jump_share * period, WRAP.slack * period
    low, high = float(q.min()), float(q.max())
    return any(
        start - slack <= low < start + margin and end - margin < high <= end + slack
        for start, end in ((-0.5 * period, 0.5 * period), (0.0, period))
    )


def _other_period(q: np.ndarray, is_neighbour: np.ndarray) -> float | None:
    """A period that is no turn: several jumps alike between neighbouring rows (`is_neighbour
    [T-1]`), far beyond all other steps, and nearly as wide as the angle's range.
    """
    step = np.abs(np.diff(q))[is_neighbour]
    span = float(np.ptp(q))
    is_jump = step > WRAP.other_jump * span
    if span < WRAP.other_span or np.sum(is_jump) < 2 or np.mean(is_jump) > WRAP.other_rare:
        return None
    jumps, other_steps = step[is_jump], step[~is_jump]
    if (
        np.max(other_steps) > WRAP.other_rest * span
        or abs(span - TURN) < WRAP.other_same * TURN
        or np.ptp(jumps) > WRAP.other_alike * span
    ):
        return None
    # the step that was made beside the jump is about as long as its neighbours
    return float(np.median(jumps + np.median(other_steps)))
