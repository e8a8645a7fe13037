"""A look back: with another effect in, an earlier one is left out, swapped for a rival or kept; and what left-out trials drop."""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fitted import Code, Fit
from adaptsim_jax.sysid.select import backward, swap
from adaptsim_jax.sysid.select.trace import Trace

DRAG, BIAS, LAG, SPRING = (("drag", "joint1"), ("bias", "joint2"), ("lag", "joint1"), ("spring", "joint1"))
PROBLEM = SimpleNamespace(criteria=Criteria())
SEEN = SimpleNamespace(response=None, ranked=lambda *_, **__: [])


def model(*active, total=0.0, ok=True):
    """A fit of a likelihood, whose start says which effects it is asked for."""
    refit = SimpleNamespace(point=SimpleNamespace(x0=None, z=np.zeros(0)), at_bound=np.zeros(0, bool))
    candidate = SimpleNamespace(active=active, theta=None, eff="eff", names=(), phases=0, refit=refit)
    code = Code.SETTLED if ok else Code.RAN_AWAY
    return Fit(candidate, SimpleNamespace(), np.array([total]), np.zeros(1), response=1, code=code)


def refits(monkeypatch, module, totals):
    """`fit` that reaches a total by the set it is asked for, and runs away where there is none."""

    def fit(problem, start, response, **how):
        total = totals.get(frozenset(start.active))
        return model(*start.active, total=-np.inf if total is None else total, ok=total is not None)

    monkeypatch.setattr(module, "fit", fit)


def looked_back(monkeypatch, totals, needed):
    """The search at a drag, with the lag tried in its place before, and a bias that came in."""
    refits(monkeypatch, swap, totals)
    monkeypatch.setattr(swap, "merged", lambda *_: "eff")
    monkeypatch.setattr(swap, "needed", lambda *_: needed)
    rivals = (model(LAG, total=40.0), model(SPRING, total=30.0))
    found = Trace(model(), "first", ()).then("added", rivals={DRAG: rivals}).then("accepted", final=model(DRAG))
    return found, rivals, swap.swap_back(PROBLEM, found, model(DRAG, BIAS, total=100.0), BIAS, SEEN, lambda _: None)


def test_an_effect_that_is_no_longer_needed_is_left_out(monkeypatch):
    before, _, (found, current) = looked_back(monkeypatch, {frozenset([BIAS]): 99.0}, needed=False)
    assert current.active == (BIAS,) and [t.active for t in found.tried] == [(BIAS,)]
    assert DRAG not in found.rivals and DRAG in before.rivals and not before.tried


def test_a_rival_that_does_better_beside_the_new_one_takes_its_place(monkeypatch):
    totals = {frozenset([BIAS]): 10.0, frozenset([LAG, BIAS]): 140.0, frozenset([SPRING, BIAS]): 90.0}
    _, rivals, (found, current) = looked_back(monkeypatch, totals, needed=True)
    assert current.active == (LAG, BIAS) and current.total == 140.0
    assert [t.active for t in found.tried] == [(BIAS,), (LAG, BIAS), (SPRING, BIAS)]
    assert DRAG not in found.rivals and found.rivals[LAG] == (rivals[1],)


@pytest.mark.parametrize(
    "totals", [{}, {frozenset([BIAS]): 10.0}, {frozenset([BIAS]): 10.0, frozenset([LAG, BIAS]): 100.5}]
)
def test_what_runs_away_or_does_hardly_better_changes_nothing(monkeypatch, totals):
    before, _, (found, current) = looked_back(monkeypatch, totals, needed=True)
    assert current.active == (DRAG, BIAS) and found.rivals == before.rivals
    assert len(found.tried) == len(totals)


@pytest.mark.parametrize("confirmed", [True, False])
def test_what_left_out_trials_do_not_confirm_is_dropped(monkeypatch, confirmed):
    final, less = model(DRAG, BIAS, total=100.0), model(DRAG, total=60.0)
    errors = {final.active: "with", less.active: "without"}
    monkeypatch.setattr(backward, "cross_validate", lambda problem, fit, view: errors[fit.active])
    monkeypatch.setattr(backward, "_nearly", lambda problem, found, whole, effect: less if effect == BIAS else None)
    monkeypatch.setattr(backward, "view", lambda problem, fit: SEEN)
    monkeypatch.setattr(backward, "confirms", lambda whole, other, criteria: confirmed)
    monkeypatch.setattr(backward, "class_of", lambda problem, effect, found: (SPRING,))
    begun = Trace(model(), SEEN, ()).then("ended", final=final, classes={DRAG: (LAG, BIAS, SPRING), BIAS: (LAG,)})
    found, tested = backward.backward_eliminated(PROBLEM, begun)
    assert (found.final, tested) == ((final, "with") if confirmed else (less, "without"))
    if not confirmed:
        assert found.tried == (less,) and found.classes == {DRAG: (SPRING, LAG)} and begun.final is final
