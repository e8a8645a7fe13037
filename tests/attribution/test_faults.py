"""What an objective cannot judge goes to the other one; a fault of the program goes to nobody."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from adaptsim_jax.attribution import examine
from adaptsim_jax.attribution.account import write_so_far
from adaptsim_jax.attribution.inquiry import Inquiry
from adaptsim_jax.attribution.parameters import INERTIA, Entry, Vector
from adaptsim_jax.attribution.torque_report import bound_notes
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.steps import NotFinite
from adaptsim_jax.diagnosis.written import FAULTS


@pytest.fixture
def balance_that(monkeypatch):
    """A balance that raises an error, and stretches that say why they judge."""

    def raises(error: Exception) -> Any:
        def search(*_):
            raise error

        monkeypatch.setattr(examine, "balances", lambda *_: (object(),))
        monkeypatch.setattr(examine, "_with_friction_law", search)
        monkeypatch.setattr(examine, "_by_stretches", lambda q, why: why)
        machine: Any = SimpleNamespace(log=SimpleNamespace(input_kind="torque"), tracks=())
        nothing: Any = SimpleNamespace()
        return examine.examine(Inquiry(machine, nothing, nothing, Criteria(), 0.5))

    return raises


def test_a_balance_that_is_not_finite_leaves_the_judging_to_stretches(balance_that):
    why = balance_that(NotFinite("a step's equations have numbers that are not finite"))
    assert why.startswith("the torque along the motion tells nothing (a step's equations")


@pytest.mark.parametrize("error", [ValueError("zip() argument 2"), np.linalg.LinAlgError("no")])
def test_a_fault_of_the_program_is_not_what_the_torque_tells(balance_that, error):
    with pytest.raises(type(error)):
        balance_that(error)


def test_a_partial_report_that_cannot_be_made_does_not_end_the_search(tmp_path):
    broken: Any = SimpleNamespace()
    write_so_far(tmp_path, broken, broken)
    assert "AttributeError" in (tmp_path / FAULTS).read_text()


@pytest.mark.parametrize(("factor", "words"), [(3.0, "3 times (or 1/3 of)"), (8.0, "8 times")])
def test_where_bodies_end_is_said_by_the_factor_that_was_asked_for(factor, words):
    wide = 0.5 * np.log(factor)
    entry = Entry(INERTIA, "mass", (0,), 0.0, 0.0, -wide, wide, "1")
    search = SimpleNamespace(final=Vector((entry,), np.array([wide])))
    problem: Any = SimpleNamespace(joint_names=("hip",))
    found: Any = SimpleNamespace(searches=(search,))
    (note,) = bound_notes(problem, found, factor)
    assert words in note
