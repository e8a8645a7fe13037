"""What a fold is predicted with, and the price of a parameter."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from adaptsim_jax.attribution.candidates import candidates
from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.held_out import attempted, modelled, refit
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.nested_models import more
from adaptsim_jax.attribution.parameters import Entry, Vector
from adaptsim_jax.attribution.paths import losses, run
from adaptsim_jax.attribution.problem import nuisances, own_inertia, prepare, scaled_reach
from adaptsim_jax.attribution.score import table
from adaptsim_jax.attribution.tree_objective import select
from adaptsim_jax.diagnosis import search
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.joints.catalogue import MACHINE
from tests.attribution.pendulum import record

FEW = tuple(
    e for e in MACHINE if e.name in ("viscous", "coulomb", "bias") or e.place == "model"
)  # to be quick


def test_of_what_no_other_trial_has_seen_a_trial_is_predicted_without(tmp_path):
    """Only the first trial moves: without it nobody knows the damping. The others say nothing of
    it, and change nothing.
    """
    folder = record(tmp_path / "log", friction=0.0, trials=6, seconds=2.0, rate=125)
    rng = np.random.default_rng(0)
    for k in range(1, 6):
        rows = np.loadtxt(folder / f"trial_{k:02d}.csv", delimiter=",", skiprows=1)
        rows[:, 1:] = np.stack([2e-4 * rng.normal(size=len(rows)), np.zeros(len(rows))], 1)
        np.savetxt(
            folder / f"trial_{k:02d}.csv",
            rows,
            delimiter=",",
            header="time,q1,tau1",
            comments="",
            fmt="%.8g",
        )
    machine = load(folder)
    problem = prepare(machine.tree, machine.tracks, FEW, declared=machine.declared)
    vector = nuisances(problem, inertia=False)
    free = tuple(
        replace(e, low=-1.0, high=1.0) for e in vector.entries
    )  # no bound at what it is where off
    fitted = fit(problem, replace(vector, entries=free), rounds=5)
    (damping,) = fitted.vector.values
    assert damping > 0.005
    vectors = modelled(problem, (), fitted).held.vectors[:, 0]
    assert vectors[0] == 0.0
    assert vectors[1:] == pytest.approx(damping, rel=0.02)


def test_only_parameters_that_are_fitted_have_a_price():
    free = Entry("bias", "torque", (0,), 0.0, 0.0, -1.0, 1.0, "N m")
    held = replace(free, name="side", low=1.0, high=1.0)

    def model(*entries):
        return SimpleNamespace(fit=SimpleNamespace(vector=Vector(entries, np.zeros(len(entries)))))

    assert more(model(free, held), model()) == 1
    assert more(model(free, held), model(free)) == 0
    assert more(model(), model(free, free)) == -2


TWO = """<mujoco><compiler angle="radian"/><option timestep="0.001"/><worldbody>
<body name="a"><joint name="qa" axis="0 1 0" damping="0.02"/>
<inertial pos="0 0 -0.2" mass="{mass}" diaginertia="0.01 0.01 0.001"/>
<body name="b" pos="0 0 -0.4"><joint name="qb" axis="0 1 0" damping="0.02"/>
<inertial pos="0 0 -0.1" mass="0.3" diaginertia="0.002 0.002 0.001"/></body></body>
<body name="c" pos="0 1 0"><joint name="qc" axis="0 1 0" damping="0.02" frictionloss="{friction}"/>
<inertial pos="0 0 -0.2" mass="0.8" diaginertia="0.01 0.01 0.001"/></body></worldbody></mujoco>"""


def two_legs(folder):
    """A problem with two groups of joints, of which the second rubs."""
    folder.mkdir()
    rng, model = (
        np.random.default_rng(3),
        mujoco.MjModel.from_xml_string(TWO.format(mass=1.0, friction=0.1)),
    )
    (folder / "model.xml").write_text(TWO.format(mass=1.2, friction=0.0))
    (folder / "meta.toml").write_text('task = "mechanism"\nmodel = "model.xml"\n')
    for trial in range(4):
        data, rows, wave = mujoco.MjData(model), [], rng.uniform(1.0, 6.0, (2, 3))
        for i in range(300):
            tau = 0.5 * np.sin(wave[0] * i / 100 + wave[1])
            rows.append([i / 100, *(data.qpos + 2e-4 * rng.normal(size=3)), *tau])
            for _ in range(10):
                data.qfrc_applied[:] = tau
                mujoco.mj_step(model, data)
        header = "time,q1,q2,q3,tau1,tau2,tau3"
        np.savetxt(
            folder / f"trial_{trial}.csv",
            rows,
            delimiter=",",
            header=header,
            comments="",
            fmt="%.8g",
        )
    machine = load(folder)
    return prepare(machine.tree, machine.tracks, FEW, declared=machine.declared)


@pytest.mark.long
def test_groups_that_a_change_does_not_touch_keep_their_numbers(tmp_path):
    problem = two_legs(tmp_path / "legs")
    assert [g.joints for g in problem.groups] == [(0, 1), (2,)]
    base = modelled(problem, (), fit(problem, nuisances(problem), rounds=6))
    reach = scaled_reach(problem, *own_inertia(problem, base.fit.vector))
    scores = table(problem, base.lin, candidates(problem, base.fit.vector, reach))
    score = next(
        s for s in scores if s.candidate.effect == "coulomb" and s.candidate.joints == (2,)
    )
    vector, starts, loss = attempted(problem, base, reach, score)
    assert loss == pytest.approx(
        losses(problem, run(problem, vector, starts), base.fit.weights), rel=1e-6
    )
    assert loss.sum() < 0.9 * base.fit.total
    one = refit(problem, vector, starts, (2,), 6, base.fit.weights)
    apart, whole = (modelled(problem, (score.candidate,), one, like=like) for like in (base, None))
    assert (
        apart.lin.residual[0] is base.lin.residual[0]
        and apart.lin.residual[1] is not base.lin.residual[1]
    )
    for a, b in zip(apart.lin.shared, whole.lin.shared, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9 * np.abs(b).max())
    np.testing.assert_allclose(apart.held.vectors, whole.held.vectors, atol=1e-9)
    np.testing.assert_allclose(apart.held.loss, whole.held.loss, rtol=1e-4)


def test_where_nothing_is_named_the_final_model_is_the_declared_one(tmp_path, monkeypatch):
    """An effect that was in the model and went leaves a fit behind it that may lie in another
    minimum, with heavier bodies.
    """
    machine = load(record(tmp_path / "log", friction=0.0, trials=6, seconds=1.5, rate=125))
    problem = prepare(machine.tree, machine.tracks, FEW, declared=machine.declared)
    null = nuisances(problem, inertia=False)

    def all_gone(objective, model, trace):
        vector = null.at(null.values + 0.01)
        return modelled(problem, (), fit(problem, vector, rounds=0)), []

    monkeypatch.setattr(search, "backward_elimination", all_gone)
    found = select(problem, null, Criteria(most_effects=1))
    assert not found.final.added
    np.testing.assert_array_equal(found.final.fit.vector.values, found.null.fit.vector.values)
