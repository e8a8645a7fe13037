"""Servos in closed loop: simulated joint by joint and whole, their law found, and its files."""

import copy
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.replay import replay
from adaptsim_jax.logs.read import read_source_and_log
from adaptsim_jax.simulators.closed_loop.criteria import CLOSED_LOOP
from adaptsim_jax.simulators.closed_loop.fit import LawFit, fit_law, sum_squares
from adaptsim_jax.simulators.closed_loop.identified import identify_servos, in_fine_steps
from adaptsim_jax.simulators.closed_loop.imposed import joint_problems
from adaptsim_jax.simulators.closed_loop.law import put_law, servos_of, step_law
from adaptsim_jax.simulators.closed_loop.pieces import imposed_motion
from adaptsim_jax.simulators.closed_loop.polish import (
    FittedServos,
    over_noise,
    polish_laws,
    whole_trials,
)
from adaptsim_jax.simulators.closed_loop.recording import recording_of
from adaptsim_jax.simulators.closed_loop.rivals import (
    damping_shown,
    gain_shown,
    or_other_friction,
    or_plain,
)
from adaptsim_jax.simulators.closed_loop.stepping import errors
from adaptsim_jax.simulators.closed_loop.whole import simulate, trial_errors

ARM = """<mujoco><option timestep="0.002"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0" armature=".03" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1.2"/><body name="fore" pos="0 0 -.3">
<joint name="elbow" axis="0 1 0" armature=".02" damping=".1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.25" size=".025" mass=".8"/></body></body></worldbody>
<actuator><position name="shoulder" joint="shoulder" kp="80" kv="4" forcerange="-40 40"/>
<position name="elbow" joint="elbow" kp="60" kv="3"/></actuator></mujoco>"""
WHEEL = """<mujoco><option timestep="0.002"/><worldbody><body name="arm">
<joint name="turn" axis="0 0 1" armature=".05" damping=".2"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".5"/></body></worldbody>
<actuator><velocity name="turn" joint="turn" kv="2"/></actuator></mujoco>"""
ARM_JOINTS = ("shoulder", "elbow")
FINE, RATE, NOISE = 2e-4, 50, 2e-4


def logged(folder: Path, file: str, law=None, late: float = 0.0, load_kg: float = 0.0) -> Path:
    """`folder` with `file` as the model, and three trials of 8 s of servos whose laws are
    `law(joint, the file's)`, with targets `late` s late and a mass at the last body.
    """
    folder.mkdir()
    (folder / "model.xml").write_text(file)
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    model = mujoco.MjModel.from_xml_string(file)
    names = [model.joint(j).name for j in range(model.njnt)]
    data = mujoco.MjData(model)
    made = type("Made", (), {"model": model})
    log = type("Log", (), {"input_kind": "command", "joint_names": names, "input_names": names})
    speeds = model.actuator_biasprm[0, 1] == 0.0
    for k, servo in enumerate(servos_of(made, log)):
        put_law(servo, model, law(k, servo.law) if law else servo.law)
    model.body_mass[-1] += load_kg
    mujoco.mj_setConst(model, data)
    model.opt.timestep = FINE
    model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    rng = np.random.default_rng(5)
    kind = "ctrl" if speeds else "target"
    heads = ",".join(["time", *(f"q_{n}" for n in names), *(f"{kind}_{n}" for n in names)])
    for trial in range(3):
        data = mujoco.MjData(model)
        rate, phase = rng.uniform(0.3, 1.3, (3, len(names))), rng.uniform(0, 6, (3, len(names)))

        def target(t, rate=rate, phase=phase):
            wave = np.sin(2 * np.pi * rate * t + phase) - np.sin(phase)
            return (2.0 if speeds else 0.25) * wave.sum(0) * min(1.0, 2 * t)

        rows = []
        for k in range(8 * RATE):
            read = data.qpos + rng.normal(0.0, NOISE, len(names))
            rows.append([k / RATE, *read, *target(k / RATE)])
            for step in range(round(1 / RATE / FINE)):
                row = np.floor(k + step * FINE * RATE - late * RATE + 1e-9)
                data.ctrl[:] = target(max(row, 0) / RATE)
                mujoco.mj_step(model, data)
        np.savetxt(folder / f"run_{trial}.csv", rows, "%.8f", ",", header=heads, comments="")
    return folder


