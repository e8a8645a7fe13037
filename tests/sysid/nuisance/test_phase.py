"""Phases of trials: found where each trial has its own, left alone where one phase serves all."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.logs.types import Atom
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.problem import clock_of
from adaptsim_jax.sysid.estimate.variance import Whitened
from adaptsim_jax.sysid.nuisance.phase import clocks
from adaptsim_jax.sysid.score.scorer import Scorer

TRIALS, WINDOWS, ROWS, SPEED = 4, 6, 40, 2.0 * np.pi * 1.5


def _scene(phase: np.ndarray, size: float, seed: int):
    """Residuals of a 1.5 Hz force in unit noise, and the sine and cosine columns of 1, 1.5 and 2 Hz."""
    rng = np.random.default_rng(seed)
    trial = np.repeat(np.arange(TRIALS), WINDOWS)
    time = np.tile(np.linspace(0.0, 6.0, WINDOWS * ROWS).reshape(WINDOWS, ROWS), (TRIALS, 1))
    residual = size * np.sin(SPEED * time + phase[trial][:, None]) + rng.normal(size=time.shape)
    columns = [f(2.0 * np.pi * hz * time) for hz in (1.0, 1.5, 2.0) for f in (np.sin, np.cos)]
    declared = rng.normal(size=(*time.shape, 2))
    white = Whitened(residual, declared, np.stack(columns, -1), trial, np.full(len(trial), ROWS))
    names = [
        Atom("periodic_disturbance", "joint1", {"frequency": f}, (2 * i, 2 * i + 1))
        for i, f in enumerate((1.0, 1.5, 2.0))
    ]
    windows = SimpleNamespace(clock=np.zeros(TRIALS), time=np.tile(np.linspace(0.0, 6.0, 50), (TRIALS, 1)))
    return windows, Scorer(white, trial), names


def test_each_trial_gets_the_clock_that_makes_the_force_coherent():
    phase = np.array([0.3, 2.0, -1.2, 3.0])
    windows, scorer, names = _scene(phase, 1.0, seed=0)
    clock = clocks(windows, scorer, names, criteria=Criteria())  # pyright: ignore[reportArgumentType]
    assert clock is not None
    gap = np.angle(np.exp(1j * (SPEED * clock - phase)))
    assert np.abs(gap).max() < 0.3
    assert np.abs(clock + 3.0).max() < 0.5 / 1.5 + 1e-9  # within half a period of the middle of the trial


@pytest.mark.parametrize(("phase", "size"), [(np.full(4, 0.7), 1.0), (np.array([0.3, 2.0, -1.2, 3.0]), 0.0)])
def test_one_phase_for_all_or_nothing_there_leaves_the_clocks_alone(phase, size):
    found = [clocks(*_scene(phase, size, seed), criteria=Criteria()) for seed in range(20)]  # pyright: ignore[reportArgumentType]
    assert found.count(None) == len(found)


def test_clocks_are_read_by_the_names_of_trials():
    recording = SimpleNamespace(trials=(SimpleNamespace(name="a"), SimpleNamespace(name="b")))
    windows = SimpleNamespace(clock=np.zeros(4))
    got = clock_of({"b": 0.25, "gone": 9.0}, recording, windows)  # pyright: ignore[reportArgumentType]
    np.testing.assert_array_equal(got, [0.0, 0.25, 0.0, 0.0])
