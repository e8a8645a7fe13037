"""Where the plain fits of the final model start from."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fitted import Fit
from adaptsim_jax.sysid.select import refine
from adaptsim_jax.sysid.select.trace import Trace


def model(total: float, x0):
    candidate = SimpleNamespace(
        active=(), theta=None, eff=np.zeros(1), refit=SimpleNamespace(point=SimpleNamespace(x0=x0))
    )
    return Fit(candidate, None, np.array([total]), None)


@pytest.mark.parametrize("best", ["data", "found"])
def test_fits_start_from_the_states_in_the_data_and_from_those_found(monkeypatch, best):
    """Either may be the one from which the bottom is reached; no more rounds than gain anything."""
    calls = []

    def fit(problem, start, response, *, weighting="gls", rounds):
        if weighting == "gls":
            return start
        calls.append(start.x0)
        return model(100.0 if (start.x0 is None) == (best == "data") else 1.0, "found")

    monkeypatch.setattr(refine, "fit", fit)
    monkeypatch.setattr(refine, "plausible", lambda model, base: True)
    problem = SimpleNamespace(criteria=Criteria(), model=SimpleNamespace(layout=None), base=())
    assert refine.lowest(problem, model(0.0, "found"), None, SimpleNamespace(response=None)).total == 100.0
    assert calls.count(None) == calls.count("found") == 2


@pytest.mark.parametrize(
    ("effects", "force", "gains", "refined"),
    [
        ((("spring", "joint1"),), 0.5, True, True),
        ((("spring", "joint1"),), 0.5, False, False),  # it was at the bottom
        ((("spring", "joint1"),), 1e-4, True, False),  # no force is left to explain
        ((), 0.5, True, False),  # nothing was found
    ],
)
def test_the_final_model_is_refined_where_something_is_left_to_gain(monkeypatch, effects, force, gains, refined):
    def fit(active, total):
        parts = SimpleNamespace(force_std=lambda: np.array([force, 0.0]))
        return Fit(SimpleNamespace(active=active), parts, np.array([total]), None)

    base, final, better = fit((), 0.0), fit(effects, 10.0), fit(effects, 20.0)
    found = Trace(base, "first", ()).then("found", final=final, view="seen")

    def lowest(problem, model, declared, seen):
        assert model is final and declared is base and seen == "seen"
        return better if gains else model

    monkeypatch.setattr(refine, "lowest", lowest)
    monkeypatch.setattr(refine, "view", lambda problem, model: f"about {model.total:g}")
    said = refine.refined(SimpleNamespace(criteria=Criteria(), torque_scale=np.array([1.0, 1.0])), found)
    assert (said is not found) == refined
    if refined:
        assert said.final is better and said.view == "about 20" and said.steps[-1].action == "refined"
