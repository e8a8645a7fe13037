"""Numbers that are no angles, and names that are not the numbers': LeRobot's per cent, grippers,
encoder steps. With the advice done.
"""

import json
import re

import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.begin import begin
from adaptsim_jax.logs.log import ActuatorName, ModelNames
from adaptsim_jax.logs.read import read_log
from tests.faults.servo_files import sines
from tests.logs.log_files import HEAD, folder

pa = pytest.importorskip("pyarrow", reason="extra 'lerobot' is not installed")
parquet = pytest.importorskip("pyarrow.parquet")

ARM = ("shoulder", "elbow")
Q = sines(1, 90, 30.0, 2, 1.1)
U = sines(2, 90, 30.0, 2, 1.1)
LOW, HIGH = np.array([-0.7, -0.6]), np.array([0.8, 0.5])


def names_of(joints, ranges=()):
    return ModelNames(
        joints,
        actuators=tuple(ActuatorName(f"p_{j}", j, "position") for j in joints),
        ranges=ranges,
    )


def data_set(path, state, action, names, named=None):
    vector = {
        "dtype": "float32",
        "shape": [state.shape[1]],
        "names": named if named is not None else list(names),
    }
    features = {
        "observation.state": vector,
        "action": vector,
        "timestamp": {"dtype": "float32", "shape": [1]},
    }
    (path / "meta").mkdir(parents=True)
    (path / "meta" / "info.json").write_text(
        json.dumps({"codebase_version": "v3.0", "fps": 30, "features": features})
    )
    table = {
        "observation.state": state.astype(np.float32).tolist(),
        "action": action.astype(np.float32).tolist(),
        "timestamp": np.arange(len(state)) / 30,
    }
    (path / "data" / "chunk-000").mkdir(parents=True)
    parquet.write_table(pa.table(table), path / "data" / "chunk-000" / "file-000.parquet")
    return path


def meta(path, text, data="../set"):
    path.mkdir(parents=True, exist_ok=True)
    (path / "meta.toml").write_text(f'{HEAD}data = "{data}"\n{text}')
    return path


def percent(x):
    return np.clip(200 * (x - LOW) / (HIGH - LOW) - 100, -100, 100)


def test_per_cent_of_a_range_is_told_in_every_command_and_read_as_advised(tmp_path):
    data_set(tmp_path / "set", percent(Q), percent(U), [f"{n}.pos" for n in ARM])
    degrees = read_log(meta(tmp_path / "deg", '[units]\nangle = "deg"\n'), names_of(ARM))
    assert any("end at exactly 100" in note for note in degrees.notes)
    with pytest.raises(BadInput, match="per cent of the joint's range") as error:
        read_log(meta(tmp_path / "none", ""), names_of(ARM))
    begun = begin(tmp_path / "set", tmp_path / "begun", None, {})
    assert 'angle = "deg"' not in begun.text and "LOW" in begun.to_mend
    lines = re.findall(r"q_\w+ = {from = \[-100, 100\], to = \[LOW, HIGH\]}", str(error.value))
    assert len(lines) == 2
    filled = [
        line.replace("LOW", str(low)).replace("HIGH", str(high))
        for line, low, high in zip(lines, LOW, HIGH, strict=True)
    ]
    log = read_log(meta(tmp_path / "mended", "[units]\n" + "\n".join(filled)), names_of(ARM))
    np.testing.assert_allclose(log.trials[0].q, np.clip(Q, LOW, HIGH), atol=1e-5)
    np.testing.assert_allclose(log.trials[0].u, np.clip(U, LOW, HIGH), atol=1e-5)
    assert not any("100" in note for note in log.notes)


