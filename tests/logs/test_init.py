"""`adaptsim init`: what it writes, what it guesses, what it refuses."""

import json
import tomllib

import numpy as np
import pytest

from adaptsim_jax.cli import main
from adaptsim_jax.logs.guess import guess, guess_units
from adaptsim_jax.logs.log import ActuatorName, ModelNames
from adaptsim_jax.logs.read import read_log, read_with_model
from tests.logs.log_files import motion, named, numbered, write_csv

ARM = ("shoulder", "elbow")
M = motion(2, rows=200)
URDF = """<robot name="arm">
  <link name="base"/>
  {links}
</robot>
"""
LINK = """<link name="{name}_link"><inertial><origin xyz="0 0 -0.1"/><mass value="1"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="{name}" type="continuous"><parent link="{parent}"/>
  <child link="{name}_link"/><axis xyz="0 1 0"/></joint>"""


def model(path):
    links = LINK.format(name="shoulder", parent="base") + LINK.format(
        name="elbow", parent="shoulder_link"
    )
    path.write_text(URDF.format(links=links))
    return path


def init(*words) -> int:
    return main(["init", *map(str, words)])


def test_a_folder_of_odd_columns_reads_after_init(tmp_path, capsys):
    columns = {
        "__time": 1e3 * M["time"],
        "/joint_states/shoulder/position": np.degrees(M["q"][:, 0]),
        "/joint_states/elbow/position": np.degrees(M["q"][:, 1]),
        "/joint_states/shoulder/velocity": M["v"][:, 0],
        "/joint_states/elbow/velocity": M["v"][:, 1],
        "/joint_states/shoulder/effort": M["tau"][:, 0],
        "/joint_states/elbow/effort": M["tau"][:, 1],
        "battery": M["time"] * 0 + 12,
    }
    write_csv(tmp_path / "logs" / "run.csv", columns)
    assert init(tmp_path / "logs", "--model", model(tmp_path / "arm.urdf")) == 0
    assert (
        "reads as 1 trial(s), 1.99 s, joints shoulder, elbow, input: torque"
        in capsys.readouterr().out
    )
    mechanism, log = read_with_model(tmp_path / "logs")
    assert mechanism.tree.joint_names == ARM
    np.testing.assert_allclose(log.trials[0].time, M["time"], atol=1e-12)
    np.testing.assert_allclose(log.trials[0].q, M["q"], atol=1e-12)
    np.testing.assert_allclose(log.trials[0].v, M["v"], atol=1e-12)
    np.testing.assert_allclose(log.trials[0].u, M["tau"], atol=1e-12)
    text = (tmp_path / "logs" / "meta.toml").read_text()
    table = tomllib.loads(text)
    assert table["units"] == {"time": "ms", "angle": "deg", "velocity": "rad/s"}
    assert all(
        "# guess" in line
        for line in text.splitlines()
        if line.startswith(("time =", "angle =", "convention")) and "_" not in line
    )


def test_arrays_of_joints_by_other_names(tmp_path, capsys):
    """An archive of `[T, n]` arrays in the words of robots' loggers; what no joint can be read from
    is told.
    """
    logs = tmp_path / "logs"
    logs.mkdir()
    arrays = {
        "timestamps": M["time"],
        "joint_positions": M["q"],
        "joint_velocities": M["v"],
        "efforts": M["tau"],
    }
    np.savez(logs / "run.npz", **arrays, torque_raw=M["tau"], contact=M["time"] > 1)
    assert init(logs, "--model", model(tmp_path / "arm.urdf")) == 0
    out = capsys.readouterr().out
    assert (
        "columns that are not used: torque_raw; name those that matter" in out
        and "input: torque" in out
    )
    table = tomllib.loads((logs / "meta.toml").read_text())
    assert table["columns"] == {
        "time": "timestamps",
        "q": "joint_positions",
        "v": "joint_velocities",
        "tau": "efforts",
    }
    (trial,) = read_log(logs).trials
    np.testing.assert_array_equal(trial.q, M["q"])
    np.testing.assert_array_equal(trial.u, M["tau"])


def test_an_archive_without_a_clock_says_what_it_has(tmp_path, capsys):
    np.savez(tmp_path / "run.npz", stamps=M["time"], q=M["q"])
    np.savez(tmp_path / "none.npz", stamps=M["time"])
    for name, there in (("run", "stamps, q"), ("none", "stamps")):
        assert (
            main(["replay", str(model(tmp_path / "arm.urdf")), str(tmp_path / f"{name}.npz")]) == 2
        )
        assert f"column 'time' is missing (there are {there}); add it" in capsys.readouterr().err


