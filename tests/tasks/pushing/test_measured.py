"""A camera's record of pushes: what the task sees of it, and every record that it must not take."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.table import read_table
from adaptsim_jax.tasks.pushing import measured, model, planar
from adaptsim_jax.tasks.pushing import task as pushing
from adaptsim_jax.tasks.pushing.task import PushingConfig
from adaptsim_jax.tasks.robot_trials import AskedTrials

CONFIG = PushingConfig(hidden=(16,))
PUSHES = AskedTrials(
    np.array([3, 4]),
    np.array([[0.8, 0.03], [0.9, -0.05]]),
    np.array([[0.6, 0.1], [0.75, -0.15]], np.float32),
)


def places(duration=1.4):
    """`[2, 140, 2]` m: the two pushes simulated."""
    options = model.PushOptions(duration=duration)
    params = jnp.array([0.15, 1e5, 0.5, 0.0])
    return np.asarray(
        jax.jit(jax.vmap(lambda a: planar.rollout(params, a, options)))(jnp.asarray(PUSHES.actions))
    )


PLACES = places()


def record(rate=60.0, until=1.35):
    """Rows `[n, 4]` of trial, time, x, y as a camera of that rate would see them."""
    out = []
    for number, track in zip(PUSHES.numbers, PLACES, strict=True):
        time = np.arange(0.0, until, 1 / rate)
        known = np.concatenate([[model.START], track])
        at = [np.interp(time, 0.01 * np.arange(141), known[:, k]) for k in range(2)]
        out.append(np.column_stack([np.full(len(time), number), time, *at]))
    return np.concatenate(out)


def write(path, rows, header="trial,time,x,y"):
    path.write_text("\n".join([header, *(",".join(f"{v:.15g}" for v in row) for row in rows), ""]))
    return path


def moved(rows, by):
    return rows + np.array(by)


def take(path, config=CONFIG):
    table = read_table(path, measured.COLUMNS, min_rows=1)

    def at(i):
        return f"{path}: {table.row_word} {table.lines[i]}"

    return measured.measured_trajectory(table.columns, at, str(path), PUSHES, config)


@pytest.mark.parametrize("rate, tolerance", [(100.0, 1e-5), (30.0, 1.5e-3), (15.0, 4e-3)])
def test_a_record_is_the_trajectory_that_was_simulated(tmp_path, rate, tolerance):
    """To rounding at the simulator's rate; to what a straight line misses of a braking bottle
    between slower frames.
    """
    got = take(write(tmp_path / "m.csv", record(rate)))
    points = PLACES[:, [21, 42, 64, 86, 107, 129]]
    np.testing.assert_allclose(got.points, points, atol=tolerance)
    np.testing.assert_allclose(got.goals, PUSHES.contexts, atol=1e-6)
    apart = np.linalg.norm(points[:, -1] - PUSHES.contexts, axis=1)
    np.testing.assert_allclose(got.rewards, np.maximum(0, 1 - apart / 0.2), atol=6 * tolerance)
    np.testing.assert_allclose(got.tested, got.rewards.mean(), atol=1e-6)


def test_rows_of_trials_may_alternate_and_begin_before_the_arm_does(tmp_path):
    rows = record()
    plain = take(write(tmp_path / "a.csv", rows))
    mixed = rows[np.argsort(rows[:, 1], kind="stable")]
    early = np.array([[number, -t, *model.START] for t in (0.05, 0.02) for number in (3, 4)])
    again = take(write(tmp_path / "b.csv", np.concatenate([early, mixed])))
    np.testing.assert_array_equal(again.points, plain.points)


def test_the_final_position_alone_serves_where_no_more_is_observed(tmp_path):
    rows = np.column_stack([PUSHES.numbers, [1.3, 1.31], PLACES[:, 129]])
    config = replace(CONFIG, observation="final")
    got = take(write(tmp_path / "m.csv", rows), config)
    np.testing.assert_allclose(got.points[:, -1], PLACES[:, 129], atol=1e-6)
    assert np.isfinite(pushing.observed(got, config)).all()
    with pytest.raises(BadInput, match=r"line 2: trial 3: begins at 1\.3 s"):
        take(tmp_path / "m.csv")
    with pytest.raises(BadInput, match=r"trial 3: no row at 1\.3 s"):
        take(write(tmp_path / "m.csv", moved(rows, [0, 0.4, 0, 0])), config)


def changed(column, value, row=10):
    def change(rows):
        rows[row, column] = value
        return rows

    return change


def scaled(*columns, by):
    def change(rows):
        rows[:, columns] *= by
        return rows

    return change


FRAMES = 81  # of a trial
BAD = {
    "millimetres": (
        scaled(2, 3, by=1000),
        "line 2: x = 560 m is beyond any push; it looks like mm: write metres",
    ),
    "milliseconds": (
        scaled(1, by=1000),
        "line 82: trial 3: lasts 1333.33 s; is time in ms? write seconds",
    ),
    "a trial never asked": (
        changed(0, 7),
        "line 12: trial 7 was never asked for; asked are 3 and 4",
    ),
    "trial 0": (changed(0, 0), "line 12: trial 0 was never asked for"),
    "a trial of before": (
        changed(0, 2),
        "line 12: trial 2 was told already; name the file of 3 and 4",
    ),
    "no whole trial": (changed(0, 3.5), "line 12: trial 3.5 is no whole number"),
    "a trial missing": (
        lambda rows: rows[:FRAMES],
        "m.csv: trial 4 is missing; record trials 3, 4 into one file",
    ),
    "a time twice": (
        changed(1, 9 / 60),
        "line 12: trial 3: time repeats (0.15 then 0.15); sort or remove such rows",
    ),
    "time backwards": (changed(1, 0.1), "line 12: trial 3: time runs backwards (0.15 then 0.1)"),
    "not a number": (
        changed(2, np.nan),
        "line 12: column x holds no number; fill or remove such rows",
    ),
    "infinite": (changed(3, np.inf, 90), "line 92: column y is inf; fill or remove such rows"),
    "a gap": (
        lambda rows: np.delete(rows, range(FRAMES + 20, FRAMES + 30), 0),
        "line 103: trial 4: nothing was recorded from 0.3167 to 0.5 s; a gap of at most 0.1 s "
        "can be filled",
    ),
    "too short": (
        lambda rows: rows[rows[:, 1] < 1.0],
        "line 61: trial 3: ends at 0.9833 s; record it for 1.3 s",
    ),
    "begun late": (
        lambda rows: rows[rows[:, 1] > 0.3],
        "line 2: trial 3: begins at 0.316666667 s; record from the arm's",
    ),
    "the clock on the wall": (
        lambda rows: moved(rows, [0, 1.7e9, 0, 0]),
        "line 2: trial 3: begins at 1.7e+09 s; record from",
    ),
    "another frame": (
        lambda rows: moved(rows, [0, 0, -0.56, 0]),
        "line 2: trial 3: the bottle stands at (0, 0) m, 56 cm from",
    ),
    "another thing": (changed(3, 0.4, FRAMES + 40), "line 123: trial 4: the bottle jumps 4"),
    "never moved": (
        lambda rows: np.column_stack([rows[:, :2], 0 * rows[:, :2] + model.START]),
        "line 82: trial 3: the bott",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_record_is_refused_with_its_row(tmp_path, case):
    change, says = BAD[case]
    path = write(tmp_path / "m.csv", change(record()))
    with pytest.raises(BadInput) as refused:
        take(path)
    message = str(refused.value)
    assert says in message and message.startswith(str(path)) and "\n" not in message


@pytest.mark.parametrize(
    "text, says",
    [
        ("", "is empty"),
        ("trial,time,x\n3,0,0.56\n", "column 'y' is missing; needed are trial, time, x, y"),
        ("trial,time,x,y\n", "has 0 data rows"),
        ("3,0,0.56,0\n3,0.1,0.56,0\n", "add a header line such as trial,time,x,y"),
        ("trial,time,x,y\n3,0,0.56,here\n", "line 2: column y is 'here', not a number"),
        ("trial,time,x,y\n3,0,,0\n", "column x holds no number in any row"),
        ("trial,time,x,y\n3,0,0.56\n", "line 2: has 3 values, the header has 4"),
        ("trial;time;x;y\n3;0,1;0,56;0\n", "decimal comma"),
    ],
)
def test_a_file_that_is_no_record_is_refused(tmp_path, text, says):
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(BadInput) as refused:
        take(tmp_path / "m.csv")
    assert says in str(refused.value) and str(refused.value).startswith(str(tmp_path / "m.csv"))


def test_pushes_are_the_policys_for_goals_of_the_task_and_new_each_time():
    naf = pushing.make_pushing_naf(CONFIG)
    policy = pushing.PushingPolicy(jax.jit(naf.init)(jax.random.key(1)).online)

    def ask(seed, told):
        return measured.trials_to_make(jax.random.key(seed), told, policy, CONFIG)

    first, again, second, other = ask(0, 0), ask(0, 0), ask(0, 1), ask(1, 0)
    assert first.numbers.tolist() == [1, 2] and second.numbers.tolist() == [3, 4]
    np.testing.assert_array_equal(first.contexts, again.contexts)
    goals = np.concatenate([first.contexts, second.contexts, other.contexts])
    assert len(np.unique(goals.round(6), axis=0)) == 6
    radius, angle = np.hypot(*(goals - [0.45, 0]).T), np.arctan2(goals[:, 1], goals[:, 0] - 0.45)
    assert np.all((radius > 0.25 - 1e-6) & (radius < 0.55 + 1e-6) & (np.abs(angle) < 0.175 + 1e-6))
    np.testing.assert_allclose(
        first.actions, pushing.make_policy(CONFIG)(policy, jnp.asarray(first.contexts)), atol=1e-6
    )


def test_a_policy_is_read_back_from_its_file(tmp_path):
    policy = pushing.PushingPolicy(
        jax.jit(pushing.make_pushing_naf(CONFIG).init)(jax.random.key(1)).online
    )
    table = {"hidden": [16], "policy": {"weights": policy.weights.tolist()}}
    configs.write(tmp_path / "best.toml", table)
    act, goal = measured.read_policy(tmp_path / "best.toml"), jnp.array([0.85, 0.02])
    np.testing.assert_allclose(act(goal), pushing.make_policy(CONFIG)(policy, goal), atol=1e-6)
    for bad in (
        {},
        {"hidden": [16], "policy": {"weights": [1.0]}},
        {"policy": 3},
        {"hidden": ["a"]},
    ):
        configs.write(tmp_path / "bad.toml", bad)
        with pytest.raises(BadInput, match="holds no policy of the push"):
            measured.read_policy(tmp_path / "bad.toml")
