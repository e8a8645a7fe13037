"""What each search may add: effects, joints, sharing, ranges, priors and grid points, in their order.

`candidates.json` was written once from answers that are right. Where a list changes on purpose,
delete the file and run this test twice: it writes what is missing and fails.
"""  # noqa: E501

import json
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.candidates import candidates
from adaptsim_jax.attribution.equation.models import separable_candidates
from adaptsim_jax.attribution.problem import nuisances, own_inertia, prepare, scaled_reach
from adaptsim_jax.attribution.stretches import JointTrack
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.mechanisms.tree import make_tree
from adaptsim_jax.simulators.mujoco.build import SteppedModel
from adaptsim_jax.simulators.mujoco.catalogue import rows, sensor_rows
from adaptsim_jax.simulators.mujoco.contact import contact_rows
from adaptsim_jax.simulators.mujoco.sensed import Reading
from adaptsim_jax.tasks.pushing.diagnosis import catalogue as pushing
from adaptsim_jax.tasks.scooping.diagnosis import catalogue as scooping
from adaptsim_jax.tasks.toss import catalogue as toss

PINNED = Path(__file__).with_name("candidates.json")
ROD = [0.6, 0.0, 0.0, -0.09, 0.02, 0.0, 0.0, 0.02, 0.0, 1e-4]
SERVO = [60.0, 0.0, -60.0, -2.0, -9.0, 9.0]  # gain, bias, per angle, per speed, lowest, highest
TORQUE = [1.0, 0.0, 0.0, 0.0, -np.inf, np.inf]
NONE = [0.0, 0.0, 0.0, 0.0, -np.inf, np.inf]


def a_track(n: int) -> JointTrack:
    """Sums of two sines at each joint, 3 s at 200 Hz."""
    time, k = np.arange(600) / 200.0, np.arange(n)
    q = 0.6 * np.sin((2.0 + 0.7 * k) * time[:, None]) + 0.2 * np.sin((5.0 + k) * time[:, None] + k)
    u = 0.8 * np.cos((3.0 + 0.4 * k) * time[:, None])
    return JointTrack("a", time, q, None, u)


def a_tree(parents, kinds=None, **values):
    n = len(parents)
    return make_tree(
        kinds or ["hinge"] * n,
        parents,
        np.tile([0.0, 0.0, -0.3], (n, 1)),
        np.tile([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], (n, 1, 1)),
        np.tile(ROD, (n, 1)),
        damping=np.full(n, 0.02),
        **values,
    )


def posed(tree, actuators, unlike=(), **more):
    """A problem with what is fitted whatever is named, and what its motion covers."""
    track = a_track(len(actuators))
    problem = prepare(tree, [track], MACHINE, actuator=np.array(actuators).T, **more)
    problem.__dict__["unlike"] = unlike
    return problem


MACHINES = {
    "a joint by torque": lambda: posed(a_tree([-1]), [TORQUE]),
    "two joints, one undriven": lambda: posed(
        a_tree([-1, 0], frictionloss=np.array([0.1, 0.0])), [TORQUE, NONE]
    ),
    "three servos with rotors": lambda: posed(
        a_tree([-1, 0, 1], armature=np.array([0.02, 0.0, 0.01])), [SERVO] * 3
    ),
    "a slide, one unlike": lambda: posed(
        a_tree([-1, 0, 1], kinds=["slide", "hinge", "hinge"]), [SERVO, TORQUE, TORQUE], unlike=(1,)
    ),
    "two arms without weight, late": lambda: posed(
        a_tree([-1, 0, -1, 2], gravity=(0.0, 0.0, 0.0), armature=np.full(4, 0.01)),
        [TORQUE] * 4,
        declared={("delay", "delay"): np.full(4, 0.004)},
    ),
}


def written(c) -> str:
    """A candidate of a tree but for its grid point."""
    entries = [
        f"{e.name}{list(e.joints)} {e.start:.6g} off {e.off:.6g} in {e.low:.6g}..{e.high:.6g} "
        f"{e.unit} prior {e.prior:.6g}"
        for e in c.entries
    ]
    if len(entries) > 12:
        entries = [*entries[:12], f"and {len(entries) - 12} more"]
    return f"{c.effect} {list(c.joints)} {c.sharing}: {'; '.join(entries)}"


def grouped(some) -> list[list[str]]:
    """Candidates in order; of those that differ in their grid point alone one, with its points."""
    out: list[list[str]] = []
    for c in some:
        line = written(c)
        if not out or out[-1][0] != line:
            out.append([line])
        if c.shape:
            out[-1].append(", ".join(f"{k} {value:.6g}" for k, value in c.shape))
    return out