def recording(folder: Path):
    return recording_of(*read_source_and_log(folder, None))


def other(joint, law):
    """kp 0.7 and damping 0.4 of the file's, and friction at the second joint."""
    return law._replace(kp=0.7 * law.kp, damping=0.4 * law.damping, rub=0.4 * joint)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return logged(tmp_path_factory.mktemp("arm") / "log", ARM, other)


def test_whole_trials_and_one_joint_by_itself_simulate_the_truth_to_within_noise(arm):
    made = recording(arm)
    laws = [other(j, s.law) for j, s in enumerate(made.servos)]
    (path,) = simulate(made, [laws])
    assert np.sqrt(np.square(trial_errors(made, path)).mean(0)).max() < 1.5 * NOISE
    motions = [imposed_motion(t, m) for t, m in zip(made.trials, path, strict=True)]
    for problem, law in zip(joint_problems(made, motions, laws), laws, strict=True):
        off = errors(problem, [law])[0]
        assert np.sqrt(np.square(off).sum() / problem.rows.sum()) < 3.0 * NOISE


def cut(joint, law):
    """Heavily damped, and at its limit whenever it moves."""
    return law._replace(kp=60 * law.kp, damping=16.0, limit=3.0 - 1.5 * joint, inside=0.0)


@pytest.fixture(scope="module")
def cut_arm(tmp_path_factory):
    return recording(logged(tmp_path_factory.mktemp("cut") / "log", ARM, cut))


def test_motion_at_a_limit_is_alike_in_any_step(cut_arm):
    laws = [cut(j, s.law) for j, s in enumerate(cut_arm.servos)]
    for step in (1e-3, 1e-4):
        model = copy.copy(cut_arm.model)
        model.opt.timestep = step
        made = replace(cut_arm, model=model)
        off = trial_errors(made, simulate(made, [laws])[0])
        assert np.sqrt(np.square(off).mean(0)).max() < 1.5 * NOISE


@pytest.mark.parametrize("way, shown", [(other, True), (cut, False)])
def test_kp_shows_unless_motion_is_at_a_limit(arm, cut_arm, way, shown):
    made = recording(arm) if way is other else cut_arm
    laws = [way(j, s.law) for j, s in enumerate(made.servos)]
    whole, found = polished(made, laws, ("scale", "damping", "rub", "limit"))
    assert gain_shown(whole, found) == (shown, shown)


def bang(joint, law):
    """Hardly damped, and at its limit whenever it moves."""
    return law._replace(kp=60 * law.kp, damping=0.5, limit=3.0 - 1.5 * joint)


def polished(made, laws, free, shared=(), rounds=0):
    """Whole trials and the servos fitted to them, begun from some laws."""
    problems = joint_problems(made, [imposed_motion(t) for t in made.trials], laws)
    whole = whole_trials(made, problems)
    fits = tuple(LawFit(law, free) for law in laws)
    return whole, polish_laws(whole, FittedServos(fits, shared), rounds=rounds)


@pytest.mark.parametrize("way, shown", [(other, True), (bang, False)])
def test_damping_shows_unless_the_limit_alone_acts(arm, tmp_path, way, shown):
    made = recording(arm if way is other else logged(tmp_path / "log", ARM, bang))
    laws = [way(j, s.law) for j, s in enumerate(made.servos)]
    whole, found = polished(made, laws, ("scale", "damping", "rub", "limit"))
    assert damping_shown(whole, found) == (shown, shown)


