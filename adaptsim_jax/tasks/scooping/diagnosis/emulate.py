"""Scoops by local regression: poses as a quadratic function of the values, and how far a scoop
strays from it.

A scoop is chaotic from where the blade's edge is under a flat bottom: Friction changed by a
millionth moves one piece in two by a millimetre. So the engine's exact derivatives say nothing.
What can be told beforehand is the mean over neighbours. Each scoop is therefore simulated at
`DRAWS` points around a centre, all values drawn at once and the action executed as an arm repeats
it. Its poses are regressed on the values, row by row. What they stray by about the regression is a
row's own uncertainty.
"""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from adaptsim_jax.tasks.scooping.diagnosis.catalogue import QUANTITIES
from adaptsim_jax.tasks.scooping.diagnosis.read import Scooped
from adaptsim_jax.tasks.scooping.diagnosis.simulate import INDEX, OWN, executed, poses

Array = Any
DRAWS, FEWER = 128, 48
"""Draws of all values, and of as few as a model fits."""
PAIRS = (("mu", "log_e"), ("mu", "h"), ("log_e", "h"))
REACH = 3.0  # widths from the centre, beyond which a row goes on along its slope alone
ROUNDS = 3  # of reweighing
RIDGE = 1.0  # draws' worth of belief that a row depends on nothing
LOW, HIGH = (np.array([getattr(q, end) for q in QUANTITIES])[OWN] for end in ("low", "high"))
PLACE = {int(o): i for i, o in enumerate(OWN)}
SCALES = np.array([q.scale for q in QUANTITIES])[OWN]
WIDE, NARROW = 2.0, {"ellipsoid": 1.0, "cylinder": 2.0, "box": 2.0}
"""Widths of the draws in scales of each quantity, at first and later. A piece that rolls strays
less the narrower they are; one with a flat bottom strays by centimetres however narrow they are,
and wide draws tell its slopes.
"""


def widths(shape: str | None = None) -> np.ndarray:
    """Standard deviations `[O]` of the draws where nothing is known better: at first, or later for
    a shape.
    """
    return (WIDE if shape is None else NARROW[shape]) * SCALES


@dataclass(frozen=True)
class Emulator:
    """centre, width `[O]` of the values that matter to a simulation; weights `[T, F, N, 2]`; stray
    `[T, N, 2]` m; shape.
    """

    centre: np.ndarray
    width: np.ndarray
    weights: np.ndarray
    stray: np.ndarray
    shape: str


def features(z: Array) -> Array:
    """`[..., F]` of values in widths from the centre `[..., O]`."""
    held = jnp.clip(z, -REACH, REACH)
    at = [tuple(PLACE[INDEX[n]] for n in pair) for pair in PAIRS]
    one = jnp.ones_like(z[..., :1])
    pairs = jnp.stack([held[..., a] * held[..., b] for a, b in at], -1)
    return jnp.concatenate([one, z, held * held - 1.0, pairs], -1)


def predicted(weights: Array, centre: Array, width: Array, values: Array) -> Array:
    """Poses `[N, 2]` of one scoop with `weights [F, N, 2]` at `values [P]`."""
    return jnp.tensordot(features((values[OWN] - centre) / width), weights, 1)


def emulate(
    scooped: Scooped,
    shape: str,
    centre: np.ndarray,
    width: np.ndarray,
    seed: int = 0,
    drawn: np.ndarray | None = None,
) -> Emulator:
    """The scoops around `centre [P]`, drawn with standard deviations `width [O]` and held within
    bounds.

    drawn `[O]`: Values that are drawn, where not all: `FEWER` draws tell a few.
    """
    count = len(scooped.names)
    draws = DRAWS if drawn is None else FEWER
    u = qmc.Sobol(len(OWN), rng=np.random.default_rng(seed)).random(DRAWS)[:draws]
    z = np.clip(ndtri(np.clip(u, 1e-3, 1 - 1e-3)), -2.5, 2.5)
    z *= 1.0 if drawn is None else drawn
    own = np.clip(centre[OWN] + width * z, LOW, HIGH)
    values = np.tile(centre, (draws, 1))
    values[:, OWN] = own
    trials = np.repeat(np.arange(count), draws)
    actions = scooped.actions[trials] + executed(scooped, len(trials), seed)
    out = poses(scooped, shape, np.tile(values, (count, 1)), trials, actions)
    out = out.reshape(count, draws, -1, 2).astype(float)
    x = np.asarray(features((own - centre[OWN]) / width), float)
    fits = [_regressed(x, rows) for rows in out]
    return Emulator(
        centre[OWN], width, np.stack([f[0] for f in fits]), np.stack([f[1] for f in fits]), shape
    )


def _regressed(x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights `[F, N, 2]` of one scoop's draws `rows [S, N, 2]` on features `x [S, F]`, and what
    these stray by `[N, 2]`.

    Draws that went another way at the lip are outliers, in the fit and in the scale: what two draws
    of three stay within.
    """
    y = rows.reshape(len(rows), -1).T  # [M, S]
    penalty = RIDGE * np.eye(x.shape[1])
    penalty[0, 0] = 1e-6
    trust = np.ones_like(y)
    for last in range(ROUNDS + 1):
        weighed = trust[:, None, :] * x.T  # [M, F, S]
        gram = weighed @ x + penalty
        weights = np.linalg.solve(gram, weighed @ y[..., None])[..., 0]
        left = y - weights @ x.T
        scale = np.maximum(np.quantile(np.abs(left), 0.68, axis=1, keepdims=True), 1e-6)
        if last == ROUNDS:
            break
        trust = 1.0 / (1.0 + np.square(left / (2.0 * scale)))
    # each draw predicted by the others
    leverage = trust * np.einsum(
        "sf,mfs->ms", x, np.linalg.solve(gram, np.broadcast_to(x.T, weighed.shape))
    )
    stray = np.quantile(np.abs(left) / np.maximum(1.0 - leverage, 0.1), 0.68, axis=1)
    return weights.T.reshape(-1, *rows.shape[1:]), stray.reshape(rows.shape[1:])
