"""What a power cut, a restart or a lost reading leaves in tables, and rows of units."""

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.begin import begin
from adaptsim_jax.logs.quality.hypotheses import Track, blocks
from adaptsim_jax.logs.read import read_log
from tests.logs.log_files import HEAD, folder, motion, named, numbered, write_csv

M = motion(2, rows=100)
ARM = ("shoulder", "elbow")


def written(path, text):
    (path / "run.csv").write_bytes(text)
    return read_log(path, ARM)


def table(path, columns=None):
    write_csv(path / "run.csv", numbered(M, "q", "tau") if columns is None else columns)
    return (path / "run.csv").read_bytes()


@pytest.mark.parametrize("cut", [0, 1, 24])
def test_zero_bytes_at_the_end_and_the_line_that_they_cut_are_left_out(tmp_path, cut):
    whole = table(tmp_path)
    log = written(tmp_path, whole[: len(whole) - cut] + bytes(1500))
    rows = 100 if not cut else 99
    np.testing.assert_array_equal(log.trials[0].q, M["q"][:rows])
    line = 102 if not cut else 101
    assert any(f"zero bytes (a power cut?), left out: line {line}" in note for note in log.notes)


def test_zero_bytes_in_the_middle_cost_the_line_that_they_are_in(tmp_path):
    lines = table(tmp_path).splitlines(keepends=True)
    log = written(tmp_path, b"".join([*lines[:40], bytes(512), *lines[40:]]))
    np.testing.assert_array_equal(log.trials[0].q, np.delete(M["q"], 39, axis=0))


@pytest.mark.parametrize("pause", [0.0, 600.0])
def test_a_header_that_stands_again_begins_a_trial(tmp_path, pause):
    lines = table(tmp_path).splitlines(keepends=True)
    later = [f"{float(x.split(b',')[0]) + pause}".encode() + x[x.index(b",") :] for x in lines[61:]]
    log = written(tmp_path, b"".join([*lines[:61], lines[0], *later]))
    assert [t.name for t in log.trials] == ["run_1", "run_2"]
    np.testing.assert_array_equal(np.concatenate([t.q for t in log.trials]), M["q"])
    assert all(np.ptp(t.time) < 1.0 for t in log.trials)
    assert any("the header of run.csv starts again: taken as 2 trials" in n for n in log.notes)


def test_the_few_rows_behind_a_second_header_are_no_trial(tmp_path):
    lines = table(tmp_path).splitlines(keepends=True)
    log = written(tmp_path, b"".join([*lines[:91], lines[0], *lines[91:]]))
    np.testing.assert_array_equal(log.trials[0].q, M["q"][:90])


UNITS = b"s,deg,[deg],N m,N m\n"


def test_a_row_of_units_is_read_as_headings_are(tmp_path):
    columns = numbered(M | {"q": np.degrees(M["q"])}, "q", "tau")
    head, body = table(tmp_path, columns).split(b"\n", 1)
    text = head + b"\n" + UNITS + body
    with pytest.raises(BadInput, match=r"says deg, and no unit is declared.*angle = \"deg\""):
        written(tmp_path, text)
    (tmp_path / "meta.toml").write_text(HEAD + '[units]\nangle = "deg"\n')
    log = read_log(tmp_path, ARM)
    np.testing.assert_allclose(log.trials[0].q, M["q"])


def test_init_takes_a_row_of_units(tmp_path):
    columns = numbered(M | {"tau": 1e3 * M["tau"]}, "q", "tau")
    head, body = table(tmp_path, columns).split(b"\n", 1)
    (tmp_path / "run.csv").write_bytes(head + b"\ns,rad,rad,mNm,mNm\n" + body)
    begun = begin(tmp_path, None, None, {})
    assert begun.log is not None and 'torque = "mNm"' in begun.text
    np.testing.assert_allclose(begun.log.trials[0].u, M["tau"])


@pytest.mark.parametrize("empty", ["", "nan"])
def test_a_reading_that_is_lost_now_and_then_is_not_used(tmp_path, empty):
    columns = named(M, ARM, "q", "v", "tau")
    lines = table(tmp_path, columns).decode().splitlines()
    for row, column in ((1, 5), (20, 1), (40, 4), (60, 5)):
        cells = lines[row].split(",")
        cells[column] = empty
        lines[row] = ",".join(cells)
    log = written(tmp_path, "\n".join(lines).encode())
    (trial,) = log.trials
    assert np.argwhere(np.isnan(trial.q)).tolist() == [[18, 0]]  # without the first row
    assert trial.v is not None and np.argwhere(np.isnan(trial.v)).tolist() == [[38, 1]]
    torques = M["tau"].copy()
    torques[59, 0] = torques[58, 0]
    np.testing.assert_array_equal(trial.u, torques[1:])
    (note,) = [n for n in log.notes if "lack a number" in n]
    assert note.startswith(
        "4 rows lack a number (q_shoulder, v_elbow, tau_shoulder), first in line 2"
    )


def test_blocks_of_a_motion_leave_out_what_was_not_read():
    time = np.arange(300) * 0.01
    q, tau = np.sin(time)[:, None], np.cos(time)[:, None]
    v = np.cos(time)[:, None]
    v[:3] = q[150] = np.nan
    found = blocks(Track(time, q, v, tau))
    assert all(np.isfinite(x).all() for x in found) and len(found[0]) > 50
    np.testing.assert_allclose(found[0] ** 2 + found[1] ** 2, 1.0, atol=2e-3)


def test_a_table_without_a_time_and_a_declared_rate(tmp_path):
    columns = numbered(M, "q", "tau")
    del columns["time"]
    data = folder(tmp_path / "data", "", run=columns)
    with pytest.raises(BadInput, match=r"rows_per_second = 100\.0"):
        read_log(data, ARM)
    (data / "meta.toml").write_text(HEAD + "rows_per_second = 50.0\n")
    log = read_log(data, ARM)
    np.testing.assert_allclose(log.trials[0].time, np.arange(100) / 50)
    (data / "meta.toml").write_text(HEAD + "rows_per_second = 0.0\n")
    with pytest.raises(BadInput, match=r"rows_per_second = 0 is not above 0; write 100\.0"):
        read_log(data, ARM)


@pytest.mark.parametrize(
    "names", [("theta", "dtheta"), ("q_present_rad", "dq_present_rad_s"), ("q_actual", "v_actual")]
)
def test_names_of_servos_registers(tmp_path, names):
    columns = {"time": M["time"], names[0]: M["q"][:, 0], names[1]: M["v"][:, 0]}
    log = read_log(write_csv(tmp_path / "run.csv", columns | {"tau": M["tau"][:, 0]}), ["wheel"])
    np.testing.assert_array_equal(log.trials[0].q[:, 0], M["q"][:, 0])
    assert log.trials[0].v is not None
    np.testing.assert_array_equal(log.trials[0].v[:, 0], M["v"][:, 0])