def test_a_file_needs_out_and_is_named_by_the_new_meta(tmp_path, capsys):
    run = write_csv(tmp_path / "run.csv", numbered(M, "q", "tau"))
    assert init(run) == 2
    assert "name a folder for meta.toml by --out" in capsys.readouterr().err
    assert init(run, "--out", tmp_path / "rig", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["written"] == str(tmp_path / "rig" / "meta.toml") and told["guesses"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rig", "run.csv"]
    log = read_log(tmp_path / "rig")
    assert [trial.name for trial in log.trials] == ["run"]


def test_it_never_overwrites(tmp_path, capsys):
    write_csv(tmp_path / "logs" / "run.csv", numbered(M, "q"))
    meta = tmp_path / "logs" / "meta.toml"
    meta.write_text("mine")
    assert init(tmp_path / "logs") == 2
    assert init(tmp_path / "logs", "--out", tmp_path / "logs") == 2
    assert init(tmp_path / "logs", "--out", tmp_path / "logs" / "sub") == 2
    assert meta.read_text() == "mine" and len(list((tmp_path / "logs").iterdir())) == 2
    for line in capsys.readouterr().err.splitlines():
        assert line.startswith("adaptsim: ")


def test_measured_pushes_need_no_init(tmp_path, capsys):
    (tmp_path / "actions.csv").write_text("trial,speed,angle\n1,0.6,0\n")
    assert init(tmp_path) == 2
    assert 'it needs one line, task = "pushing" or' in capsys.readouterr().err


@pytest.mark.parametrize("task", ["[1]", "{a = 1}", "3"])
def test_a_task_that_is_no_word(task, tmp_path, capsys):
    (tmp_path / "meta.toml").write_text(f"task = {task}\n")
    assert main(["diagnose", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "task must be text in quotes" in capsys.readouterr().err


@pytest.mark.parametrize("what", ["nothing", "empty", "bad model"])
def test_nothing_is_left_where_it_fails(tmp_path, what, capsys):
    data = tmp_path / "logs"
    words = []
    if what != "nothing":
        data.mkdir()
    if what == "bad model":
        write_csv(data / "run.csv", numbered(M, "q"))
        (tmp_path / "arm.xml").write_text("<mujoco>")
        words = ["--model", tmp_path / "arm.xml"]
    assert init(data, "--out", tmp_path / "rig", *words) == 2
    assert not (tmp_path / "rig").exists()
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_joint_without_a_log_beside_one_that_the_model_lacks_is_said(tmp_path, capsys):
    write_csv(tmp_path / "logs" / "run.csv", named(M, ("shoulder", "wrist"), "q"))
    assert init(tmp_path / "logs", "--model", model(tmp_path / "arm.urdf")) == 0
    shown = capsys.readouterr().out
    assert "nothing is logged of elbow, held" in shown and "q_wrist is left out" in shown


def test_joints_of_other_names_and_joints_that_the_model_lacks(tmp_path, capsys):
    m = motion(3, rows=60)
    write_csv(
        tmp_path / "logs" / "run.csv",
        named(m, ("shoulder_joint", "elbow_joint", "gripper"), "q", "tau"),
    )
    assert init(tmp_path / "logs", "--model", model(tmp_path / "arm.urdf")) == 0
    table = tomllib.loads((tmp_path / "logs" / "meta.toml").read_text())
    assert table["ignore"] == ["gripper"]
    assert table["columns"]["q_elbow"] == "q_elbow_joint"
    np.testing.assert_array_equal(read_log(tmp_path / "logs").trials[0].u, m["tau"][:, :2])


def test_a_command_by_its_actuators_name_is_no_joint_that_the_model_lacks():
    cart = ModelNames(
        ("rail", "pivot"), slides=("rail",), actuators=(ActuatorName("belt", "rail"),)
    )
    columns = {
        name: np.linspace(0.0, 1.0, 5)
        for name in ("time", "q_rail", "q_pivot", "ctrl_belt", "tau_belt")
    }
    found = guess(columns, cart)
    assert found.unknown_joints == (
        "tau_belt",
    )  # the column alone: a torque is named for its joint
    assert found.columns == {} and found.ignored == ()
    assert guess({name: columns[name] for name in list(columns)[:4]}, cart).unknown_joints == ()


def test_a_bag_with_its_topics(tmp_path, capsys):
    pytest.importorskip("rosbags.rosbag2", reason="extra 'ros' is not installed")
    from tests.logs.test_bags import Bag, states

    bag = Bag("mcap")
    states(bag)
    for i, t in enumerate(M["time"][:60]):
        bag.array("/arm/commands", 1_700_000_000_000_000_000 + round(t * 1e9), M["q"][i])
    path = bag.write(tmp_path)
    assert init(path, "--out", tmp_path / "rig") == 0
    table = tomllib.loads((tmp_path / "rig" / "meta.toml").read_text())
    assert table["ros"] == {"state_topic": "/joint_states", "command_topic": "/arm/commands"}
    assert table["input"] == "torque"
    assert read_log(tmp_path / "rig").joint_names == ARM
    assert init(path, "--out", tmp_path / "other", "--command-topic", "/arm/comands") == 2
    assert "did you mean '/arm/commands'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("columns", "units"),
    [
        (named(M, ARM, "q", "v"), {}),
        (
            named(M | {"q": np.degrees(M["q"])}, ARM, "q", "v"),
            {"angle": "deg", "velocity": "rad/s"},
        ),
        (named(M | {"v": np.degrees(M["v"])}, ARM, "q", "v"), {"velocity": "deg/s"}),
        (named(M | {"v": M["v"] * 60 / (2 * np.pi)}, ARM, "q", "v"), {"velocity": "rpm"}),
        (named(M | {"q": np.degrees(M["q"])}, ARM, "q"), {"angle": "deg"}),
        (named(M | {"time": M["time"] * 1e9}, ARM, "q", "v"), {"time": "ns"}),
        (named(M | {"time": M["time"] * 1e6}, ARM, "q"), {"time": "us"}),
    ],
)
def test_units_that_numbers_betray(columns, units):
    assert {key: unit for key, (unit, _) in guess_units(columns).items()} == units


def test_column_names_of_many_kinds():
    row = np.arange(30.0)
    names = {
        "Time [s]": "time",
        "joint_1_pos": "q1",
        "pos.joint2": "q2",
        "shoulder_pan.velocity": "v_shoulder_pan",
        "J1 current": "i1",
        "elbow_pos_desired": "target_elbow",
        "elbow torque (Nm)": "tau_elbow",
    }
    found = guess({name: row for name in names}, ModelNames(("shoulder_pan", "elbow")))
    assert {theirs: ours for ours, theirs in found.columns.items()} == names
