"""Whether left-out trials confirm an effect, and how far declared parameters reach over a class."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.evaluate.crossval import CrossValidation
from adaptsim_jax.sysid.report.union_intervals import reach_over_classes
from adaptsim_jax.sysid.select import backward
from adaptsim_jax.sysid.select.backward import confirms


def cross_validate(errors):
    """A held-out simulation of one window a trial with these errors."""
    squared = np.array(errors, float)[:, None] ** 2
    trial = np.arange(len(errors))
    return CrossValidation(np.zeros((len(errors), 1, 1)), squared, np.ones_like(squared), trial, trial)


@pytest.mark.parametrize(
    ("with_effect", "without", "expected"),
    [
        ([1.0, 1.0, 1.0, 1.0], [2.0, 2.0, 2.0, 2.0], True),
        ([1.0, 1.0, 1.0, 1.0], [1.01, 1.01, 1.01, 1.01], False),  # too little
        ([1.02, 1.02, 1.02, 0.2], [1.0, 1.0, 1.0, 1.0], False),  # one trial alone
        ([1.0, 1.0, 0.1, 0.1], [1.0, 1.0, 1.0, 1.0], True),
    ],
)
def test_left_out_trials_confirm_an_effect(with_effect, without, expected):
    assert confirms(cross_validate(with_effect), cross_validate(without), Criteria()) is expected


@pytest.mark.parametrize(
    ("fitted", "far"),
    [([2.2, 2.2, 2.2, 2.2], True), ([1.9, 1.9, 1.9, 1.9], False), ([9.0, 9.0, 1.0, 1.0], False)],
)
def test_trials_need_not_be_left_out_where_the_fit_to_all_of_them_is_twice_as_far_off(monkeypatch, fitted, far):
    error = np.array(fitted)[:, None, None]
    monkeypatch.setattr(backward, "initial_states", lambda *_: SimpleNamespace(residual=4.0 * error))
    problem = SimpleNamespace(windows=SimpleNamespace(weight=np.full_like(error, 4.0)))
    candidate = SimpleNamespace(active=(), theta=None, eff=None, refit=SimpleNamespace(point=SimpleNamespace(x0=None)))
    less, times = SimpleNamespace(candidate=candidate), Criteria().far
    assert backward._far(problem, cross_validate([1.0, 1.0, 1.0, 1.0]), less, times) is far


def test_an_effect_that_the_search_has_shown_to_be_needed_is_not_left_out_again(monkeypatch):
    """Its fits without the effect are at hand; only one that is not far off is made again."""
    made = []
    monkeypatch.setattr(backward, "initial_states", lambda *_: SimpleNamespace(residual=6.0 * np.ones((4, 1, 1))))
    monkeypatch.setattr(backward, "fit", lambda problem, start, *_: made.append(start) or searched)
    monkeypatch.setattr(backward, "lowest", lambda problem, less, *_: less)
    problem = SimpleNamespace(criteria=Criteria(), windows=SimpleNamespace(weight=np.ones((4, 1, 1))))
    candidate = SimpleNamespace(active=(), theta=None, eff=None, refit=SimpleNamespace(point=SimpleNamespace(x0=None)))
    searched = SimpleNamespace(active=(("drag", "joint1"),), candidate=candidate, total=0.0, ok=True)
    final = SimpleNamespace(active=(("drag", "joint1"), ("lag", "joint2")), start=lambda active: active)
    found = SimpleNamespace(final=final, view=SimpleNamespace(response=None), base=None, tried=[searched])
    nearly = lambda errors: backward._nearly(problem, found, cross_validate(errors), ("lag", "joint2"))
    assert nearly([1.0] * 4) is None and made == []
    assert nearly([2.0] * 4) is None and len(made) == 1
    assert nearly([5.0] * 4) is searched


def model(active, z, error):
    refit = SimpleNamespace(point=SimpleNamespace(z=np.array([z])), covariance=np.array([[error**2]]))
    return SimpleNamespace(active=active, total=0.0, candidate=SimpleNamespace(names=("m1",), refit=refit))


def test_an_interval_reaches_over_the_class():
    here, there = ("torque_gain", "joint1"), ("torque_gain", "joint2")
    rival, stranger = model((there,), 1.3, 0.01), model((("bias", "joint1"),), 9.0, 0.01)
    found = SimpleNamespace(classes={here: [there]}, final=model((here,), 1.0, 0.01), tried=[rival, stranger])
    declared = {"m1": {"value": 1.0, "low": 0.98, "high": 1.02}}
    reach_over_classes(declared, SimpleNamespace(plant=SimpleNamespace(theta_names=("m1",))), found)
    assert declared["m1"]["value"] == 1.0
    assert declared["m1"]["low"] == 0.98
    assert declared["m1"]["high"] == pytest.approx(1.3 + 1.6449 * 0.01)
