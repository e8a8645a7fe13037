"""Rules of the search along the measured motion, each on numbers made for it, and on an arm that
meets a stop.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.attribution.candidates import JointCandidate
from adaptsim_jax.attribution.equation import balance_objective
from adaptsim_jax.attribution.equation.balance_objective import (
    BalanceEvidence,
    BalanceObjective,
    steadiness,
)
from adaptsim_jax.attribution.equation.searched import Searched, ranked
from adaptsim_jax.attribution.equation.solve import compared, rows_of
from adaptsim_jax.attribution.parameters import Entry
from adaptsim_jax.diagnosis.criteria import Criteria, TorqueCriteria
from adaptsim_jax.diagnosis.rules import refusal
from adaptsim_jax.diagnosis.testing import false_discovery
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.effects.registry import effect_named

LIMITS = TorqueCriteria()
BLOCKS = np.arange(20)
PROBLEM = SimpleNamespace(
    effect=lambda name: effect_named(name, MACHINE), offers=lambda name: True, parents=(-1,)
)


def one(effect, name="level", low=0.0, shape=()):
    entry = Entry(effect, name, (0,), 0.0, 0.0, low, 9.0, "N m", np.inf)
    return JointCandidate(effect, (0,), "joint", (entry,), shape)


def test_much_at_one_joint_outweighs_little_at_the_others():
    rows = SimpleNamespace(fold=BLOCKS // 5, block=BLOCKS)

    def loss(first, rest):
        return SimpleNamespace(loss=np.tile([first, *[rest] * 5], (20, 1)))

    assert compared(rows, loss(1.0, 1.0), loss(0.1, 1.2), [0]).overall > 0.0
    assert compared(rows, loss(1.0, 1.0), loss(0.1, 2.0), [0]).overall < 0.0


def test_joints_that_were_asked_count_in_the_false_discovery_rate():
    assert false_discovery([0.03], LIMITS.discovery, asked=1) == 0.03
    assert false_discovery([0.03], LIMITS.discovery, asked=6) == 0.0
    assert false_discovery([0.001, 0.014, 0.5], LIMITS.discovery, asked=6) == 0.014


def test_of_two_numbers_one_that_is_somewhat_large_is_not_steady():
    c = one("cogging", "sine")
    entries = (*c.entries, Entry("cogging", "cosine", (0,), 0.0, 0.0, -9.0, 9.0, "N m", np.inf))
    c = JointCandidate("cogging", (0,), "joint", entries)
    solved = SimpleNamespace(entries=entries, step=np.array([1.2, 0.6]), error=np.ones(2))
    assert (
        steadiness(solved, c)
        < LIMITS.steady
        < steadiness(SimpleNamespace(**{**vars(solved), "step": np.array([3.0, 0.0])}), c)
    )


def test_a_gain_that_is_little_of_the_torque_is_no_name():
    c = one("position_gain", "gain", low=-0.9)
    state = SimpleNamespace(
        problem=PROBLEM,
        commanded=False,
        limits=LIMITS,
        criteria=Criteria(),
        carry=lambda c: 1.0,
        torque=np.ones(1),
        balance=SimpleNamespace(joints=1),
    )
    solved = SimpleNamespace(
        entries=c.entries,
        step=np.array([0.0013]),
        error=np.array([1e-5]),
        columns=np.ones((20, 1, 1)),
    )
    test = SimpleNamespace(p=1e-4, gain=0.3, overall=0.1)
    evidence = BalanceEvidence(state, solved, c, test, 0.02, 0.01)
    assert refusal(evidence) is None
    assert BalanceObjective(state, ()).unnamed(evidence).code == "less_than_joint_torque"


@pytest.mark.parametrize(("friction_alone", "instead"), [(0.101, None), (0.3, "dead_zone")])
def test_one_effect_takes_the_place_of_two_only_where_neither_does_by_itself(
    friction_alone, instead, monkeypatch
):
    """Soft friction of a simulator is friction and a trifle of a rotor, not a dead zone of its
    servo.
    """
    losses = {
        (): 1.0,
        ("coulomb", "armature"): 0.1,
        ("coulomb",): friction_alone,
        ("armature",): 0.9,
        ("dead_zone",): 0.09,
    }
    state = SimpleNamespace(
        rows=SimpleNamespace(fold=BLOCKS // 5, block=BLOCKS),
        criteria=Criteria(),
        limits=LIMITS,
        set_of=lambda some: SimpleNamespace(
            loss=np.full((20, 1), losses[tuple(c.effect for c in some)])
        ),
        settled=lambda rest, c: c,
        own=lambda *some: [0],
        problem=PROBLEM,
    )
    monkeypatch.setattr(balance_objective, "ranked", lambda state, now, some: list(some))
    monkeypatch.setattr(balance_objective, "refusal", lambda evidence: None)
    monkeypatch.setattr(balance_objective, "at_bound", lambda *a: False)
    monkeypatch.setattr(balance_objective, "_known", lambda whole: {})
    judge = BalanceObjective(state, [one("dead_zone", "width")])
    found = judge.one_for_two(judge.model([one("coulomb"), one("armature", "inertia")]))
    assert (found and found[0].added[0].effect) == instead


def test_what_was_found_only_where_nothing_drives_is_held_against_one_joint(monkeypatch):
    state = SimpleNamespace(
        limits=LIMITS,
        local={0: 0},
        averaged=np.zeros((3, 1)),
        set_of=lambda some: None,
        likely=lambda c: True,
        own=lambda c: [0],
        rows=None,
        problem=PROBLEM,
    )
    test = SimpleNamespace(p=1e-3, gain=0.5)
    monkeypatch.setattr(balance_objective, "compared", lambda *a: test)
    monkeypatch.setattr(balance_objective, "worth_apart", lambda *a: [(0.5, None)])
    judge = BalanceObjective(state, ())
    rotor = SimpleNamespace(effect="armature", joints=(0,), entries=(0,), split=lambda: [rotor])
    model, _ = judge.members(judge.model([rotor]))
    (evidence,) = judge.evidence(model, model.added)
    assert evidence.level == max(LIMITS.level, false_discovery([test.p], LIMITS.discovery, 1))


def test_a_shift_has_its_column_at_its_own_value():
    def told(added):
        return SimpleNamespace(
            step=np.array([0.003 - 0.02 * dict(added[-1].shape)["lag"]])
        )  # of a grid's, too small

    lag = one("actuator_lag", "lag", shape=(("lag", 0.06),))
    state = SimpleNamespace(set_of=told, problem=PROBLEM)
    at = dict(Searched.settled(state, [], lag).shape)["lag"]
    assert at == pytest.approx(0.003, rel=0.05)
    spring = one("spring", "stiffness")
    assert Searched.settled(state, [], spring) is spring


def test_a_column_at_its_bound_does_not_hide_what_goes_the_other_way():
    rng = np.random.default_rng(0)
    x = rng.standard_normal((400, 1))
    time = np.arange(400) * 0.04
    missing = -x + 0.01 * rng.standard_normal(x.shape)
    rows = rows_of(missing, missing, np.zeros(400, int), time, np.full(1, 1e-3), np.ones_like(x))
    gain = one("torque_gain", "gain", low=-0.9)
    state = SimpleNamespace(
        rows=rows,
        began=lambda entries: np.array([e.start for e in entries]),
        table=SimpleNamespace(stack=lambda entries, shape: -0.5 * x[..., None]),
        own=lambda c: [0],
        carry=lambda c: 1.0,
        limits=LIMITS,
    )

    def at(level):
        return SimpleNamespace(
            entries=one("coulomb").entries, columns=x[..., None], step=np.array([level])
        )

    assert ranked(state, at(0.0), [gain]) == [gain]
    assert ranked(state, at(1e-6), [gain]) == []


@pytest.mark.parametrize("trials", [1, 3], ids=["thirds_of_one", "trials"])
@pytest.mark.parametrize(("orders", "holds"), [((7, 7, 7), True), ((7, 7, 9), False)])
def test_a_cogging_must_predict_parts_of_which_its_period_was_not_chosen(trials, orders, holds):
    """It fits its own third well; by pieces of all thirds it would hold out."""
    rng = np.random.default_rng(0)
    time, part = np.arange(600) * 0.04, np.repeat(np.arange(3), 200)
    angle = np.linspace(0.0, 12.0, 600)[:, None]
    true = np.choose(part[:, None], [np.sin(n * angle) for n in orders])
    missing = true * (part == 2)[:, None] if not holds else true
    missing = missing + 0.01 * rng.standard_normal(missing.shape)
    trial = part if trials == 3 else 0 * part
    rows = rows_of(missing, missing, trial, time, np.full(1, 1e-3), np.ones_like(missing))
    state = SimpleNamespace(
        rows=rows,
        began=lambda entries: np.array([e.start for e in entries]),
        table=SimpleNamespace(
            stack=lambda entries, shape: np.sin(shape["order"] * angle)[..., None]
        ),
        own=lambda c: [0],
        carry=lambda c: 1.0,
        limits=LIMITS,
    )
    some = [one("cogging", "sine", -9.0, (("order", n),)) for n in (5, 7, 9)]
    none = SimpleNamespace(entries=(), columns=np.zeros((600, 1, 0)), step=np.zeros(0))
    assert ranked(state, none, some) == (some[1:2] if holds else [])


@pytest.mark.parametrize(("span", "least"), [(7.0, 2), (1.3, 10), (0.3, None)])
def test_what_the_motion_has_not_seen_twice_is_no_cogging(span, least):
    reach = SimpleNamespace(q_low=np.array([-0.3]), q_high=np.array([span - 0.3]))
    points = effect_named("cogging", MACHINE).grid_points(reach, 0)
    assert [p["order"] for p in points][:1] == ([least] if least else [])


def test_a_name_that_left_out_trials_do_not_bear_out_is_refused():
    state = SimpleNamespace(
        problem=PROBLEM,
        commanded=False,
        limits=LIMITS,
        criteria=Criteria(),
        carry=lambda c: 1.0,
    )
    c = one("coulomb")
    solved = SimpleNamespace(entries=c.entries, step=np.ones(1), error=np.full(1, 0.1))
    test = SimpleNamespace(p=1e-4, gain=0.3, overall=0.1)
    for apart, code in ((0.1, None), (-0.1, "not_worth_apart")):
        reason = refusal(BalanceEvidence(state, solved, c, test, 0.02, 0.01, apart=apart))
        assert (reason and reason.code) == code