def test_a_cut_trial_begins_as_it_was_measured(arm):
    made = recording(arm)
    laws = [other(j, s.law) for j, s in enumerate(made.servos)]
    cut_recording = made.in_pieces_of(1.0).cut()
    assert len(cut_recording.trials) == len(cut_recording.pieces) == 24
    first, second = cut_recording.trials[:2]
    assert first.begin == 0.0 and 0.5 < second.begin == pytest.approx(first.time[-1], abs=0.05)
    (path,) = simulate(cut_recording, [laws])
    off = trial_errors(cut_recording, path)
    late = np.concatenate([t.time > CLOSED_LOOP.unscored for t in cut_recording.trials])
    assert np.sqrt(np.square(off[late]).mean(0)).max() < 3.0 * NOISE


def test_friction_that_holds_is_taken_where_creeping_does_no_better(arm):
    made = recording(arm)
    laws = [other(j, s.law)._replace(sharp=0.0) for j, s in enumerate(made.servos)]
    whole, creeping = polished(made, laws, ("scale", "damping", "rub"), rounds=3)
    holding = or_other_friction(whole, creeping)
    assert holding.model.laws[0].sharp == 1.0
    assert over_noise(whole, holding.errors).max() < 1.5


def heavy(joint, law):
    """Stopped by its damping within a step, with friction at the second joint."""
    return law._replace(kp=20 * law.kp, damping=20 * law.damping, rub=0.4 * joint)


@pytest.mark.parametrize("way, times", [(other, 1.0), (heavy, 0.5)])
def test_steps_are_as_fine_as_a_law_asks_for(arm, tmp_path, way, times):
    made = recording(arm if way is other else logged(tmp_path / "log", ARM, way))
    laws = [way(j, s.law) for j, s in enumerate(made.servos)]
    whole, _ = polished(made, laws, ())
    assert in_fine_steps(whole, laws).recording.whole_step == times * made.whole_step


def test_late_targets_take_the_place_of_rotors_that_stood_for_them(tmp_path):
    made = recording(logged(tmp_path / "log", ARM, other, late=0.02))
    laws = [other(j, s.law) for j, s in enumerate(made.servos)]
    free = ("scale", "damping", "rub", "rotor")
    whole, rotors = polished(made, laws, free, ("damping_delay", "shift"), rounds=6)
    plain = or_plain(whole, rotors, [s.law for s in made.servos])
    assert plain.model.laws[0].delay == pytest.approx(0.02, abs=0.002)
    assert not any("rotor" in f.free for f in plain.model.fits)
    assert over_noise(whole, plain.errors).max() < 1.5


def test_coordinates_move_the_scale_with_all_that_it_multiplies(arm):
    made = recording(arm)
    (problem, _) = joint_problems(
        made, [imposed_motion(t) for t in made.trials], [s.law for s in made.servos]
    )
    law, free = problem.servo.law, problem.servo.free
    twice = step_law(problem.servo, problem.scales, law, free, np.array([np.log(2.0), 0.0, 0.0]))
    assert twice.kp == pytest.approx(2 * law.kp)
    assert twice.damping / twice.kp == pytest.approx(law.damping / law.kp)
    assert twice.limit == law.limit  # is not fitted
    far = replace(problem, groups=problem.groups)
    begun = fit_law(far, LawFit(law._replace(kp=0.5 * law.kp), free))
    assert sum_squares(far, begun.law).sum() < 0.1 * sum_squares(far, law).sum()


def test_kp_damping_and_friction_that_are_not_the_files_are_found(arm, tmp_path):
    report = diagnose(arm, out=tmp_path / "out")
    rows = {(r["name"], r["where"]): r["parameters"] for r in report["effects"]}
    assert set(rows) == {
        ("position_gain", "shoulder"),
        ("position_gain", "elbow"),
        ("coulomb", "elbow"),
    }
    for joint, kp in (("shoulder", 56.0), ("elbow", 42.0)):
        row = rows["position_gain", joint]
        assert row["kp"]["value"] == pytest.approx(kp, rel=0.05)
        ratio = row["damping_over_kp"]
        assert ratio["value"] == pytest.approx(0.4 / 0.7 * ratio["file"], rel=0.03)
    assert rows["coulomb", "elbow"]["level"]["value"] == pytest.approx(0.4, rel=0.1)
    assert report["verdict"] == "explained" and "law is not the file's" in report["message"]
    assert not any(row["worse"] for row in report["files"]["model.xml"])
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "model.xml"))
    assert model.actuator_gainprm[0, 0] == pytest.approx(56.0, rel=0.05)
    assert model.dof_frictionloss[1] == pytest.approx(0.4, rel=0.1)
    mended, file = (load(arm, m) for m in (tmp_path / "out" / "model.toml", None))
    assert mended.actuator[3] == pytest.approx(0.4 * file.actuator[3], rel=0.1)
    after, before = (np.median(replay(m, 1.0).error, 0) for m in (mended, file))
    assert np.all(after < 0.1 * before)


