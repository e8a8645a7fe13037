"""Rival models: what a refit that settles leaves behind."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.sysid.estimate import fit
from adaptsim_jax.sysid.estimate.fit import Fit, seen_anew, settled
from adaptsim_jax.sysid.estimate.problem import Diverged

RESPONSE = SimpleNamespace(lin=None, kernels=None)


def settle(monkeypatch, totals, rounds=3):
    """`settled` of a model of likelihood 100 under a covariance of 9, whose refits reach `totals` in turn under one of 1."""
    made = iter(totals)

    def refit_more(problem, start, factor, *, iterations=2):
        total = start.total if iterations == 0 else next(made)
        if total is None:
            raise Diverged("runs away")
        return SimpleNamespace(total=total, variance=factor)

    judged = lambda problem, candidate, parts, response: SimpleNamespace(
        candidate=candidate, total=candidate.total, parts=1.0
    )
    monkeypatch.setattr(fit.variance, "whitener", lambda lin, parts, kernels: parts)
    monkeypatch.setattr(fit, "refit_more", refit_more)
    monkeypatch.setattr(fit, "_judged", judged)
    model = SimpleNamespace(candidate=SimpleNamespace(total=100.0, variance=9.0), total=100.0, parts=1.0)
    return settled(None, model, RESPONSE, rounds=rounds)


@pytest.mark.parametrize(
    ("totals", "expected"), [([200.0, 300.0, 300.5], 300.5), ([200.0, 150.0], 200.0), ([90.0], 100.0), ([None], 100.0)]
)
def test_the_likeliest_stays_with_the_errors_of_its_own_covariance(monkeypatch, totals, expected):
    """A stop that was fitted to the last digit kept the errors of a model that lacked it, and passed for none."""
    model = settle(monkeypatch, totals)
    assert model.total == expected
    assert model.candidate.variance == 1.0


def test_no_rounds_change_nothing(monkeypatch):
    assert settle(monkeypatch, [], rounds=0).candidate.variance == 9.0


@pytest.mark.parametrize("away", [False, True])
def test_a_model_seen_anew_takes_the_likelihood_alone(monkeypatch, away):
    """What is fitted under another response is compared with it; its own covariance stays what its fit found."""
    other = SimpleNamespace(likelihood=np.array([-7.0]), parts="other")

    def again(problem, model, factor, response, iterations):
        assert (factor, response, iterations) == ("here", RESPONSE, 0)
        return None if away else other

    monkeypatch.setattr(fit.variance, "whitener", lambda lin, parts, kernels: parts)
    monkeypatch.setattr(fit, "_again", again)
    model = Fit(None, "here", np.array([-5.0]), None)
    seen = seen_anew(None, model, RESPONSE)
    assert seen.total == (-5.0 if away else -7.0) and seen.parts == "here"
