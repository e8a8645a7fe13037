"""Tables that other programs export: several topics in one file, commands less often than states,
lists in cells, commands in a file of their own. With what is advised done.
"""

import re

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.begin import begin
from adaptsim_jax.logs.read import read_log
from tests.faults.servo_files import model, sines, swung
from tests.logs.log_files import HEAD

NAMES = ("left", "right")
RATE, EPOCH = 100.0, 1.7e9
U = sines(1, 120, RATE, 2)
Q = swung(U, RATE)
T = np.arange(120) / RATE


def export(path, head, rows):
    path.parent.mkdir(parents=True, exist_ok=True)

    def cell(x):
        return x if isinstance(x, str) else f"{x:.10g}"

    lines = [
        ",".join(head),
        *(
            ",".join([f"{t:.6f}", *map(cell, cells)])
            for t, cells in sorted(rows, key=lambda r: r[0])
        ),
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def meta(folder, text):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.xml").write_text(model(NAMES))
    (folder / "meta.toml").write_text(f'{HEAD}model = "robot.xml"\n{text}')
    return folder


@pytest.mark.parametrize("offset", [-2e-4, 2e-3, 9e-3])
def test_topics_of_one_export_come_onto_the_clock_of_the_states(tmp_path, offset):
    head = [
        "__time",
        *(f"/joint_states/{n}/position" for n in NAMES),
        "/commands/data[0]",
        "/commands/data[1]",
    ]
    rows = [(EPOCH + t, [*q, "", ""]) for t, q in zip(T, Q, strict=True)]
    rows += [(EPOCH + t + offset, ["", "", *u]) for t, u in zip(T, U, strict=True)]
    columns = [
        "[columns]",
        'time = "__time"',
        *(f'q_{n} = "/joint_states/{n}/position"' for n in NAMES),
        *(f'target_{n} = "/commands/data[{k}]"' for k, n in enumerate(NAMES)),
    ]
    data = meta(tmp_path / "log", "\n".join(columns))
    export(data / "run.csv", head, rows)
    log = read_log(data)
    assert any("held from when they came" in note for note in log.notes)
    (trial,) = log.trials
    share = (offset * RATE) % 1.0  # of a row, in which the command before still acts
    late = 1 if offset > 0 else 0
    first = round(120 - len(trial.time))
    np.testing.assert_allclose(trial.q, Q[first:], atol=1e-9)
    k = np.arange(first + 1, 118)
    now = share * U[k - late] + (1 - share) * U[k + 1 - late]
    np.testing.assert_allclose(trial.u[k - first], now, atol=2e-3)


@pytest.mark.parametrize("every", [4, 20])
def test_commands_that_come_less_often_than_states_hold(tmp_path, every):
    rows = [
        (t, [*q, *(u if k % every == 0 else ("", ""))])
        for k, (t, q, u) in enumerate(zip(T, Q, U, strict=True))
    ]
    data = meta(tmp_path / "log", "")
    export(data / "run.csv", ["time", "q_left", "q_right", "target_left", "target_right"], rows)
    (trial,) = read_log(data).trials
    np.testing.assert_allclose(trial.u, U[(np.arange(120) // every) * every], atol=1e-9)


def test_an_export_is_begun_and_reads(tmp_path):
    head = [
        "__time",
        *(f"/joint_states/{n}/position" for n in NAMES),
        "/commands/data[0]",
        "/commands/data[1]",
    ]
    rows = [(EPOCH + t, [*q, "", ""]) for t, q in zip(T, Q, strict=True)]
    rows += [(EPOCH + t - 1e-4, ["", "", *u]) for t, u in zip(T, U, strict=True)]
    export(tmp_path / "data" / "run.csv", head, rows)
    (tmp_path / "robot.xml").write_text(model(NAMES))
    begun = begin(tmp_path / "data", tmp_path / "meta", tmp_path / "robot.xml", {})
    assert begun.log is not None, begun.to_mend
    np.testing.assert_allclose(begun.log.trials[0].u, U, atol=5e-3)


def said(row):
    return '"[' + ", ".join(f"{x:.9g}" for x in row) + ']"'


@pytest.mark.parametrize(
    "cells",
    [
        said,
        lambda row: '"' + str(np.round(row, 9)) + '"',
        lambda row: f"({row[0]:.9g} {row[1]:.9g})",
    ],
)
def test_lists_in_cells_are_joints_in_order(tmp_path, cells):
    data = meta(tmp_path / "log", '[columns]\ntarget = "goal_of_all"\n')
    rows = [(t, [cells(q), cells(u)]) for t, q, u in zip(T, Q, U, strict=True)]
    export(data / "run.csv", ["time", "positions", "goal_of_all"], rows)
    log = read_log(data)
    np.testing.assert_allclose(log.trials[0].q, Q, atol=1e-8)
    np.testing.assert_allclose(log.trials[0].u, U, atol=1e-8)
    assert any("positions holds a number for each joint, without names" in n for n in log.notes)


def test_a_list_of_another_length_is_refused_by_its_line(tmp_path):
    data = meta(tmp_path / "log", "")
    rows = [
        (t, [said(q if k != 50 else q[:1]), said(u)])
        for k, (t, q, u) in enumerate(zip(T, Q, U, strict=True))
    ]
    export(data / "run.csv", ["time", "positions", "targets"], rows)
    with pytest.raises(
        BadInput, match="line 52: column positions holds a list of 1, the first one of 2"
    ):
        read_log(data)


def test_commands_in_a_file_of_their_own_are_told_and_read_as_advised(tmp_path):
    data = meta(tmp_path / "log", 'input = "command"\n')

    def us(t):
        return round((t + EPOCH) * 1e6)

    state = [f"STATE,{us(t)},{said(q)}" for t, q in zip(T, Q, strict=True)]
    control = [f"CONTROL,{us(t + 0.002)},{said(u)}" for t, u in zip(T, U, strict=True)]
    (data / "state_motor.csv").write_text("\n".join(["type,timestamp,positions", *state]) + "\n")
    (data / "control.csv").write_text("\n".join(["type,timestamp,positions", *control]) + "\n")
    with pytest.raises(
        BadInput, match=r"control.csv: looks like the commands of state_motor"
    ) as error:
        read_log(data)
    lines = re.search(r"commands = {.*?}", str(error.value))[0]
    meta(data, f'input = "command"\n[units]\ntime = "us"\n[trials]\n{lines}\n')
    log = read_log(data)
    (trial,) = log.trials
    np.testing.assert_allclose(trial.q, Q[1:], atol=1e-7)
    np.testing.assert_allclose(trial.u[:-1], 0.2 * U[:-2] + 0.8 * U[1:-1], atol=1e-3)


def test_a_folder_of_states_and_commands_is_begun_and_reads(tmp_path):
    data = tmp_path / "data"
    data.mkdir()
    (tmp_path / "robot.xml").write_text(model(NAMES))

    def rows(x):
        return (
            "\n".join(
                ["time,positions", *(f"{t:.6f},{said(r)}" for t, r in zip(T, x, strict=True))]
            )
            + "\n"
        )

    (data / "run_state.csv").write_text(rows(Q))
    (data / "run_command.csv").write_text(rows(U))
    begun = begin(data, tmp_path / "begun", tmp_path / "robot.xml", {})
    assert begun.log is not None, begun.to_mend
    np.testing.assert_allclose(begun.log.trials[0].u, U, atol=1e-8)
