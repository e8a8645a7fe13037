"""What real data and real days do, from the command line: told with what to write, before a model
is judged.
"""

import re

import numpy as np
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.logs.pendulum import read_pendulum
from tests.logs.arm_files import META, arm, wrapped, write


def refused(capsys, *words):
    """What `adaptsim` says of a command that it refuses, in its one line."""
    assert main([str(w) for w in words]) == 2
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("adaptsim:")]
    assert len(told) == 1
    assert re.search(r" \[E-[A-Z]+-\d{3}\]$", told[0]), told
    return told[0]


def comma(x):
    return '"' + f"{x:.6f}".replace(".", ",") + '"'


def swapped(c):
    return {k if k == "time" else k[:-1] + {"1": "2", "2": "1"}[k[-1]]: x for k, x in c.items()}


def late(c, rows=2):
    return c | {k: np.r_[[c[k][0]] * rows, c[k][:-rows]] for k in ("tau1", "tau2")}


EPOCH = 1.7e9
SPOILED = {
    "joints": (swapped, "joint 1 and joint 2 look swapped"),
    "one degrees": (
        lambda c: c | {"q1": np.degrees(c["q1"]), "v1": np.degrees(c["v1"])},
        'q1 = "deg" under [units]',
    ),
    "absolute": (
        lambda c: c | {"q2": c["q1"] + c["q2"], "v2": c["v1"] + c["v2"]},
        "q2 looks absolute",
    ),
    "late": (late, "are logged about 20 ms (2 rows) late"),
    "commas": (lambda c: {k: [comma(v) for v in x] for k, x in c.items()}, "decimal comma"),
    "float32": (
        lambda c: c | {"time": (c["time"] + EPOCH).astype(np.float32)},
        "save it as float64",
    ),
    "ms": (lambda c: c | {"time": 1e3 * c["time"]}, 'time = "ms"'),
    "us": (lambda c: c | {"time": 1e6 * c["time"]}, 'time = "us"'),
    "ns": (lambda c: c | {"time": 1e9 * (c["time"] + EPOCH)}, 'time = "ns"'),
    "back": (
        lambda c: c | {"time": np.where(c["time"] > 1.0, c["time"] - 0.5, c["time"])},
        "time runs backwards",
    ),
    "needed": (lambda c: c | {"q2": ["nan"] * len(c["time"])}, "column q2 holds no number"),
    "hole": (
        lambda c: c | {"tau1": np.where(c["time"] < 0.3, np.nan, c["tau1"])},
        "column tau1 holds no number",
    ),
    "mNm": (lambda c: c | {"tau2": 1e3 * c["tau2"]}, 'write tau2 = "mNm" under [units]'),
    "turns": (
        lambda c: c | {k: c[k] / (2 * np.pi) for k in ("q2", "v2")},
        'write q2 = "rev" under [units]',
    ),
    "folded": (lambda c: c | {"q2": c["q2"] - np.pi}, "add 3.1416 rad to column q2"),
    "swapped": (
        lambda c: c | {"tau1": c["tau2"], "tau2": c["tau1"]},
        "exchange columns tau1 and tau2",
    ),
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_spoiled_log_is_refused_with_a_mend(tmp_path, capsys, name):
    spoil, says = SPOILED[name]
    data = write(tmp_path / "data", [spoil(c) for c in arm()])
    assert says in refused(capsys, "diagnose", data, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_gravity_that_is_not_that_of_the_motion(tmp_path, capsys):
    data = write(tmp_path / "data", arm(), meta=META.replace("9.81", "0.0"))
    assert "write g = 9.8" in refused(capsys, "diagnose", data, "--out", tmp_path / "out")


def test_lengths_in_mm_are_no_pendulum_of_this_motion(tmp_path, capsys):
    data = write(tmp_path / "data", arm(), l1=350.0)
    assert "write l1 = 0.35 under [geometry]" in refused(
        capsys, "diagnose", data, "--out", tmp_path / "out"
    )


ENCODED = {
    "semicolons and decimal commas": (
        lambda text: text.replace(",", ";").replace(".", ","),
        "utf-8",
        "decimal comma",
    ),
    "utf-16": (lambda text: text, "utf-16", "UTF-8"),
    "spaces": (lambda text: text.replace(",", " "), "utf-8", "separate"),
    "tabs": (lambda text: text.replace(",", "\t"), "utf-8-sig", None),
    "semicolons": (lambda text: text.replace(",", ";"), "utf-8-sig", None),
}


@pytest.mark.parametrize("name", ENCODED)
def test_text_of_other_programs_is_read_or_told(tmp_path, capsys, name):
    change, encoding, says = ENCODED[name]
    plain = read_pendulum(write(tmp_path / "plain", arm(count=2)))
    data = write(tmp_path / "data", arm(count=2))
    for path in data.glob("*.csv"):
        path.write_text(change(path.read_text()), encoding=encoding)
    if says is not None:
        assert says in refused(capsys, "diagnose", data, "--out", tmp_path / "out")
        return
    for a, b in zip(plain.trials, read_pendulum(data).trials, strict=True):
        np.testing.assert_array_equal(a.q, b.q)


def test_an_epoch_in_float64_is_a_clock_as_any_other(tmp_path):
    data = write(
        tmp_path, [c | {"time": [f"{t + EPOCH:.4f}" for t in c["time"]]} for c in arm(count=2)]
    )
    assert abs(read_pendulum(data).trials[0].dt - 0.01) < 1e-6


@pytest.mark.parametrize("lost", [0, 2, 4])
def test_wraps_are_taken_out_even_where_rows_are_lost_just_there(tmp_path, lost):
    """Angles in (-pi, pi] of fast rounds; `lost` rows on either side of each wrap are gone."""
    whole = arm(count=4, scale=3.0)
    trials = [wrapped(c, lost) for c in whole]
    all_rows = [wrapped(c) for c in whole]
    assert sum(np.sum(np.abs(np.diff(c[k])) > np.pi) for c in all_rows for k in ("q1", "q2")) >= 3
    read = read_pendulum(write(tmp_path, trials))
    for trial, c in zip(read.trials, whole, strict=True):
        for j, name in enumerate(("q1", "q2")):
            off = trial.q[:, j] - np.interp(trial.time, c["time"], c[name])
            assert np.ptp(off) < 0.01


def test_the_data_folder_is_no_place_for_the_report(tmp_path, capsys):
    data = write(tmp_path / "data", arm(count=2))
    assert "is the folder of the recordings" in refused(capsys, "diagnose", data, "--out", data)
    assert sorted(p.name for p in data.iterdir()) == ["00.csv", "01.csv", "meta.toml"]


def test_trials_to_leave_out_are_checked(tmp_path, capsys):
    data = write(tmp_path / "data", arm(count=2))
    assert "no trial is named '07'" in refused(
        capsys, "diagnose", data, "--out", tmp_path / "o", "--without", "07"
    )
    (data / "01.csv").write_text("torn")  # what is left out is not looked at
    assert "01.csv" in refused(capsys, "diagnose", data, "--out", tmp_path / "o")
    assert read_pendulum(data, without=["01"]).trials[0].name == "00"
    assert "leave some" in refused(
        capsys, "diagnose", data, "--out", tmp_path / "o", "--without", "00,01"
    )


THOUSANDS = {
    "quoted": ('"{:,.3f}"', "1234.5, nothing between the digits"),
    "whole": ('"{:,.0f}"', "thousands or decimals behind a comma"),
    "bare": ("{:,.3f}", "commas between thousands suspected"),
    "apostrophes": ("{:,.3f}", "1234.5, nothing between the digits"),
}


@pytest.mark.parametrize("name", THOUSANDS)
def test_commas_between_thousands_are_told_from_decimal_commas(tmp_path, capsys, name):
    form, says = THOUSANDS[name]

    def cell(v):
        return form.format(v).replace(",", "'" if name == "apostrophes" else ",")

    data = write(
        tmp_path / "data",
        [c | {"time": [cell(1e3 * t + 1e3) for t in c["time"]]} for c in arm(count=2)],
    )
    assert says in refused(capsys, "diagnose", data, "--out", tmp_path / "out")
