"""Layouts of tables as programs write them: remarks above the header, arrays by rows, times in two
columns, trials in one file.
"""

import re

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.read import read_log
from adaptsim_jax.logs.table import read_table
from tests.logs.log_files import HEAD, motion

ARM = ("shoulder", "elbow")
M = motion(2)
ROWS = "".join(f"{k / 100:.2f},{k}\n" for k in range(30))


@pytest.mark.parametrize(
    "above",
    [
        "# rig: arm2, operator: Jo\n# date, 2026-03-01, 10:00\ntime,q1\n",
        "# date, 2026-03-01\ntime,q1\n",  # as many cells as the header
        "% rig, arm2, 3\n\ntime,q1\n",
        "# rig: arm2, operator: Jo, 3\n# time,q1\n",
        "# time,q1\n# rig: arm2, operator: Jo, 3\n",
        "time,q1\n",
    ],
)
def test_remarks_with_commas_are_no_header(tmp_path, above):
    path = tmp_path / "log.csv"
    path.write_text(above + ROWS)
    table = read_table(path, ("time", "q1"))
    assert list(table.columns["q1"]) == list(range(30))
    assert list(table.lines) == list(range(above.count("\n") + 1, above.count("\n") + 31))
    assert read_log(path, ("shoulder",)).trials[0].q.shape == (30, 1)


def test_remarks_above_rows_without_a_header_are_told_as_such(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("# rig: arm2, operator: Jo, 3\n" + ROWS)
    with pytest.raises(
        BadInput, match=r"line 2 holds numbers, not column names; add a header line such as time"
    ):
        read_log(path, ("shoulder",))
    path.write_text("# rig: arm2, operator: Jo, 3\ntime,q1\n" + ROWS)  # as advised
    read_log(path, ("shoulder",))


def test_lines_above_the_header_that_are_no_remarks_are_told_and_their_mends_work(tmp_path):
    path = tmp_path / "log.csv"
    above = "rig,operator\narm2,Jo\n"
    rows = "time,q1,q2\n" + "".join(f"{k / 100:.2f},{k},{k}\n" for k in range(30))
    path.write_text(above + rows)
    with pytest.raises(
        BadInput,
        match=r"line 3: has 3 values, the header has 2 columns; as 31 lines have: remove what",
    ) as e:
        read_log(path, ARM)
    assert "begin it with #" in str(e.value)
    for mended in (rows, re.sub("(?m)^", "# ", above.strip()) + "\n" + rows):
        path.write_text(mended)
        read_log(path, ARM)


def archived(path, **arrays):
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize("time", [M["time"], M["time"][:, None], M["time"][None, :]])
@pytest.mark.parametrize("name", ["time", "t"])
def test_a_time_of_one_row_or_one_column_is_a_time(tmp_path, time, name):
    path = archived(
        tmp_path / "run.npz",
        **{name: time},
        q=M["q"],
        tau1=M["tau"][:, :1],
        tau2=M["tau"][None, :, 1],
        dt=0.01,
    )
    (trial,) = read_log(path, ARM).trials
    np.testing.assert_array_equal(trial.time, M["time"])
    np.testing.assert_array_equal(trial.q, M["q"])
    np.testing.assert_array_equal(trial.u, M["tau"])


@pytest.mark.parametrize("time", [M["time"], M["time"][None, :]])
def test_arrays_with_a_row_for_each_joint_are_turned_and_told(tmp_path, time):
    path = archived(tmp_path / "run.npz", time=time, q=M["q"].T, tau=M["tau"], gains=np.ones(2))
    log = read_log(path, ARM)
    np.testing.assert_array_equal(log.trials[0].q, M["q"])
    np.testing.assert_array_equal(log.trials[0].u, M["tau"])
    assert "arrays with a row for each joint turned to a row for each sample: q" in log.notes


def test_one_array_of_one_joint_is_still_the_first_joints(tmp_path):
    path = archived(tmp_path / "run.npz", time=M["time"], q=M["q"][:, :1])
    log = read_log(path, ("shoulder", "elbow"))
    assert log.joint_names == ("shoulder",)


def test_arrays_of_other_lengths_are_told_in_a_short_line(tmp_path):
    path = archived(tmp_path / "run.npz", time=M["time"], q=M["q"].T[:, 1:], tau=M["tau"])
    with pytest.raises(
        BadInput,
        match=r"arrays differ in length \(time 60, q 2 x 59, tau 60 x 2\); save them with one row",
    ):
        read_log(path, ARM)


def test_separators_at_the_ends_of_rows_open_no_columns(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time,q1\n" + ROWS.replace("\n", ",,\n"))
    assert list(read_table(path, ("time", "q1")).columns["q1"]) == list(range(30))
    path.write_text("time,q1\n" + ROWS.replace("5\n", "5,word\n", 1))
    with pytest.raises(
        BadInput, match="has 3 values, the header has 2 columns; complete or remove that line"
    ):
        read_table(path, ("time", "q1"))


@pytest.mark.parametrize(
    "columns",
    [
        'q = ["q[0]", "q[2]", "q[1]", "q[3]"]\ntarget = ["u[0]", "u[2]", "u[1]", "u[3]"]',
        "\n".join(
            f'{ours}_{joint} = "{theirs}[{place}]"'
            for ours, theirs in (("q", "q"), ("target", "u"))
            for joint, place in zip(("lh", "lk", "rh", "rk"), (0, 2, 1, 3), strict=True)
        ),
    ],
    ids=["lists", "by joint"],
)
@pytest.mark.parametrize("kind", ["npz", "csv"])
def test_arrays_in_another_order_than_the_models(tmp_path, columns, kind):
    """Joint level by joint level in the file, leg by leg in the model; another array is left."""
    m, legs = motion(4), ("lh", "lk", "rh", "rk")
    arrays = {"q": m["q"][:, [0, 2, 1, 3]], "u": m["tau"][:, [0, 2, 1, 3]]}
    data = tmp_path / "data"
    data.mkdir()
    if kind == "npz":
        np.savez(data / "run.npz", time=m["time"], **arrays)
    else:
        rows = zip(m["time"], arrays["q"].tolist(), arrays["u"].tolist(), strict=True)
        lines = ["time,q,u", *(f'{t},"{q}","{u}"' for t, q, u in rows)]
        (data / "run.csv").write_text("\n".join(lines) + "\n")
    (data / "meta.toml").write_text(f"{HEAD}[columns]\n{columns}\n")
    log = read_log(data, legs)
    np.testing.assert_allclose(log.trials[0].q, m["q"], rtol=1e-12)
    np.testing.assert_allclose(log.trials[0].u, m["tau"], rtol=1e-12)
    assert not any("without names" in note for note in log.notes)
    (data / "meta.toml").write_text(HEAD)
    notes = read_log(data, legs).notes
    assert any("q holds a number for each joint, without names: taken in" in n for n in notes)
    (data / "meta.toml").write_text(f'{HEAD}[columns]\nq_lh = "q[4]"\n')
    with pytest.raises(BadInput, match=r"has no place 'q\[4\]', which \[columns\] gives to q_lh"):
        read_log(data, legs)
