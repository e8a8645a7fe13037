"""Bodies that are the model file's, and what the steps of a simulator do to damping: by the balance
of torques of a stiff arm.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.attribution.equation import confirmed as filed_module
from adaptsim_jax.attribution.equation.balance import balances, inside
from adaptsim_jax.attribution.equation.confirmed import enough, without_bodies
from adaptsim_jax.attribution.equation.models import model_of, search_balances
from adaptsim_jax.attribution.equation.solve import compared
from adaptsim_jax.attribution.equation.windows import left_of, runs_of
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.parameters import DAMPING_STEP, INERTIA, Entry, Vector
from adaptsim_jax.attribution.paths import run, starts_of
from adaptsim_jax.attribution.posed import declared_vector
from adaptsim_jax.attribution.problem import own_inertia, scaled_reach
from adaptsim_jax.attribution.stretches import JointTrack
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.joints.catalogue import MACHINE
from tests.attribution.servo_logs import servo_log

KP, KV, STEP = 2000.0, 200.0, 5e-4
JOINTS = ("turn", "lift", "elbow")
SERVOS = "".join(
    f'<position name="{j}" joint="{j}" kp="{KP}" kv="{KV}" {"{limit}" * (j == "elbow")}/>'
    for j in JOINTS
)
ARM = f"""<mujoco><compiler angle="radian"/><option timestep="{STEP}" integrator="implicitfast"/><worldbody><body>
<joint name="turn" axis="0 0 1" armature="0.1"/><inertial pos="0 0 0.1" mass="4.0" diaginertia="0.05 0.05 0.05"/>
<body pos="0 0 0.2"><joint name="lift" axis="0 1 0" armature="0.1"/>
<inertial pos="0 0 -0.2" mass="4.0" diaginertia="0.08 0.08 0.01"/>
<body pos="0 0 -0.4"><joint name="elbow" axis="{{axis}}" armature="{{rotor}}" {{range_}}/>
<inertial pos="0.02 0 -0.15" mass="{{mass}}" diaginertia="0.03 0.03 0.005"/></body></body></body></worldbody>
<actuator>{SERVOS}</actuator></mujoco>"""  # noqa: E501


def arm_log(folder, rotor=0.1, mass=2.0, trials=3, axis="0 1 0", limit="", late=0.0, range_=""):
    """A folder whose file has a rotor of 0.1 kg m2 and a forearm of 2 kg; logs of an arm with
    others.
    """
    same = {"axis": axis, "limit": limit, "range_": range_}
    file, own = ARM.format(rotor=0.1, mass=2.0, **same), ARM.format(rotor=rotor, mass=mass, **same)
    return servo_log(folder, file, own, 5, trials, late)


def searched(folder):
    """The problem, and what is found with fitted bodies and with those of the file."""
    machine = load(folder, None)
    problem = machine.problem(MACHINE)
    null, told = declared_vector(machine, problem), balances(problem, machine.tracks)
    reach = scaled_reach(problem, *own_inertia(problem, null))
    return problem, *(
        search_balances(problem, told, vector, reach, Criteria(), True)
        for vector in (null, without_bodies(null))
    )


def good(problem, held, free):
    """Whether the file's bodies are enough."""
    models = tuple(model_of(problem, s, s.final, s.added) for s in (held, free))
    return enough(problem, (held, free), models, Criteria())


def test_damping_by_another_speed_leaves_a_joint_some_of_its_weight(tmp_path):
    machine = load(arm_log(tmp_path / "arm", trials=1), None)
    problem = machine.problem(MACHINE)
    vector = without_bodies(declared_vector(machine, problem))
    (entry,) = vector.entries
    assert -0.25 / 200 < entry.low < 0.0 < entry.high == pytest.approx(0.25 / 200)

    def whole(step):
        return np.isfinite(run(problem, vector.at(np.array([step])), starts_of(problem))[0].x).all()

    assert whole(entry.low) and whole(entry.high) and not whole(-entry.high)


@pytest.mark.parametrize(("joints", "vectors"), [(16, 2), (24, 1)])
def test_bodies_of_a_machine_of_many_joints_are_not_fitted(joints, vectors, monkeypatch):
    monkeypatch.setattr(filed_module, "model_of", lambda *a: None)
    monkeypatch.setattr(filed_module, "over_floor", lambda *a: np.inf)
    monkeypatch.setattr(filed_module, "enough", lambda *a: False)
    asked = []
    null = Vector(
        tuple(Entry(o, "x", (0,), 0.0, 0.0, -1.0, 1.0, "1") for o in (INERTIA, DAMPING_STEP)),
        np.zeros(2),
    )

    def search(vector):
        return asked.append(vector) or SimpleNamespace(final=None, added=(), null=vector)

    found, usual, each = filed_module.searched(
        SimpleNamespace(joints=joints), search, null, Criteria()
    )
    assert (
        [len(v) for v in asked] == [1, 2][:vectors]
        and found is usual
        and found.null is asked[-1]
        and not each
    )


def test_speeds_are_those_of_the_motion_where_a_stiff_controller_shows_them():
    time = np.arange(0.0, 8.0, 0.005)
    q = np.stack([np.sin(2 * np.pi * 1.2 * time)], 1)
    (run,) = runs_of([JointTrack("a", time, q, None, np.zeros_like(q))], np.full(1, 1e-6))
    true = 2 * np.pi * 1.2 * np.cos(2 * np.pi * 1.2 * run.time)
    assert (
        np.abs(run.v[0] - true)[20:-20].max() < 1e-4 * np.abs(true).max()
    )  # 2e-3 by the slope of a local quadratic


