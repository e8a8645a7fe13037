"""What may be said of what was found, and when a name is refused."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.decide import Evidence, Verdict, _not_confirmed, _stand_in, decide
from adaptsim_jax.sysid.evaluate.crossval import CrossValidation
from adaptsim_jax.sysid.evaluate.residual import ResidualDiagnosis
from adaptsim_jax.sysid.evaluate.spectrum import Line
from adaptsim_jax.sysid.rivals.kinematics import Remeasured
from adaptsim_jax.sysid.rivals.known_parameters import Freed

NAMED = Verdict("explained", "The residual is explained by coulomb at joint 2.", True)
FOUND = SimpleNamespace(added=(("coulomb", "joint2"),), tried=[], base=None)
FLOOR = 1e-4


def cross_validate(rmse, trials=4):
    squared = np.full((trials, 1), rmse**2)
    return CrossValidation(
        np.zeros((trials, 1, 1)), squared, np.ones((trials, 1)), np.arange(trials), np.arange(trials)
    )


def left(share, p_value):
    return ResidualDiagnosis(p_value, share, 10.0, (("joint2", "speed", share, p_value),))


def evidence(found, after, error_before=FLOOR, error_after=None, **more):
    return Evidence(
        found, **({"before": after, "after": after, "force": np.zeros(2), "floor": FLOOR, "powered": True} | more),
        error_before=cross_validate(error_before), error_after=error_after,
    )  # fmt: skip


def stand_in(after, error, before=100.0 * FLOOR):
    """The verdict on a name beside `after`, with this error left."""
    shown = evidence(FOUND, after, before, cross_validate(error))
    return _stand_in(shown, NAMED, Criteria()) or NAMED


@pytest.mark.parametrize(
    ("after", "share", "p_value", "named"),
    [
        (20.0 * FLOOR, 0.09, 1e-100, False),  # a stand-in: much is left, and it follows the motion
        (30.0 * FLOOR, 0.01, 1e-20, False),  # hardly predictable, but a third of the error is left and it is no chance
        (20.0 * FLOOR, 0.001, 0.05, True),  # a wandering torque leaves as much, and nothing follows anything
        (1.5 * FLOOR, 0.08, 1e-70, True),  # clear, and of no size: integration error of a right name
        (30.0 * FLOOR, 0.01, 1e-5, True),
        (30.0 * FLOOR, 0.015, 1e-9, False),
        (30.0 * FLOOR, 0.006, 1e-9, True),  # no sure sign beside a wandering torque
    ],
)
def test_a_name_is_refused_where_what_it_leaves_is_no_chance(after, share, p_value, named):
    verdict = stand_in(left(share, p_value), after)
    assert verdict.named is named
    assert verdict.name == ("explained" if named else "structured_unattributed")
    if not named:
        assert "coulomb at joint 2" in verdict.message
        assert "sits at joint 2 and follows its speed" in verdict.message


def test_an_effect_that_takes_nearly_all_of_the_error_away_keeps_its_name():
    verdict = stand_in(left(0.09, 1e-100), 100.0 * FLOOR, 1e4 * FLOOR)
    assert verdict is NAMED


def confirmed(found, error, after, trials=4):
    shown = evidence(found, after, error_after=cross_validate(error, trials))
    return _not_confirmed(replace(shown, error_before=cross_validate(1.0, trials)), NAMED, Criteria()) or NAMED


def test_left_out_trials_must_gain_by_a_name():
    clear = left(0.1, 1e-20)
    assert confirmed(FOUND, 0.5, clear) is NAMED
    assert confirmed(FOUND, 0.7, clear).name == "structured_unattributed"


def test_beside_a_wandering_torque_a_smaller_fall_will_do():
    def named(error=0.9, trials=6, what=None, gain=np.ones):
        found = SimpleNamespace(base=likely(np.zeros(trials)), final=likely(gain(trials)))
        return confirmed(found, error, what or left(0.0, 0.5), trials).named

    likely = lambda gain: SimpleNamespace(likelihood=gain)
    assert named()
    assert not named(error=0.99)
    assert not named(what=left(0.02, 1e-5)), "what is left follows something"
    assert not named(gain=lambda n: np.arange(n) - 0.5), "one trial is less likely"
    assert not named(trials=4), "four trials gain together by chance"


@pytest.mark.parametrize(("force", "powered", "expected"), [
    (0.5 * Criteria().large, True, "within_noise"),
    (0.5 * Criteria().large, False, "underpowered"),
    (1.1 * Criteria().large, True, "structured_unattributed"),
])  # fmt: skip
def test_a_force_as_large_as_the_torque_is_no_noise(force, powered, expected):
    nothing = SimpleNamespace(added=(), tried=[], base=None)
    quiet = left(0.0, 1.0)
    verdict = decide(evidence(nothing, quiet, powered=powered, force=np.array([0.0, force])), Criteria())
    assert verdict.name == expected
    assert not verdict.named


@pytest.mark.parametrize(("powered", "expected"), [(True, "within_noise"), (False, "underpowered")])
def test_where_far_more_than_the_sensors_do_is_left_it_is_said(powered, expected):
    nothing = SimpleNamespace(added=(), tried=[], base=None)
    quiet, force = left(0.0, 1.0), np.array([0.0, 0.01])
    said = lambda beyond: decide(evidence(nothing, quiet, beyond * FLOOR, powered=powered, force=force), Criteria())
    assert said(15.2).name == expected and "leaves 15 times the sensors' noise" in said(15.2).message
    assert "times" not in said(1.1).message


def test_a_line_in_the_spectrum_is_structure_and_is_said():
    nothing = SimpleNamespace(added=(), tried=[], base=None)
    hum = Line("joint1", 4.0, 0.2, 1e-50)
    found = ResidualDiagnosis(0.9, 0.0, 1.0, (("joint1", hum.words(), 0.2, 1e-50), ("joint2", "speed", 0.0, 0.9)), hum)
    verdict = decide(evidence(nothing, found), Criteria())
    assert verdict.name == "structured_unattributed"
    assert "joint 1, where the unexplained torque has a line at 4 Hz (20 % of the residual)" in verdict.message


def test_structure_that_is_no_chance_is_no_noise_and_noise_is_said_as_it_is():
    nothing = SimpleNamespace(added=(), tried=[], base=None)
    uneven = decide(evidence(nothing, left(0.0, 1e-50)), Criteria())
    assert uneven.name == "structured_unattributed"
    assert "0 %" not in uneven.message
    chance = decide(evidence(nothing, left(0.0, 1.0), 27.0 * FLOOR), Criteria())
    assert chance.name == "within_noise"
    assert "27 times the sensors' noise" in chance.message


@pytest.mark.parametrize(("share", "expected"), [(0.03, "within_noise"), (0.07, "structured_unattributed")])
def test_where_commands_answer_to_the_motion_a_little_that_follows_it_is_chance(share, expected):
    """A rig that a controller balances under a wandering torque: 1e-48 and 3 % of nothing."""
    nothing = SimpleNamespace(added=(), tried=[], base=None)
    said = lambda at: decide(evidence(nothing, at, 30.0 * FLOOR), Criteria())
    answered = said(replace(left(share, 1e-48), answered=True))
    assert answered.name == expected
    assert ("controller" in answered.message) is (expected == "within_noise")
    assert said(left(share, 1e-48)).name == "structured_unattributed"
    assert "controller" not in said(replace(left(0.0, 1.0), answered=True)).message
    assert "0 %" not in said(replace(left(0.001, 1e-20), answered=True)).message
    hum = Line("joint1", 4.0, 0.2, 1e-50)
    assert said(replace(left(share, 1e-48), answered=True, line=hum)).name == "structured_unattributed"


def test_pieces_abreast_keep_their_order_and_raise():
    assert parallel_map(lambda k: k * k, range(9)) == [k * k for k in range(9)]
    with np.errstate(over="ignore"):  # where a warning would be an error
        assert np.isinf(parallel_map(np.exp, np.array([1e3, 1e4]))).all()
    with pytest.raises(ZeroDivisionError):
        parallel_map(lambda k: 1 // k, [1, 0, 2])


@pytest.mark.parametrize(
    ("flexible", "beyond", "expected"),
    [(0.05, 30.0, "structured_unattributed"), (0.05, 1.1, "within_noise"), (0.6, 30.0, "within_noise")],
)
def test_forces_that_predict_left_out_trials_are_structure(flexible, beyond, expected):
    """A mass that leaks away: no linear score about the declared model shows it, smooth forces of time do."""
    nothing, quiet = SimpleNamespace(added=(), tried=[], base=None), left(0.0, 1.0)
    assert decide(evidence(nothing, quiet, beyond * FLOOR, flexible=flexible), Criteria()).name == expected


def test_the_rules_that_spoke_are_told():
    nothing, quiet = SimpleNamespace(added=(), tried=[], base=None), left(0.0, 1.0)
    assert decide(evidence(nothing, quiet), Criteria()).rules == ("nothing found",)
    shown = evidence(nothing, quiet, force=np.array([0.0, 0.5]), error_before=1.0, known={"m2": 1.2}, length=0.3)
    assert decide(shown, Criteria()).name == "structured_unattributed"
    shown = replace(shown, freed=Freed(cross_validate(0.5), {"m2": 1.0}))
    verdict = decide(shown, Criteria())
    assert (verdict.name, verdict.rules) == ("confounded_with_declared", ("nothing found", "known value"))
    assert "m2 is not 1.2 but 1" in verdict.message
    shown = replace(shown, freed=Freed(cross_validate(0.9), {"m2": 1.0}), remeasured=Remeasured(0.31, None, 0.1))
    verdict = decide(shown, Criteria())
    assert (verdict.name, verdict.rules) == ("confounded_with_declared", ("nothing found", "wrong length"))
    assert "l1 is not 0.3 but 0.31 m" in verdict.message
    far = replace(shown, remeasured=Remeasured(0.4, None, 0.1))
    assert decide(far, Criteria()).name == "structured_unattributed", "nobody measures that badly"
