"""`report.json` as an interface: a schema that any validator takes, every key on its page."""

import copy
import json
import re
import runpy
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from adaptsim_jax.diagnosis.schema import problems

ROOT = Path(__file__).parents[2]
SCHEMA = json.loads(runpy.run_path(str(ROOT / "docs" / "hooks.py"))["schema"]())
STORED = {
    path.stem: json.loads(path.read_text(encoding="utf-8"))
    for path in sorted((ROOT / "tests" / "pins" / "stored").glob("report_*.json"))
}
REPORTS = {name: stored["report"] for name, stored in STORED.items() if "report" in stored}


def test_the_schema_is_one():
    Draft202012Validator.check_schema(SCHEMA)
    assert len(REPORTS) > 5


@pytest.mark.parametrize("name", REPORTS)
def test_a_report_keeps_it_without_our_keyword(name):
    assert not list(Draft202012Validator(SCHEMA).iter_errors(REPORTS[name]))


@pytest.mark.parametrize(
    "key, value", [("schema", 2), ("verdict", "fine"), ("effects", [{"name": "coulomb"}])]
)
def test_what_breaks_it_is_found_by_either(key, value):
    report = copy.deepcopy(next(iter(REPORTS.values()))) | {key: value}
    assert list(Draft202012Validator(SCHEMA).iter_errors(report)) and problems(report)


def test_every_key_of_a_report_is_on_the_page():
    page = (ROOT / "docs" / "reference" / "report.md").read_text(encoding="utf-8")
    told = set(re.findall(r"\w+", " ".join(re.findall(r"^\| (`.*?) \|", page, re.M))))
    keys = {key for report in REPORTS.values() for key in report}
    assert keys <= told, keys - told
    assert set(SCHEMA["properties"]) <= told