@pytest.mark.parametrize("load", [0.0, 4.0, -6.0])
def test_what_a_limit_leaves_of_the_spikes_of_a_held_command(load):
    """Against a joint of 0.1 kg m2 that follows at 3 rad/s and carries a load, in steps of 10
    us.
    """
    inertia, limit, row, speed, step = 0.1, 12.0, 5e-3, 3.0, 1e-5
    q, v, asked, did = -speed * KV / KP, speed, [], []
    for k in range(40 * 500):
        law = KP * (speed * row * (k // 500) - q) - KV * v
        force = min(max(law, -limit), limit)
        v += step * (force - load) / inertia
        q += step * v
        asked.append(law)
        did.append(force)

    def mean(z):
        return float(np.mean(z[-500:]))  # of the last row

    spike, slow = KP * speed * row, inertia / KV
    left = left_of(*(np.array([[z]]) for z in (mean(asked), spike, limit, slow)), np.array([row]))[
        0, 0
    ]
    assert mean(did) == pytest.approx(load, abs=0.05)
    assert left == pytest.approx(load, abs=0.25 * abs(mean(asked) - load) + 0.05)


def test_where_limits_cut_much_of_the_spikes_nothing_is_told(tmp_path):
    folder = arm_log(tmp_path / "limited", limit='forcerange="-12 12"')
    machine = load(folder, None)
    problem = machine.problem(MACHINE)
    (b,) = balances(problem, machine.tracks)
    spike = b.averaged(np.abs(KP * b.jump))
    fast, slow = spike[:, 2] > 30.0, spike[:, 2] < 8.0
    assert fast.sum() > 20 and slow.sum() > 20
    moves = np.square(b.averaged(b.sign)) > 0.9  # in one direction throughout
    assert b.clear[fast & moves[:, 2], 2].mean() < 0.1 < 0.7 < b.clear[slow & moves[:, 2], 2].mean()
    assert b.clear[moves[:, 0], 0].mean() > 0.7  # no limit


@pytest.mark.long
def test_a_rotor_shows_beside_the_files_bodies_and_damping_acts_half_a_step_late(tmp_path):
    problem, free, held = searched(arm_log(tmp_path / "rotor", rotor=0.16))
    assert good(problem, held, free)
    assert [(n.candidate.effect, n.candidate.joints) for n in held.named] == [("armature", (2,))]
    values = {e.key: z for e, z in zip(held.final.entries, held.final.values, strict=True)}
    assert values["armature", "inertia", (2,)] == pytest.approx(0.16, abs=0.004)
    assert values[DAMPING_STEP, "step", (0, 1, 2)] == pytest.approx(0.5 * STEP, abs=0.2 * STEP)


def test_a_delay_of_rows_has_no_lag_beside_it(tmp_path):
    """Its column is a difference, of which a lag would take what is left, and then its place."""
    _, free, held = searched(arm_log(tmp_path / "late", late=0.0137))
    for found in (free, held):
        assert [(n.candidate.effect, n.candidate.joints) for n in found.named] == [
            ("delay", (0, 1, 2))
        ]
        assert "actuator_lag" not in {c.effect for c in found.added}
    values = {e.owner: z for e, z in zip(held.final.entries, held.final.values, strict=True)}
    assert values["delay"] == pytest.approx(0.0137, abs=5e-4)


@pytest.mark.long
def test_a_body_that_is_not_the_files_is_named(tmp_path):
    problem, free, held = searched(arm_log(tmp_path / "payload", mass=3.0))
    assert good(problem, held, free)
    assert [(n.candidate.effect, n.candidate.joints) for n in held.named] == [("inertia", (2,))]


@pytest.mark.long
def test_a_heavier_body_shows_at_the_joints_that_carry_it(tmp_path):
    problem, free, held = searched(
        arm_log(tmp_path / "payload", mass=3.0, axis="0 0 1")
    )  # its own joint carries none of it
    assert good(problem, held, free)
    (named,) = held.named
    alike = [(c.effect, c.joints) for c in (named.candidate, *named.alternatives)]
    assert (INERTIA, (2,)) in alike and {effect for effect, _ in alike} == {INERTIA}


def test_a_joint_that_neither_set_explains_does_not_outweigh_the_others():
    blocks = np.arange(20)
    rows = SimpleNamespace(fold=blocks // 5, block=blocks)

    def loss(first):
        return SimpleNamespace(loss=np.stack([np.full(20, first), np.full(20, 100.0)], 1))

    test = compared(rows, loss(1.0), loss(0.1), [0, 1])
    assert test.gain == pytest.approx(
        1.0 - (0.5 * (0.1 + 1.0) + 0.1) / 1.1
    )  # one of two joints by nine tenths, floor 0.1
    assert test.p < 0.01


def test_windows_within_an_encoders_offset_of_the_end_of_a_range_are_left_out():
    tree = SimpleNamespace(
        range=np.array([[-2.0, 2.0], [0.0, 0.04], [0.0, 0.0]]),
        limited=np.array([True, True, False]),
    )
    q = np.array([[1.9, 1.97], [0.001, 0.0005], [9.0, -9.0]])
    assert inside(tree, q).tolist() == [[True, False], [True, False], [True, True]]


@pytest.mark.long
def test_nothing_is_added_to_a_file_that_is_right(tmp_path):
    report = diagnose(arm_log(tmp_path / "null"), out=tmp_path / "out")
    assert report["verdict"] == "within_noise" and not report["effects"]
    assert report["message"].startswith("The model file as it is")
    assert not any(e.startswith(INERTIA) for e in report["fit_coordinates"]["after"])
    assert DAMPING_STEP in (tmp_path / "out" / "model.toml").read_text()
