"""What is on disk whatever fails: the report first, each other file if it can be written."""

import json

import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.diagnosis.run import plain
from adaptsim_jax.diagnosis.schema import new_report, read_report
from adaptsim_jax.diagnosis.written import (
    FAULTS,
    UNFINISHED,
    cleared,
    fault_line,
    faults_into,
    write_all,
    write_partial,
)


def _report():
    return new_report(
        "mechanism",
        "robot.xml",
        "within_noise",
        "Nothing.",
        {"trials": 1, "samples": 9, "held_out_trials": 1},
    )


def test_a_file_that_cannot_be_written_is_a_line_and_the_rest_is_there(tmp_path):
    def broken() -> str:
        raise RuntimeError("a mesh is\nmissing")

    report, evidence = _report(), {}
    write_all(
        tmp_path, report, evidence, plain, {"model.xml": broken, "model.toml": lambda: "a = 1\n"}
    )
    assert (tmp_path / "model.toml").read_text() == "a = 1\n" and not (
        tmp_path / "model.xml"
    ).exists()
    (line,) = read_report(tmp_path / "report.json")["warnings"]
    what = "model.xml could not be written: RuntimeError: a mesh is missing"
    assert line == f"{what}; a fault of the program, see faults.txt"
    assert 'raise RuntimeError("a mesh is' in (tmp_path / FAULTS).read_text()
    assert evidence["audit"][0]["message"] == line


def test_a_page_that_fails_leaves_the_numbers(tmp_path):
    def page(folder, report, evidence):
        raise ValueError("no ink")

    write_all(tmp_path, _report(), {}, page, {"model.toml": lambda: ""})
    (line,) = read_report(tmp_path / "report.json")["warnings"]
    assert line.startswith("report.html could not be written: ValueError: no ink; a fault of")
    assert (tmp_path / "model.toml").exists()


def test_a_full_disk_costs_neither_the_report_nor_the_files_that_have_room(tmp_path, monkeypatch):
    def page(folder, report, evidence):
        raise BadInput(f"{folder}: no space left on the disk")

    def write(path, value):
        raise BadInput(f"{path}: no space left on the disk")

    monkeypatch.setattr("adaptsim_jax.diagnosis.written.write_json", write)
    report = _report()
    write_all(tmp_path, report, {}, page, {"model.toml": lambda: "a = 1\n"})
    assert (tmp_path / "model.toml").read_text() == "a = 1\n"
    for name in ("report.json", "report.html"):
        assert any(f"{name} could not be written" in line for line in report["warnings"])


def test_an_unfinished_report_says_so_and_an_earlier_one_is_gone(tmp_path):
    (tmp_path / "model.xml").write_text("old")
    cleared(tmp_path)
    assert not (tmp_path / "model.xml").exists()
    write_partial(tmp_path, _report)
    told = json.loads((tmp_path / "report.json").read_text())
    assert told["unfinished"] and told["message"].startswith(UNFINISHED)


def test_a_partial_report_that_cannot_be_written_does_not_end_the_search(tmp_path):
    (tmp_path / "report.json").mkdir()
    write_partial(tmp_path, _report)
    assert (tmp_path / "report.json").is_dir() and not (tmp_path / FAULTS).exists()


def test_a_partial_report_that_cannot_be_made_is_a_fault_that_the_page_says(tmp_path):
    def broken():
        raise KeyError("effect")

    write_partial(tmp_path, broken)
    assert "KeyError: 'effect'" in (tmp_path / FAULTS).read_text()
    write_all(tmp_path, _report(), {}, plain, {})
    (line,) = read_report(tmp_path / "report.json")["warnings"]
    assert line.endswith("a fault of the program, see faults.txt")
    cleared(tmp_path)
    assert not (tmp_path / FAULTS).exists()


def test_a_fault_that_ends_a_search_leaves_its_traceback_beside_what_was_found(tmp_path):
    write_partial(tmp_path, _report)
    with pytest.raises(ZeroDivisionError) as caught, faults_into(tmp_path):
        1 / 0  # noqa: B018
    assert "ZeroDivisionError" in (tmp_path / FAULTS).read_text()
    assert str(tmp_path / FAULTS) in caught.value.__notes__[0]
    assert json.loads((tmp_path / "report.json").read_text())["unfinished"]
    (tmp_path / FAULTS).unlink()
    with pytest.raises(BadInput), faults_into(tmp_path):
        raise BadInput("a.csv: no rows; record some")
    assert fault_line(tmp_path, OSError(28, "No space left")).startswith("OSError")
    assert not (tmp_path / FAULTS).exists()
