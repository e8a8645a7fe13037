"""The zero of a yardstick: what a straight line and holding still leave of a stretch, against which
a model's error is held.
"""

import numpy as np

from adaptsim_jax.diagnosis.simulator import Stretches


def doing_nothing(stretches: Stretches) -> tuple[np.ndarray, np.ndarray]:
    """RMS errors `[W, C]`, in each signal's unit, of a straight line through a stretch's own
    readings, and of its mean.

    Both are fitted to the stretch, as a model's start is: two numbers of a signal, and one.
    """
    seen, y = (stretches.seen > 0).astype(float), np.nan_to_num(stretches.measured)
    count = np.maximum(seen.sum(1), 1.0)

    def mean(z):
        return (z * seen).sum(1) / count

    t = (stretches.time - stretches.time.mean(1, keepdims=True))[..., None] * np.ones_like(y)
    t = t - mean(t)[:, None]
    still = y - mean(y)[:, None]
    slope = mean(t * still) / np.maximum(mean(t * t), 1e-300)

    def rms(z):
        return np.sqrt(mean(np.square(z)))

    return rms(still - slope[:, None] * t), rms(still)


def skill(error: float, line: float, still: float) -> float | None:
    """1 - error / the better of a straight line and holding still; None where nothing moved."""
    least = min(line, still)
    if least > 0.0:
        return 1.0 - error / least
    return None
