"""The balance of torques along a measured motion: exact where the motion is, blind to what shrinks
with the torque, right about friction.
"""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.account import reported
from adaptsim_jax.attribution.equation.balance import balances, in_proportion, residual
from adaptsim_jax.attribution.equation.models import (
    left_out_values,
    made_apart,
    search_balances,
    without_each,
)
from adaptsim_jax.attribution.equation.searched import EffectTable, Searched
from adaptsim_jax.attribution.equation.windows import runs_of
from adaptsim_jax.attribution.examine import examined
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.measures import headline, of_torque, predicts_nothing
from adaptsim_jax.attribution.parameters import Entry, Vector
from adaptsim_jax.attribution.posed import DiagnosisSetting, declared_vector, scaled
from adaptsim_jax.attribution.problem import own_inertia, prepare, scaled_reach
from adaptsim_jax.attribution.stretches import JointTrack
from adaptsim_jax.diagnosis.criteria import Criteria, TorqueCriteria
from adaptsim_jax.effects.joints.catalogue import MACHINE
from experiments.mechanism_rigs import RIGS
from tests.attribution.pendulum import record
from tests.logs.measured_files import measured

NOTHING = Vector((), np.zeros(0))
SERVO = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/><worldbody><body name="link">
<joint name="hinge" axis="0 1 0" frictionloss="{friction}" solreffriction="0.002 1" solimpfriction="0.99 0.999 0.001"/>
<inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.004 0.004 0.001"/></body></worldbody>
<actuator><position name="hinge" joint="hinge" kp="{kp}" kv="{kv}" {limit}/></actuator></mujoco>"""  # noqa: E501
HEAVY = """<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody><body name="link">
<joint name="hinge" axis="0 1 0"/><inertial pos="0 0 0" mass="1e6" diaginertia="1e6 1e6 1e6"/></body></worldbody></mujoco>"""  # noqa: E501


def prepared(folder, model=None):
    machine = load(folder, model)
    problem = machine.problem(MACHINE)
    return machine, problem, balances(problem, machine.tracks)


def test_speed_and_acceleration_of_a_sine_are_its_own():
    time = np.arange(0.0, 8.0, 0.004)
    q = np.stack([np.sin(3.0 * time), 0.3 * np.cos(2.0 * time)], 1)
    (run,) = runs_of([JointTrack("a", time, q, None, np.zeros_like(q))], np.full(2, 1e-6))

    def weigh(z):
        return run.averaged(z)

    assert weigh(run.a)[0] == pytest.approx(weigh(-9.0 * run.q)[0], abs=0.05)
    assert run.averaged(np.ones((1, len(run.time)))) == pytest.approx(1.0)


def test_the_true_model_misses_nothing_but_its_friction(tmp_path):
    data = record(tmp_path / "rub", friction=0.2, trials=2, held=False)
    truth = tmp_path / "truth.xml"
    truth.write_text(
        (data / "model.xml")
        .read_text()
        .replace('mass="1.2"', 'mass="1.0"')
        .replace('damping="0.01"', 'damping="0.02"')
    )
    _, problem, (balance,) = prepared(data, truth)
    missing = residual(problem, balance, NOTHING)[:, 0]
    moves = balance.clear[:, 0] > 0.9
    sign = balance.averaged(balance.sign)[:, 0]
    assert np.median(np.abs(missing[moves] + 0.2 * sign[moves])) < 0.03
    assert np.sqrt(np.mean(missing[moves] ** 2)) == pytest.approx(0.2, rel=0.15)


def test_a_fold_of_stretches_has_the_values_of_the_windows_without_its_own_trial(tmp_path):
    """The second of six trials is shorter than a stretch, and has windows."""
    tracks = load(record(tmp_path / "log", friction=0.0, seconds=2.0)).tracks
    short = {"time": 100, "q": 100, "u": 100}
    tracks = [
        replace(t, **{k: getattr(t, k)[:n] for k, n in short.items()}) if i == 1 else t
        for i, t in enumerate(tracks)
    ]
    machine = load(tmp_path / "log")
    problem = prepare(machine.tree, tracks, MACHINE, declared=machine.declared)
    null = declared_vector(machine, problem)
    reach = scaled_reach(problem, *own_inertia(problem, null))
    (balance,) = balances(problem, tracks)
    state = Searched(problem, balance, null, reach, Criteria(), False)
    whole = state.set_of(())
    part = SimpleNamespace(balance=balance, rows=state.rows, base=whole, whole=whole)
    found = SimpleNamespace(searches=(part,), null=null)
    values = left_out_values(problem, found, null, without_each(found, null))
    trial = problem.groups[0].stretches.trial[: len(problem.fold)]
    assert set(balance.trial) == set(range(6)) and set(trial) == {0, 2, 3, 4, 5}
    for t in set(trial):
        (own,) = set(state.rows.fold[balance.trial == t])
        off = whole.by_fold[own] - whole.step
        expected = np.clip(null.values + off, null.low, null.high)
        np.testing.assert_allclose(
            values[trial == t], expected[None] * np.ones((sum(trial == t), 1))
        )
    assert np.ptp(values, 0).max() > 0.0


def test_trials_at_two_rates_are_each_read_by_their_own_step(tmp_path):
    late = Vector((Entry("delay", "delay", (0,), 0.0, 0.0, -0.1, 0.1, "s"),), np.array([0.02]))
    tracks = []
    for rate in (100, 250):
        folder = record(tmp_path / f"at_{rate}", friction=0.0, trials=1, seconds=3.0, rate=rate)
        tracks.append(load(folder).tracks[0])
    machine = load(tmp_path / "at_100")
    law = np.array([[1.0], [0.0], [0.0], [-0.5], [-0.6], [0.6]])
    problem = prepare(machine.tree, tracks, MACHINE, actuator=law, declared=machine.declared)
    assert problem.reach.dt == pytest.approx(0.01)

    def changed(*some):
        (balance,) = balances(problem, some)
        return residual(problem, balance, late) - residual(problem, balance, NOTHING)

    alone = np.concatenate([changed(t) for t in tracks])
    assert np.abs(alone).max() > 0.05
    np.testing.assert_allclose(changed(*tracks), alone, atol=1e-9)


def test_columns_are_slopes_of_what_is_missing(tmp_path):
    machine, problem, (balance,) = prepared(record(tmp_path / "rub", friction=0.2, trials=2))
    vector = declared_vector(machine, problem).with_entries(
        [
            Entry("encoder_offset", "offset", (0,), 0.0, 0.0, -0.8, 0.8, "rad"),
            Entry("encoder_scale", "scale", (0,), 0.0, 0.0, -0.5, 0.5, "1"),
        ]
    )
    table = EffectTable(problem, balance, vector)
    for k, entry in enumerate(vector.entries):
        step = np.zeros(len(vector))
        step[k] = 1e-4
        slope = (
            residual(problem, balance, vector.at(vector.values + step)) - table.missing()
        ) / -1e-4
        assert table.of(entry) == pytest.approx(slope, abs=1e-3 * max(1.0, np.abs(slope).max()))


def test_an_actuator_that_does_nothing_leaves_as_much_as_it_was_told():
    told = np.ones((9, 2))
    assert in_proportion(told, told * np.array([0.5, 0.0])) == pytest.approx([0.5, 0.02])


def test_friction_is_found_in_seconds_and_nothing_beside(tmp_path):
    machine, problem, told = prepared(record(tmp_path / "rub", friction=0.2, trials=4, held=False))
    null = declared_vector(machine, problem)
    found = search_balances(
        problem, told, null, scaled_reach(problem, *own_inertia(problem, null)), Criteria(), False
    )
    (named,) = found.named
    assert (named.candidate.effect, named.candidate.joints) == ("coulomb", (0,))
    value = found.final.values[found.final.index()["coulomb", "level", (0,)]]
    assert value == pytest.approx(0.2, rel=0.1)


def test_a_dead_model_is_refused_by_yardstick_verdict_and_search(tmp_path):
    """A body too heavy to move, driven by next to nothing, is a straight line, and a straight line
    a good forecast of slow motion.
    """
    folder = tmp_path / "slow"
    folder.mkdir()
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 12.0, 0.01)
    for k in range(2):
        q = (
            0.3 * np.sin(0.4 * time + k)
            + 0.1 * np.sin(1.1 * time - k)
            + 1e-3 * rng.normal(size=len(time))
        )
        torque = 0.5 * rng.normal(
            size=len(time)
        )  # of another machine: it has nothing to do with the motion
        np.savetxt(
            folder / f"t{k}.csv",
            np.stack([time, q, torque], 1),
            delimiter=",",
            header="time,q1,tau1",
            comments="",
        )
    (folder / "model.xml").write_text(HEAVY)
    mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\ninput = "torque"\n')
    machine, problem, told = prepared(folder)
    assert of_torque(problem, told, NOTHING).skill <= -0.9
    others = [e.name for e in MACHINE if e.name not in ("viscous", "coulomb", "torque_gain")]
    whole = examined(machine, DiagnosisSetting(exclude=tuple(others)))
    report, _ = reported(whole)
    assert predicts_nothing(whole.after) and headline(whole.before)[0] == "stretches"
    assert report["effects"] == [] and report["message"].startswith("This model predicts nothing")


def test_what_is_made_without_a_trial_is_what_the_other_trials_say(tmp_path):
    """Beside a file that is fitted to all trials; one of them had other friction."""
    folder = record(tmp_path / "log", friction=0.2, trials=2, held=False)
    other = record(tmp_path / "other", friction=0.3, trials=3, held=False)
    (other / "trial_02.csv").rename(folder / "trial_02.csv")
    machine, problem, told = prepared(folder)
    null = declared_vector(machine, problem)
    reach = scaled_reach(problem, *own_inertia(problem, null))
    found = search_balances(problem, told, null, reach, Criteria(), False)
    (friction,) = (n.candidate for n in found.named)
    parts = {part[0]: less for part, less in made_apart(found)}

    def level(search):
        return search.final.known()[friction.entries[0].key]

    assert list(parts) == ["trial_00", "trial_01", "trial_02"]
    assert level(parts["trial_02"]) == pytest.approx(0.2, rel=0.1)
    assert 0.215 < level(found) < level(parts["trial_01"])


@pytest.mark.slow
def test_what_the_torque_shows_of_a_real_servo_is_held_against_its_motion(tmp_path):
    """The torque along the motion finds a rotor that simulates worse than none; friction that
    follows the load simulates better.
    """
    folder = measured("measured_servo_pendulum")
    (tmp_path / "meta.toml").write_text(
        'task = "mechanism"\nmodel = "model.xml"\ninput = "voltage"\n'
    )
    (tmp_path / "model.xml").write_text((RIGS / "servo_pendulum" / "model.xml").read_text())
    for file in [*folder.glob("kp100_*.csv"), *folder.glob("kp400_*.csv")]:
        (tmp_path / file.name).symlink_to(file)
    skill = {}
    for criteria in (Criteria(torque=TorqueCriteria(simulated=0)), Criteria()):
        whole = examined(scaled(load(tmp_path, None), 0.5), DiagnosisSetting(criteria))
        skill[whole.judge] = {k: m.skill for k, m in whole.after.items()}
    assert skill["torque"]["stretches"] < -0.9 and skill["stretches"]["stretches"] > 0.0
    assert sum(skill["stretches"].values()) > sum(skill["torque"].values())
