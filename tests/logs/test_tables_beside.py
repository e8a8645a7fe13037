"""Tables beside the trials that are none: left out and told, or refused with the line that leaves them out."""

import pytest

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
    with pytest.raises(BadInput, match=r"index.csv: column 'time' is missing|a trial needs at least") as error:
        read_log(data, ARM)
    assert "exclude" not in str(error.value)


def test_a_damaged_trial_is_no_table_beside_the_others(tmp_path):
    data = runs(tmp_path / "logs")
    write_csv(data / "run2.csv", {n: x[:5] for n, x in numbered(M, "q", "tau").items()})
    (data / "index.csv").write_text(INDEX)
    with pytest.raises(BadInput, match=r"run2.csv: has 5 data rows.*leave this file out: \[trials\] exclude = ..run2"):
        read_log(data, ARM)


@pytest.mark.parametrize(
    ("text", "says"),
    [("ti", "has 0 data rows.*leave this file out: "), ("", "is empty"), ("0,1,2\n" * 30, "holds numbers")],
)
def test_a_trial_that_lost_its_header_is_none_either(tmp_path, text, says):
    data = runs(tmp_path / "logs")
    (data / "run2.csv").write_text(text)
    with pytest.raises(BadInput, match=f"run2.csv: .*({says}|is missing)"):
        read_log(data, ARM)
