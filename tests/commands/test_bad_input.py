"""Bad input end to end: whatever a person hands to a command, one line, exit code 2, and nothing
half-written.

Targets, configs and runs are in `test_train.py`, words in `test_errors.py`, every way a file can be
wrong in `tests/closeloop`; here the same through the command line, with what is left on the disk.
"""

import errno
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import adaptsim_jax
from adaptsim_jax.cli import main
from adaptsim_jax.core import files
from adaptsim_jax.core.store import RunFolder

SAMPLE = Path(adaptsim_jax.__file__).parent / "logs" / "sample" / "recording"


@pytest.fixture
def data(tmp_path):
    """A copy of the sample recording."""
    return Path(shutil.copytree(SAMPLE, tmp_path / "data"))


def refused(capsys, *arguments):
    """The one line of standard error beside progress; nothing on standard output."""
    assert main([str(word) for word in arguments]) == 2
    captured = capsys.readouterr()
    lines = [line for line in captured.err.splitlines() if " %, " not in line]
    assert len(lines) == 1 and lines[0].startswith("adaptsim: "), captured.err
    assert captured.out == ""
    return lines[0]


def column(change):
    """An edit of the first trial's table `[T, 7]` of texts, header included."""

    def edit(folder):
        path = folder / "trial_00.csv"
        rows = [line.split(",") for line in path.read_text().splitlines()]
        path.write_text("\n".join(",".join(row) for row in change(rows)) + "\n")

    return edit


def cell(row, place, text):
    def change(rows):
        rows[row][place] = text
        return rows

    return column(change)


def scaled(places, factor):
    def change(rows):
        return [
            rows[0],
            *(
                [f"{float(x) * (factor if i in places else 1):.9g}" for i, x in enumerate(row)]
                for row in rows[1:]
            ),
        ]

    def edit(folder):
        for path in folder.glob("*.csv"):
            rows = [line.split(",") for line in path.read_text().splitlines()]
            path.write_text("\n".join(",".join(row) for row in change(rows)) + "\n")

    return edit


def meta(old, new):
    def edit(folder):
        text = (folder / "meta.toml").read_text()
        assert old in text
        (folder / "meta.toml").write_text(text.replace(old, new))

    return edit


def some_nan(rows):
    return [[*r[:1], "nan", *r[2:]] if k % 10 == 7 else r for k, r in enumerate(rows)]


def swapped(rows):
    rows[40], rows[41] = rows[41], rows[40]
    return rows


DATA = {
    "a missing column": (
        column(lambda rows: [row[:2] + row[3:] for row in rows]),
        "trial_00.csv",
        "q2",
    ),
    "not a number": (column(some_nan), "trial_00.csv", "line 8"),
    "text": (cell(7, 5, "off"), "trial_00.csv", "'off'"),
    "time that runs backwards": (column(swapped), "trial_00.csv", "runs backwards"),
    "two rows": (column(lambda rows: rows[:3]), "trial_00.csv", "2 data rows"),
    "degrees": (scaled({1, 2, 3, 4}, 180 / np.pi), "degrees", "[units]"),
    "an unknown key": (meta("angle_zero", "angel_zero"), "meta.toml", "did you mean 'angle_zero'"),
    "a missing key": (meta('task = "pendulum"\n', ""), "meta.toml", "'task' is missing"),
    "another task": (meta('"pendulum"', '"walking"'), "meta.toml", "walking"),
    "a known parameter that the model has not": (
        meta("[geometry]", "[known]\nmass_1 = 1.0\n[geometry]"),
        "mass_1",
        "",
    ),
    "a parameter outside its physical range": (
        meta("l1 = 0.411", "l1 = -0.411"),
        "meta.toml",
        "l1",
    ),
    "no trials": (
        lambda folder: [path.unlink() for path in folder.glob("*.csv")],
        "data",
        "no .csv",
    ),
    "no meta": (lambda folder: (folder / "meta.toml").unlink(), "meta.toml", "missing"),
    "no folder": (shutil.rmtree, "data", "does not exist"),
}