@pytest.mark.parametrize("known", [True, False])
def test_a_gripper_has_a_scale_of_its_own(tmp_path, known):
    joints, low, high = (*ARM, "gripper"), -0.2, 1.8
    grip = 0.8 + 0.5 * np.sin(np.arange(90) / 10)

    def share(x, g):
        return np.column_stack([np.degrees(x), 100 * (g - low) / (high - low)])

    data_set(tmp_path / "set", share(Q, grip), share(U, grip + 0.1), [f"{n}.pos" for n in joints])
    model = names_of(joints, (None, None, (low, high) if known else None))
    told = read_log(meta(tmp_path / "deg", '[units]\nangle = "deg"\n'), model)
    (note,) = [n for n in told.notes if "grippers as 0 to 100" in n]
    line = re.search(r"q_gripper = (\"percent\"|{percent = \[LOW, HIGH\]})", note)[0]
    assert ("LOW" in line) != known
    line = line.replace("LOW", str(low)).replace("HIGH", str(high))
    log = read_log(meta(tmp_path / "mended", f'[units]\nangle = "deg"\n{line}\n'), model)
    np.testing.assert_allclose(log.trials[0].q, np.column_stack([Q, grip]), atol=1e-5)
    np.testing.assert_allclose(log.trials[0].u, np.column_stack([U, grip + 0.1]), atol=1e-5)
    from adaptsim_jax.logs.guess import guess
    from adaptsim_jax.logs.lerobot import read_lerobot
    from adaptsim_jax.logs.readers import Wanted

    found = guess(read_lerobot(tmp_path / "set", Wanted())[0].columns, model, lerobot=True)
    assert found.units["angle"][0] == "deg" and found.units["q_gripper"][0].is_complete == known


def test_degrees_are_no_per_cent(tmp_path):
    data_set(tmp_path / "set", np.degrees(Q), np.degrees(U), [f"{n}.pos" for n in ARM])
    log = read_log(meta(tmp_path / "deg", '[units]\nangle = "deg"\n'), names_of(ARM))
    assert not any("100" in note for note in log.notes)
    begun = begin(tmp_path / "set", tmp_path / "begun", None, {})
    assert 'angle = "deg"' in begun.text
    setpoints = {"time": np.arange(90) / 30} | {
        "q1": np.degrees(Q[:, 0]),
        "target1": np.repeat([0.0, 100.0, -50.0], 30),
    }
    log = read_log(
        folder(tmp_path / "round", '[units]\nangle = "deg"\n', run=setpoints), names_of(("arm",))
    )
    assert not any("per cent" in note for note in log.notes)


def test_a_share_of_the_range_is_told_and_read_as_advised(tmp_path):
    def share(x):
        return np.clip(2 * (x - LOW) / (HIGH - LOW) - 1, -1, 1)

    columns = {"time": np.arange(90) / 30} | {f"q_{n}": share(Q)[:, j] for j, n in enumerate(ARM)}
    (note,) = [
        n for n in read_log(folder(tmp_path / "a", "", run=columns), ARM).notes if "exactly 1" in n
    ]
    lines = re.findall(r"q_\w+ = {from = \[-1, 1\], to = \[LOW, HIGH\]}", note)
    filled = [
        x.replace("LOW", str(a)).replace("HIGH", str(b))
        for x, a, b in zip(lines, LOW, HIGH, strict=True)
    ]
    log = read_log(folder(tmp_path / "b", "[units]\n" + "\n".join(filled), run=columns), ARM)
    np.testing.assert_allclose(log.trials[0].q, np.clip(Q, LOW, HIGH), atol=1e-9)
    assert not any("exactly 1" in n for n in log.notes)


def test_an_episode_that_is_left_out_is_not_read(tmp_path):
    data_set(tmp_path / "set", Q[:9], U[:9], ARM)
    with pytest.raises(BadInput, match="episode_0 has 9 rows; a trial needs at least 20"):
        read_log(meta(tmp_path / "a", ""), names_of(ARM))
    with pytest.raises(BadInput, match="leaves no trial"):
        read_log(meta(tmp_path / "b", '[trials]\nexclude = ["episode_0"]\n'), names_of(ARM))


