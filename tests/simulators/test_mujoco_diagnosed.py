"""What MuJoCo as a diagnosed simulator names: an arm with a payload, a box on a floor, an IMU
without a pose, a coarse step.
"""

import mujoco
import numpy as np
import pytest

from adaptsim_jax import cli
from adaptsim_jax.attribution.replay import replay_files
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.simulators.mujoco.diagnosed import (
    change,
    diagnose,
    simulator,
    step_notes,
    with_half_step,
)
from adaptsim_jax.simulators.mujoco.replay import replayed
from tests.simulators.robots import quadruped, record, walk
from tests.simulators.test_mujoco import ARM, swing

BOX = """<mujoco><option timestep="0.002" cone="elliptic"/><worldbody><geom name="floor" type="plane" size="9 9 0.1" friction="{mu}"/>
<body name="box" pos="0 0 0.049"><freejoint name="root"/><geom type="box" size="0.1 0.08 0.05" mass="1" friction="{mu}"/>
<site name="imu" pos="0.02 0 0.01"/></body></worldbody>
<sensor><gyro name="gyro" site="imu"/><accelerometer name="accel" site="imu"/></sensor></mujoco>"""  # noqa: E501


def noisy(folder, size: float, columns: slice):
    """The logs of a folder with noise of that size."""
    rng = np.random.default_rng(0)
    for path in sorted(folder.glob("*.csv")):
        rows, head = np.loadtxt(path, delimiter=",", skiprows=1), path.read_text().split("\n")[0]
        rows[:, columns] += size * rng.standard_normal(rows[:, columns].shape)
        np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.9g")
    return folder


def replay_error(model, data) -> float:
    """rad: of a model file over a recording, the worst joint."""
    return float(
        np.max(np.median(replay_files(str(model), str(data), simulator="mujoco").error, 0))
    )


def swung(folder, **truth):
    own = {"damping": 0.1, "mass": 0.5, "kp": 30}
    texts = ARM.format(**own), ARM.format(**own | truth)
    return noisy(
        record(folder, texts[0], truth=texts[1], told=swing, every=2, trials=6, seconds=1.5),
        1e-4,
        slice(1, 3),
    )


@pytest.mark.long
def test_a_payload_is_named_and_its_size_found(tmp_path):
    data = swung(tmp_path / "log", mass=0.6)
    assert (
        cli.main(
            [
                "diagnose",
                str(data),
                "--simulator",
                "mujoco",
                "--out",
                str(tmp_path / "out"),
                "--json",
            ]
        )
        == 0
    )
    report = diagnose(simulator(*read_source_and_log(data)))
    (effect,) = report["effects"]
    assert effect["name"] == "payload at lower" and report["error"]["after"] < 1.2
    assert effect["parameters"]["body:lower.mass"]["value"] == pytest.approx(0.6, rel=0.02)
    out = tmp_path / "out"
    assert (out / "report.html").exists() and "payload at lower" in (out / "model.toml").read_text()
    mended = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    assert mended.body("lower").mass[0] == pytest.approx(0.6, rel=0.02)
    before, after = (replay_error(path, data) for path in (data / "model.xml", out / "model.xml"))
    assert after < 0.2 * before


def test_an_arm_that_is_as_its_file_has_it_lacks_nothing(tmp_path):
    report = diagnose(simulator(*read_source_and_log(swung(tmp_path / "log", damping=0.2))))
    assert report["verdict"] == "within_noise" and not report["effects"]
    assert report["declared"]["after"]["joint:elbow.damping"]["value"] == pytest.approx(
        0.2, rel=0.05
    )


