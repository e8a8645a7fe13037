"""A trace of a search is added to, never changed: what was handed on stays what it was."""

from dataclasses import FrozenInstanceError
from types import SimpleNamespace

import pytest

from adaptsim_jax.sysid.select.trace import Trace

DRAG, BIAS, LAG = ("drag", "joint1"), ("bias", "joint2"), ("lag", "joint1")


def model(*active):
    return SimpleNamespace(active=active)


def begun():
    return Trace(model(), "first", ())


def test_a_step_gives_a_new_trace_and_leaves_the_old_one():
    begin, drag = begun(), model(DRAG)
    after = begin.then("tried", tried=(drag,)).then("accepted", final=drag, view="about it")
    assert (begin.final, begin.view, begin.tried, begin.steps) == (begin.base, "first", (), ())
    assert (after.final, after.view, after.tried) == (drag, "about it", (drag,)) and after.added == (DRAG,)
    assert [s.action for s in after.steps] == ["tried", "accepted"]
    with pytest.raises(FrozenInstanceError):
        after.steps = ()


def test_what_is_fitted_again_takes_the_place_of_its_earlier_fit():
    coarse, other, fine = model(DRAG), model(BIAS), model(DRAG)
    found = begun().then("tried", tried=(coarse, other)).then("in shorter steps", tried=(fine,), instead_of=(coarse,))
    assert found.tried[0] is other and found.tried[1] is fine and len(found.tried) == 2


def test_rivals_are_of_the_effects_that_stay():
    one, two = model(BIAS), model(LAG)
    found = begun().then("added", rivals={DRAG: (one, two)})
    assert found.rivals == {DRAG: (one, two)}
    assert found.then("swapped", settled=(DRAG,), rivals={BIAS: (two,)}).rivals == {BIAS: (two,)}
    assert found.then("left out", settled=(DRAG,)).rivals == {}


def test_classes_and_what_leads_are_the_last_that_were_told():
    found = begun().then("ended", classes={DRAG: (LAG,)}, leading=model(DRAG, BIAS))
    later = found.then("in another scale", classes={DRAG: (LAG, BIAS)})
    assert found.classes == {DRAG: (LAG,)} and later.classes == {DRAG: (LAG, BIAS)}
    assert later.leading is found.leading and begun().leading is None
