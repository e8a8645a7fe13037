"""Random motions of joints that keep to limits: a Fourier series under a smooth envelope, from home
and back, at rest at both ends (Swevers et al., 1997, for series as excitation).
"""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.mechanisms.allowed import Allowed

SLOWEST, FASTEST = 0.08, 1.4  # Hz, of a series: slower is rest, faster shakes the mount
BLEND = 1.5  # s, of the envelope at each end
HARMONICS = (2, 6)  # of a joint, from, below
SMALLER = 0.7  # of itself, that a motion becomes which touches something
FULL = 0.98  # of a limit: between rows a motion goes a little farther
ROUNDS = 12  # of scaling to torques


@dataclass(frozen=True)
class Basis:
    """Terms of a motion at times [T] s: a shift of the pose, then sines and cosines `[T, 1 + 2 H]`,
    all under the envelope, with their first and second derivative; plain: without the envelope.
    """

    time: np.ndarray
    hz: np.ndarray
    plain: np.ndarray
    terms: tuple[np.ndarray, np.ndarray, np.ndarray]

    def motion(self, home: np.ndarray, genes: np.ndarray) -> tuple[np.ndarray, ...]:
        """q, v, a [T, n] of coefficients [1 + 2 H, n]."""
        q, v, a = (z @ genes for z in self.terms)
        return home + q, v, a


def basis(seconds: float, rate: float) -> Basis:
    """At `rate` Hz over `seconds`."""
    time = np.arange(round(seconds * rate) + 1) / rate
    slow = 1.0 / (seconds - BLEND)
    hz = slow * np.arange(max(1, round(SLOWEST / slow)), max(2, round(FASTEST / slow) + 1))
    w = 2.0 * np.pi * hz
    s, c, one = np.sin(np.outer(time, w)), np.cos(np.outer(time, w)), np.ones((len(time), 1))
    b0 = np.concatenate([one, s, c], 1)
    b1 = np.concatenate([0.0 * one, c * w, -s * w], 1)
    b2 = np.concatenate([0.0 * one, -s * w * w, -c * w * w], 1)
    u = np.clip(np.minimum(time, seconds - time) / BLEND, 0.0, 1.0)[:, None]
    up = np.where(time < 0.5 * seconds, 1.0, -1.0)[:, None] / BLEND
    e0 = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    e1 = 30.0 * up * np.square(u - u * u)
    e2 = 60.0 * up * up * (u - 3.0 * u**2 + 2.0 * u**3)
    return Basis(time, hz, b0, (e0 * b0, e1 * b0 + e0 * b1, e2 * b0 + 2.0 * e1 * b1 + e0 * b2))


def drawn(rng: np.random.Generator, b: Basis, may: Allowed) -> np.ndarray | None:
    """Coefficients [1 + 2 H, n] of a random motion that fills what limits allow; None where even a
    small one touches something.
    """
    n, count = len(may.home), len(b.hz)
    series = rng.normal(0.0, 1.0, (2, count, n)) * b.hz[:, None] ** -rng.uniform(0.0, 1.5)
    for j in range(n):
        some = rng.choice(count, min(count, rng.integers(*HARMONICS)), replace=False)
        series[:, np.setdiff1d(np.arange(count), some), j] = 0.0
    shift = rng.uniform(0.0, 1.0) * (rng.uniform(may.low, may.high) - may.home)
    genes = scaled(b, may, np.concatenate([shift[None], series.reshape(2 * count, n)]))
    for _ in range(ROUNDS):
        q, v, a = b.motion(may.home, genes)
        over = float((np.abs(may.bodies.torques(q, v, a)) / may.torque).max())
        if over > FULL:
            genes = genes * np.clip(0.95 / over, 0.6, 0.95)
        elif may.bodies.touching(q):
            genes = genes * SMALLER
        else:
            return genes
    return None


def scaled(b: Basis, may: Allowed, genes: np.ndarray) -> np.ndarray:
    """Within ranges and speeds, joint by joint. Under the envelope a motion lies between home and
    the series, so it is in range where both are.
    """
    shift, series = genes[:1], genes[1:]
    z = b.plain[:, 1:] @ series
    top, bottom = z.max(0), -z.min(0)
    size = FULL * (may.high - may.low) / np.maximum(top + bottom, 1e-12)
    low, high = may.low - may.home + size * bottom, may.high - may.home - size * top
    genes = np.concatenate([np.clip(shift, low, high), size * series])
    fastest = np.abs(b.terms[1] @ genes).max(0)
    return genes * np.minimum(1.0, FULL * may.speed / np.maximum(fastest, 1e-12))
