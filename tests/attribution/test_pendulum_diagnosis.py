"""`task = "pendulum"` from files to a report and back: friction sized, data that contradict
themselves, a mended model as the declared one, a linearized world, an effect of one's own.
"""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

import adaptsim_jax
from adaptsim_jax import diagnose
from adaptsim_jax.attribution import pendulum_diagnosis
from adaptsim_jax.attribution.candidates import candidates
from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.fitted import over_floor
from adaptsim_jax.attribution.held_out import modelled
from adaptsim_jax.attribution.parameters import BODY_NUMBERS, inertias
from adaptsim_jax.attribution.pendulum import LINK, base_parameters, declared_machine, in_the_plane
from adaptsim_jax.attribution.pendulum_diagnosis import first_parameters
from adaptsim_jax.attribution.posed import declared_vector
from adaptsim_jax.attribution.problem import own_inertia, scaled_reach
from adaptsim_jax.attribution.tree_objective import TreeObjective
from adaptsim_jax.diagnosis import Effect, Quantity, catalogue
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.logs.pendulum import read_pendulum
from adaptsim_jax.logs.quality.audit import audit, usable
from adaptsim_jax.mechanisms import dynamics, equations
from adaptsim_jax.mechanisms.double_pendulum.linear import linearized
from adaptsim_jax.mechanisms.double_pendulum.plant import double_pendulum_mjcf
from adaptsim_jax.mechanisms.mjcf import read_mechanism
from adaptsim_jax.mend.model_toml import read_model_table
from tests.attribution.small_rig import TRUE, make_trials, written
from tests.generators import Spec, make_datasets, write_dataset

SAMPLE = Path(adaptsim_jax.__file__).parent / "logs" / "sample" / "recording"
FEW = ("viscous", "coulomb", "bias", "quadratic_drag")
REST = tuple(e.name for e in catalogue("mechanism") if e.name not in FEW)
LEVEL = 0.03  # N m of dry friction on joint 2


def rubbing(t, q, v, u):
    return np.array([0.0, -LEVEL * np.tanh(v[1] / 1e-2)])


def test_the_fit_begins_near_the_truth(tmp_path):
    recording = read_pendulum(written(tmp_path, make_trials(seed=1, count=3, noise=0.2)))
    found = first_parameters(recording)
    np.testing.assert_allclose(found[:4], TRUE[:4], rtol=0.15)


def test_rows_that_the_audit_found_spiked_are_not_fitted(tmp_path):
    trials = make_trials(seed=2, count=3, seconds=3.0, noise=0.2)
    trials[1].q[205, 1] += 0.4
    recording = read_pendulum(written(tmp_path, trials))
    checked = audit(recording)
    rest = usable(recording, checked)
    hidden = ~np.isfinite(rest.trials[1].q[:, 1])
    assert np.flatnonzero(hidden).tolist() == [205]
    np.testing.assert_allclose(first_parameters(rest)[:4], TRUE[:4], rtol=0.15)
    holes = replace(checked, valid={t.name: np.arange(len(t.time)) % 50 > 0 for t in rest.trials})
    # no part is as long as one that is regressed by itself
    torn = usable(recording, holes)
    assert np.all(np.isfinite(first_parameters(torn)))


@pytest.mark.long
def test_an_effect_at_all_joints_stays_where_it_is(tmp_path):
    """Dry friction put in at both joints, of which the second rubs: tested at each, it is left at
    that one, refitted.
    """
    recording = read_pendulum(
        written(tmp_path, make_trials(3, 4, 2.0, 100.0, noise=0.2, extra=rubbing, velocity=False))
    )
    machine = declared_machine(recording, first_parameters(recording), tmp_path / "declared.xml")
    problem = machine.problem(MACHINE)
    null = in_the_plane(declared_vector(machine, problem))
    reach = scaled_reach(problem, *own_inertia(problem, null))
    (both,) = [
        c for c in candidates(problem, null, reach) if c.effect == "coulomb" and c.sharing == "all"
    ]
    assert [c.joints for c in both.split()] == [(0,), (1,)]
    model = modelled(problem, (both,), fit(problem, null.with_entries(both.entries), rounds=8))
    less, trace = TreeObjective(problem, model, reach, Criteria()).members(model)
    assert [(c.effect, c.joints, c.sharing) for c in less.added] == [("coulomb", (1,), "joint")]
    assert [s.candidate.joints for s in trace] == [(0,)]
    values = {
        e.key: z for e, z in zip(less.fit.vector.entries, less.fit.vector.values, strict=True)
    }
    assert values["coulomb", "level", (1,)] == pytest.approx(LEVEL, rel=0.1)
    assert ("coulomb", "level", (0,)) not in values


