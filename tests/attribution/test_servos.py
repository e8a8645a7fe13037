"""What `diagnose` says of a stiff arm of position servos, and of two arms on one base."""

import json

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.simulators.closed_loop import identified
from tests.attribution.servo_logs import servo_log

KP, KV, STEP = 2000.0, 200.0, 5e-4
JOINTS = ("turn", "lift", "elbow")
SERVOS = "".join(f'<position name="{j}" joint="{j}" kp="{KP}" kv="{KV}"/>' for j in JOINTS)
ARM = f"""<mujoco><compiler angle="radian"/><option timestep="{STEP}" integrator="implicitfast"/><worldbody><body>
<joint name="turn" axis="0 0 1" armature="0.1"/><inertial pos="0 0 0.1" mass="4.0" diaginertia="0.05 0.05 0.05"/>
<body pos="0 0 0.2"><joint name="lift" axis="0 1 0" armature="0.1"/>
<inertial pos="0 0 -0.2" mass="4.0" diaginertia="0.08 0.08 0.01"/>
<body pos="0 0 -0.4"><joint name="elbow" axis="0 1 0" armature="{{rotor}}"/>
<inertial pos="0.02 0 -0.15" mass="{{mass}}" diaginertia="0.03 0.03 0.005"/></body></body></body></worldbody>
<actuator>{SERVOS}</actuator></mujoco>"""  # noqa: E501
ONE = """<body pos="0 {at} 0"><joint name="{side}_lift" axis="0 1 0" armature="0.01"/>
<inertial pos="0 0 -0.2" mass="2.0" diaginertia="0.03 0.03 0.005"/>
<body pos="0 0 -0.4"><joint name="{side}_elbow" axis="0 1 0" armature="0.01"/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia="2e-3 2e-3 1e-3"/></body></body>"""
NAMES = ("left_lift", "left_elbow", "right_lift", "right_elbow")
OF_NAMES = "".join(
    f'<position name="{n}" joint="{n}" kp="800" kv="{30 if "lift" in n else 8}"/>' for n in NAMES
)
ARMS = f"""<mujoco><compiler angle="radian"/><option timestep="{STEP}"/><worldbody>{ONE.format(at=-0.3, side="left")}
{ONE.format(at=0.3, side="right")}</worldbody><actuator>{OF_NAMES}</actuator></mujoco>"""  # noqa: E501


def arm_log(folder, rotor=0.1, mass=2.0, late=0.0):
    """A folder whose file has a rotor of 0.1 kg m2 and a forearm of 2 kg; logs of an arm with
    others.
    """
    file, own = ARM.format(rotor=0.1, mass=2.0), ARM.format(rotor=rotor, mass=mass)
    return servo_log(folder, file, own, 5, 3, late)


@pytest.mark.long
def test_nothing_is_added_to_a_file_that_is_right(tmp_path):
    for name, log in (
        ("arm", arm_log(tmp_path / "arm")),
        ("arms", servo_log(tmp_path / "arms", ARMS, ARMS, 4)),
    ):
        report = diagnose(log)
        assert (report["verdict"], report["effects"]) == ("within_noise", []), name


@pytest.mark.long
@pytest.mark.xfail(strict=True, reason="a rotor of less than damping times a step has no name")
def test_a_rotor_that_is_not_the_files_is_named(tmp_path):
    (row,) = diagnose(arm_log(tmp_path / "rotor", rotor=0.16))["effects"]
    assert (row["name"], row["where"]) == ("armature", "elbow")
    assert row["parameters"]["inertia"]["value"] == pytest.approx(0.16, abs=0.004)


@pytest.mark.long
def test_a_body_that_is_not_the_files_is_named(tmp_path):
    (row,) = diagnose(arm_log(tmp_path / "payload", mass=3.0))["effects"]
    assert (row["name"], row["where"]) == ("body_mass", "elbow")
    assert row["parameters"]["mass"]["value"] == pytest.approx(1.0, rel=0.15)


