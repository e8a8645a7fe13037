"""Where the plain fits of the final model start from."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fitted import Fit
from adaptsim_jax.sysid.select import refine


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