@pytest.mark.parametrize("damage", DATA)
def test_a_recording(data, tmp_path, capsys, damage):
    edit, *says = DATA[damage]
    edit(data)
    message = refused(capsys, "diagnose", data, "--out", tmp_path / "out")
    assert all(word in message for word in says), message
    assert not (tmp_path / "out").exists()


def test_an_excluded_effect_that_is_not_in_the_catalogue(data, tmp_path, capsys):
    message = refused(
        capsys, "diagnose", data, "--out", tmp_path / "out", "--exclude", "backlash", "backlask"
    )
    assert "'backlask'" in message and "backlash" in message
    assert not (tmp_path / "out").exists()


def test_an_unwritable_output_folder(data, tmp_path, capsys):
    (tmp_path / "file").write_text("kept")
    out = tmp_path / "file" / "out"
    for command in (
        ("diagnose", data, "--out", out),
        ("train", "pendulum", "--run", out),
        ("compare", "pendulum", "--out", out, "--methods", "udr"),
        ("demo", "--out", out),
    ):
        message = refused(capsys, *command)
        assert "cannot be written" in message and "name a folder" in message
    assert (tmp_path / "file").read_text() == "kept"


@pytest.mark.parametrize(
    "more, says",
    [
        (("--settings", "odd-1"), "unknown setting 'odd-1'; did you mean 'ood-1'?"),
        (("--methods", "oracle"), "unknown method 'oracle'; known: adaptsim, adaptsim_state"),
        (("--methods", "adaptsin"), "unknown method 'adaptsin'; did you mean 'adaptsim'?"),
        (("--seeds", "0"), "'0' is not a whole number"),
        (("--set", "train.phase1.trajectoris=5"), "unknown key"),
        (("--set", "sysid.simulations=3"), "too few to fit a network"),
        (("--set", "train.phase1.trajectories=7"), "do not divide into rounds"),
        (("--config", "none.toml"), "none.toml: no such file"),
    ],
)
def test_a_comparison(tmp_path, capsys, more, says):
    assert says in refused(capsys, "compare", "pendulum", "--out", tmp_path / "out", *more)
    assert not (tmp_path / "out").exists()


def test_a_run_of_another_task(tmp_path, capsys):
    run = RunFolder.create(tmp_path / "run", {"seed": 0}, task="stirring")
    before = (run.path / "config.toml").read_bytes()
    for command in (
        ("train", "pendulum", "--run", run.path, "--resume"),
        ("robot", "new", run.path, "--dir", tmp_path / "robot"),
        ("adapt", run.path, "--target", "wd"),
    ):
        assert "stirring" in refused(capsys, *command)
    assert (run.path / "config.toml").read_bytes() == before
    assert not (tmp_path / "robot").exists()


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_disk_that_fills_while_a_run_is_made(tmp_path, capsys, monkeypatch, call):
    def full(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(files.os, call, full)
    message = refused(capsys, "train", "pendulum", "--run", tmp_path / "run")
    assert "no space left" in message
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


@pytest.mark.slow
def test_a_disk_that_fills_while_results_are_written(tmp_path, capsys, monkeypatch):
    """The comparison of bounds alone is quick; its files are whole or not there."""

    def full(path, _text):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    import adaptsim_jax.report.comparison as comparison

    monkeypatch.setattr(comparison, "write_bytes", full)  # results.json is written before
    command = (
        "compare",
        "pendulum",
        "--out",
        tmp_path / "out",
        "--methods",
        "udr,best-in-omega",
        "--settings",
        "wd",
    )
    assert "no space left" in refused(capsys, *command)
    json.loads((tmp_path / "out" / "results.json").read_text())
    assert not [path for path in (tmp_path / "out").iterdir() if path.suffix == ".tmp"]
