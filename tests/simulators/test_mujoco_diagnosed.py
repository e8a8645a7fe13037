"""What MuJoCo as a diagnosed simulator names: an arm with a payload, a box on a floor, an IMU without a pose, a coarse step."""

import numpy as np
import pytest

from adaptsim_jax import cli
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.simulators.mujoco.coarse import change, halved, told
from adaptsim_jax.simulators.mujoco.diagnosed import diagnose, simulator
from tests.simulators.robots import record
from tests.simulators.test_mujoco import ARM, swing

BOX = """<mujoco><option timestep="0.002" cone="elliptic"/><worldbody><geom name="floor" type="plane" size="9 9 0.1" friction="{mu}"/>
<body name="box" pos="0 0 0.049"><freejoint name="root"/><geom type="box" size="0.1 0.08 0.05" mass="1" friction="{mu}"/>
<site name="imu" pos="0.02 0 0.01"/></body></worldbody>
<sensor><gyro name="gyro" site="imu"/><accelerometer name="accel" site="imu"/></sensor></mujoco>"""


def noisy(folder, size: float, columns: slice):
    """The logs of a folder with noise of that size."""
    rng = np.random.default_rng(0)
    for path in sorted(folder.glob("*.csv")):
        rows, head = np.loadtxt(path, delimiter=",", skiprows=1), path.read_text().split("\n")[0]
        rows[:, columns] += size * rng.standard_normal(rows[:, columns].shape)
        np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.9g")
    return folder


def swung(folder, **truth):
    own = {"damping": 0.1, "mass": 0.5, "kp": 30}
    texts = ARM.format(**own), ARM.format(**own | truth)
    return noisy(record(folder, texts[0], truth=texts[1], told=swing, every=2, trials=6, seconds=1.5), 1e-4, slice(1, 3))


def test_a_payload_is_named_and_its_size_found(tmp_path):
    data = swung(tmp_path / "log", mass=0.6)
    assert cli.main(["diagnose", str(data), "--simulator", "mujoco", "--out", str(tmp_path / "out"), "--json"]) == 0
    report = diagnose(*read_source_and_log(data))
    (effect,) = report["effects"]
    assert effect["name"] == "payload at lower" and report["error"]["after"] < 1.2
    assert effect["parameters"]["body:lower.mass"]["value"] == pytest.approx(0.6, rel=0.02)
    assert (tmp_path / "out" / "report.html").exists() and "payload at lower" in (tmp_path / "out" / "model.toml").read_text()


def test_an_arm_that_is_as_its_file_has_it_lacks_nothing(tmp_path):
    report = diagnose(*read_source_and_log(swung(tmp_path / "log", damping=0.2)))
    assert report["verdict"] == "within_noise" and not report["effects"]
    assert report["declared"]["after"]["joint:elbow.damping"]["value"] == pytest.approx(0.2, rel=0.05)
