"""One model against another by the same left-out units: a permutation test."""

from dataclasses import dataclass

import numpy as np

EXACT = 14  # parts up to which the sign-flip test takes all patterns of signs


@dataclass(frozen=True)
class Test:
    """Of one model against another. gain: the share of the loss that it takes off (geometric mean
    over folds); p of a sign-flip test over `parts` blocks; better: folds in which it is better.
    """

    gain: float
    p: float
    better: int
    folds: int
    parts: int


def sign_flip(d: np.ndarray) -> float:
    """One-sided p of the mean of paired differences [F] under random signs (Fisher's permutation
    test): all patterns, or 20,000.
    """
    count = len(d)
    if count <= EXACT:
        signs = 1.0 - 2.0 * ((np.arange(2**count)[:, None] >> np.arange(count)) & 1)
    else:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (10_000, count))
        signs[0] = 1.0
    return float(np.mean(signs @ d >= d.sum() * (1.0 - 1e-12)))
