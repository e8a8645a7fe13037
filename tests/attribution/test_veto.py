"""What one objective names and another may refute, what leaves most of the rows, and what
is fitted without a name: each rule on numbers made for it.
"""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from adaptsim_jax.attribution.candidates import JointCandidate
from adaptsim_jax.attribution.equation import confirmed
from adaptsim_jax.attribution.equation.balance_objective import BalanceEvidence, read_so
from adaptsim_jax.attribution.equation.confirmed import harmed, informative_joints
from adaptsim_jax.attribution.fitted import over_floor, times_floor
from adaptsim_jax.attribution.nested_models import SimulatedEvidence, least_worth
from adaptsim_jax.attribution.parameters import Entry, Vector
from adaptsim_jax.attribution.problem import passing
from adaptsim_jax.attribution.stretches import JointTrack
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Named
from adaptsim_jax.diagnosis.rules import refusal
from adaptsim_jax.diagnosis.testing import Test as Paired
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.effects.registry import effect_named

TRIALS, EACH = 6, 10  # stretches of each
DT = 0.01  # s


def problem() -> Any:
    """Three joints, noise of 1 mrad; the last stands still."""
    trial = np.repeat(np.arange(TRIALS), EACH)
    return SimpleNamespace(
        joints=3,
        fold=trial,
        floor=np.full(6, 1e-3),
        groups=(SimpleNamespace(stretches=SimpleNamespace(trial=trial)),),
        reach=SimpleNamespace(q_low=np.zeros(3), q_high=np.array([1.0, 1.0, 1e-3]), dt=DT),
        effect=lambda name: SimpleNamespace(shifts_time=True),
    )


def model(*errors: float) -> Any:
    """One that leaves these errors [rad] by joint, a little more or less from stretch to stretch."""  # noqa: E501
    wave = 1.0 + 0.1 * np.sin(np.arange(TRIALS * EACH))[:, None]
    return SimpleNamespace(
        held=SimpleNamespace(squared=np.square(np.hstack([errors, errors]) * wave))
    )


@pytest.fixture(autouse=True)
def a_line_that_leaves_ten_mrad(monkeypatch):
    both = 2 * (np.full((TRIALS * EACH, 3), 0.01),)
    monkeypatch.setattr(confirmed, "without_a_model", lambda problem: both)


def test_simulation_tells_something_near_its_noise_or_better_than_a_line():
    assert informative_joints(problem(), model(0.002, 0.008, 0.02), Criteria()) == [
        True,
        True,
        False,
    ]


def test_a_joint_that_is_simulated_worse_with_a_name_has_a_veto_where_it_tells_anything():
    null, less = model(0.005, 0.005, 0.05), model(0.004, 0.004, 0.04)

    def worse(*errors):
        return harmed(problem(), null, less, model(*errors), range(3), Criteria())

    assert worse(0.006, 0.004, 0.08) == [0]  # a ruler that tells nothing has no say
    assert worse(0.00406, 0.003, 0.04) == []  # right names leave up to 1.5 % more
    assert harmed(problem(), null, less, model(0.006, 0.004, 0.04), [1], Criteria()) == []


@pytest.mark.parametrize(("effect", "least"), [("coulomb", 0.1), ("angle_torque", 0.5)])
def test_a_form_must_do_more_than_a_law_whoever_judges(effect, least):
    assert least_worth(effect_named(effect, MACHINE), Criteria()) == least


def test_a_limit_leaves_half_of_the_rows_and_a_dead_zone_three_quarters():
    time = np.arange(2000) * DT
    torque = np.stack([3.0 * np.sin(time), 0.0 * time], 1)
    law = np.array([[1.0] * 2, [0.0] * 2, [0.0] * 2, [0.0] * 2, [-np.inf] * 2, [np.inf] * 2])
    most = passing([JointTrack("a", time, 0.0 * torque, None, torque)], law, np.ones(2))
    size = np.abs(torque[:, 0])
    limit, zone = 3.0 * (1.0 - most["saturation", "cut"][1][0]), most["dead_zone", "width"][1][0]
    assert np.mean(size > limit) == pytest.approx(0.5, abs=1e-3)
    assert np.mean(size < zone) == pytest.approx(0.25, abs=1e-3)
    assert list(most["torque_gain", "gain"][:, 0]) == [-0.5, 1.0]
    assert most["dead_zone", "width"][1][1] == 0.0  # of a joint that nothing drives


def shift(effect: str, name: str, joint: int = 0) -> JointCandidate:
    entry = Entry(effect, name, (joint,), 0.0, 0.0, -0.1, 0.1, "s")
    return JointCandidate(effect, (joint,), "common", (entry,))


