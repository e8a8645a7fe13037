"""Angles that a filter without lag has smoothed: found about the declared model, taken off, and nobody's effect."""

from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.closeloop.audit import audit, usable
from adaptsim_jax.closeloop.diagnose import declared_model, diagnose, unfiltered_model
from adaptsim_jax.closeloop.noise import noise_floor
from adaptsim_jax.closeloop.recording import read_recording
from adaptsim_jax.closeloop.smoothing import smoothing_of, unsmoothed
from adaptsim_jax.closeloop.view import generic_p_value
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
    weights = np.ones(5) / 5
    plain, filtered, checked = recording(tmp_path, weights)
    noise = noise_floor(filtered, checked)
    problem, base, first = declared_model(filtered, checked, noise, catalogue("pendulum"))
    offset = (np.arange(len(weights)) - len(weights) // 2) * plain.trials[0].dt
    s = smoothing_of(problem, base, first)
    assert s == pytest.approx(0.5 * np.sum(weights * offset**2), rel=0.25)  # a first look; a second follows
    assert generic_p_value(first) < 1e-6  # what it would pass for
    problem, base, first = unfiltered_model(filtered, checked, noise, catalogue("pendulum"))
    assert generic_p_value(first) > 0.01
    assert "filter without lag" in problem.recording.notes[-1]
    sharp = unsmoothed(filtered, s)
    for a, b, c in zip(plain.trials, filtered.trials, sharp.trials, strict=True):
        gap = [np.abs(x.q - a.q)[20:-20].std() for x in (b, c)]
        assert gap[1] < gap[0] or gap[1] < 2.0 * noise.std["q1"]


def test_a_recording_as_the_encoders_gave_it_is_left_alone(tmp_path):
    plain, _, checked = recording(tmp_path, np.ones(1))
    noise = noise_floor(plain, checked)
    found = declared_model(plain, checked, noise, catalogue("pendulum"))
    assert smoothing_of(*found) is None


def test_a_filter_that_shows_once_an_effect_is_named_leaves_the_name_right(tmp_path):
    """A bias under a filter: a weak spring beside it would soak up some of the curvature."""
    spec = Spec(911, "low_noise", (("bias", 2, 3.72),))
    (dataset,) = make_datasets([spec])
    report = diagnose(write_dataset(disguise(dataset, "filtered", 911), tmp_path / "set"), follow_up=False)
    assert [(e["name"], e["where"]) for e in report["effects"]] == [("bias", "joint2")]
    assert report["error"]["after"] < 1.2 * report["error"]["noise_floor"]
