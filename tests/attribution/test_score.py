"""The score test of a tree counts all that was tried: the points of a candidate's grid."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from adaptsim_jax.attribution.candidates import candidates
from adaptsim_jax.attribution.estimate import linear
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.parameters import TreeFit
from adaptsim_jax.attribution.paths import losses, run, starts_of, weigh
from adaptsim_jax.attribution.problem import nuisances, own_inertia, prepare, scaled_reach
from adaptsim_jax.attribution.score import table
from adaptsim_jax.diagnosis.testing import best_along, best_of, score_p
from adaptsim_jax.effects.base import Effect, Quantity
from adaptsim_jax.effects.joints.friction import VISCOUS
from tests.attribution.pendulum import record

POINTS = 160
WAVE = Effect(
    "wave",
    "force",
    (
        Quantity("size", "N m", -1.0, 1.0, 0.0),
        Quantity("order", "1/rad", 0.0, 1000.0, 1.0, shape=True, held=True),
    ),
    lambda p, m: p["size"] * jnp.sin(p["order"] * m.q),
    "a torque that ripples over the angle",
    "slow motion",
    grid=[{"order": float(2 * k + 1)} for k in range(POINTS)],
)


def test_the_best_of_many_points_is_as_if_they_were_independent():
    p = np.random.default_rng(0).uniform(size=(4000, POINTS)).min(1)
    assert stats.kstest([best_of(z, POINTS) for z in p], "uniform").pvalue > 0.01
    assert best_of(1e-12, POINTS) == pytest.approx(POINTS * 1e-12)
    assert best_of(1.0, POINTS) == 1.0


@pytest.mark.parametrize("width", [1.0, 8.0, 60.0])
def test_the_best_of_a_fine_grid_is_neither_too_small_nor_the_worst_case(width):
    """Scores of 30 clusters at 40 points, alike over so many of them."""
    rng, at, found = np.random.default_rng(3), np.arange(40), []
    root = np.linalg.cholesky(
        np.exp(-0.5 * np.square((at[:, None] - at) / width)) + 1e-6 * np.eye(40)
    )
    for _ in range(400):
        scores = rng.normal(size=(30, 40)) @ root.T
        p = min(score_p(scores[:, [k]]) for k in at)
        found.append((best_along(p, scores), best_of(p, 40)))
    along, apart = np.array(found).T
    assert np.mean(along < 0.05) < 0.09
    assert width == 1.0 or np.median(along) < 0.9 * np.median(apart)


def test_the_best_of_many_frequencies_of_noise_has_no_small_p(tmp_path):
    machine = load(record(tmp_path / "log", friction=0.0, trials=8, seconds=2.0, rate=100))
    problem = prepare(machine.tree, machine.tracks, (VISCOUS, WAVE), declared=machine.declared)
    vector, starts = nuisances(problem, inertia=False), starts_of(problem)
    paths = run(problem, vector, starts)
    weights = weigh(problem, paths)
    fit = TreeFit(vector, starts, weights, losses(problem, paths, weights), "", 0)
    lin = linear(problem, fit)
    reach = scaled_reach(problem, *own_inertia(problem, vector))
    every = [c for c in candidates(problem, vector, reach) if c.effect == "wave"]
    assert len(every) == POINTS
    seen, rng, found = lin.residual[0] != 0.0, np.random.default_rng(0), []
    for _ in range(24):
        noise = (rng.normal(size=seen.shape) * seen,)
        (best,) = table(problem, replace(lin, residual=noise), every)
        found.append(best)
    assert {s.points for s in found} == {POINTS}
    assert np.mean([s.p < 0.1 for s in found]) < 0.34
    assert np.mean([s.p < 0.5 for s in found]) < 0.8