def test_steps_of_an_encoder_are_told_and_read_as_advised(tmp_path):
    def ticks(x):
        return np.round(2048 + x * 4096 / (2 * np.pi))

    columns = {"time": np.arange(90) / 30} | {f"q_{n}": ticks(Q[:, j]) for j, n in enumerate(ARM)}
    with pytest.raises(BadInput, match="encoder's steps") as error:
        read_log(folder(tmp_path / "a", "", run=columns), ARM)
    lines = re.findall(r"q_\w+ = {ticks = 4096, zero = 2048}", str(error.value))
    log = read_log(folder(tmp_path / "b", "[units]\n" + "\n".join(lines), run=columns), ARM)
    np.testing.assert_allclose(log.trials[0].q, Q, atol=1e-3)


@pytest.mark.parametrize(
    "named",
    [["shoulder", "elbow"], ["shoulder", "elbow", "elbow"], {"motors": ["shoulder", "elbow"]}],
)
def test_names_that_are_not_the_numbers_shift_no_joint(tmp_path, named):
    grip = 0.4 + 0.3 * np.sin(np.arange(90) / 10)
    data_set(tmp_path / "set", np.column_stack([grip, Q]), np.column_stack([grip, U]), (), named)
    with pytest.raises(BadInput, match=r"of the 3 numbers of observation.state.*elbow") as error:
        read_log(meta(tmp_path / "a", ""), names_of(ARM))
    assert '[columns] and q_shoulder = "observation.state[K]", K from 0 to 2' in str(error.value)
    columns = [
        f'q_{n} = "observation.state[{k}]"\ntarget_{n} = "action[{k}]"'
        for k, n in enumerate(ARM, start=1)
    ]
    log = read_log(meta(tmp_path / "b", "[columns]\n" + "\n".join(columns)), names_of(ARM))
    np.testing.assert_allclose(log.trials[0].q, Q, atol=1e-6)
    np.testing.assert_allclose(log.trials[0].u, U, atol=1e-6)
    info = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())
    for vector in ("observation.state", "action"):  # the other mend: all names in order
        info["features"][vector]["names"] = ["gripper", *ARM]
    (tmp_path / "set" / "meta" / "info.json").write_text(json.dumps(info))
    log = read_log(meta(tmp_path / "c", 'ignore = ["gripper"]\n'), names_of(ARM))
    np.testing.assert_allclose(log.trials[0].q, Q, atol=1e-6)


def test_numbers_without_names_that_are_more_than_the_joints_are_refused(tmp_path):
    grip = 0.4 + 0.3 * np.sin(np.arange(90) / 10)
    data_set(tmp_path / "set", np.column_stack([grip, Q]), np.column_stack([grip, U]), (), named=[])
    with pytest.raises(BadInput, match="3 numbers without names, the model 2 joint"):
        read_log(meta(tmp_path / "a", ""), names_of(ARM))
    columns = [f'q_{n} = "q_{k}"\ntarget_{n} = "target_{k}"' for k, n in enumerate(ARM, start=2)]
    text = 'ignore = ["q_1", "target_1"]\n[columns]\n' + "\n".join(columns)
    log = read_log(meta(tmp_path / "b", text), names_of(ARM))
    np.testing.assert_allclose(log.trials[0].q, Q, atol=1e-6)


@pytest.mark.parametrize(
    "line",
    [
        "q_elbow = {percent = [1.0]}",
        "q_elbow = {ticks = 0}",
        "q_elbow = {from = [0, 0], to = [0, 1]}",
        "q_elbow = 0.0",
        "q_elbow = true",
        'q_elbow = {percent = ["a", 1]}',
        "q_elbow = {scale = 1e999}",
    ],
)
def test_scales_that_are_none_are_refused(tmp_path, line):
    columns = {"time": np.arange(90) / 30} | {f"q_{n}": Q[:, j] for j, n in enumerate(ARM)}
    with pytest.raises(BadInput, match=r"units.q_elbow"):
        read_log(folder(tmp_path / "a", f"[units]\n{line}\n", run=columns), ARM)
    assert (
        read_log(folder(tmp_path / "b", "[units]\nq_elbow = 0.5\n", run=columns), ARM)
        .trials[0]
        .q[3, 1]
        == 0.5 * Q[3, 1]
    )
