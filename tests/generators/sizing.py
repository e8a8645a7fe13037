"""How large an effect is: the torque that the best-fitting declared model leaves unexplained.

Along a noise-free run, the declared inverse dynamics Y(q, v, a) theta are evaluated with what the
sensors read, on average over each row (a from the change of v), and compared with the commanded
torque of that row. The discrepancy, each joint divided by the RMS of its torque, is projected
orthogonal to the columns of Y (so what a declared parameter can absorb does not count). Its RMS,
summed over the joints in squares, is the *unexplained share*; the RMS before projection is the *raw
share*.

**The size that just matters** (size multiple 1) has an unexplained share of 3 %. A multiple m aims
at m times 3 %. If the declared model absorbs over nine tenths of the effect (unexplained < 0.1
raw), it is confounded with the declared model, and the raw share is aimed at instead.
"""

from dataclasses import dataclass

import numpy as np

from tests.generators.simulate import Run
from tests.generators.worlds import Rig, base_parameters, regressor

JUST_MATTERS = 0.03
# multiple below which what a quiet run leaves is its integration's: smaller sizes are in proportion
LEAST = 0.05


@dataclass(frozen=True)
class Share:
    """Shares of the torque's RMS, and that RMS `[2]` N m."""

    raw: float
    unexplained: float
    torque: np.ndarray

    @property
    def confounded(self) -> bool:
        return self.unexplained < 0.1 * self.raw

    @property
    def counted(self) -> float:
        return self.raw if self.confounded else self.unexplained


def measure(rig: Rig, run: Run, lanes: slice, valid: np.ndarray) -> Share:
    """The shares of whatever separates this (quiet) run of one data set from the declared model."""
    smooth, u = run.smooth[..., lanes], run.command[..., lanes]
    dt = np.maximum(np.diff(run.times[:, lanes], axis=0), 1e-12)[:, None]
    middle, slope = (smooth[1:] + smooth[:-1]) / 2, np.diff(smooth[:, 2:], axis=0) / dt

    def pick(x):
        return x.transpose(2, 0, 1)[valid[:, :-1]]

    x, a, u = pick(middle), pick(slope), pick(u[:-1])
    y = regressor(rig, x[:, :2], x[:, 2:], a)
    if not np.isfinite(y).all():  # the closed loop did not bear an effect of this size
        return Share(np.inf, np.inf, np.ones(2))
    gap = (y @ base_parameters(rig)).T - u
    torque = np.sqrt(np.mean(u**2, axis=0))
    # A joint that is hardly driven is measured against the larger of the two, scaled.
    torque = np.maximum(torque, 0.1 * torque.max() + 1e-9)
    rows, target = np.concatenate(y / torque[:, None, None]), (gap / torque).T.reshape(-1)
    scale = np.linalg.norm(rows, axis=0) + 1e-12
    theta = np.linalg.lstsq(rows / scale, target, rcond=1e-10)[0]
    rest = target - rows / scale @ theta
    return Share(
        float(np.sqrt(2 * np.mean(target**2))), float(np.sqrt(2 * np.mean(rest**2))), torque
    )


def aimed_at(multiple: float) -> float:
    """The multiple to size by quiet runs, from which the size is then scaled down in proportion."""
    return multiple if multiple >= LEAST else 2 * LEAST


def next_size(
    sizes: list[float], shares: list[float], target: float, low: float, high: float
) -> float:
    """The next size to try: proportional at first, then the secant in logarithms with a bounded
    slope.
    """
    if not np.isfinite(shares[-1]):
        return sizes[-1] / 3
    slope = 1.0
    if len(sizes) > 1 and sizes[-1] != sizes[-2] and np.isfinite(shares[-2]):
        rise = np.log(max(shares[-1], 1e-9) / max(shares[-2], 1e-9))
        slope = float(np.clip(rise / np.log(sizes[-1] / sizes[-2]), 0.3, 3.0))
    factor = (target / max(shares[-1], 1e-9)) ** (1 / slope)
    return float(np.clip(sizes[-1] * np.clip(factor, 0.2, 5.0), low, high))
