"""A frequency between the points of a coarse grid is found over a trial that is much longer than a window."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.effects.grids import FINEST, frequencies
from adaptsim_jax.logs.types import Atom
from adaptsim_jax.sysid.estimate.variance import Whitened
from adaptsim_jax.sysid.nuisance.frequency import frequency_of
from adaptsim_jax.sysid.score.scorer import Scorer

RATE, WINDOW = 50.0, 50  # Hz, rows


def rows(trials: int, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Times `[W, M]` of windows of a second, and their trials `[W]`."""
    each = int(seconds * RATE) // WINDOW
    time = (np.arange(each * WINDOW) / RATE).reshape(each, WINDOW)
    return np.tile(time, (trials, 1)), np.repeat(np.arange(trials), each)


def scored(residual: np.ndarray, time: np.ndarray, trial: np.ndarray) -> tuple[Scorer, list[Atom], SimpleNamespace]:
    grid = [p["frequency"] for p in frequencies(SimpleNamespace(dt=1 / RATE, duration=time.max(), tone=0.0), 0)]
    columns = [f(2 * np.pi * tone * time) for tone in grid for f in (np.sin, np.cos)]
    atoms = [Atom("hum", "joint1", {"frequency": g}, (2 * i, 2 * i + 1)) for i, g in enumerate(grid)]
    white = Whitened(residual, np.ones((*time.shape, 1)), np.stack(columns, -1), trial, np.full(len(time), WINDOW))
    scorer = Scorer(white, trial)
    ends = np.concatenate([time, time[:, -1:] + 1 / RATE], 1)
    return scorer, atoms, SimpleNamespace(time=time.reshape(trial.max() + 1, -1), times=ends)


@pytest.mark.parametrize(("trials", "seconds"), [(1, 40.0), (3, 20.0)])
def test_a_tone_between_the_points_of_the_grid_is_found(trials, seconds):
    rng = np.random.default_rng(3)
    time, trial = rows(trials, seconds)
    frequency = 6.0 + 0.45 * FINEST
    phase = rng.uniform(0, 2 * np.pi, trials)[trial][:, None]
    residual = 0.5 * np.sin(2 * np.pi * frequency * time + phase) + rng.normal(size=time.shape)
    scorer, atoms, windows = scored(residual, time, trial)
    assert frequency_of(windows, scorer, atoms, 0.01) == pytest.approx(frequency, abs=0.2 / seconds)


def test_noise_has_no_tone_and_short_trials_are_left_to_the_grid():
    rng = np.random.default_rng(4)
    time, trial = rows(1, 40.0)
    scorer, atoms, windows = scored(rng.normal(size=time.shape), time, trial)
    assert frequency_of(windows, scorer, atoms, 0.01) is None
    time, trial = rows(6, 6.0)
    scorer, atoms, windows = scored(np.sin(2 * np.pi * 6.04 * time), time, trial)
    assert frequency_of(windows, scorer, atoms, 0.01) is None


def test_the_grid_reaches_high_frequencies_in_long_trials_and_gives_way_to_a_tone():
    reach = SimpleNamespace(dt=0.01, duration=43.0, tone=6.83)
    grid = [p["frequency"] for p in frequencies(reach, 0)]
    assert max(grid) > 13.0 and 6.83 in grid and len(grid) == 160
