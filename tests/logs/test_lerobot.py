"""LeRobot data sets, written here with pyarrow in both layouts."""

import json
import sys

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.read import read_log
from tests.logs.log_files import motion

pa = pytest.importorskip("pyarrow", reason="extra 'lerobot' is not installed")
parquet = pytest.importorskip("pyarrow.parquet")

ARM = ("shoulder", "elbow")
M = motion(2, rows=40, dt=1 / 30)


def data_set(path, *, names=("shoulder.pos", "elbow.pos"), one_file=True, drop=(), features=None):
    vector = {"dtype": "float32", "shape": [len(names)], "names": list(names)}
    info = {
        "codebase_version": "v3.0",
        "fps": 30,
        "features": features
        or {
            "observation.state": vector,
            "action": {**vector, "names": {"motors": list(names)}},
            "timestamp": {"dtype": "float32", "shape": [1]},
            "episode_index": {"dtype": "int64", "shape": [1]},
        },
    }
    for name in drop:
        del info["features"][name]
    (path / "meta").mkdir(parents=True)
    (path / "meta" / "info.json").write_text(json.dumps(info))
    rows = {
        "observation.state": [*M["q"].tolist(), *(-M["q"]).tolist()],
        "action": [*(M["q"] + 1).tolist(), *M["q"].tolist()],
        "timestamp": [*M["time"], *M["time"]],
        "episode_index": [0] * 40 + [1] * 40,
        "frame_index": [*range(40), *range(40)],
    }
    rows = {name: values for name, values in rows.items() if name not in drop}
    files = (
        [(slice(0, 80), "chunk-000/file-000")]
        if one_file
        else [
            (slice(0, 40), "chunk-000/episode_000000"),
            (slice(40, 80), "chunk-000/episode_000001"),
        ]
    )
    for part, name in files:
        file = path / "data" / f"{name}.parquet"
        file.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(pa.table({k: v[part] for k, v in rows.items()}), file)
    return path


@pytest.mark.parametrize("one_file", [True, False])
def test_episodes_are_trials_and_actions_targets(tmp_path, one_file):
    log = read_log(data_set(tmp_path / "set", one_file=one_file), ARM)
    assert [t.name for t in log.trials] == ["episode_0", "episode_1"]
    assert (log.input_kind, log.joint_names) == ("command", ARM)
    np.testing.assert_allclose(log.trials[0].q, M["q"])
    np.testing.assert_allclose(log.trials[1].q, -M["q"])
    np.testing.assert_allclose(log.trials[0].u, M["q"] + 1)
    np.testing.assert_allclose(log.trials[1].time, M["time"])


def test_names_one_level_deeper(tmp_path):
    """`names` of info.json as a list of lists, actions as lists of one list."""
    features = {
        "observation.state": {"dtype": "float32", "shape": [2], "names": [["elbow", "shoulder"]]},
        "action": {
            "dtype": "float32",
            "shape": [1, 2],
            "names": {"motors": [["elbow", "shoulder"]]},
        },
        "timestamp": {"dtype": "float32", "shape": [1]},
        "episode_index": {"dtype": "int64", "shape": [1]},
    }
    path = data_set(tmp_path / "set", features=features)
    file = path / "data" / "chunk-000" / "file-000.parquet"
    table = parquet.read_table(file).to_pydict()
    table["action"] = [[row] for row in table["action"]]
    parquet.write_table(pa.table(table), file)
    log = read_log(path, ARM)
    np.testing.assert_allclose(log.trials[0].q, M["q"][:, ::-1])
    np.testing.assert_allclose(log.trials[0].u, M["q"][:, ::-1] + 1)


def test_an_episode_that_is_too_short_is_left_out(tmp_path):
    path = data_set(tmp_path / "set")
    file = path / "data" / "chunk-000" / "file-000.parquet"
    table = parquet.read_table(file)
    parquet.write_table(table.slice(30), file)  # ten rows of the first episode
    log = read_log(path, ARM)
    assert [t.name for t in log.trials] == ["episode_1"]
    assert "fewer than 20 rows, left out: episode_0" in log.notes
    parquet.write_table(table.slice(70), file)
    with pytest.raises(BadInput, match="episode_1 has 10 rows; a trial needs at least 20"):
        read_log(path, ARM)


