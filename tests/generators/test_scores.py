"""The judge of the suites: names, classes, look-alikes, confounding, intervals."""

import pytest

from experiments.closeloop_scores import (
    classes,
    declared_errors,
    localised,
    parse,
    row,
    score_case,
    summarise,
    table,
    wilson,
)
from tests.generators import Spec
from tests.generators.suites import Case


def judged(
    hidden, effects, verdict="explained", suite="single", confounded=False, name="single_1", **more
):
    truth = {
        "effects": [
            {"name": n, "where": w, "confounded": confounded, "multiple_reached": 3.0}
            for n, w in hidden
        ]
    }
    return score_case(
        suite, Case(name, Spec(1), **more), truth, {"verdict": verdict, "effects": effects}
    )


def test_names_are_read_in_any_spelling():
    assert parse("bias", "joint2") == ("bias", "joint2")
    assert (
        parse("bias@joint1", "joint2") == parse("bias at joint 1", "joint2") == ("bias", "joint1")
    )
    assert parse("tilt", "joint1") == ("tilt", "base")
    assert parse({"name": "dahl", "where": "joint 2"}, "") == ("presliding", "joint2")


def test_right_wrong_joint_and_class():
    named = {"name": "coulomb", "where": "joint1", "alternatives": []}
    assert judged([("coulomb", "joint1")], [named])["hits"] == [True]
    other_joint = judged([("coulomb", "joint2")], [named])
    assert other_joint["hits"] == [False] and other_joint["wrong"] == 1
    in_class = judged([("stribeck", "joint1")], [named | {"alternatives": ["stribeck"]}])
    assert in_class["hits"] == [True] and in_class["wrong"] == 0
    assert judged([("coulomb", "joint1")], [], "within_noise")["hits"] == [False]


def test_one_name_is_not_two_effects():
    tilt = {"name": "tilt", "where": "base", "alternatives": ["periodic_disturbance@joint1"]}
    hum = {"name": "periodic_disturbance", "where": "joint1"}
    hidden = [("periodic_disturbance", "joint1"), ("tilt", "base")]
    assert sum(judged(hidden, [tilt], suite="two")["hits"]) == 1
    assert judged(hidden, [tilt, hum], suite="two")["hits"] == [True, True]
    assert judged(hidden, [hum | {"alternatives": ["tilt@base"]}, tilt], suite="two")["hits"] == [
        True,
        True,
    ]
    assert judged(hidden, [], "structured_unattributed", suite="two")["hits"] == [False, False]


def test_what_physics_makes_the_same_counts_and_nothing_else():
    offset = {"name": "encoder_offset", "where": "joint1"}
    assert judged([("tilt", "base")], [offset])["hits"] == [True]
    assert judged([("tilt", "base")], [offset | {"where": "joint2"}])["hits"] == [False]
    assert classes({"effects": [{"name": "bias", "where": "joint1"}]}) == [{("bias", "joint1")}]


def test_the_first_place_counts_and_of_a_scale_of_the_torque_the_other_joint_too():
    told = [{"joint": "joint2", "variable": "command"}, {"joint": "joint1", "variable": "past"}]

    def record(effect, where, told):
        return {"hidden": [(effect, where)], "leftover": told}

    assert localised(record("spring", "joint2", told)) and not localised(
        record("saturation", "joint1", told)
    )
    assert localised(record("torque_gain", "joint1", told)) and not localised(
        record("torque_gain", "joint1", told[:1])
    )
    assert not localised(
        record("torque_gain", "joint1", [told[0] | {"variable": "angle"}, told[1]])
    )
    assert localised(record("tilt", "base", told)) and not localised(
        record("spring", "joint1", None)
    )


def test_a_confounded_effect_is_right_when_nothing_is_named():
    hidden = [("rotor_inertia", "joint1")]
    assert judged(hidden, [], "within_noise", confounded=True)["hits"] == [True]
    assert judged(hidden, [{"name": "bias", "where": "joint1"}], confounded=True)["wrong"] == 1
    assert judged(hidden, [], "structured_unattributed", confounded=True)["hits"] == [False]


def test_wilson_by_hand():
    assert wilson(0, 25) == (0.0, pytest.approx(0.1332, abs=1e-3))
    low, high = wilson(90, 100)
    assert low == pytest.approx(0.8256, abs=1e-3) and high == pytest.approx(0.9448, abs=1e-3)


def test_summary_counts_and_prints():
    error = {"before": 1.0, "after": 0.3, "noise_floor": 0.2}
    right = judged([("coulomb", "joint1")], [{"name": "coulomb", "where": "joint1"}])
    wrong = judged([("coulomb", "joint2")], [{"name": "bias", "where": "joint2"}], name="single_2")
    alarm = judged([], [{"name": "bias", "where": "joint1"}], suite="null", name="null_1")
    records = [r | {"seconds": 2.0, "error": error} for r in (right, wrong, alarm)]
    results = summarise(records)
    assert (
        results["single"]["right"]["hits"] == 1
        and results["single"]["wrong_without_right"]["hits"] == 1
    )
    assert results["single"]["confusion"]["coulomb@joint2"] == {"bias@joint2": 1}
    assert results["single"]["gap_closed_median"] == pytest.approx(0.875)
    assert results["null"]["false_alarms"]["clean"]["hits"] == 1
    assert "1/2 = 50.0 %" in table(results)


def test_a_disguise_that_changes_the_verdict_is_seen():
    plain = judged([], [], "within_noise", "metamorphic", name="meta_1_plain")
    same = judged([], [], "within_noise", "metamorphic", name="meta_1_a", variant="shuffled")
    other = judged(
        [], [], "structured_unattributed", "metamorphic", name="meta_1_b", variant="filtered"
    )
    records = [r | {"seconds": 1.0} for r in (plain, same, other)]
    assert summarise(records)["metamorphic"]["consistent"] == pytest.approx(0.5)


def test_declared_parameters_are_compared_where_they_are_identifiable():
    truth = {"b1": 0.1, "b2": 0.2, "p1": 1.0}
    before = {"b1": {"value": 0.2}, "b2": {"value": 0.1}, "p1": {"value": 2.0}}
    after = {
        "b1": {"value": 0.11, "low": 0.09, "high": 0.13},
        "b2": {"value": 0.25, "low": 0.22, "high": 0.28},
        "p1": {"value": 1.0, "low": 0.9, "high": 1.1, "identifiable": False},
    }
    found = declared_errors(truth, {"before": before, "after": after})
    assert set(found) == {"b1", "b2"} and found["b1"]["before"] == pytest.approx(1.0)
    assert found["b1"]["covered"] and not found["b2"]["covered"]


def test_a_case_in_a_line():
    effects = [
        {"name": "coulomb", "where": "joint1", "alternatives": ["stribeck"]},
        {"name": "bias", "where": "joint2"},
    ]
    record = judged([("stribeck", "joint1")], effects, "explained_class") | {
        "seconds": 9.6,
        "error": {"before": 0.0123456},
    }
    record["declared"] = {
        "m1": {"before": 0.1, "after": 0.0, "covered": True},
        "b1": {"before": 0.1, "after": 0.2},
    }
    line = row(record)
    assert (line["hidden"], line["said"]) == (
        "stribeck@joint1",
        "coulomb@joint1|stribeck@joint1 + bias@joint2",
    )
    assert (line["right"], line["wrong"], line["covered"], line["told"]) == (1, 1, 1, 1)
    assert (line["before"], line["after"], line["seconds"]) == ("0.01235", "", "10")
