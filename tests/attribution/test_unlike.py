"""Joints that are not as the model says in a way that no effect is: followers that do not follow,
servos that do not move.
"""

from dataclasses import replace

import mujoco
import numpy as np

from adaptsim_jax.attribution.candidates import candidates
from adaptsim_jax.attribution.criteria import BALANCE
from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.posed import declared_vector
from adaptsim_jax.attribution.problem import held, own_inertia, scaled_reach
from adaptsim_jax.attribution.sentences import standing
from tests.attribution.servo_logs import servo_log
from tests.attribution.test_rubbing import FINGER, finger_log, prepared

GRIPPER = """<mujoco><option timestep="1e-3"/><worldbody><body>
<joint name="turn" axis="0 1 0" armature="0.05"/><inertial pos="0 0 -0.1" mass="0.5" diaginertia="1e-3 1e-3 1e-3"/>
<body name="left"><joint name="left" type="slide" axis="0 1 0"/>
<inertial pos="0 0 0" mass="0.02" diaginertia="1e-5 1e-5 1e-5"/></body>
<body name="right"><joint name="right" type="slide" axis="0 -1 0"/>
<inertial pos="0 0 0" mass="0.02" diaginertia="1e-5 1e-5 1e-5"/></body></body></worldbody>
<equality><joint joint1="right" joint2="left" polycoef="0 1 0 0 0"/></equality>
<actuator><position name="turn" joint="turn" kp="100" kv="5"/><position name="grip" joint="left" kp="200" kv="8"/></actuator>
</mujoco>"""  # noqa: E501

HELD = FINGER.replace("<motor", '<position kp="60" kv="2"')


def test_followers_that_do_not_follow_are_known_by_their_leader(tmp_path):
    (tmp_path / "model.xml").write_text(GRIPPER)
    (tmp_path / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    model = mujoco.MjModel.from_xml_string(GRIPPER)
    data, rows = mujoco.MjData(model), []
    for k in range(400):
        told = 0.3 * np.sin(0.02 * k), 0.02 * np.sin(0.05 * k)
        apart = 0.003 * np.sin(0.11 * k)
        rows.append([k / 200, *data.qpos[:2], data.qpos[2] + apart, *told])
        data.ctrl[:] = told
        mujoco.mj_step(model, data, 5)
    names = "time,q_turn,q_left,q_right,ctrl_turn,ctrl_grip"
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=names, comments="", fmt="%.9g")
    assert load(tmp_path, None).log.unlike == ("left",)


def test_nothing_is_sought_at_a_joint_that_is_unlike_the_model_but_what_all_share(tmp_path):
    machine, problem = prepared(finger_log(tmp_path / "log"))
    problem = replace(problem, unlike=(1,))
    null = declared_vector(machine, problem)
    reach = scaled_reach(problem, *own_inertia(problem, null))
    here = {
        c.effect for c in candidates(problem, null, reach) if 1 in c.joints and c.effect != "tilt"
    }
    assert here == {
        "delay",
        "actuator_lag",
        "sensor_delay",
        "sensor_lag",
        "torque_gain",
    }  # with one value for all
    (balance,) = balances(problem, machine.tracks)
    assert (
        np.all(balance.clear[:, 1] == BALANCE.no_weight)
        and np.mean(balance.clear[:, 0] > BALANCE.no_weight) > 0.9
    )


def test_servos_that_do_not_follow_are_known(tmp_path):
    for law, joints in (
        ('stiffness="1e4"', []),
        ("", [0, 1]),
    ):  # held by a brake, which the file has not
        file, own = (HELD.format(law=z, near=0.1, far=0.08) for z in ("", law))
        machine, _ = prepared(servo_log(tmp_path / f"log{len(law)}", file, own, 8))
        gaps = [
            replace(t, q=np.where(np.arange(len(t.q))[:, None] % 7 == 0, np.nan, t.q))
            for t in machine.tracks
        ]
        unseen = replace(machine.tracks[0], q=np.full_like(machine.tracks[0].q, np.nan))
        told = standing(replace(machine, tracks=tuple(gaps)))
        assert standing(replace(machine, tracks=(unseen, *gaps[1:]))) == []
        assert len(told) == (not joints) and (
            joints or all(f"{j} (" in told[0] for j in machine.tree.joint_names)
        )


def test_joints_that_are_told_how_fast_to_go_are_held_too():
    position, velocity, motor, damped = (
        [9.0, 0, -9.0, -1.0],
        [50.0, 0, 0, -50.0],
        [1.0, 0, 0, 0],
        [0.0, 0, 0, -2.0],
    )
    law = np.array([[*row, -np.inf, np.inf] for row in (position, velocity, motor, damped)]).T
    assert held(law).tolist() == [True, True, False, False]
