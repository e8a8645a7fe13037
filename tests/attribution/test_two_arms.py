"""What all joints share (a late computer, a simulator's step) where two arms on one base share no
moving body.
"""

from types import SimpleNamespace

import pytest

from adaptsim_jax.attribution.candidates import JointCandidate, adjacent
from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.attribution.equation.balance import balances
from adaptsim_jax.attribution.equation.confirmed import without_bodies
from adaptsim_jax.attribution.equation.models import search_balances
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.parameters import DAMPING_STEP
from adaptsim_jax.attribution.posed import declared_vector
from adaptsim_jax.attribution.problem import own_inertia, scaled_reach
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.joints.catalogue import MACHINE
from tests.attribution.servo_logs import servo_log

STEP = 5e-4
ONE = """<body pos="0 {at} 0"><joint name="{side}_lift" axis="0 1 0" armature="0.01"/>
<inertial pos="0 0 -0.2" mass="2.0" diaginertia="0.03 0.03 0.005"/>
<body pos="0 0 -0.4"><joint name="{side}_elbow" axis="0 1 0" armature="0.01"/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia="2e-3 2e-3 1e-3"/></body></body>"""
NAMES = ("left_lift", "left_elbow", "right_lift", "right_elbow")
SERVOS = "".join(
    f'<position name="{n}" joint="{n}" kp="800" kv="{30 if "lift" in n else 8}"/>' for n in NAMES
)
ARMS = f"""<mujoco><compiler angle="radian"/><option timestep="{STEP}"/><worldbody>{ONE.format(at=-0.3, side="left")}
{ONE.format(at=0.3, side="right")}</worldbody><actuator>{SERVOS}</actuator></mujoco>"""  # noqa: E501


@pytest.mark.parametrize(
    ("joints", "others", "near"),
    [((1,), (0,), True), ((3,), (3,), True), ((1,), (2,), False), ((0, 1), (3,), False)],
)
def test_neighbours_are_joints_of_one_arm(joints, others, near):
    problem = SimpleNamespace(parents=(-1, 0, -1, 2))
    one, other = (JointCandidate("coulomb", j, "joint", ()) for j in (joints, others))
    assert adjacent(problem, one, other) is near and adjacent(problem, other, one) is near


def test_a_simulators_steps_are_no_effect_of_either_arm(tmp_path):
    machine = load(servo_log(tmp_path / "log", ARMS, ARMS, 4), None)
    problem = machine.problem(MACHINE)
    assert problem.parents == (-1, 0, -1, 2)
    null = without_bodies(declared_vector(machine, problem))
    reach = scaled_reach(problem, *own_inertia(problem, null))
    found = search_balances(
        problem, balances(problem, machine.tracks), null, reach, Criteria(), True
    )
    assert not {n.candidate.effect for n in found.named} & {
        "position_gain",
        "torque_gain",
        "armature",
        "actuator_lag",
    }
    values = {e.key: z for e, z in zip(found.final.entries, found.final.values, strict=True)}
    for arm in (
        (0, 1),
        (2, 3),
    ):  # a command acts as if at the middle of a step, and damping at another time in it
        assert 0.0 < abs(values[DAMPING_STEP, "step", arm]) < STEP
        assert values["delay", "delay", arm] == pytest.approx(-0.5 * STEP, abs=0.2 * STEP)


@pytest.mark.long
def test_a_late_computer_is_late_for_both_arms(tmp_path):
    report = diagnose(servo_log(tmp_path / "log", ARMS, ARMS, 4, late=0.0137), out=tmp_path / "out")
    assert {e["name"] for e in report["effects"]} == {"delay"}
    assert {n for e in report["effects"] for n in e["joints"]} == set(NAMES)
    for e in report["effects"]:
        assert e["parameters"]["delay"]["value"] == pytest.approx(0.0137, abs=5e-4)
