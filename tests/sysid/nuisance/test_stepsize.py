"""Steps are halved for what switches, where that moves the simulation, and for nothing else."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.logs.noise.floor import noise_floor
from adaptsim_jax.logs.quality.audit import audit
from adaptsim_jax.logs.recording import read_recording
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.problem import at_point, prepare
from adaptsim_jax.sysid.nuisance import stepsize
from adaptsim_jax.sysid.nuisance.null_model import fit_declared
from tests.sysid.small_rig import TRUE, make_trials, written


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    folder = written(tmp_path_factory.mktemp("rig"), make_trials(seed=3, count=3, noise=0.01))
    recording = read_recording(folder)
    checked = audit(recording)
    effects = tuple(e for e in catalogue() if e.name in ("stribeck", "spring"))
    return prepare(recording, checked, noise_floor(recording, checked), effects)


def model(problem, *active):
    """The true parameters with effects about half the torque."""
    layout, eff = problem.model.layout, problem.model.layout.off().copy()
    for a in active:
        at = layout.instances[layout.index(*a)].at
        values = (0.3, 0.4, 0.1) if a[0] == "stribeck" else (0.5,)
        eff[at.start : at.start + len(values)] = np.array(values) * problem.torque_scale[1]
    point = SimpleNamespace(x0=problem.windows.start)
    return SimpleNamespace(
        candidate=SimpleNamespace(active=active, theta=TRUE, eff=eff, refit=SimpleNamespace(point=point))
    )


def left(problem, model):
    c = model.candidate
    return np.asarray(at_point(problem, c.active, c.theta, c.eff, c.refit.point.x0).residual)


def test_smooth_models_keep_the_step_of_the_rows(problem):
    assert stepsize.in_short_steps(problem, model(problem, ("spring", "joint2"))) is problem


def test_friction_that_sticks_gets_shorter_steps_and_is_nearer_to_what_many_steps_give(problem):
    sticking = model(problem, ("stribeck", "joint2"))
    finer = stepsize.in_short_steps(problem, sticking)
    assert finer.windows.substeps in (2, 4) and problem.windows.substeps == 1
    many = left(replace(problem, windows=replace(problem.windows, substeps=np.asarray(32))), sticking)
    far, near = (np.sqrt(np.mean((left(p, sticking) - many) ** 2)) for p in (problem, finer))
    assert near < 0.4 * far and far > Criteria().step_share


def test_a_model_that_runs_away_keeps_its_steps(problem, monkeypatch):
    monkeypatch.setattr(stepsize, "_simulated", lambda problem, model: None)
    assert stepsize.stepped(problem, model(problem), None)[0] is problem


@pytest.mark.parametrize("noise, shorter", [(1.0, False), (0.02, True)])
def test_a_declared_model_gets_the_steps_that_its_sensors_ask_for(tmp_path, noise, shorter):
    """A light arm that whirls at 37 rad/s: steps of 5 ms are off by more than sensors of 20 microradians, which looked like
    structure, though nothing is missing; by less than those of a milliradian."""
    light = TRUE * np.array([0.2, 0.05, 0.3, 0.1, 0.2, 0.1])
    folder = written(tmp_path, make_trials(seed=5, count=3, noise=noise, velocity=False, theta=light))
    recording = read_recording(folder)
    checked = audit(recording)
    floor = noise_floor(recording, checked)
    effects = tuple(e for e in catalogue() if e.name in ("stribeck", "spring"))
    coarse = prepare(recording, checked, floor, effects)
    problem, base, _ = fit_declared(recording, checked, floor, effects)
    assert (problem.windows.substeps > coarse.windows.substeps) == shorter
    if shorter:
        assert np.mean(np.square(left(problem, base))) < 0.9 * np.mean(np.square(left(coarse, base)))
