"""Calibration of a push model against rows of another: which map of the modulus e makes bottles
stop where they should.

Errors are distances of the bottle at 0.81 s (the release's trial) and at the end (the paper's),
each held at 0.2 m, so that single bottles that just miss or just make it over the patch do not
decide a fit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import Report, silent
from adaptsim_jax.tasks.engine import Backend
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.engines import make_backend
from adaptsim_jax.tasks.pushing.model import PAPER, ElasticityMap, PushOptions
from adaptsim_jax.tasks.pushing.planar import DEFAULT, PlanarCoefficients

HELD_AT = 0.2
EARLY = 0.81
SPREAD = (
    0.3,
    0.3,
    0.15,
    0.4,
    0.3,
    0.15,
    0.3,
    0.6,
)  # of the first simplex, for the coefficients of a map


class Reference(NamedTuple):
    """Pushes and where their bottles were: `params [B, 4]`, `actions [B, 2]`, `starts [B, 2]`,
    `rows [B, T, 2]` m.
    """

    params: np.ndarray
    actions: np.ndarray
    starts: np.ndarray
    rows: np.ndarray


class Fit(NamedTuple):
    """Coefficients, and the errors (median, p90, max in m at the end) on the pushes fitted to and
    on the others.
    """

    coefficients: Any
    fitted: tuple[float, ...]
    held_out: tuple[float, ...]
    evaluations: int


def observe(backend: Backend, seed: int, samples: int) -> Reference:
    """`samples` random pushes over Omega in `backend`, less those that went wrong there."""
    batch = pushing.draw(seed, samples)
    out = backend.simulate(*batch)
    good = np.asarray(out.code) == pushing.FINE
    if good.sum() < 8:
        raise BadInput(
            f"calibration: {good.sum()} of {samples} pushes of {backend.name} are usable; give 8 "
            "or more"
        )
    params, actions, starts = (np.asarray(a)[good] for a in batch)
    return Reference(params, actions, starts, np.asarray(out.state)[good, :, :2])


def fit_planar(
    reference: Reference,
    options: PushOptions = PAPER,
    start: PlanarCoefficients = DEFAULT,
    rounds: int = 1500,
) -> Fit:
    """Coefficients of the planar model: map of e, lift, and size of the sole."""

    def pack(c):
        return np.array([*_unmap(c.elasticity), c.lift, c.sole])

    def unpack(t):
        return PlanarCoefficients(_map(t[:8]), float(t[8]), float(t[9]))

    rows = _planar_rows(options)
    spread = np.array([*SPREAD, 0.3, 0.2])
    return _fit(
        lambda t, r: rows(unpack(t), r),
        pack(start),
        spread,
        unpack,
        reference,
        options,
        rounds,
        silent,
    )


def fit_elasticity(
    reference: Reference,
    options: PushOptions = PAPER,
    start: ElasticityMap = pushing.ELASTICITY,
    rounds: int = 200,
    progress: Report = silent,
) -> Fit:
    """The map of e for the MuJoCo scene, by native MuJoCo."""

    def rows(theta: np.ndarray, r: Reference) -> np.ndarray:
        return (
            make_backend("native", options, elasticity=_map(theta)).simulate(*r[:3]).state[:, :, :2]
        )

    return _fit(rows, _unmap(start), np.array(SPREAD), _map, reference, options, rounds, progress)


def _map(theta: np.ndarray) -> ElasticityMap:
    frequency, damping, speed = (
        tuple(map(float, part)) for part in (theta[:3], theta[3:6], theta[6:8])
    )
    return ElasticityMap(frequency, damping, speed)


def _unmap(elasticity: ElasticityMap) -> np.ndarray:
    return np.array([*elasticity.frequency, *elasticity.damping, *elasticity.speed], float)


def _planar_rows(options: PushOptions) -> Callable[[PlanarCoefficients, Reference], np.ndarray]:
    """One compiled program for all coefficients."""
    import jax
    import jax.numpy as jnp

    from adaptsim_jax.tasks.pushing import planar as pushing_planar

    def one(c, p, a, s):
        return pushing_planar.rollout(p, a, options, c, s)

    run = jax.jit(jax.vmap(one, in_axes=(None, 0, 0, 0)))
    kind = jnp.result_type(float)

    def rows(coefficients: PlanarCoefficients, r: Reference) -> np.ndarray:
        traced = jax.tree.map(lambda x: jnp.asarray(x, kind), coefficients)
        return np.asarray(run(traced, *(jnp.asarray(a, kind) for a in r[:3])))

    return rows


def _fit(
    rows,
    theta,
    spread,
    unpack,
    reference: Reference,
    options: PushOptions,
    rounds: int,
    progress: Report,
) -> Fit:
    """Nelder and Mead from two starts, on every second push; the others judge."""
    half = [Reference(*(a[k::2] for a in reference)) for k in (0, 1)]
    early = max(0, min(len(reference.rows[0]), round(EARLY / options.row)) - 1)
    count = 0

    def loss(theta: np.ndarray) -> float:
        nonlocal count
        count += 1
        progress(min(count, 2 * rounds), 2 * rounds, "fit")
        found = rows(theta, half[0])
        return sum(np.minimum(_apart(found, half[0].rows, k), HELD_AT).mean() for k in (early, -1))

    best = None
    for sign in (1.0, -1.0):
        simplex = theta + np.concatenate([np.zeros((1, len(theta))), sign * np.diag(spread)])
        options_nm = {"maxfev": rounds, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-6}
        result = optimize.minimize(loss, theta, method="Nelder-Mead", options=options_nm)
        best = result if best is None or result.fun < best.fun else best
        theta = best.x

    def judge(r):
        return tuple(
            float(q) for q in np.percentile(_apart(rows(theta, r), r.rows, -1), [50, 90, 100])
        )

    return Fit(unpack(theta), judge(half[0]), judge(half[1]), count)


def _apart(a: np.ndarray, b: np.ndarray, row: int) -> np.ndarray:
    """Distances `[B]` m at a row."""
    return np.linalg.norm(a[:, row] - b[:, row], axis=-1)