@pytest.mark.long
def test_play_begins_at_what_was_read_with_the_link_at_either_end(tmp_path):
    """An encoder with a play of 0.15 rad at joint 1: from 0.1 rad the gap is found, and little more
    than the noise is left.
    """
    trials = make_trials(3, 4, 2.0, 200.0, noise=0.2, velocity=False)
    for trial in trials:
        trial.q[:, 0] = read_with_play(trial.q[:, 0], 0.075)
    recording = read_pendulum(written(tmp_path, trials))
    machine = declared_machine(recording, np.array(TRUE), tmp_path / "declared.xml")
    problem = machine.problem(MACHINE)
    null = in_the_plane(declared_vector(machine, problem))
    every = candidates(problem, null, scaled_reach(problem, *own_inertia(problem, null)))
    play = next(c for c in every if c.effect == "backlash" and c.joints == (0,))
    vector = null.with_entries(play.entries, [0.1])
    found = fit(problem, vector, rounds=15)
    values = {e.key: z for e, z in zip(found.vector.entries, found.vector.values, strict=True)}
    assert values["backlash", "gap", (0,)] == pytest.approx(0.15, rel=0.03)
    assert over_floor(problem, modelled(problem, (play,), found)) < 2.0


def read_with_play(q, half):
    """What an encoder reads that follows an angle at a distance of at most `half`."""
    reading = np.array(q, float)
    for k in range(1, len(q)):
        reading[k] = np.clip(reading[k - 1], q[k] - half, q[k] + half)
    return reading


@pytest.mark.slow
def test_friction_is_named_and_a_second_pass_on_the_mended_model_finds_nothing(tmp_path):
    trials = make_trials(3, 6, 3.0, 100.0, noise=0.2, extra=rubbing, velocity=False)
    (tmp_path / "data").mkdir()
    data = written(tmp_path / "data", trials)
    report = diagnose(data, out=tmp_path / "out", exclude=REST)
    assert [(e["name"], e["where"]) for e in report["effects"]] == [("coulomb", "joint2")]
    assert report["effects"][0]["parameters"]["level"]["value"] == pytest.approx(LEVEL, rel=0.1)
    for name, true in zip(("p1", "p3", "h1", "h2"), TRUE[:4], strict=True):
        assert report["declared"]["after"][name]["value"] == pytest.approx(true, rel=0.05)
    effects = read_model_table(tmp_path / "out" / "model.toml")["effects"]
    (level,) = (e["parameters"]["level"] for e in effects if e["name"] == "coulomb")
    assert level["value"] == pytest.approx(LEVEL, rel=0.1)
    meta = (data / "meta.toml").read_text().replace('"rigid_body"', '"../out/model.toml"')
    (data / "meta.toml").write_text(meta[: meta.index("[geometry]")])
    again = diagnose(data, exclude=REST)
    assert again["verdict"] == "within_noise" and not again["effects"]


def test_what_an_earlier_run_left_in_the_folder_goes(tmp_path):
    """A recording that contradicts itself has no model; that of the run before is not this
    report's.
    """
    stale = [
        tmp_path / "out" / name
        for name in ("model.toml", "leading.toml", "next_experiment.csv", "model.xml")
    ]
    (tmp_path / "out").mkdir()
    for file in stale:
        file.write_text("old")
    data = shutil.copytree(SAMPLE, tmp_path / "data")
    for trial in data.glob("*.csv"):
        rows = np.genfromtxt(trial, delimiter=",", names=True)
        rows["v1"] = rows["v1"][::-1].copy()
        np.savetxt(trial, rows, delimiter=",", header=",".join(rows.dtype.names), comments="")
    assert diagnose(data, out=tmp_path / "out")["verdict"] == "data_fault"
    assert not any(file.exists() for file in stale)


