"""What lies beside the trials of a folder: copies, packed files, remarks above a header."""

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.beside import copies, unread
from adaptsim_jax.logs.table import read_table


def test_a_copy_is_told_and_a_trial_of_its_own_is_not():
    q = np.random.default_rng(0).normal(size=(50, 2))
    assert copies([("a", q), ("b", q + 1e-3), ("c", q[:-1])]) == ()
    (told,) = copies([("a", q), ("b", q * (1 + 1e-9))])
    assert told == "b holds the angles of a: a copy? leave it out (--without b)"


def test_files_that_are_not_read_are_told(tmp_path):
    (tmp_path / "trial_0.csv").write_text("time,q1\n0,0\n")
    (tmp_path / "out").mkdir()  # of a diagnosis
    for name in ("report.json", "next_experiment.csv"):
        (tmp_path / "out" / name).write_text("{}")
    assert unread(tmp_path) == ()
    (tmp_path / "trial_1.csv.gz").write_bytes(b"")
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "trial_2.csv").write_text("time,q1\n0,0\n")
    packed, inner = unread(tmp_path)
    assert "trial_1.csv.gz" in packed and "more" in inner


def test_remarks_above_the_header_are_no_rows_and_lines_keep_their_numbers(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("# logger v2\n# rate: 100\n#time,q1\n0,1\n0.1,2\n")
    table = read_table(path, ("time", "q1"), min_rows=1)
    assert list(table.columns["q1"]) == [1, 2] and list(table.lines) == [4, 5]
    path.write_text("logger v2\ntime,q1\n0,1\n")
    with pytest.raises(BadInput, match="remove the lines above the columns' names"):
        read_table(path, ("time", "q1"), min_rows=1)
