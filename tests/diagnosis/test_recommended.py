"""A file is recommended only where no joint is simulated worse than by the declared one, and files
tell more than a straight line.
"""

from pathlib import Path

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.diagnosis.recommended import WHOLE_TRIALS, FileReplay, joint_errors
from adaptsim_jax.report.diagnosis_words import headline, recommended, todo

SPANS = {"stretches of 0.5 s": 0.5, WHOLE_TRIALS: 0.0}


def run(table):
    """Simulated errors by file and span: one stretch of three joints, of which the last does
    nothing that a straight line does not.
    """

    def one(file, span):
        name = file.name if file else "declared"
        if name not in table:
            raise BadInput("no such file")
        return FileReplay(
            ("a", "b", "c"),
            ("rad",) * 3,
            np.array([table[name][span]]),
            np.array([[0.2, 0.2, 0.001]]),
        )

    return one


def test_a_joint_that_gets_worse_over_any_span_is_told_the_worst_first():
    declared = {0.5: [0.01, 0.01, 0.01], 0.0: [0.02, 0.02, 0.02]}
    toml = {0.5: [0.005, 0.0102, 0.01], 0.0: [0.01, 0.01, 0.02]}
    xml = {0.5: [0.005, 0.02, 0.09], 0.0: [0.24, 0.01, 0.02]}
    simulate = run({"declared": declared, "model.toml": toml, "model.xml": xml})
    files = [Path("model.xml"), Path("model.toml"), Path("of_another_kind.toml")]
    found = joint_errors(simulate, files, SPANS)
    worse = {name: [r for r in rows if r["worse"]] for name, rows in found.items()}
    assert worse["model.toml"] == worse["of_another_kind.toml"] == []  # 2 % is no matter
    assert [(r["joint"], r["over"]) for r in worse["model.xml"]] == [
        ("a", WHOLE_TRIALS),
        ("c", "stretches of 0.5 s"),  # which a straight line tells better than either file
        ("b", "stretches of 0.5 s"),
    ]
    assert worse["model.xml"][0]["after"] == pytest.approx(0.24)


def test_the_headline_and_what_to_do_say_which_joint_and_by_how_much():
    row = {"joint": "elbow", "over": WHOLE_TRIALS, "before": 0.02, "after": 0.24, "unit": "rad"}
    row |= {"nothing": 0.1, "worse": True}
    effect = {"name": "coulomb", "where": "elbow", "alternatives": []}
    report = {
        "verdict": "explained",
        "effects": [effect],
        "error": {"after": 1.0, "noise_floor": 1.0, "before": 2.0},
        "declared": {"after": {"x": 1}, "before": {}},
        "files": {"model.xml": [], "model.toml": []},
    }
    assert "worse" not in headline(report) and todo(report).startswith("Use the mended model")
    report["files"] = {"model.xml": [row], "model.toml": []}
    assert "model.xml simulates elbow worse than the declared file" in headline(report)
    assert "over whole trials" in headline(report)
    assert todo(report).startswith("Simulate with model.toml alone")
    report["files"] = {"model.xml": [row], "model.toml": [row]}
    assert todo(report).startswith("Keep the declared file for simulation")
    flat = row | {"before": 0.15, "after": 0.12, "worse": False}  # better than declared, and no use
    report["files"] = {"model.toml": [flat]}
    assert "a straight line simulates 1 of 1 joints better than any file" in headline(report)
    assert todo(report).startswith("Do not simulate these motions by any file")


def test_of_two_files_that_are_no_worse_the_one_that_leaves_more_at_a_joint_is_not_recommended():
    def rows(*after):
        row = {"over": WHOLE_TRIALS, "before": 0.1, "nothing": 0.2, "unit": "rad", "worse": False}
        return [row | {"joint": name, "after": z} for name, z in zip("ab", after, strict=True)]

    files = {"model.xml": rows(0.02, 0.05), "model.toml": rows(0.02, 0.03)}
    assert recommended({"files": files}) == ["model.toml"]
    assert recommended({"files": files | {"model.xml": rows(0.0205, 0.03)}}) == list(files)
    assert recommended({"files": {"model.xml": [], "model.toml": []}}) == list(files)
