"""The noise of a channel by differences of neighbouring rows, of which smooth motion has next to
none.
"""

from collections.abc import Sequence
from math import comb

import numpy as np

NORMAL = 0.6745  # median size of a normal deviate, in standard deviations


def difference_noise(
    parts: Sequence[np.ndarray], order: int = 3, robust: bool = True, pooled: bool = False
) -> np.ndarray:
    """Standard deviation [...] of the noise of channels, 0 where no row tells of it.

    Args:
        parts: unbroken runs of rows [T, ...] at even steps, NaN where nothing was read.
        order: of the differences; a motion that is a polynomial of lower degree leaves none.
        robust: by the median of their sizes, which impacts hardly move; else by their mean square.
        pooled: whether all channels have one noise, [1].
    """
    rows = [np.diff(z, order, axis=0) for z in parts]
    d = np.concatenate([z.reshape(-1, 1) for z in rows] if pooled else rows)
    out = np.zeros(d.shape[1:])
    some = np.isfinite(d).any(0)
    if not some.any():
        return out
    d = d[:, some]
    if robust:
        size = np.nanmedian(np.abs(d), axis=0) / NORMAL
    else:
        size = np.sqrt(np.nanmean(np.square(d), axis=0))
    out[some] = size / np.sqrt(comb(2 * order, order))
    return out
