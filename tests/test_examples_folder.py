"""The files of `examples/`, which the pages show, are taken by their readers (the package there:
test_extend_page.py).
"""

import shutil
from pathlib import Path

import pytest

from adaptsim_jax.adaptation.sweep_read import read_sweep
from adaptsim_jax.logs.log_meta import read_log_meta
from adaptsim_jax.logs.pendulum import read_pendulum_meta

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.slow
def test_a_sweep():
    sweep = read_sweep(EXAMPLES / "sweep.toml")
    assert len(sweep.members) == 16 * 4 * 8 * 2


def test_meta_of_a_mechanism(tmp_path):
    (tmp_path / "bags").mkdir()
    (tmp_path / "logs").mkdir()
    for name in ("bags/run.mcap", "logs/robot.xml"):
        (tmp_path / name).touch()
    meta = read_log_meta(
        shutil.copy(EXAMPLES / "meta_mechanism.toml", tmp_path / "logs" / "meta.toml")
    )
    assert meta.columns["tau_elbow"] == "motor2" and meta.fit == {
        "inertias": True,
        "damping": ["elbow"],
    }


def test_meta_of_a_pendulum():
    rig = read_pendulum_meta(EXAMPLES / "meta_pendulum.toml")[0].rig
    assert rig.known == {"b1": 0.01} and rig.unactuated == (1,)


@pytest.mark.parametrize("folder", ["so101", "go2_hung", "panda_hand"])
def test_logs_of_robots(tmp_path, folder):
    """The script's log is read by the folder's meta.toml, of a hung quadruped of our own with a
    gripper's name where one is held.
    """
    from importlib import util

    from adaptsim_jax.logs.read import read_source_and_log
    from tests.simulators.robots import quadruped

    module = util.spec_from_file_location("robot_log", EXAMPLES / "robot_log.py")
    script = util.module_from_spec(module)
    module.loader.exec_module(script)
    model = tmp_path / "model.xml"
    model.write_text(quadruped().replace("fl_knee", "gripper"))
    script.main([str(model), str(tmp_path / folder), *(["--degrees"] if folder == "so101" else [])])
    shutil.copy(EXAMPLES / folder / "meta.toml", tmp_path / folder)
    _, log = read_source_and_log(tmp_path / folder)
    assert len(log.trials) == 4 and log.input_kind == "command" and abs(log.trials[0].q).max() < 2.0
    assert ("gripper" in log.held) == (folder == "so101")


def test_a_simulator_and_a_trainer_of_anyone():
    """Where Gymnasium and torch are installed: what the example's functions give."""
    for name in ("gymnasium", "mujoco", "torch"):
        pytest.importorskip(name)
    from runpy import run_path

    made = run_path(str(EXAMPLES / "gymnasium_torch.py"))
    policy = made["train"]({"pole": (5.0, 5.0), "damping": (1.0, 1.0), "gear": (90.0, 90.0)})
    score, obs = made["returns"](policy, [[5.0, 1.0, 90.0], [8.0, 3.0, 50.0]], 1)
    assert score.shape == (2,) and obs.shape == (2, 24) and -2.0 < score[0] < 0.0