@pytest.mark.parametrize("how", ["next angle", "step to it"])
def test_actions_that_are_the_next_rows_angles_are_no_commands(tmp_path, how):
    path = data_set(tmp_path / "set")
    file = path / "data" / "chunk-000" / "file-000.parquet"
    table = parquet.read_table(file).to_pydict()
    q = np.array(table["observation.state"])
    after = np.concatenate([q[1:40], q[39:40], q[41:], q[-1:]])
    action = after if how == "next angle" else after - q
    table["action"] = action.tolist()
    parquet.write_table(pa.table(table), file)
    with pytest.raises(BadInput, match=r"'target_shoulder' is the .* targets = \"absolute\""):
        read_log(path, ARM)
    meta = tmp_path / "meta.toml"
    for targets, u in (("absolute", action), ("relative", q + action)):
        meta.write_text(f'task = "mechanism"\ndata = "set"\n[commands]\ntargets = "{targets}"\n')
        np.testing.assert_allclose(read_log(tmp_path, ARM).trials[0].u, u[:40])


def test_entries_without_names_go_by_their_order(tmp_path):
    vector = {"dtype": "float32", "shape": [2], "names": None}
    index = {"dtype": "int64", "shape": [1]}
    features = {"observation.state": vector, "action": vector, "episode_index": index}
    path = data_set(tmp_path / "set", features=features)
    log = read_log(path, ARM)
    np.testing.assert_allclose(log.trials[0].q, M["q"])
    np.testing.assert_allclose(log.trials[0].time, M["time"], atol=1e-9)
    assert any("30 times a second" in note for note in log.notes)
    for name in ("observation.state", "action"):
        assert f"{name} has no names: taken in the model's order of joints" in log.notes


def test_a_state_of_positions_and_speeds(tmp_path):
    log = read_log(data_set(tmp_path / "set", names=("elbow.pos", "elbow.vel")), ("elbow",))
    np.testing.assert_allclose(log.trials[0].q[:, 0], M["q"][:, 0])
    np.testing.assert_allclose(log.trials[0].v[:, 0], M["q"][:, 1])


def test_units_and_ignored_joints_of_meta_toml(tmp_path):
    path = data_set(tmp_path / "set", names=("elbow.pos", "gripper.pos"))
    with pytest.raises(BadInput, match="the model has no joint 'gripper'"):
        read_log(path, ("elbow",))
    (path / "meta.toml").write_text(
        'task = "mechanism"\nignore = ["gripper"]\n[units]\nangle = "deg"\n'
    )
    log = read_log(path, ("elbow",))
    np.testing.assert_allclose(log.trials[0].q[:, 0], np.radians(M["q"][:, 0]))
    np.testing.assert_allclose(log.trials[0].u[:, 0], np.radians(M["q"][:, 0] + 1))


def test_bad_sets(tmp_path):
    with pytest.raises(BadInput, match=r"has no feature 'observation.state'"):
        read_log(data_set(tmp_path / "a", drop=("observation.state",)), ARM)
    path = data_set(tmp_path / "b")
    file = next(path.rglob("*.parquet"))
    file.write_bytes(file.read_bytes()[:-20])
    with pytest.raises(BadInput, match="is no readable Parquet file"):
        read_log(path, ARM)
    file.unlink()
    with pytest.raises(BadInput, match="download the data set whole"):
        read_log(path, ARM)
    (path / "meta" / "info.json").write_text("{")
    with pytest.raises(BadInput, match=r"info\.json: is no description"):
        read_log(path, ARM)


def test_without_the_library_the_mend_is_named(tmp_path, monkeypatch):
    path = data_set(tmp_path / "set")
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(
        BadInput, match=r"needs pyarrow; run: pip install 'adaptsim_jax\[lerobot\]'"
    ):
        read_log(path, ARM)