AXES = [f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"]


def slid(folder, truth: str, *, pose: bool = True, trials: int = 6):
    """A box that was pushed over a floor, from rest on it at speeds that differ: its pose, or what
    its IMU reads.
    """
    folder.mkdir()
    (folder / "model.xml").write_text(BOX.format(mu=0.5))
    table = (
        ""
        if pose
        else "[channels]\n" + "".join(f'{a} = "{a[:-2]}[{"xyz".index(a[-1])}]"\n' for a in AXES)
    )
    (folder / "meta.toml").write_text(f'task = "mechanism"\nmodel = "model.xml"\n{table}')
    model, rng = mujoco.MjModel.from_xml_string(truth), np.random.default_rng(1)
    data = mujoco.MjData(model)
    head = (
        ["time", *(f"base_{c}" for c in ("x", "y", "z", "qw", "qx", "qy", "qz"))]
        if pose
        else ["time", *AXES]
    )
    for trial in range(trials):
        mujoco.mj_resetData(model, data)
        for _ in range(200):  # it lies still before it is pushed
            mujoco.mj_step(model, data)
        data.qvel[:2], rows = rng.uniform(-1.5, 1.5, 2), []
        for row in range(60):
            place, turn = data.qpos[:3] + 2e-4 * rng.standard_normal(3), data.qpos[3:].copy()
            mujoco.mju_quatIntegrate(turn, 3e-4 * rng.standard_normal(3), 1.0)
            for step in range(5):
                mujoco.mj_step(model, data)
                if step == 0:
                    felt = data.sensordata + np.repeat([2e-3, 2e-2], 3) * rng.standard_normal(6)
            rows.append([0.01 * row, *place, *turn] if pose else [0.01 * row, *felt])
        np.savetxt(
            folder / f"run_{trial}.csv",
            rows,
            delimiter=",",
            header=",".join(head),
            comments="",
            fmt="%.9g",
        )
    return folder


@pytest.mark.long
def test_a_floor_that_is_more_slippery_is_named(tmp_path):
    report = diagnose(simulator(*read_source_and_log(slid(tmp_path / "log", BOX.format(mu=0.35)))))
    (effect,) = report["effects"]
    assert effect["name"] == "floor friction at all contacts"
    assert effect["parameters"]["contact.friction[0]"]["value"] == pytest.approx(0.35, rel=0.05)


IMU = '<sensor><gyro name="gyro" site="imu"/><accelerometer name="accel" site="imu"/></sensor></mujoco>'  # noqa: E501


def test_a_base_that_only_its_imu_tells_of_is_estimated_with_the_start(tmp_path):
    """A quadruped that sways on its feet: tilt, height and speed of its trunk are nowhere in the
    log.
    """
    text = (
        quadruped()
        .replace('mass="4"/>', 'mass="4"/><site name="imu" pos="0.03 0 0.02"/>', 1)
        .replace("</mujoco>", IMU)
    )
    table = "".join(f'{a} = "{a[:-2]}[{"xyz".index(a[-1])}]"\n' for a in AXES)
    (tmp_path / "model.xml").write_text(text)
    (tmp_path / "meta.toml").write_text(
        f'task = "mechanism"\nmodel = "model.xml"\n[channels]\n{table}'
    )
    model, rng, rows, truth = mujoco.MjModel.from_xml_string(text), np.random.default_rng(0), [], []
    data, rest = mujoco.MjData(model), np.tile([0.3, -0.6], 4)
    for row in range(120):
        data.ctrl[:] = rest + 0.15 * (walk(0.01 * row, 0) - rest)
        state = np.concatenate([data.qpos[7:] + 1e-4 * rng.standard_normal(8), data.ctrl])
        truth.append(np.concatenate([data.qpos[:7], data.qvel[:3]]))
        for step in range(5):
            mujoco.mj_step(model, data)
            if step == 0:
                felt = data.sensordata + np.repeat([5e-3, 5e-2], 3) * rng.standard_normal(6)
        rows.append([0.01 * row, *state, *felt])
    joints = [f"q_{model.joint(k).name}" for k in range(1, model.njnt)]
    head = ["time", *joints, *(f"ctrl_{model.actuator(k).name}" for k in range(model.nu)), *AXES]
    np.savetxt(
        tmp_path / "run.csv",
        rows[40:],
        delimiter=",",
        header=",".join(head),
        comments="",
        fmt="%.9g",
    )
    again = replayed(*read_source_and_log(tmp_path), 0.1)
    assert again.base is None and np.median(again.error) < 0.01  # of a sway of 0.15
    made = simulator(*read_source_and_log(tmp_path))
    assert (
        made.stepped_model.free == 0
        and made.stepped_model.base < 0
        and [c.unit for c in made.channels[-6:]] == ["rad/s"] * 3 + ["m/s^2"] * 3
    )
    up, nv = (
        lambda q: np.array([2 * (q[1] * q[3] - q[0] * q[2]), 2 * (q[2] * q[3] + q[0] * q[1])]),
        model.nv,
    )
    for w, start in enumerate(made.stretches.start):
        pose, was = (
            made.mujoco_stretches.qpos[w].copy(),
            truth[40 + round(100 * made.mujoco_stretches.time[w, 0])],
        )
        mujoco.mj_integratePos(model, pose, np.ascontiguousarray(start[:nv]), 1.0)
        assert np.abs(up(pose[3:]) - up(was[3:])).max() < 0.02 and abs(pose[2] - was[2]) < 5e-3
        assert (
            np.linalg.norm(made.mujoco_stretches.qvel[w, :3] + start[nv : nv + 3] - was[7:]) < 0.2
        )


def test_sensors_that_the_model_has_not_are_refused(tmp_path):
    data = slid(tmp_path / "log", BOX.format(mu=0.5), pose=False, trials=1)
    text = (data / "meta.toml").read_text()
    for bad, says in (
        ("gyra[0]", "no sensor 'gyra'; did you mean 'gyro'"),
        ("gyro[5]", "gyro has 3 numbers"),
    ):
        (data / "meta.toml").write_text(text.replace("gyro[0]", bad))
        with pytest.raises(BadInput, match=r"meta\.toml: ") as error:
            simulator(*read_source_and_log(data))
        assert says in str(error.value)


def test_a_coarse_step_is_told_and_a_fine_one_is_not(tmp_path):
    data = swung(tmp_path / "log")
    made = simulator(*read_source_and_log(data))
    values = np.array([q.default for q in made.quantities])
    size = change(made, values)
    assert (
        with_half_step(made).stepped_model.model.opt.timestep == 0.002
        and 0.0 < change(with_half_step(made), values) < 0.7 * size
    )
    assert bool(step_notes(made, values)) == (size >= 1.0)
    (data / "model.xml").write_text(
        (data / "model.xml").read_text().replace('timestep="0.004"', 'timestep="0.02"')
    )
    coarse = simulator(*read_source_and_log(data))
    (line,) = step_notes(coarse, values)
    assert "step of 20 ms is coarse" in line
