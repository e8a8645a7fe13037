"""Angles that a filter without lag has smoothed: found about the declared model, taken off, and nobody's effect."""

from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.logs.noise.floor import noise_floor
from adaptsim_jax.logs.quality.audit import audit, usable
from adaptsim_jax.logs.recording import read_recording
from adaptsim_jax.sysid.nuisance.null_model import fit_declared
from adaptsim_jax.sysid.nuisance.prefilter import fit_unfiltered, revised, smoothing_of, unsmoothed
from adaptsim_jax.sysid.pipeline import diagnose
from adaptsim_jax.sysid.score.table import generic_p_value, view
from adaptsim_jax.sysid.select.extend import extend
from tests.generators import Spec, make_datasets, write_dataset
from tests.generators.suites import disguise

FEW = tuple(e for e in catalogue("pendulum") if e.name in ("bias", "spring", "coulomb"))


def recording(tmp_path, weights):
    """A null recording with precise encoders, its angles filtered by symmetric `weights`."""
    (dataset,) = make_datasets([Spec(41, "low_noise")])
    read = read_recording(write_dataset(dataset, tmp_path / "set"))
    half = len(weights) // 2
    smooth = lambda x: np.concatenate([x[:half], np.convolve(x, weights, "valid"), x[len(x) - half :]])
    filtered = tuple(replace(t, q=np.stack([smooth(q) for q in t.q.T], 1)) for t in read.trials)
    checked = audit(read)
    return usable(read, checked), usable(read.replace(trials=filtered), checked), checked


def test_a_symmetric_filter_is_found_and_taken_off(tmp_path):
    plain, filtered, checked = recording(tmp_path, np.ones(5) / 5)
    noise = noise_floor(filtered, checked)
    as_it_is = fit_declared(filtered, checked, noise, catalogue("pendulum"))[2]
    assert generic_p_value(as_it_is) < 1e-6  # what it would pass for
    problem, _, first = fit_unfiltered(filtered, checked, noise, catalogue("pendulum"))
    assert generic_p_value(first) > 0.01
    s = plain.trials[0].dt ** 2  # half the variance of five equal weights
    assert problem.recording.smoothing == pytest.approx(s, rel=0.1)
    sharp = unsmoothed(filtered, s)
    for a, b, c in zip(plain.trials, filtered.trials, sharp.trials, strict=True):
        bend = a.q[20:] - 2.0 * a.q[10:-10] + a.q[:-20]  # over ten rows: sensors hardly show
        share = [np.sum((x.q - a.q)[10:-10] * bend) / np.sum(bend**2) * 100.0 for x in (b, c)]
        assert abs(share[1]) < 0.2 * share[0]


def test_a_recording_as_the_encoders_gave_it_is_left_alone(tmp_path):
    plain, _, checked = recording(tmp_path, np.ones(1))
    noise = noise_floor(plain, checked)
    found = fit_declared(plain, checked, noise, catalogue("pendulum"))
    assert smoothing_of(*found) is None


def test_a_filter_that_an_effect_hides_shows_once_that_effect_is_in_the_model(tmp_path):
    (dataset,) = make_datasets([Spec(911, "low_noise", (("bias", 2, 3.72),))])
    read = read_recording(write_dataset(disguise(dataset, "filtered", 911), tmp_path / "set"))
    checked = audit(read)
    filtered = usable(read, checked)
    problem, base, first = fit_declared(filtered, checked, noise_floor(filtered, checked), catalogue("pendulum"))
    assert smoothing_of(problem, base, first) is None and problem.recording.smoothing == 0.0
    bias = next(r for r in first.ranked() if r.instance == ("bias", "joint2"))
    mended = extend(problem, base, bias, first)
    s = smoothing_of(problem, mended, view(problem, mended))
    assert s == pytest.approx(filtered.trials[0].dt ** 2 / 8, rel=0.1)


@pytest.mark.parametrize("was_filtered", [True, False])
def test_a_filter_that_was_none_is_put_back_once_the_effect_is_in_the_model(tmp_path, was_filtered):
    (dataset,) = make_datasets([Spec(911, "low_noise", (("bias", 2, 3.72),))])
    if was_filtered:
        dataset = disguise(dataset, "filtered", 911)
    read = read_recording(write_dataset(dataset, tmp_path / "set"))
    checked = audit(read)
    sharp = unsmoothed(usable(read, checked), read.trials[0].dt ** 2 / 8)
    problem, base, first = fit_declared(sharp, checked, noise_floor(sharp, checked), catalogue("pendulum"))
    bias = next(r for r in first.ranked() if r.instance == ("bias", "joint2"))
    mended = extend(problem, base, bias, first)
    assert revised(problem, mended, view(problem, mended)) == (None if was_filtered else 0.0)


def test_the_effect_that_hid_a_filter_is_named_and_its_look_alike_is_not(tmp_path):
    """Bias or a spring that soaks up a little of the curvature: with the filter taken off, the bias alone."""
    (dataset,) = make_datasets([Spec(911, "low_noise", (("bias", 2, 3.72),))])
    folder = write_dataset(disguise(dataset, "filtered", 911), tmp_path / "set")
    report = diagnose(folder, effects=FEW, follow_up=False)
    assert [(e["name"], e["where"]) for e in report["effects"]] == [("bias", "joint2")]
    assert report["error"]["after"] < 1.2 * report["error"]["noise_floor"]