def weak(joint, law):
    """At limits that do not carry the arm's own swing."""
    return law._replace(kp=4.0 * law.kp, damping=0.5 * law.damping, limit=1.6 - 0.9 * joint)


@pytest.mark.long
def test_joints_that_run_away_at_a_limit_are_judged_over_stretches(tmp_path):
    report = diagnose(logged(tmp_path / "log", ARM, weak), out=tmp_path / "out")
    rows = {(r["name"], r["where"]): r["parameters"] for r in report["effects"]}
    wanted = {(n, j) for n in ("position_gain", "saturation") for j in ARM_JOINTS}
    assert set(rows) - {("body_mass", "elbow")} == wanted
    for j, joint in enumerate(ARM_JOINTS):
        limit = rows["saturation", joint]["limit"]["value"]
        assert limit == pytest.approx(1.6 - 0.9 * j, rel=0.03)
    assert "Stretches of 1 s" in report["message"]
    assert all(r["after"] < 0.1 * r["before"] for r in report["files"]["model.xml"])
    if set(rows) != wanted:
        pytest.xfail("a mass that is not there is named beside the limits")
    assert rows["position_gain", "shoulder"]["kp"]["value"] == pytest.approx(320.0, rel=0.05)


def test_what_lacks_nothing_is_not_searched(tmp_path):
    found = identify_servos(recording(logged(tmp_path / "log", ARM)))
    assert found.members == () and found.laws == [s.law for s in found.recording.servos]
    assert found.over_noise.max() < 1.5


@pytest.mark.long
def test_a_late_target_is_a_delay_and_nothing_else(tmp_path):
    report = diagnose(logged(tmp_path / "log", ARM, late=0.03))
    (row,) = report["effects"]
    assert (row["name"], row["where"]) == ("delay", "all joints")
    assert row["parameters"]["delay"]["value"] == pytest.approx(0.03, abs=1e-3)


@pytest.mark.long
def test_a_mass_at_the_hand_is_named_with_its_interval(tmp_path):
    report = diagnose(logged(tmp_path / "log", ARM, load_kg=0.4), out=tmp_path / "out")
    (row,) = report["effects"]
    assert (row["name"], row["where"]) == ("body_mass", "elbow")
    mass = row["parameters"]["mass"]
    assert mass["value"] == pytest.approx(0.4, rel=0.15) and mass["low"] < 0.4 < mass["high"]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "model.xml"))
    assert model.body_mass[-1] == pytest.approx(1.2, rel=0.05)


def test_a_speed_servo_has_its_damping_found(tmp_path):
    slower = logged(tmp_path / "log", WHEEL, lambda j, law: law._replace(damping=1.0))
    report = diagnose(slower, out=tmp_path / "out")
    (row,) = report["effects"]
    assert row["name"] == "position_gain"
    assert row["parameters"]["damping"]["value"] == pytest.approx(1.0, rel=0.1)
    mended, file = (load(slower, m) for m in (tmp_path / "out" / "model.toml", None))
    after, before = (np.median(replay(m, 1.0).error, 0) for m in (mended, file))
    assert np.all(after < 0.2 * before)


def test_machines_of_which_a_joint_follows_nothing_are_left_to_others(tmp_path):
    source, log = read_source_and_log(logged(tmp_path / "log", ARM), None)
    assert recording_of(source, log) is not None
    assert recording_of(source, replace(log, input_kind="torque")) is None
    assert recording_of(source, replace(log, input_names=("shoulder",))) is None
