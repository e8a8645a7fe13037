"""Tables beside the trials that are none: left out and told, or refused with the line that leaves
them out.
"""

import gzip

import numpy as np
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.begin import begin
from adaptsim_jax.logs.read import read_log
from tests.logs.log_files import folder, motion, numbered, write_csv

ARM = ("shoulder", "elbow")
M = motion(2)
INDEX = "file,operator,payload\nrun0.csv,Jo,0.4\nrun1.csv,Jo,0.4\n"


def runs(path, names=("run0", "run1")):
    return folder(path, "", **{name: numbered(M, "q", "tau") for name in names})


@pytest.mark.parametrize("name", ["index", "summary"])  # before the trials, and behind them
@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("text", [INDEX, "payload,mass\n" + "1,2\n" * 40])
def test_a_list_of_trials_is_left_out_and_told(tmp_path, name, count, text):
    data = runs(tmp_path / "logs", ("run0", "run1")[:count])
    (data / f"{name}.csv").write_text(text)
    log = read_log(data, ARM)
    assert len(log.trials) == count
    assert f"{name}.csv is left out: it has no time and no column of the other files" in log.notes
    (data / "meta.toml").unlink()
    begun = begin(data, None, None, {})
    assert begun.log is not None and len(begun.log.trials) == count, begun.to_mend


@pytest.mark.parametrize("text", ["q1,operator\n0,Jo\n1,Jo\n", "q1,rate\n" + "1,2\n" * 40])
def test_what_may_be_a_trial_without_a_time_is_refused_with_both_mends(tmp_path, text):
    data = runs(tmp_path / "logs")
    (data / "index.csv").write_text(text)
    (data / "meta.toml").unlink()
    begun = begin(data, None, None, {})
    line = '[trials] exclude = ["index"]'
    assert begun.log is None and line in begun.to_mend and "index.csv" in begun.to_mend
    with pytest.raises(BadInput, match=r"add it \(s\), or name it by|a trial needs at least"):
        read_log(data, ARM)
    (data / "meta.toml").write_text('task = "mechanism"\n[trials]\nexclude = ["index"]\n')
    assert len(read_log(data, ARM).trials) == 2


def test_a_table_of_words_alone_is_refused_as_before(tmp_path):
    data = folder(tmp_path / "logs", "")
    (data / "index.csv").write_text(INDEX)
    with pytest.raises(
        BadInput, match=r"index.csv: column 'time' is missing|a trial needs at least"
    ) as error:
        read_log(data, ARM)
    assert "exclude" not in str(error.value)


def test_a_damaged_trial_is_no_table_beside_the_others(tmp_path):
    data = runs(tmp_path / "logs")
    write_csv(data / "run2.csv", {n: x[:5] for n, x in numbered(M, "q", "tau").items()})
    (data / "index.csv").write_text(INDEX)
    with pytest.raises(
        BadInput,
        match=r"run2.csv: has 5 data rows.*leave this file out: \[trials\] exclude = ..run2",
    ):
        read_log(data, ARM)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("ti", "has 0 data rows.*leave this file out: "),
        ("", "is empty"),
        ("0,1,2\n" * 30, "holds numbers"),
    ],
)
def test_a_trial_that_lost_its_header_is_none_either(tmp_path, text, says):
    data = runs(tmp_path / "logs")
    (data / "run2.csv").write_text(text)
    with pytest.raises(BadInput, match=f"run2.csv: .*({says}|is missing)"):
        read_log(data, ARM)


def packed(data):
    for path in list(data.glob("*.csv")):
        (data / f"{path.name}.gz").write_bytes(gzip.compress(path.read_bytes()))
        path.unlink()


def unpacked(data):
    for path in list(data.glob("*.gz")):
        (data / path.stem).write_bytes(gzip.decompress(path.read_bytes()))


def renamed(old, new):
    return lambda data: [path.rename(path.with_suffix(new)) for path in list(data.glob(f"*{old}"))]


def parted(data):
    for path in list(data.glob("*.csv")):
        (data / path.stem).mkdir()
        path.rename(data / path.stem / "states.csv")


def together(data):
    for path in list(data.glob("*/states.csv")):
        path.rename(data / f"{path.parent.name}.csv")


@pytest.mark.parametrize(
    ("spoil", "says", "mend"),
    [
        (
            packed,
            "not read: run0.csv.gz, run1.csv.gz, run2.csv.gz, run3.csv.gz and 1 more; unpack",
            unpacked,
        ),
        (renamed(".csv", ".txt"), "run0.txt, .* to .csv", renamed(".txt", ".csv")),
        (
            parted,
            "tables in the folder run0, .* and 1 more; move them up, each by the name",
            together,
        ),
        (renamed(".csv", ".parquet"), "run0.parquet, .*export as CSV", renamed(".parquet", ".csv")),
    ],
)
def test_a_folder_without_recordings_says_what_lies_there_and_the_mend_works(
    tmp_path, spoil, says, mend
):
    data = runs(tmp_path / "logs", tuple(f"run{k}" for k in range(5)))
    (data / "meta.toml").unlink()
    spoil(data)
    for refused in (lambda: begin(data, None, None, {}), lambda: read_log(data, ARM)):
        with pytest.raises(
            BadInput,
            match=f"holds no .*; {says}" if spoil is packed else f"holds no .*; not read: .*{says}",
        ):
            refused()
    mend(data)
    assert len(begin(data, None, None, {}).log.trials) == 5


def test_an_empty_folder_has_nothing_to_say_of(tmp_path):
    with pytest.raises(BadInput, match=r"or a LeRobot data set\)$"):
        begin(tmp_path, None, None, {})


def test_columns_without_a_name_are_not_listed(tmp_path, capsys):
    write_csv(tmp_path / "run.csv", {"": M["time"]} | numbered(M, "q", "tau"))
    assert main(["init", str(tmp_path)]) == 0
    assert "not used" not in capsys.readouterr().out + (tmp_path / "meta.toml").read_text()


def test_places_of_exported_arrays_are_joints(tmp_path):
    """As `rostopic echo -p` names them."""
    columns = {"%time": 1e9 * (1.7e9 + M["time"]), "field.header.seq": M["time"]}
    columns |= {f"field.position{j}": M["q"][:, j] for j in range(2)}
    columns |= {f"field.effort{j}": M["tau"][:, j] for j in range(2)}
    write_csv(tmp_path / "run.csv", columns)
    begun = begin(tmp_path, None, None, {})
    assert begun.log is not None, begun.to_mend
    np.testing.assert_array_equal(begun.log.trials[0].q, M["q"])
    np.testing.assert_array_equal(begun.log.trials[0].u, M["tau"])
    assert begun.unused == ("field.header.seq",)


def test_a_folder_that_meta_names_as_its_data_was_read(tmp_path):
    data = runs(tmp_path / "logs" / "log")
    (data / "meta.toml").rename(tmp_path / "logs" / "meta.toml")
    meta = tmp_path / "logs" / "meta.toml"
    meta.write_text('data = "log"\n' + meta.read_text())
    log = read_log(tmp_path / "logs", ARM)
    assert len(log.trials) == 2 and not any("not read" in note for note in log.notes)