@pytest.mark.long
def test_a_late_computer_is_late_for_both_arms(tmp_path):
    report = diagnose(servo_log(tmp_path / "log", ARMS, ARMS, 4, late=0.0137))
    (row,) = report["effects"]
    assert (row["name"], row["where"]) == ("delay", "all joints")
    assert row["parameters"]["delay"]["value"] == pytest.approx(0.0137, abs=5e-4)


SERVO = """<mujoco><option timestep="0.001"/><worldbody><body name="arm">
<joint name="hinge" axis="0 1 0" damping="0.02" armature="0.01" frictionloss="{friction}"/>
<inertial pos="0 0 -0.2" mass="0.5" diaginertia="1e-3 1e-3 1e-3"/></body></worldbody>
<actuator><position name="hinge" joint="hinge" kp="{kp}" kv="{kv}" {limit}/></actuator></mujoco>"""


def hinge_log(folder, kp, kv, friction=0.0, limit="", late=0):
    """A pendulum under a position servo, 3 trials of 12 s at 50 Hz; its file has no friction, and
    commands act so many rows late.
    """
    numbers = {"kp": kp, "kv": kv, "limit": limit}
    model = mujoco.MjModel.from_xml_string(SERVO.format(friction=friction, **numbers))
    rng = np.random.default_rng(1)
    folder.mkdir()
    (folder / "model.xml").write_text(SERVO.format(friction=0.0, **numbers))
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    for k in range(3):
        data, rows = mujoco.MjData(model), []
        speed, phase = rng.uniform(0.5, 3.0, 3), rng.uniform(0, 6, 3)
        for i in range(600):
            target = 0.4 * np.sin(speed * i / 50 + phase).sum()
            rows.append([i / 50, data.qpos[0] + 3e-4 * rng.normal(), target])
            data.ctrl[0] = rows[max(i - late, 0)][2]
            mujoco.mj_step(model, data, 20)
        heads = "time,q_hinge,target_hinge"
        np.savetxt(folder / f"t{k}.csv", rows, "%.9g", ",", header=heads, comments="")
    return folder


@pytest.mark.parametrize("friction", [pytest.param(0.0, marks=pytest.mark.long), 0.1])
def test_friction_of_a_servo_whose_gains_are_the_files(friction, tmp_path):
    report = diagnose(hinge_log(tmp_path / "servo", 30.0, 2.0, friction))
    assert [e["name"] for e in report["effects"]] == (["coulomb"] if friction else [])
    if friction:
        level = report["effects"][0]["parameters"]["level"]["value"]
        assert level == pytest.approx(friction, rel=0.1)


@pytest.mark.long
def test_what_is_excluded_is_not_named(tmp_path):
    report = diagnose(hinge_log(tmp_path / "servo", 30.0, 2.0, 0.1), exclude=("coulomb at hinge",))
    assert "coulomb" not in [e["name"] for e in report["effects"]]


@pytest.mark.long
def test_a_late_command_of_a_stiff_servo_that_is_often_at_its_limit(tmp_path):
    report = diagnose(hinge_log(tmp_path / "servo", 300.0, 8.0, 0.0, 'forcerange="-4 4"', late=2))
    (row,) = report["effects"]
    assert row["name"] == "delay"
    assert row["parameters"]["delay"]["value"] == pytest.approx(0.04, abs=0.001)


@pytest.mark.long
def test_a_late_failure_leaves_what_was_found(tmp_path, monkeypatch):
    def fails(*_):
        raise RuntimeError("late")

    monkeypatch.setattr(identified, "held_out_errors", fails)
    with pytest.raises(RuntimeError, match="late"):
        diagnose(hinge_log(tmp_path / "servo", 30.0, 2.0, 0.1), out=tmp_path / "out")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["unfinished"] and [e["name"] for e in report["effects"]] == ["coulomb"]
