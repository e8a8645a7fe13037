"""Clocks of trials, refitted with the periodic force in the model."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.logs.noise.floor import noise_floor
from adaptsim_jax.logs.quality.audit import audit
from adaptsim_jax.logs.recording import read_recording
from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.problem import prepare_within_reach
from adaptsim_jax.sysid.nuisance.null_model import declared, timed
from adaptsim_jax.sysid.select.phase_refinement import phases_refined, phases_refined_early
from adaptsim_jax.sysid.select.trace import Trace
from tests.generators import make_dataset, write_dataset

PLACE = ("periodic_disturbance", "joint1")
SEED = 304  # its trials meet the force at phases of their own


@pytest.mark.slow
def test_clocks_that_are_off_are_found_again(tmp_path):
    data = make_dataset(SEED, n_trials=3, seconds=3.0, world="linearized", effects=((PLACE[0], 1, 6.0),))
    assert data.truth["effects"][0]["parameters"]["free_phase"] == 1.0
    frequency = data.truth["effects"][0]["parameters"]["frequency"]
    recording = read_recording(write_dataset(data, tmp_path / "data"))
    checked = audit(recording)
    effects = tuple(e for e in catalogue() if e.name in (PLACE[0], "coulomb"))
    problem, start = prepare_within_reach(recording, checked, noise_floor(recording, checked), effects)
    base, first = declared(problem, start)
    eff = problem.model.layout.off()
    at = problem.model.layout.instances[problem.model.layout.index(*PLACE)].at
    eff[at] = [0.3 * problem.torque_rms[0], 0.0, frequency]

    def with_clock(clock):
        set_to = replace(problem, windows=replace(problem.windows, clock=clock))
        return set_to, fit(set_to, base.start(active=(PLACE,), eff=eff), first.response)

    problem, seen = timed(problem, base, first)
    early, _ = phases_refined_early(problem, seen, base)
    clock = problem.windows.clock
    assert np.ptp(clock) > 0.0
    away = np.array([0.0, 0.05, -0.05, 0.0]) / frequency
    ends = []
    for start_at in (clock, clock + away):
        set_to, model = with_clock(start_at)
        better, sharp = phases_refined(set_to, Trace(base, first, ()).then("found", final=model), rounds=6)
        assert sharp.final.total >= model.total
        ends.append(better.windows.clock)
    assert sharp.final.total > model.total + 10.0
    assert np.abs(np.diff(ends[0] - ends[1])[:2]).max() * frequency < 5e-3  # of a period, from one trial to the next
    assert sharp.final.parts.force_std()[0] < 0.05 * problem.torque_rms[0]
    assert early.reach.tone == pytest.approx(frequency, rel=1e-3)
    assert np.abs(np.diff(ends[0] - early.windows.clock)[:2]).max() * frequency < 5e-3


def test_without_clocks_nothing_is_sharpened():
    problem = SimpleNamespace(windows=SimpleNamespace(clock=np.zeros(3)))
    assert phases_refined_early(problem, "first", None) == (problem, "first")
