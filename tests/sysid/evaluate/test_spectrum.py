"""A hum whose phase or frequency differs from trial to trial is a line of the unexplained force's spectrum; chance has none."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from adaptsim_jax.logs.segments import folds
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.variance import (
    CORRELATION_TIMES,
    Linearised,
    VarianceComponents,
    force_kernels,
    whiten,
    whitener,
)
from adaptsim_jax.sysid.evaluate.spectrum import line
from adaptsim_jax.sysid.score.scorer import Scorer

RATE, WINDOW = 100.0, 50  # Hz, rows
PARTS = VarianceComponents(
    np.ones(2), np.tile([0.0, 0.0, 1.0], (2, 1))
)  # a force that wanders slowly at each joint, and the sensors


def seen(trials: int, seconds: float, hum: float, seed: int, wander: float = 0.0, jolt: float = 0.0, ring: float = 0.0):
    """Two joints whose forces are seen as they are, row by row; `hum` at the second, 7.3 Hz, another phase in each trial, and a
    frequency that begins up to `wander` Hz higher and falls; `jolt`: a short swing at 7.3 Hz in the first trial alone; `ring` at
    the first: a resonance at 5 Hz, of 7 % damping, that something shakes."""
    rng = np.random.default_rng(seed)
    each, dt = int(seconds * RATE) // WINDOW, 1.0 / RATE
    trial = np.repeat(np.arange(trials), each)
    time = np.tile((np.arange(each * WINDOW) * dt).reshape(each, WINDOW), (trials, 1))
    keep = np.exp(-dt / CORRELATION_TIMES[2])
    force = np.zeros((len(trial), WINDOW, 2))
    force[:, 0] = rng.normal(size=(len(trial), 2))
    for k in range(1, WINDOW):
        force[:, k] = keep * force[:, k - 1] + np.sqrt(1 - keep**2) * rng.normal(size=(len(trial), 2))
    phase = rng.uniform(0, 2 * np.pi, trials)[trial][:, None]
    start = 7.3 + wander * rng.uniform(0, 1, trials)[trial][:, None]
    force[..., 1] += hum * np.cos(2 * np.pi * (start * time - 0.1 * wander * time**2) + phase)
    force[..., 1] += jolt * np.cos(2 * np.pi * 7.3 * time) * ((trial == 0)[:, None] & (time < 1.0))
    for k in range(trials if ring else 0):
        force[trial == k, :, 0] += ring * _rung(rng.normal(size=each * WINDOW)).reshape(each, WINDOW)
    rows = 2 * WINDOW
    impulse = np.zeros((len(trial), rows, 2, WINDOW))
    for j in range(2):
        impulse[:, j::2, j] = np.eye(WINDOW)
    lin = Linearised(
        residual=force.reshape(len(trial), rows) + rng.normal(size=(len(trial), rows)),
        jac_state=np.tile(np.eye(2), (WINDOW, 1))[None].repeat(len(trial), 0),
        jac_theta=rng.normal(size=(len(trial), rows, 1)),
        atoms=np.zeros((len(trial), rows, 0)),
        impulse=impulse,
        dt=np.full((len(trial), WINDOW), dt),
        channel=np.tile([0, 1], WINDOW),
        trial=trial,
        used=np.ones((len(trial), rows), bool),
    )
    kernels = force_kernels(lin)
    white = whiten(lin, whitener(lin, PARTS, kernels))
    path = SimpleNamespace(time=np.concatenate([time, time[:, -1:] + dt], 1), dt=lin.dt)
    return SimpleNamespace(
        lin=lin, path=path, response=SimpleNamespace(kernels=kernels), scorer=Scorer(white, folds(trial, white.rows))
    )


def _rung(shaking: np.ndarray) -> np.ndarray:
    """White noise through a resonance, of unit variance."""
    pole = np.exp(2 * np.pi * 5.0 / RATE * (-0.07 + 1j * np.sqrt(1 - 0.07**2)))
    out = lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], shaking)
    return out / out.std()


PROBLEM = SimpleNamespace(criteria=Criteria(), plant=SimpleNamespace(joints=("joint1", "joint2")))


@pytest.mark.parametrize(("trials", "seconds"), [(6, 6.0), (1, 30.0)])
def test_a_hum_is_found_at_its_joint(trials, seconds):
    found = line(PROBLEM, seen(trials, seconds, 0.7, 5), PARTS)
    assert found.joint == "joint2"
    assert found.frequency == pytest.approx(7.3, abs=0.12)
    assert found.share > 0.05


def test_a_hum_that_wanders_is_found_and_said_to():
    found = line(PROBLEM, seen(6, 6.0, 1.0, 5, wander=2.0), PARTS)
    assert found.joint == "joint2"
    assert (
        4.9 < found.frequency < 6.5 and 7.3 < found.highest < 9.3
    )  # from 7.3 to 9.3 Hz at first, 2.4 Hz lower at the end
    assert "wanders between" in found.words()


def test_what_rings_is_a_resonance_at_its_joint():
    found = line(PROBLEM, seen(6, 6.0, 0.0, 5, ring=1.5), PARTS)
    assert found.joint == "joint1" and found.broad
    assert found.frequency == pytest.approx(5.0, abs=0.5)
    assert found.words() == f"resonance at {found.frequency:.2g} Hz"


def test_a_jolt_in_one_trial_is_no_hum():
    assert line(PROBLEM, seen(6, 6.0, 0.0, 5, jolt=2.0), PARTS) is None


@pytest.mark.parametrize("seed", range(6, 12))
def test_a_force_that_wanders_has_no_line(seed):
    assert line(PROBLEM, seen(6, 6.0, 0.0, seed), PARTS) is None


def test_a_recording_too_short_to_compare_says_nothing():
    assert line(PROBLEM, seen(1, 6.0, 0.7, 5), PARTS) is None
