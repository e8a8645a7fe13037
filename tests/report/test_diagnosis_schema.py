"""The schema of report.json: every key of the design is wanted, and a contradiction is refused."""

import copy
import json

import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.diagnosis import schema
from tests.report.diagnosis_cases import REPORTS

TOP = (
    "schema",
    "task",
    "model",
    "data",
    "verdict",
    "message",
    "effects",
    "error",
    "candidates",
    "declared",
    "next_experiment",
)
NESTED = [
    *[("data", key) for key in ("trials", "samples", "held_out_trials")],
    *[("effects", 0, key) for key in ("name", "where", "parameters", "alternatives")],
    *[("effects", 0, "parameters", "torque", key) for key in ("value", "low", "high", "unit")],
    *[("error", key) for key in schema.ERROR_KEYS],
    *[("error", "per_channel", "q1", key) for key in ("before", "after")],
    *[
        ("candidates", 0, key)
        for key in ("name", "where", "held_out_gain", "p_value", "accepted", "why")
    ],
    *[("declared", key) for key in ("before", "after")],
    *[("declared", "after", "m1", key) for key in ("value", "low", "high", "unit", "identifiable")],
]


def without(report, path):
    report = copy.deepcopy(report)
    table = report
    for key in path[:-1]:
        table = table[key]
    del table[path[-1]]
    return report


@pytest.mark.parametrize("verdict", schema.VERDICTS)
def test_every_verdict_has_a_report_that_keeps_the_schema(verdict):
    report = REPORTS[verdict]()
    assert schema.problems(report) == []
    assert schema.check(report) == json.loads(json.dumps(report, allow_nan=False))


@pytest.mark.parametrize(
    "path", [(key,) for key in TOP] + NESTED, ids=lambda path: ".".join(map(str, path))
)
def test_every_key_is_wanted(path):
    found = schema.problems(without(REPORTS["explained"](), path))
    assert found and any(str(path[-1]) in line for line in found)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"verdict": "sure"}, "verdict"),
        ({"schema": 2}, "schema"),
        ({"verdict": "within_noise"}, "names no effect"),
        ({"effects": []}, "names an effect"),
        ({"verdict": "explained_class"}, "alternatives"),
        ({"message": " "}, "message"),
        ({"not_established": "all"}, "not_established"),
    ],
)
def test_contradictions_are_refused(change, complaint):
    with pytest.raises(schema.ReportError, match=complaint):
        schema.check(REPORTS["explained"]() | change)


def test_values_are_checked():
    report = REPORTS["explained"]()
    report["effects"][0]["parameters"]["torque"]["low"] = 1.0
    report["candidates"][0]["p_value"] = 1.5
    report["candidates"][1]["status"] = "perhaps"
    report["error"]["before"] = -1.0
    report["error"]["per_channel"]["q1"]["intervals"]["before"] = [2.0, 1.0]
    report["declared"]["after"]["m1"]["identifiable"] = None
    found = "; ".join(schema.problems(report))
    for part in (
        "upside down",
        "p_value",
        "status",
        "error.before",
        "q1.intervals.before",
        "m1.identifiable",
    ):
        assert part in found, part


def test_free_keys_are_free():
    assert schema.problems(REPORTS["explained"]() | {"mine": {"anything": [1, None]}}) == []


def test_new_report_is_whole():
    report = schema.new_report(
        "pendulum",
        "linearized",
        "data_fault",
        "why",
        {"trials": 0, "samples": 0, "held_out_trials": 0},
    )
    assert schema.problems(report) == [] and set(TOP) == set(report)


def test_read_report_refuses_what_is_not_one(tmp_path):
    path = tmp_path / "report.json"
    with pytest.raises(BadInput, match="cannot be read"):
        schema.read_report(path)
    for text in ("{", "[]", json.dumps({"schema": 1})):
        path.write_text(text)
        with pytest.raises(BadInput, match="not a whole report"):
            schema.read_report(path)
    path.write_text(json.dumps(REPORTS["within_noise"]()))
    assert schema.read_report(path)["verdict"] == "within_noise"
