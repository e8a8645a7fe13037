"""Words of registers: whole numbers with a bit for their sign, or read without their sign."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from adaptsim_jax.logs.criteria import CLOCK, TABLE, WORD


def _sign_bit(x: np.ndarray, top: float) -> np.ndarray:
    return np.where(x >= top, top - x, x)


def _signed(x: np.ndarray, every: float) -> np.ndarray:
    """Words that take `every` value once, followed over their ends, from the one nearer to 0."""
    here = np.isfinite(x)
    out, raw = x.copy(), x[here]
    out[here] = np.unwrap(raw, period=every) - every * np.round(raw[:1] / every)[: len(raw)]
    return out


WORDS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    f"bit {bit} taken as the sign": partial(_sign_bit, top=2.0**bit) for bit in (10, 11, 15, 31)
} | {
    f"taken as words of {width} bits with a sign": partial(_signed, every=2.0**width)
    for width in (32, 16)
}
"""How a word may be taken -> the numbers `[T]` of its readings. Registers of Dynamixel and Feetech
have their sign in a bit of its own.
"""


def word_of(parts: Sequence[np.ndarray]) -> str:
    """How the readings of one register, by trial `[T]` (NaN where missing), are to be taken, of
    `WORDS`; '' where they are as they are: nothing leaps, or no word explains it.
    """
    raw = [x[np.isfinite(x)] for x in parts]
    all_readings, largest_leap = np.concatenate(raw), _leap(raw)
    if largest_leap < WORD.min_leap or np.any(all_readings != np.round(all_readings)):
        return ""
    readings_by_word = {word: [decode(x) for x in raw] for word, decode in WORDS.items()}
    candidates = [
        word
        for word, readings in readings_by_word.items()
        if _leap(readings) < WORD.max_leap_ratio * largest_leap
    ]
    return min(
        candidates,
        key=lambda h: sum(np.sum(np.abs(np.diff(x))) for x in readings_by_word[h]),
        default="",
    )


UNANSWERED = (-1.0, 2.0**16 - 1, 2.0**32 - 1)
"""All bits set: what a bus hands on that was not answered."""


def unanswered(x: np.ndarray) -> np.ndarray:
    """Rows `[T]` in which a register was not read: a few with all bits set, far from the readings
    before and after, which agree. None where readings are no whole numbers.
    """
    is_answered = np.isfinite(x) & ~np.isin(x, UNANSWERED)
    raw = x[is_answered]
    if not 0 < np.mean(~is_answered) <= TABLE.max_missing_share or np.any(raw != np.round(raw)):
        return np.zeros(len(x), bool)
    max_distance = WORD.max_usual_steps * max(
        float(np.quantile(np.abs(np.diff(raw)), CLOCK.usual_quantile)), 1.0
    )
    count = np.cumsum(is_answered)
    before, after = raw[np.maximum(count - 1, 0)], raw[np.minimum(count, len(raw) - 1)]
    distance = np.minimum(np.abs(x - before), np.abs(x - after))
    return ~is_answered & (distance > max_distance) & (np.abs(before - after) <= max_distance)


def _leap(parts: Sequence[np.ndarray]) -> float:
    return max(float(np.max(np.abs(np.diff(x)), initial=0.0)) for x in parts)
