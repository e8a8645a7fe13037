"""Dry friction that yields as a spring before the joint slides."""

from dataclasses import replace

import numpy as np
import pytest

from adaptsim_jax.attribution.acting import bristles
from adaptsim_jax.attribution.estimate import linear
from adaptsim_jax.attribution.parameters import Entry, TreeFit
from adaptsim_jax.attribution.paths import run, starts_of, weigh
from adaptsim_jax.attribution.problem import nuisances, prepare, values_of
from adaptsim_jax.attribution.stretches import JointTrack
from adaptsim_jax.effects.base import Dry, Effect, Quantity
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.mechanisms.mjcf import read_mechanism

XML = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="a" axis="0 1 0" damping="2"/>
<inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>"""  # noqa: E501
LEVEL = 0.2  # N m


def pushed(tmp_path, torque, compliance, level=LEVEL, more=()):
    """(problem, vector) of trials at rest that are pushed by torques [k] N m, as functions of time
    or numbers.
    """
    (tmp_path / "arm.xml").write_text(XML)
    time = np.arange(250) / 250.0
    tracks = [
        JointTrack(str(k), time, np.zeros((250, 1)), None, np.broadcast_to(u, (250,))[:, None])
        for k, u in enumerate(torque)
    ]
    effects = (*(e for e in MACHINE if e.name in ("viscous", "coulomb", "presliding")), *more)
    problem = prepare(read_mechanism(tmp_path / "arm.xml").tree, tracks, effects)
    new = [
        Entry(name, key, (0,), z, 0.0, 0.0, 9.0, "1")
        for name, key, z in (("coulomb", "level", level), ("presliding", "compliance", compliance))
    ]
    return problem, nuisances(problem, inertia=False).with_entries(new)


def test_it_holds_as_a_spring_up_to_its_level_and_then_slides(tmp_path):
    problem, vector = pushed(tmp_path, (0.1, 0.4), 0.05)
    (path,) = run(problem, vector, starts_of(problem))
    trial = problem.groups[0].stretches.trial
    held, slid = (path.x[:, 0, np.flatnonzero(trial == k)[0]] for k in (0, 1))
    assert held[-1] == pytest.approx(0.05 * 0.1, rel=0.05)
    assert slid[-1] > 0.03 and np.abs(path.rub).max() == pytest.approx(LEVEL)


def test_dry_friction_of_another_package_rubs_too(tmp_path):
    """Asked by what it answers, not by its name."""
    own = Effect(
        "tight_spot",
        "force",
        (Quantity("level", "N m", 0.0, 9.0, 0.0, sign=1),),
        lambda p, m: Dry(p["level"] + 0.0 * m.q),
        "dry friction",
        "motion",
    )
    problem, vector = pushed(tmp_path, (0.1, 0.4), 0.0, level=0.0, more=(own,))
    (free,) = run(problem, vector, starts_of(problem))
    held = vector.with_entries([Entry("tight_spot", "level", (0,), LEVEL, 0.0, 0.0, 9.0, "N m")])
    (path,) = run(problem, held, starts_of(problem))
    assert free.x[-1, 0].max() > 0.05 and np.abs(path.rub).max() == pytest.approx(LEVEL)
    assert path.x[-1, 0].max() < free.x[-1, 0].max() / 1.5


def test_without_bristles_it_holds_still(tmp_path):
    problem, vector = pushed(tmp_path, (0.1, 0.19), 0.0)
    group = problem.groups[0]
    assert not bristles(group.model, values_of(problem, group, vector))
    (path,) = run(problem, vector, starts_of(problem))
    np.testing.assert_allclose(path.x[:, 0], 0.0, atol=1e-12)


def test_the_linearised_path_follows_the_bristles(tmp_path):
    """By start and by a level that all is below: only the bristles' own spring answers."""
    time = np.arange(250) / 250.0
    problem, vector = pushed(
        tmp_path, (0.3 * np.sin(5.0 * time), 0.1 * np.cos(9.0 * time)), 0.05, level=5.0
    )
    starts = starts_of(problem)
    fit = TreeFit(
        vector, starts, weigh(problem, run(problem, vector, starts)), np.zeros(0), "stopped", 0
    )
    fit = replace(
        fit,
        weights=replace(fit.weights, channel=np.ones(2), stretch=np.ones_like(fit.weights.stretch)),
    )
    lin = linear(problem, fit)
    moved = [x + np.array([[1e-6], [0.0]]) for x in starts]
    (there,), (here,) = run(problem, vector, moved), run(problem, vector, starts)
    change = lin.counted[0].flat(((there.sensed - here.sensed) / 1e-6).transpose(2, 0, 1))
    np.testing.assert_allclose(lin.start[0][..., 0], change, atol=1e-3)
