"""When there is something to explain, and so candidates are worth refits."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.select import shortlist
from adaptsim_jax.sysid.select.shortlist import anything


@pytest.mark.parametrize(
    ("force", "candidate", "generic", "expected"),
    [
        (0.05, 0.5, 0.5, False),
        (0.05, 1e-5, 0.5, True),  # a candidate is no chance
        (0.05, 0.5, 1e-5, True),  # some smooth force is none
        (0.8, 0.5, 0.5, True),  # a stop that is hit in few windows: hardly sure, and four fifths of the torque
    ],
)
def test_what_is_worth_refits(monkeypatch, force, candidate, generic, expected):
    monkeypatch.setattr(shortlist, "generic_p_value", lambda view: generic)
    problem = SimpleNamespace(criteria=Criteria(), torque_scale=np.array([2.0, 2.0]))
    current = SimpleNamespace(parts=SimpleNamespace(force_std=lambda: np.array([0.0, 2.0 * force])))
    ranked = [SimpleNamespace(corrected=lambda count: candidate)]
    assert anything(problem, current, ranked, None) is expected
