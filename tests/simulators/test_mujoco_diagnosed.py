"""What MuJoCo as a diagnosed simulator names: an arm with a payload, a box on a floor, an IMU without a pose, a coarse step."""

import mujoco
import numpy as np
import pytest

from adaptsim_jax import cli
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.diagnosis.simulator import residuals
from adaptsim_jax.diagnosis.starts import anchored
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


AXES = [f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"]


def slid(folder, truth: str, *, pose: bool = True, trials: int = 6):
    """A box that was pushed over a floor, from rest on it at speeds that differ: its pose, or what its IMU reads."""
    folder.mkdir()
    (folder / "model.xml").write_text(BOX.format(mu=0.5))
    table = "" if pose else "[channels]\n" + "".join(f'{a} = "{a[:-2]}[{"xyz".index(a[-1])}]"\n' for a in AXES)
    (folder / "meta.toml").write_text(f'task = "mechanism"\nmodel = "model.xml"\n{table}')
    model, rng = mujoco.MjModel.from_xml_string(truth), np.random.default_rng(1)
    data = mujoco.MjData(model)
    head = ["time", *(f"base_{c}" for c in ("x", "y", "z", "qw", "qx", "qy", "qz"))] if pose else ["time", *AXES]
    for trial in range(trials):
        mujoco.mj_resetData(model, data)
        data.qvel[:2], data.qvel[5], rows = rng.uniform(-2, 2, 2), rng.uniform(-6, 6), []
        for row in range(60):
            place, turn = data.qpos[:3] + 2e-4 * rng.standard_normal(3), data.qpos[3:].copy()
            mujoco.mju_quatIntegrate(turn, 3e-4 * rng.standard_normal(3), 1.0)
            for step in range(5):
                mujoco.mj_step(model, data)
                if step == 0:
                    felt = data.sensordata + np.repeat([2e-3, 2e-2], 3) * rng.standard_normal(6)
            rows.append([0.01 * row, *place, *turn] if pose else [0.01 * row, *felt])
        np.savetxt(folder / f"run_{trial}.csv", rows, delimiter=",", header=",".join(head), comments="", fmt="%.9g")
    return folder


def test_a_floor_that_is_more_slippery_is_named(tmp_path):
    report = diagnose(*read_source_and_log(slid(tmp_path / "log", BOX.format(mu=0.35))))
    (effect,) = report["effects"]
    assert effect["name"] == "floor friction at all contacts"
    assert effect["parameters"]["contact.friction[0]"]["value"] == pytest.approx(0.35, rel=0.05)


def test_a_base_that_only_its_imu_tells_of_is_estimated_with_the_start(tmp_path):
    made = simulator(*read_source_and_log(slid(tmp_path / "log", BOX.format(mu=0.5), pose=False)))
    assert made.made.free == 0 and made.made.base < 0 and [c.unit for c in made.channels] == ["rad/s"] * 3 + ["m/s^2"] * 3
    neutral = np.array([q.neutral for q in made.quantities])
    found = anchored(made, neutral)
    left = residuals(made, np.tile(neutral, (made.stretches.count, 1)), found.starts, np.arange(made.stretches.count))
    assert np.median(np.square(left).sum(1) / made.stretches.seen.sum((1, 2))) < 1.5
    at = [made.made.model.nv, made.made.model.nv + 1]  # speeds along the floor, from rest by the guess: told by what friction does
    speed = np.linalg.norm((made.own.qvel[:, :2] + found.starts[:, at]), axis=1)
    assert np.all(np.isfinite(speed)) and np.abs(found.starts[:, :2]).max() < 0.05  # where it is, nothing tells


def test_sensors_that_the_model_has_not_are_refused(tmp_path):
    data = slid(tmp_path / "log", BOX.format(mu=0.5), pose=False, trials=1)
    text = (data / "meta.toml").read_text()
    for bad, says in (("gyra[0]", "no sensor 'gyra'; did you mean 'gyro'"), ("gyro[5]", "gyro has 3 numbers")):
        (data / "meta.toml").write_text(text.replace("gyro[0]", bad))
        with pytest.raises(BadInput, match="meta.toml: ") as error:
            simulator(*read_source_and_log(data))
        assert says in str(error.value)


def test_a_coarse_step_is_told_and_a_fine_one_is_not(tmp_path):
    data = swung(tmp_path / "log")
    made = simulator(*read_source_and_log(data))
    values = np.array([q.neutral for q in made.quantities])
    size = change(made, values)
    assert halved(made).made.model.opt.timestep == 0.002 and 0.0 < change(halved(made), values) < 0.7 * size
    assert bool(told(made, values)) == (size >= 1.0)
    (data / "model.xml").write_text((data / "model.xml").read_text().replace('timestep="0.004"', 'timestep="0.02"'))
    coarse = simulator(*read_source_and_log(data))
    (line,) = told(coarse, values)
    assert "step of 20 ms is coarse" in line