def test_of_a_delay_and_a_lag_of_the_same_joints_the_sum_is_how_a_log_is_read():
    delay, lag = shift("delay", "delay"), shift("actuator_lag", "lag")
    state: Any = SimpleNamespace(
        commanded=False,
        follows=False,
        reach=problem().reach,
        limits=Criteria().torque,
        torque=np.ones(1),
        problem=SimpleNamespace(
            offers=lambda name: True, effect=lambda name: SimpleNamespace(shifts_commands=True)
        ),
    )

    def whole(*steps):
        entries = tuple(e for c in (delay, lag) for e in c.entries)
        columns = np.full((20, 1, 2), 0.1)
        return SimpleNamespace(entries=entries, step=np.array(steps), columns=columns)

    assert read_so(state, whole(-0.0185, 0.0117), delay)
    assert read_so(state, whole(-0.0185, 0.0117), lag)
    assert not read_so(state, whole(0.0117, 0.0117), lag)
    state.criteria, test = Criteria(), SimpleNamespace(p=0.0, gain=1.0, overall=0.0)
    state.carry, errors = lambda c: 1.0, {"error": np.full(2, 1e-6)}
    late = SimpleNamespace(**vars(whole(0.02, 0.02)), **errors)
    evidence = BalanceEvidence(state, late, delay, test, 0.02, 0.01, naming=True)
    assert "% of the joint's torque" in refusal(evidence).words


def test_a_long_delay_at_one_joint_does_not_shield_a_short_one_at_another():
    long, short = shift("delay", "delay", 0), shift("delay", "delay", 1)
    vector = Vector(long.entries + short.entries, np.array([0.03, 0.001]))
    found: Any = SimpleNamespace(fit=SimpleNamespace(vector=vector))

    def unresolved(c):
        test: Any = None
        return SimulatedEvidence(problem(), found, found, c, test, 9.0, Criteria()).unresolved_shift

    assert unresolved(short) == pytest.approx(0.1) and unresolved(long) is None


def test_what_is_left_is_left_at_the_worst_joint_that_moves():
    error = np.tile([1e-3, 8e-3, 0.05], (TRIALS * EACH, 1))
    assert times_floor(problem(), error) == pytest.approx([1.0, 8.0, 0.0])


def test_two_joints_far_off_are_not_hidden_by_four_that_stand_still():
    """Where the search by simulation goes on, and whose bodies are taken, hangs on it."""
    far = np.array([1e-3, 0.05, 1e-3, 1e-3, 0.05, 1e-3])
    six = problem()
    six.joints, six.floor = 6, np.full(12, 1e-3)
    six.reach = SimpleNamespace(q_low=np.zeros(6), q_high=np.where(far > 1e-3, 1.0, 1e-3))
    squared = np.tile(np.square(np.concatenate([far, far])), (TRIALS * EACH, 1))
    left: Any = SimpleNamespace(held=SimpleNamespace(squared=squared))
    assert over_floor(six, left) == pytest.approx(50.0)


@dataclass(frozen=True)
class Names:
    """What a balance found, as far as simulation is asked of it."""

    named: tuple[Named, ...]
    vetoes: tuple = ()
    final: Any = None
    added: tuple = ()


def test_each_name_that_simulation_does_not_bear_out_leaves_a_step(monkeypatch):
    paired = Paired(0.2, 1e-4, 6, 6, 24)
    names = tuple(Named(shift("delay", "delay", j), paired, 9.0) for j in range(3))

    def less(problem, found, gone, instead):
        return replace(found, named=tuple(n for n in found.named if n.candidate not in gone))

    fitted: Any = SimpleNamespace(fit=SimpleNamespace(starts=None))
    monkeypatch.setattr(confirmed, "without", less)
    monkeypatch.setattr(confirmed, "_gone", lambda found: found)
    monkeypatch.setattr(confirmed, "model_of", lambda *a: fitted)
    monkeypatch.setattr(confirmed, "over_floor", lambda *a: 99.0)
    monkeypatch.setattr(confirmed, "informative_joints", lambda *a: [True] * 3)
    monkeypatch.setattr(confirmed, "_shown", lambda found, c: list(c.joints))
    monkeypatch.setattr(confirmed, "harmed", lambda *a: [j for j in a[4] if j == 1])
    monkeypatch.setattr(confirmed.SimulatedNames, "test", lambda *a: paired)
    found: Any = Names(names)
    left: Any = confirmed.confirmed(problem(), found, fitted, Criteria(), fitted)
    assert [n.candidate.joints for n in left.named] == [(0,), (2,)]
    assert [(s.action, s.candidate.joints, s.reason.code) for s in left.vetoes] == [
        ("dropped", (1,), "harms_joints")
    ]
