"""The one fit: how it goes on, how it ends, and what may be compared."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.sysid.estimate import fit as fitting
from adaptsim_jax.sysid.estimate.fit import fit, seen_anew
from adaptsim_jax.sysid.estimate.fitted import (
    Code,
    Fit,
    Incomparable,
    Start,
    force_ratio,
    gain,
    likeliest,
    plausible,
    rough_gain,
)
from adaptsim_jax.sysid.estimate.problem import DIVERGED, Diverged
from adaptsim_jax.sysid.estimate.variance import VarianceComponents

RESPONSE = SimpleNamespace(lin=None, kernels=None, number=7)
DRAG = ("drag", "joint1")
PARTS = VarianceComponents(np.ones(2), np.ones((2, 3)))


def candidate(total: float, variance: float = 1.0, active=()):
    refit = SimpleNamespace(point=SimpleNamespace(x0=np.zeros((4, 4)), z=np.zeros(0)), at_bound=np.zeros(0, bool))
    return SimpleNamespace(
        total=total,
        variance=variance,
        active=active,
        theta=np.ones(3),
        eff=np.zeros(2),
        names=(),
        phases=0,
        refit=refit,
    )


def model(total: float, *, response: int = 7, size: int = 3, active=()):
    fitted = candidate(total, 9.0, active)
    fitted.names = ("p",) * size
    return Fit(fitted, PARTS, np.array([total]), np.ones((2, 3)), response=response)


def fakes(monkeypatch, totals):
    """Refits that reach `totals` in turn under a covariance of 1, and what was called."""
    made, calls = iter(totals), []

    def refit_more(problem, start, factor, *, iterations=2):
        calls.append(("more", iterations))
        total = start.total if iterations == 0 else next(made)
        if total is None:
            raise Diverged("runs away")
        return candidate(total)

    def refit_from(problem, active, ended, factor, *, iterations):
        calls.append((ended, iterations))
        if ended.code == DIVERGED:
            raise Diverged("runs away")
        return candidate(next(made))

    judged = lambda problem, c, parts, response, code: Fit(
        c, PARTS, np.array([c.total]), np.ones((2, 3)), response=response.number, code=code
    )
    monkeypatch.setattr(fitting.variance, "whitener", lambda lin, parts, kernels: parts)
    monkeypatch.setattr(fitting, "refit_more", refit_more)
    monkeypatch.setattr(fitting, "refit_from", refit_from)
    monkeypatch.setattr(fitting, "_judged", judged)
    monkeypatch.setattr(fitting, "at_point", lambda *_: SimpleNamespace(code=0, how="as it is"))
    monkeypatch.setattr(fitting, "by_least_squares", lambda *_: SimpleNamespace(code=0, how="least squares"))
    return calls


PROBLEM = SimpleNamespace(windows=SimpleNamespace(start=np.zeros((4, 4))))
START = Start((DRAG,), np.ones(3), np.zeros(2), None, PARTS)


@pytest.mark.parametrize(
    ("totals", "expected", "code"),
    [
        ([200.0, 300.0, 300.5], 300.5, Code.SETTLED),
        ([200.0, 150.0], 200.0, Code.SETTLED),
        ([90.0], 100.0, Code.SETTLED),
        ([None], 100.0, Code.SETTLED),
        ([200.0, 300.0, 400.0], 400.0, Code.UNSETTLED),
    ],
)
def test_the_likeliest_stays_with_the_errors_of_its_own_covariance(monkeypatch, totals, expected, code):
    """A stop that was fitted to the last digit kept the errors of a model that lacked it, and passed for none."""
    fakes(monkeypatch, totals)
    went_on = fit(PROBLEM, model(100.0), RESPONSE, rounds=3)
    assert (went_on.total, went_on.code, went_on.candidate.variance) == (expected, code, 1.0)


@pytest.mark.parametrize(
    ("weighting", "rounds", "calls", "code"),
    [
        ("gls", 1, [("as it is", 10)], Code.UNSETTLED),
        ("gls", 2, [("as it is", 10), ("more", 2)], Code.SETTLED),
        ("gls", 0, [("as it is", 0)], Code.JUDGED),
        ("ols", 0, [("least squares", 0)], Code.JUDGED),
        ("ols", 1, [("least squares", 0), ("more", 2)], Code.SETTLED),
    ],
)
def test_start_weighting_and_rounds_say_what_is_done(monkeypatch, weighting, rounds, calls, code):
    made = fakes(monkeypatch, [50.0, 50.5])
    fitted = fit(PROBLEM, START, RESPONSE, weighting=weighting, rounds=rounds)
    assert [(getattr(how, "how", how), n) for how, n in made] == calls
    assert fitted.code is code and fitted.ok and fitted.response == RESPONSE.number


def test_a_least_squares_fit_that_was_made_is_not_made_again(monkeypatch):
    made = fakes(monkeypatch, [50.0])
    ended = SimpleNamespace(code=0, theta=np.ones(3), eff=np.zeros(2), x0=np.zeros((4, 4)))
    fit(PROBLEM, Start.after(ended, (DRAG,), PARTS), RESPONSE, weighting="ols", rounds=0)
    assert made == [(ended, 0)]


@pytest.mark.parametrize("rounds", [0, 2])
def test_what_runs_away_is_a_fit_that_nothing_prefers(monkeypatch, rounds):
    fakes(monkeypatch, [])
    ended = SimpleNamespace(code=DIVERGED, theta=np.ones(3), eff=np.zeros(2), x0=np.zeros((4, 4)))
    away = fit(PROBLEM, Start.after(ended, (DRAG,), PARTS), RESPONSE, weighting="ols", rounds=rounds)
    base = model(-500.0)
    assert away.code is Code.RAN_AWAY and not away.ok and "runs away" in away.code.value
    assert away.active == (DRAG,) and away.total == -np.inf and away.merit(4.0) == -np.inf
    assert not plausible(away, base) and force_ratio(away, base) == np.inf and away.at_bound() == ()
    assert likeliest([away, base]) is base
    assert fit(PROBLEM, away, RESPONSE, rounds=3) is away


@pytest.mark.parametrize("away", [False, True])
def test_a_model_seen_anew_takes_the_likelihood_alone(monkeypatch, away):
    """What is fitted under another response is compared with it; its own covariance stays what its fit found."""
    other = model(-7.0)

    def again(problem, model, factor, response, iterations):
        assert (factor, response, iterations) == ("here", RESPONSE, 0)
        return None if away else other

    monkeypatch.setattr(fitting.variance, "whitener", lambda lin, parts, kernels: "here")
    monkeypatch.setattr(fitting, "_again", again)
    old = model(-5.0, response=3)
    seen = seen_anew(PROBLEM, old, RESPONSE)
    assert seen.total == (-5.0 if away else -7.0) and seen.parts is old.parts and seen.candidate is old.candidate
    assert seen.response == RESPONSE.number and gain(seen, other) == seen.total - other.total


def test_fits_under_different_responses_are_not_compared():
    here, there = model(-10.0, response=1), model(-20.0, response=2)
    with pytest.raises(Incomparable, match="different responses"):
        gain(here, there)
    with pytest.raises(Incomparable):
        likeliest([here, there])
    assert rough_gain(here, there) == 10.0  # where that is meant, it is written
    beside = model(-14.0, response=1, size=1)
    assert gain(here, beside) == 4.0 and gain(here, beside, price=4.0) == -4.0
    assert likeliest([here, beside]) is here and likeliest([here, beside], price=4.0) is beside
    assert likeliest([]) is None