def test_a_linearized_tree_is_the_papers_linear_model(tmp_path):
    m1, m2 = 1.7, 1.2
    file = tmp_path / "model.xml"
    theta = np.array([m1 + 2 * m2, m2, m1 + m2, m2, 0.0, 0.0])
    file.write_text(double_pendulum_mjcf(theta, {"l1": 1.0}, "upright"))
    tree = read_mechanism(file).tree
    with jax.enable_x64(True):
        A, B = linearized(jnp.array([m1, m2, 0.0, 0.0]))
        q, v, force = jnp.array([2.1, -0.7]), jnp.array([3.0, -5.0]), jnp.array([0.4, -0.2])
        right = A[2:] @ jnp.concatenate([q, v]) + B[2:] @ force
        inertial, gravity = jnp.asarray(tree.inertial), jnp.asarray(tree.gravity)
        linear = replace(tree, linear=True)
        got = equations.acceleration(linear, inertial, q, v, force, jnp.zeros(2), gravity)
        np.testing.assert_allclose(
            got, right, rtol=2e-2
        )  # two bodies near point masses, as MJCF can write them
        full = dynamics.acceleration(tree, inertial, q, v, force, jnp.zeros(2), gravity)
        assert np.abs(np.asarray(full - right)).max() > 1.0
        a = equations.acceleration(linear, inertial, q, v, force, jnp.zeros(2), gravity)
        table = equations.regressor(linear, q, v, a, gravity)
        np.testing.assert_allclose(table @ inertial.ravel(), force, atol=1e-9)


@pytest.mark.slow
def test_of_two_effects_of_a_linearized_world_both_are_named(tmp_path):
    two = (("coulomb", 2, 5.0), ("spring", 1, 4.0))
    (data,) = make_datasets([Spec(906, n_trials=4, seconds=4.0, effects=two, world="linearized")])
    report = diagnose(write_dataset(data, tmp_path / "data"), out=tmp_path / "out")
    found = {(e["name"], e["where"]) for e in report["effects"]}
    assert {("coulomb", "joint2"), ("spring", "joint1")} <= found, report["message"]
    assert set(report["declared"]["after"]) == {"m1", "m2", "b1", "b2"}
    assert (
        not (tmp_path / "out" / "model.xml").exists() and (tmp_path / "out" / "model.toml").exists()
    )


@pytest.mark.slow
def test_an_effect_of_ones_own_competes(tmp_path):
    def pull(p, m):
        return -p["size"] * jnp.sin(3.0 * m.q)

    mine = Effect(
        "mine",
        "force",
        (Quantity("size", "N m", -1.0, 1.0, 0.0),),
        pull,
        "a magnet",
        "wide angles",
    )
    trials = make_trials(
        5,
        4,
        3.0,
        100.0,
        noise=0.2,
        extra=lambda t, q, v, u: np.array([-0.1 * np.sin(3 * q[0]), 0.0]),
    )
    data = written(tmp_path, trials)
    few = tuple(e for e in catalogue("mechanism") if e.name in ("bias", "coulomb"))
    report = diagnose(data, effects=(*few, mine))
    assert [(e["name"], e["where"]) for e in report["effects"]] == [("mine", "joint1")]
    assert report["effects"][0]["parameters"]["size"]["value"] == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize(("known", "file"), [({}, None), ({"m1": 1.0}, None), ({}, "rig.xml")])
def test_a_gain_of_either_joint_is_the_same_where_no_mass_is_known(known, file):
    """Twice the torque of joint 2 on masses M is half of that of joint 1 on M / 2."""
    gain = {
        "name": "torque_gain",
        "where": "joint2",
        "alternatives": [],
        "parameters": {"gain": {"value": 1.0}},
    }
    report = {"effects": [gain], "verdict": "explained", "notes": []}
    pendulum_diagnosis._of_unknown_masses(report, SimpleNamespace(known=known, model_file=file))
    if known or file:
        assert (gain["alternatives"], report["verdict"], report["notes"]) == ([], "explained", [])
        return
    assert gain["alternatives"] == ["torque_gain@joint1"] and report["verdict"] == "explained_class"
    assert "torque_gain at joint1 of -0.5, with masses and dampings 0.5 times" in report["notes"][0]


def test_links_are_thin_enough_for_rigs_whose_mass_sits_at_their_ends(tmp_path):
    """Base parameters of a rig with little moment about its centres of mass are reached by the
    fitted links, from others.
    """
    theta, wanted, l1 = (
        np.array([0.070, 0.0355, 0.122, 0.081, 0.0, 0.0]),
        np.array([0.1404, 0.0798, 0.2808, 0.2139]),
        0.244,
    )
    (tmp_path / "rig.xml").write_text(double_pendulum_mjcf(theta, {"l1": l1}, "hanging"))
    bodies = inertias(np.asarray(read_mechanism(tmp_path / "rig.xml").tree.inertial))
    places = [(b, BODY_NUMBERS.index(name)) for b in range(2) for name in LINK]

    def off(z):
        numbers = np.zeros((2, len(BODY_NUMBERS)))
        numbers[tuple(zip(*places, strict=True))] = z
        return base_parameters(bodies.at(numbers)[0], l1, 1.0) / wanted - 1.0

    found = least_squares(off, np.zeros(len(places)))
    assert np.max(np.abs(found.fun)) < 1e-3
