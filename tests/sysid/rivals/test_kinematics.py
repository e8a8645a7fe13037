"""What the declared model cannot know by itself: a first link that was measured wrong, and the scale of a free swing."""

from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.logs.noise.floor import noise_floor
from adaptsim_jax.logs.quality.audit import audit, usable
from adaptsim_jax.logs.recording import read_recording
from adaptsim_jax.sysid.estimate.problem import prepare_within_reach
from adaptsim_jax.sysid.nuisance.null_model import declared
from adaptsim_jax.sysid.rivals.kinematics import (
    FARTHEST,
    _faint,
    _foretold,
    _likeliest,
    _vertex,
    remeasured,
)
from tests.sysid.small_rig import GEOMETRY, TRUE, make_trials, written

EFFECTS = tuple(e for e in catalogue() if e.name in ("coulomb", "quadratic_drag"))


def prepared(folder):
    recording = read_recording(folder)
    checked = audit(recording)
    recording = usable(recording, checked)
    return prepare_within_reach(recording, checked, noise_floor(recording, checked), EFFECTS)


@pytest.mark.parametrize("top", [0.0, 0.004, -0.03, 0.11])
def test_parabolas_lead_to_the_likeliest_length(top):
    def total(offset):
        return -1e4 * (offset - top) ** 2 - 3e4 * abs(offset - top) ** 3

    assert _likeliest(total) == pytest.approx(top, abs=2e-3)
    assert abs(_likeliest(lambda offset: 50.0 * offset)) <= FARTHEST + 1e-9


def test_where_the_likeliest_length_is_far_off_and_none_beyond_is_likelier_no_more_are_tried():
    tried = []

    def total(offset):
        tried.append(offset)
        return {-0.01: 50.0, 0.0: 0.0, 0.01: 1000.0}.get(round(offset, 4), 900.0)

    assert _likeliest(total, lambda offset: True) == 0.01
    assert max(tried) == pytest.approx(0.03) and len(set(tried)) == 4
    tried.clear()
    _likeliest(total, lambda offset: False)
    assert len(set(tried)) > 4


@pytest.mark.parametrize("off", [0.003, -0.02, 0.08, -0.14])
def test_two_lengths_foretell_what_the_right_one_leaves(off):
    """Unexplained force grows with the distance from the right length; its variance is a parabola."""
    force = lambda offset: 0.01 + (100 * (offset - off)) ** 2
    left = _foretold([force(offset) for offset in (-0.01, 0.0, 0.01)])
    assert left == pytest.approx(np.sqrt(0.01 / force(0.0)), abs=1e-6)


@pytest.mark.parametrize("off", [0.0, 0.006, -0.013, 0.1])
def test_the_unexplained_force_leads_to_the_length_in_one_step(off):
    assert 0.01 * _vertex([3.0 * (offset - off) ** 2 for offset in (-0.01, 0.0, 0.01)]) == pytest.approx(off, abs=1e-9)
    assert 0.01 * _vertex([1.0 - offset**2 + offset * off for offset in (-0.01, 0.0, 0.01)]) == pytest.approx(
        -FARTHEST * np.sign(off), abs=1e-9
    )


def test_a_force_that_hardly_changes_with_the_length_is_none_of_its():
    assert _foretold([1.012, 1.0, 0.986]) > 0.85
    assert _foretold([1.0, 1.0, 1.0]) == 1.0


@pytest.mark.slow
def test_a_first_link_measured_wrong_is_said_to_be(tmp_path):
    folder = written(tmp_path, make_trials(seed=5, count=3, seconds=2.0, noise=0.1), l1=1.02 * GEOMETRY["l1"])
    problem, start = prepared(folder)
    base, first = declared(problem, start)
    found = remeasured(problem, base, EFFECTS, first)
    assert found.l1 == pytest.approx(GEOMETRY["l1"], rel=1e-3)
    assert found.left < 0.35 and found.model.total > base.total


@pytest.mark.slow
def test_a_hidden_force_is_not_taken_for_a_wrong_length(tmp_path):
    trials = make_trials(seed=6, count=3, seconds=2.0, noise=0.1, extra=lambda t, q, v, u: -0.05 * np.tanh(v / 0.01))
    problem, start = prepared(written(tmp_path, trials))
    base, first = declared(problem, start)
    assert _faint(problem, base, first)
    assert remeasured(problem, base, EFFECTS, first) is None
    again = remeasured(problem, base, EFFECTS)  # the fits say the same
    assert again is None or again.left > 0.35


def test_the_geometry_of_a_mended_model_is_left_alone(tmp_path):
    problem, _ = prepared(written(tmp_path, make_trials(seed=8, count=3, seconds=2.0, noise=0.1)))
    mended = replace(problem, recording=problem.recording.replace(model_file="model.toml"))
    assert remeasured(mended, None, EFFECTS) is None


def test_a_free_swing_fixes_parameters_up_to_a_factor(tmp_path):
    trials = make_trials(seed=7, count=3, seconds=2.0, noise=0.1, extra=lambda t, q, v, u: -u)
    for t in trials:
        t.torque = np.zeros_like(t.torque)
    problem, _ = prepared(written(tmp_path, trials))
    assert problem.theta0[0] == 1.0
    np.testing.assert_allclose(problem.theta0[:4], TRUE[:4] / TRUE[0], rtol=0.05)
    weight = GEOMETRY["g"] * TRUE[2] / TRUE[0]  # what the bounds of a force are counted in
    assert 0.05 * weight < problem.reach.torque[0] < 2 * weight
    assert np.all(problem.torque_scale > 0)
