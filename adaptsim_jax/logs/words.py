"""Words of registers: whole numbers with a bit for their sign, or read without their sign."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from adaptsim_jax.logs.criteria import WORD

SIGN_BITS = (10, 11, 15, 31)
"""Bits that say that the others are below zero, as of Dynamixel's and Feetech's registers."""
WIDTHS = (8, 16, 32)
"""Bits of words that go on from their other end, as two's complement does."""
Way = Callable[[np.ndarray], np.ndarray]


def decoded(parts: Sequence[np.ndarray]) -> tuple[list[np.ndarray], str]:
    """Readings of one register by trial `[T]` (NaN where missing) as the numbers that its words
    mean, and how they were taken; as they are, and '', where nothing leaps as words do.
    """
    raw = [x[np.isfinite(x)] for x in parts]
    every, leap = np.concatenate(raw), _leap(raw)
    if leap < 2.0 ** (min(WIDTHS) - 1) or np.any(every != np.round(every)):
        return list(parts), ""
    ways: dict[str, Way] = {
        f"bit {bit} taken as the sign": lambda x, top=2.0**bit: np.where(x >= top, top - x, x)
        for bit in SIGN_BITS
        if every.min() >= 0 and 2.0**bit <= every.max() < 2.0 ** (bit + 1)
    }
    ways |= {
        f"taken as words of {width} bits with a sign": lambda x, all_=2.0**width: _signed(x, all_)
        for width in WIDTHS
        if np.ptp(every) < 2.0**width
    }
    read = {how: [way(x) for x in raw] for how, way in ways.items()}
    good = [how for how, own in read.items() if _leap(own) < WORD.left * leap]
    if not good:
        return list(parts), ""
    how = min(good, key=lambda h: sum(np.sum(np.abs(np.diff(x))) for x in read[h]))
    out = [x.copy() for x in parts]
    for x, own in zip(out, read[how], strict=True):
        x[np.isfinite(x)] = own
    return out, f"whole numbers leap by {leap:.0f}: {how}"


def _leap(parts: Sequence[np.ndarray]) -> float:
    return max(float(np.max(np.abs(np.diff(x)), initial=0.0)) for x in parts)


def _signed(x: np.ndarray, every: float) -> np.ndarray:
    """Words that take `every` value once, followed over their ends, from the one nearer to 0."""
    start = every * np.round(x[:1] / every)
    return np.unwrap(x, period=every) - (start if len(x) else 0.0)
