"""A model file with fitted numbers in it reads back to those numbers."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from adaptsim_jax.mechanisms.mjcf import read_mechanism
from adaptsim_jax.mend.mjcf import Changes, mended_mjcf

ARM = """<mujoco><compiler angle="radian"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.1"/>
<inertial pos="0 0.01 -0.2" mass="1" diaginertia="0.01 0.01 0.002"/>
  <body name="lower" pos="0 0 -0.4" quat="0.9 0.1 0.2 0"><joint name="elbow" axis="1 1 0"/>
    <inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.004 0.004 0.001"/>
    <body name="tool" pos="0 0 -0.2"><inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body></body></body>
</worldbody><actuator><position name="drive" joint="shoulder" kp="20" kv="1"/></actuator></mujoco>"""  # noqa: E501


def test_what_is_written_is_read_back(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    arm = read_mechanism(path)
    inertial = np.array(arm.tree.inertial) * np.array([[1.3], [0.8]])
    changes = Changes(
        inertial,
        {
            "damping": {"shoulder": 0.2, "elbow": 0.3},
            "frictionloss": {"elbow": 0.5},
            "armature": {"shoulder": 0.01},
        },
        np.array([0.1, 0.0, -9.8]),
        {"kp": {"drive": 1.1}, "delay": {"drive": 0.006}, "limit": {"drive": 3.0}},
        comments=("not held: cogging at elbow",),
    )
    out = tmp_path / "model.xml"
    out.write_text(mended_mjcf(arm, changes))
    new = read_mechanism(out)
    np.testing.assert_allclose(new.tree.inertial, inertial, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(new.tree.damping, [0.2, 0.3])
    np.testing.assert_allclose(new.tree.frictionloss, [0.0, 0.5])
    np.testing.assert_allclose(new.tree.armature, [0.01, 0.0])
    np.testing.assert_allclose(new.tree.gravity, [0.1, 0.0, -9.8])
    (drive,) = new.actuators
    np.testing.assert_allclose(
        [drive.gain, drive.kp, drive.kv, drive.delay], [22.0, 22.0, 1.0, 0.006]
    )
    np.testing.assert_allclose(drive.forcerange, [-3.0, 3.0])
    assert "cogging at elbow" in out.read_text()
    assert mujoco.MjModel.from_xml_path(str(out)).nv == 2


def test_nothing_changed_is_the_same_machine(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    arm = read_mechanism(path)
    out = tmp_path / "same.xml"
    out.write_text(mended_mjcf(arm, Changes(np.array(arm.tree.inertial))))
    np.testing.assert_allclose(
        read_mechanism(out).tree.inertial, arm.tree.inertial, rtol=1e-6, atol=1e-9
    )


def test_a_joint_without_an_actuator_gets_a_motor_with_a_limit_and_a_servo_loses_its_kv(tmp_path):
    path, out = tmp_path / "arm.xml", tmp_path / "model.xml"
    path.write_text(ARM)
    changes = Changes(
        actuators={"limit": {"elbow": 0.2}, "kv": {"drive": 0.0}}, motors={"elbow": 0.05}
    )
    out.write_text(mended_mjcf(read_mechanism(path), changes))
    drive, motor = read_mechanism(out).actuators
    assert (drive.kp, drive.kv) == (20.0, 0.0)
    assert (motor.joint, motor.kind, motor.gear) == (1, "motor", pytest.approx(0.05))
    np.testing.assert_allclose(0.05 * np.array(motor.forcerange), [-0.2, 0.2])


def test_a_file_whose_meshes_are_not_there_is_written_without_them(tmp_path):
    path = tmp_path / "arm.xml"
    mesh = '<asset><mesh name="gone" file="gone.stl"/></asset><worldbody>'
    path.write_text(
        ARM.replace("<worldbody>", mesh)
        .replace('mass="1"', 'mass="1"', 1)
        .replace('<body name="lower"', '<geom type="mesh" mesh="gone"/><body name="lower"')
    )
    text = mended_mjcf(read_mechanism(path), Changes(joints={"damping": {"shoulder": 0.7}}))
    assert "could not be read" in text and "gone.stl" not in text
    assert mujoco.MjModel.from_xml_string(text).dof_damping[0] == pytest.approx(0.7)


DRAWN = """<mujoco><compiler angle="radian" meshdir="assets" texturedir="assets"/><asset>
<mesh name="box" file="box.obj"/><texture name="t" type="2d" file="t.png"/>
<material name="m" texture="t"/></asset><worldbody><body><joint name="hinge" axis="0 1 0"/>
<geom type="mesh" mesh="box" material="m"/></body></worldbody></mujoco>"""
CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.mark.parametrize("whole", [True, False], ids=["whole path", "relative path"])
def test_a_file_with_meshes_compiles_where_it_is_written(tmp_path, monkeypatch, whole):
    from PIL import Image

    assets = tmp_path / "robot" / "assets"
    assets.mkdir(parents=True)
    (assets / "box.obj").write_text(CORNERS)
    Image.new("RGB", (4, 4)).save(assets / "t.png")
    (tmp_path / "robot" / "robot.xml").write_text(DRAWN)
    monkeypatch.chdir(tmp_path)
    path = (tmp_path if whole else Path()) / "robot" / "robot.xml"
    text = mended_mjcf(read_mechanism(path), Changes())
    assert 'mesh name="box"' in text and "without shapes" not in text
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "model.xml").write_text(text)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "model.xml"))
    assert (model.nmesh, model.ntex) == (1, 1)


@pytest.mark.parametrize("angle", ["", '<compiler angle="radian"/>', '<compiler angle="degree"/>'])
def test_a_rest_angle_is_in_rad_whatever_the_file_has_its_angles_in(tmp_path, angle):
    path, out = tmp_path / "arm.xml", tmp_path / "model.xml"
    path.write_text(ARM.replace('<compiler angle="radian"/>', angle))
    table = {"stiffness": {"elbow": 0.12}, "springref": {"elbow": 0.25}}
    out.write_text(mended_mjcf(read_mechanism(path), Changes(joints=table)))
    np.testing.assert_allclose(
        mujoco.MjModel.from_xml_path(str(out)).qpos_spring, [0.0, 0.25], atol=1e-6
    )
