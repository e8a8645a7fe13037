"""A time in two columns, and a clock that starts again within a file: read, guessed by `adaptsim
init`, or told with what to write.
"""

import re
import tomllib

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.begin import begin
from adaptsim_jax.logs.read import read_log
from tests.logs.log_files import HEAD, folder, motion, numbered, write_csv

ARM = ("shoulder", "elbow")
M = motion(2, rows=240)
EPOCH = 1_700_000_000


def stamped(seconds, nanos, time=M["time"]):
    """The columns of a motion with its time in two parts."""
    whole = np.floor(time + 0.25).astype(int)
    parts = {seconds: whole + EPOCH, nanos: np.round(1e9 * (time + 0.25 - whole)).astype(int)}
    return (
        {"header.seq": np.arange(len(time))}
        | parts
        | {n: x for n, x in numbered(M, "q", "tau").items() if n != "time"}
    )


STAMPS = [
    ("header.stamp.secs", "header.stamp.nsecs"),
    ("header.stamp.sec", "header.stamp.nanosec"),
    ("/joint_states/header/stamp/sec", "/joint_states/header/stamp/nanosec"),
    ("stamp_secs", "stamp_nsecs"),
    ("sec", "nanosec"),
]


@pytest.mark.parametrize(("seconds", "nanos"), STAMPS)
def test_a_time_of_seconds_and_nanoseconds_is_begun_and_reads(tmp_path, seconds, nanos):
    write_csv(tmp_path / "logs" / "run.csv", stamped(seconds, nanos))
    begun = begin(tmp_path / "logs", None, None, {})
    assert begun.log is not None, begun.to_mend
    np.testing.assert_allclose(begun.log.trials[0].time, M["time"], atol=1e-6)
    assert tomllib.loads(begun.text)["columns"] == {"time": seconds, "time_nanos": nanos}
    assert f"time taken from {seconds} and {nanos} together" in begun.log.notes
    assert tomllib.loads(begun.text)["units"] == {} and begun.unused == ("header.seq",)


@pytest.mark.parametrize(
    "columns", ["", 'time = "header.stamp.secs"\n', 'time = "header.stamp.nsecs"\n']
)
@pytest.mark.parametrize("rows", [240, 60])
def test_one_part_of_a_time_is_refused_with_the_line_that_reads(tmp_path, columns, rows):
    told = {name: x[:rows] for name, x in stamped(*STAMPS[0]).items()}
    if columns.endswith('.nsecs"\n') and rows == 60:
        return  # within one second nanoseconds alone increase
    data = folder(tmp_path / "logs", f"[columns]\n{columns}", run=told)
    with pytest.raises(BadInput, match=r"has two parts|have two parts") as error:
        read_log(data)
    line = re.search(r"time = \[.*?\]", str(error.value))[0]
    (data / "meta.toml").write_text(f"{HEAD}[columns]\n{line}\n")
    np.testing.assert_allclose(read_log(data).trials[0].time, M["time"][:rows], atol=1e-6)


def test_what_is_no_part_of_a_second_is_refused(tmp_path):
    told = stamped("s", "n") | {"n": np.round(1e9 * (EPOCH + M["time"]))}
    data = folder(tmp_path / "logs", '[columns]\ntime = ["s", "n"]\n', run=told)
    with pytest.raises(BadInput, match="column n goes beyond a second"):
        read_log(data)
    data = folder(tmp_path / "logs", '[columns]\ntime = ["s", "n", "q1"]\n', run=told)
    with pytest.raises(BadInput, match=r"columns.time names 3 columns"):
        read_log(data)


def trials_in_one(path, names=None, shift=0.0):
    """Three trials of 80 rows in one table, whose clock starts again; names: a column of these."""
    starts = np.repeat([0.0, shift, -shift], 80)
    columns = numbered(M, "q", "tau") | {"time": np.tile(M["time"][:80], 3) + starts}
    more = {} if names is None else {"run_id": np.repeat(np.array(names), 80)}
    return write_csv(path, {"battery": np.full(240, 24.0)} | more | columns)


def test_a_clock_that_starts_again_parts_trials(tmp_path):
    log = read_log(trials_in_one(tmp_path / "all.csv"), ARM)
    assert [t.name for t in log.trials] == ["all_1", "all_2", "all_3"]
    np.testing.assert_array_equal(log.trials[1].q, M["q"][80:160])
    assert "the clock of all.csv starts again: taken as 3 trials, all_1 to all_3" in log.notes


@pytest.mark.parametrize("names", [(0, 1, 2), ("a", "b", "c")])
@pytest.mark.parametrize("shift", [0.0, 0.3])
def test_what_names_such_trials_is_told_and_guessed(tmp_path, names, shift):
    data = folder(tmp_path / "logs", "")
    trials_in_one(data / "all.csv", names, shift)
    said = r'\[columns\] trial = "run_id"'
    if shift:
        with pytest.raises(BadInput, match=f"time runs backwards.*{said} in meta.toml"):
            read_log(data, ARM)
    else:
        assert any(re.search(said, note) for note in read_log(data, ARM).notes)
    (data / "meta.toml").unlink()
    begun = begin(data, None, None, {})
    assert begun.log is not None, begun.to_mend
    assert [t.name for t in begun.log.trials] == [str(name) for name in names]
    assert tomllib.loads(begun.text)["columns"] == {"trial": "run_id"}


def test_trials_of_one_archive(tmp_path):
    time = np.tile(M["time"][:80], 3)
    np.savez(
        tmp_path / "all.npz",
        time=time,
        q=M["q"],
        tau=M["tau"],
        run_id=np.repeat(["a", "b", "c"], 80),
    )
    log = read_log(tmp_path / "all.npz", ARM)
    assert [len(t.time) for t in log.trials] == [80, 80, 80] and any(
        'trial = "run_id"' in note for note in log.notes
    )


@pytest.mark.parametrize("spoil", ["set back", "swapped rows", "short"])
def test_a_clock_that_does_anything_else_is_still_refused(tmp_path, spoil):
    time = M["time"].copy()
    if spoil == "set back":
        time[120:] -= 0.5
    elif spoil == "swapped rows":
        time[[0, 1]] = time[[1, 0]]
    else:
        time[-5:] = time[:5]
    path = write_csv(tmp_path / "all.csv", numbered(M, "q", "tau") | {"time": time})
    with pytest.raises(
        BadInput, match=r"time runs backwards .*; sort or remove such rows, or cut the file there"
    ):
        read_log(path, ARM)


def test_commands_of_several_trials_in_one_file_are_refused(tmp_path):
    data = folder(
        tmp_path / "logs", '[trials]\ncommands = {run = "control.csv"}\n', run=numbered(M, "q")
    )
    columns = {"time": np.tile(M["time"][:80], 3), "target1": M["q"][:, 0], "target2": M["q"][:, 1]}
    write_csv(data / "control.csv", columns)
    with pytest.raises(
        BadInput, match=r"control.csv: holds commands of 3 trials.*; write each a file"
    ):
        read_log(data, ARM)


def test_trials_of_one_name_in_two_files_are_called_by_their_files(tmp_path):
    data = folder(tmp_path / "logs", '[columns]\ntrial = "run_id"\n')
    for name in ("monday", "tuesday"):
        trials_in_one(data / f"{name}.csv", (0, 1, 2))
    names = [t.name for t in read_log(data, ARM).trials]
    assert names == [f"{day}_{k}" for day in ("monday", "tuesday") for k in range(3)]