def of_machine(name: str) -> dict[str, list[list[str]]]:
    problem = MACHINES[name]()
    null = nuisances(problem)
    reach = scaled_reach(problem, *own_inertia(problem, null))
    out = {"simulated": grouped(candidates(problem, null, reach))}
    for commanded in (False, True):
        for g in problem.groups:
            state = SimpleNamespace(
                problem=problem,
                null=null,
                reach=reach,
                commanded=commanded,
                limits=Criteria().torque,
                balance=SimpleNamespace(group=g),
            )
            title = f"balance of {list(g.joints)}, {'commands' if commanded else 'torques'}"
            out[title] = grouped(separable_candidates(state))
    return out


def of_trials(some, quantities) -> dict[str, list[str]]:
    """Candidates and quantities of short trials."""
    known = [
        f"{q.name} [{q.unit}] {q.default:.6g} in {q.low:.6g}..{q.high:.6g} scale {q.scale:.6g} "
        f"prior {q.prior:.6g}"
        for q in quantities
    ]
    shown = []
    for c in some:
        points = [", ".join(f"{k} {z:.6g}" for k, z in point.items()) for point in c.points]
        shown.append(
            f"{c.name} | {c.place} | {list(c.names)} | points {points} | same {list(c.same)} "
            f"{c.separated_by}| absorbed {list(c.look_alikes)} | {c.physics} | {c.excitation}"
        )
    return {"effects": shown, "quantities": known}


WALKER = """<mujoco><worldbody><geom type="plane" size="9 9 0.1"/><body name="trunk" pos="0 0 0.5">
<freejoint/><geom size="0.1" mass="3"/><site name="imu"/><body name="leg"><joint name="knee" damping="0.1" armature="0.01"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.4" mass="0.5" condim="6"/></body></body></worldbody>
<actuator><position name="drive" joint="knee" kp="30" kv="1"/></actuator>
<sensor><gyro site="imu"/><accelerometer site="imu"/></sensor></mujoco>"""  # noqa: E501
ARM = """<mujoco><worldbody><body><joint name="a" axis="0 1 0" damping="0.1" frictionloss="0.2"/>
<geom size="0.05" pos="0 0 -0.2" mass="1"/><body pos="0 0 -0.4"><joint name="b" axis="0 1 0"/>
<geom size="0.04" pos="0 0 -0.2" mass="0.4"/></body></body></worldbody>
<actuator><motor name="m" joint="a"/></actuator></mujoco>"""


def of_mujoco(text: str, joints: tuple[str, ...]) -> dict[str, list[str]]:
    model = mujoco.MjModel.from_xml_string(text)
    angle = np.array([model.jnt_qposadr[model.joint(name).id] for name in joints])
    free = 0 if model.nq > model.nv else -1
    kinds = ("gyro", "accelerometer") if model.nsensor else ()
    read = [
        Reading(f"{kind}{i}", 3 * k + i, kind) for k, kind in enumerate(kinds) for i in range(3)
    ]
    made = SteppedModel("", model, angle, -1, model.qpos0, (), free, tuple(read))
    every = [*rows(made, joints), *contact_rows(made), *sensor_rows(made, len(joints))]
    return of_trials(every, [f for e in every for f in e.parameters])


OTHERS = {
    "pushing": lambda: of_trials(pushing.EFFECTS, pushing.QUANTITIES),
    "pushing without yaw": lambda: of_trials(pushing.effects_of(False), ()),
    "scooping": lambda: of_trials(
        (*scooping.EFFECTS, scooping.HEIGHT, scooping.SHAPE), scooping.QUANTITIES
    ),
    "toss": lambda: of_trials(toss.EFFECTS, toss.OWN),
    "MuJoCo, a walker": lambda: of_mujoco(WALKER, ("knee",)),
    "MuJoCo, an arm": lambda: of_mujoco(ARM, ("a", "b")),
}


@pytest.mark.parametrize("name", [*MACHINES, *OTHERS])
def test_candidates_and_their_order(name):
    found = of_machine(name) if name in MACHINES else OTHERS[name]()
    pinned = json.loads(PINNED.read_text()) if PINNED.exists() else {}
    if name not in pinned:
        PINNED.write_text(json.dumps(pinned | {name: found}, indent=1) + "\n")
        pytest.fail(f"{name}: written to {PINNED.name}; run again")
    assert found == pinned[name]
