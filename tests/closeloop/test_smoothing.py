"""Angles that a filter without lag has smoothed: found about the declared model, taken off, and nobody's effect."""

from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.closeloop.audit import audit, usable
from adaptsim_jax.closeloop.diagnose import declared_model, unfiltered_model
from adaptsim_jax.closeloop.noise import noise_floor
from adaptsim_jax.closeloop.recording import read_recording
from adaptsim_jax.closeloop.search import extend
from adaptsim_jax.closeloop.smoothing import smoothing_of, told, unsmoothed
from adaptsim_jax.closeloop.view import generic_p_value, view
from adaptsim_jax.models.effects import catalogue
from tests.generators import Spec, make_datasets, write_dataset
from tests.generators.suites import disguise


def recording(tmp_path, weights):
    """A null recording with precise encoders, its angles filtered by symmetric `weights`."""
    (dataset,) = make_datasets([Spec(41, "low_noise")])
    read = read_recording(write_dataset(dataset, tmp_path / "set"))
    half = len(weights) // 2
    smooth = lambda x: np.concatenate([x[:half], np.convolve(x, weights, "valid"), x[-half:]])
    filtered = tuple(replace(t, q=np.stack([smooth(q) for q in t.q.T], 1)) for t in read.trials)
    checked = audit(read)
    return usable(read, checked), usable(read.replace(trials=filtered), checked), checked


def test_a_symmetric_filter_is_found_and_taken_off(tmp_path):
    plain, filtered, checked = recording(tmp_path, np.ones(5) / 5)
    noise = noise_floor(filtered, checked)
    problem, _, first = unfiltered_model(filtered, checked, noise, catalogue("pendulum"))
    assert generic_p_value(first) > 0.01
    assert "filter without lag" in told(problem.recording)[0]
    sharp = unsmoothed(filtered, plain.trials[0].dt ** 2)  # half the variance of five equal weights
    for a, b, c in zip(plain.trials, filtered.trials, sharp.trials, strict=True):
        gap = [np.abs(x.q - a.q)[20:-20].std() for x in (b, c)]
        assert gap[1] < gap[0] or gap[1] < 2.0 * noise.std["q1"]


def test_a_recording_as_the_encoders_gave_it_is_left_alone(tmp_path):
    plain, _, checked = recording(tmp_path, np.ones(1))
    noise = noise_floor(plain, checked)
    found = declared_model(plain, checked, noise, catalogue("pendulum"))
    assert smoothing_of(*found) is None


def test_a_filter_that_an_effect_hides_shows_once_that_effect_is_in_the_model(tmp_path):
    (dataset,) = make_datasets([Spec(911, "low_noise", (("bias", 2, 3.72),))])
    read = read_recording(write_dataset(disguise(dataset, "filtered", 911), tmp_path / "set"))
    checked = audit(read)
    filtered = usable(read, checked)
    problem, base, first = declared_model(filtered, checked, noise_floor(filtered, checked), catalogue("pendulum"))
    assert smoothing_of(problem, base, first) is None
    bias = next(r for r in first.ranked() if r.instance == ("bias", "joint2"))
    mended = extend(problem, base, bias, first)
    s = smoothing_of(problem, mended, view(problem, mended))
    assert s == pytest.approx(filtered.trials[0].dt ** 2 / 8, rel=0.1)
