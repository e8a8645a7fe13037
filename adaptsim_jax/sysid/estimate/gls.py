"""Joint refit of declared parameters, effect parameters and initial states under a full residual covariance.

`output_error.py` weighs samples one by one, which is right where the sensors are the only noise. Here the residual covariance
comes from `variance.py`: a Gauss-Newton step on whitened rows, initial states projected out of them, so that a force
which wanders costs what it should and no more. The linearisation is a callable; nothing here knows a model.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from adaptsim_jax.sysid.estimate.variance import Linearised, Whitened, whiten


class Point(NamedTuple):
    """Shared parameters `z [G]` (declared, then effects) and initial states `x0 [W, S]`."""

    z: np.ndarray
    x0: np.ndarray


@dataclass(frozen=True)
class Refit:
    """Where the refit ended. cost: `[W]` whitened sum of squares with initial states projected out (chi-square if the
    model is right); covariance `[G, G]` of z, zero for entries that were held; at_bound `[G]`."""

    point: Point
    linearised: Linearised
    white: Whitened
    covariance: np.ndarray
    free: np.ndarray
    at_bound: np.ndarray
    iterations: int
    damping: float  # that a next step would begin with

    @property
    def cost(self) -> np.ndarray:
        return np.sum(self.white.residual**2, axis=1)


def nowhere(x0: np.ndarray) -> Refit:
    """What is left of a refit that ran away from its initial states `[W, S]`: no parameters, and no rows."""
    count, none, trial = len(x0), np.zeros((len(x0), 0, 0)), np.zeros(len(x0), int)
    rows = np.zeros((count, 0))
    lin = Linearised(rows, none, none, none, none[..., None], rows, np.zeros(0, int), trial, rows > 0)
    held = np.zeros(0, bool)
    white = Whitened(rows, none, none, trial, trial)
    return Refit(Point(np.zeros(0), x0), lin, white, np.zeros((0, 0)), held, held, 0, LEAST)


Linearise = Callable[[Point], Linearised]
TOLD = 1e-13  # of a parameter's effect on the outputs: with less of it left beside the initial states, the data say nothing
MOST_OF_THE_WAY = 0.9  # to a bound where there is no slope
LEAST = 1e-6  # damping to begin with, relative to the information


def refit(
    linearise: Linearise,
    start: Point,
    factor: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    free: np.ndarray,
    *,
    keep: np.ndarray | None = None,
    iterations: int = 8,
    tolerance: float = 0.02,
    known: Linearised | None = None,
    damping: float = LEAST,
    slow: np.ndarray | None = None,
) -> Refit:
    """Minimise the whitened sum of squares over `z[free]` within `[low, high]` and over all initial states.

    factor: `[W, M, M]` from `variance.whitener`. keep `[W]`: windows that inform z; the others only get their initial
    states, so that their cost is a held-out one. known: the linearisation at `start`, if it is at hand. damping: of the first step;
    that with which an earlier refit of the model ended saves what it took to find it. slow `[G]`: entries without a slope at `low`,
    from which nothing leads back: a step goes no more than nine tenths of the way there. Stops after so many steps
    that lower the cost, or when one lowers it by less than `tolerance` (absolute plus relative 1e-5): below what any test could
    see. Steps that raise it are shortened and do not count: where effects switch, several in a row may.
    """
    keep = np.ones(len(start.x0), bool) if keep is None else keep
    point = Point(np.clip(start.z, low, high), start.x0)
    lin = linearise(point) if known is None else known
    damping, done = float(np.clip(damping, LEAST, 1.0)), 0
    while done < iterations:
        old = _objective(lin, factor, keep)
        least = low if slow is None else np.where(slow, point.z + MOST_OF_THE_WAY * (low - point.z), low)
        trial = _stepped(point, lin, factor, least, high, free, keep, damping)
        trial_lin = linearise(trial)
        new = _objective(trial_lin, factor, keep)
        if np.isfinite(new) and new <= old:
            point, lin, damping = trial, trial_lin, max(damping * 0.1, 1e-9)
            done += 1
            if old - new < tolerance + 1e-5 * old:
                break
        else:
            damping = max(damping * 30.0, 1e-4)
            if damping > 1e4:
                break
    white = whiten(lin, factor)
    covariance, stuck = _covariance(point.z, white, low, high, free, keep)
    return Refit(point, lin, white, covariance, free, stuck, done, damping)


def _objective(lin: Linearised, factor: np.ndarray, keep: np.ndarray) -> float:
    """Whitened sum of squares at the initial states as they are. Not the projected one: where a model runs away, its
    response to initial states is so large that the projection would hide all of the residual."""
    with np.errstate(over="ignore", invalid="ignore"):
        white = (factor @ lin.residual[..., None])[..., 0]
        return float(np.sum(white[keep] ** 2))


def _information(white: Whitened, keep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    j = white.jac_theta[keep]
    return np.einsum("wmi,wmj->ij", j, j, optimize=True), np.einsum("wmi,wm->i", j, white.residual[keep])


def _stepped(point: Point, lin: Linearised, factor, low, high, free, keep, damping) -> Point:
    """A damped Gauss-Newton step of everything at once: initial states are eliminated as they will be stepped, damped."""
    jac, rows = factor @ lin.jac_state, factor @ np.concatenate([lin.jac_theta, lin.residual[..., None]], -1)
    normal, right = np.swapaxes(jac, 1, 2) @ jac, np.swapaxes(jac, 1, 2) @ rows
    scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-12))[..., None]
    scaled = normal / scale / np.swapaxes(scale, 1, 2) + (1e-10 + damping) * np.eye(normal.shape[1])
    back = np.linalg.solve(scaled, right / scale) / scale  # [W, S, G+1]
    whole = np.einsum("wmi,wmj->ij", rows[keep], rows[keep], optimize=True)
    gram = whole - np.einsum("wsi,wsj->ij", right[keep], back[keep], optimize=True)
    step, live = np.zeros_like(point.z), free & (np.diag(gram) > TOLD * np.diag(whole) + 1e-30)[:-1]
    if live.any():
        hess, slope = gram[:-1, :-1][np.ix_(live, live)], gram[:-1, -1][live]
        step[live] = _solve(hess, slope, (low - point.z)[live], (high - point.z)[live], damping)
    return Point(np.clip(point.z + step, low, high), point.x0 + back[..., -1] - back[..., :-1] @ step)


def _solve(hess: np.ndarray, slope: np.ndarray, low: np.ndarray, high: np.ndarray, damping: float) -> np.ndarray:
    """Scaled, damped solve between `low` and `high` that leaves alone the directions on which the data say nothing. A step merely
    clipped there may raise even the linearised cost: what is held changes where the rest should go."""
    scale = 1.0 / np.sqrt(np.diag(hess))
    value, vector = np.linalg.eigh(hess * scale[:, None] * scale[None, :])
    seen = value > 1e-10
    root = np.where(seen, np.sqrt(np.maximum(value, 1e-30) + damping), 1.0)
    ways, far = (vector * root).T, np.where(seen, vector.T @ (scale * slope) / root, 0.0)
    return scale * lsq_linear(ways, far, (low / scale, high / scale), method="bvls").x


@np.errstate(over="ignore", invalid="ignore")  # of a model that runs away
def _covariance(z, white: Whitened, low, high, free, keep) -> tuple[np.ndarray, np.ndarray]:
    """Sandwich covariance over windows, no smaller than the model's own; entries at a bound are held there."""
    hess, slope = _information(white, keep)
    stuck = free & (((z <= low) & (slope <= 0)) | ((z >= high) & (slope >= 0)))
    live = np.flatnonzero(free & ~stuck)
    out = np.zeros((len(z), len(z)))
    if not len(live):
        return out, stuck
    part = hess[np.ix_(live, live)]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(part), 1e-30))
    inverse = scale[:, None] * np.linalg.pinv(part * scale[:, None] * scale, rcond=1e-10, hermitian=True) * scale
    scores = np.einsum("wmi,wm->wi", white.jac_theta[keep][:, :, live], white.residual[keep])
    count = max(int((white.rows[keep] > 0).sum()), 1)
    sandwich = inverse @ (scores.T @ scores) @ inverse * count / max(count - len(live), 1)
    wider = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(inverse), 1e-300), 1.0))
    out[np.ix_(live, live)] = inverse * wider[:, None] * wider
    return out, stuck
