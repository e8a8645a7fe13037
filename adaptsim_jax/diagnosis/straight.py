"""What needs no model: a straight line through a stretch's own readings, and its mean."""

import numpy as np


def straight_lines(
    time: np.ndarray, z: np.ndarray, seen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Value at time zero and slope [W, C] of the lines through z [W, R, C] where it was seen, by
    least squares; time [W, R].
    """
    time = time[..., None] + 0.0 * z

    def total(x):
        return (x * seen).sum(1)

    count, first, second = total(1.0 + 0.0 * z), total(time), total(time * time)
    spread = np.maximum(count * second - first**2, 1e-12)
    slope = (count * total(time * z) - first * total(z)) / spread
    return (total(z) - slope * first) / np.maximum(count, 1), slope


def doing_nothing(
    time: np.ndarray, z: np.ndarray, seen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """RMS errors [W, C] of a straight line and of holding still at the mean, both fitted to the
    stretch, as a model's start is: two numbers of a signal, and one.
    """
    count = np.maximum(seen.sum(1), 1)
    since = time - time.mean(1, keepdims=True)
    value, slope = straight_lines(since, z, seen)
    line = z - value[:, None] - slope[:, None] * since[..., None]
    still = z - ((z * seen).sum(1) / count)[:, None]

    def rms(off):
        return np.sqrt((np.square(off) * seen).sum(1) / count)

    return rms(line), rms(still)


def skill(error: float, line: float, still: float) -> float | None:
    """1 - error / the better of a straight line and holding still; None where nothing moved."""
    lowest = min(line, still)
    if lowest > 0.0:
        return 1.0 - error / lowest
    return None
