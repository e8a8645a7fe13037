"""Controllers that are faster than the steps of a simulation: a light wrist on an arm, logged at 30
Hz.
"""

from dataclasses import replace

import jax
import numpy as np
import pytest

from adaptsim_jax.attribution.parameters import Entry
from adaptsim_jax.attribution.paths import run, scheme, starts_of
from adaptsim_jax.attribution.problem import nuisances, prepare, values_of
from adaptsim_jax.attribution.simulate import simulate
from adaptsim_jax.attribution.stretches import JointTrack
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.mechanisms.mjcf import read_mechanism

XML = """<mujoco><compiler angle="radian"/><worldbody><body name="upper" pos="0 0 1"><joint name="a" axis="0 1 0" damping="0.1"/>
<inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.01 0.01 0.01"/><body name="hand" pos="0 0 -0.4"><joint name="b" axis="0 1 0"/>
<inertial pos="0 0 -0.02" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body></body></worldbody></mujoco>"""  # noqa: E501
LAW = np.array([[20.0] * 2, [0.0] * 2, [-20.0] * 2, [-0.9] * 2, [-3.0] * 2, [3.0] * 2])


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Problem, and vectors without and with dry friction."""
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(XML)
    time = np.arange(60) / 30.0
    target = np.stack([0.6 * np.sin(3.0 * time), 0.8 * np.sin(5.0 * time)], 1)
    tracks = [JointTrack(str(k), time, 0.9**k * target, None, 0.9**k * target) for k in range(5)]
    effects = tuple(e for e in MACHINE if e.name in ("viscous", "coulomb", "presliding"))
    problem = prepare(read_mechanism(path).tree, tracks, effects, LAW)
    rub = [Entry("coulomb", "level", (j,), 0.1, 0.0, 0.0, 1.0, "N m") for j in (0, 1)]
    plain = nuisances(problem, inertia=False)
    return problem, {"free": plain, "rubs": plain.with_entries(rub)}


@pytest.mark.parametrize("kind", ["free", "rubs"])
def test_stiff_steps_follow_what_many_small_ones_do(arm, kind):
    problem, vectors = arm
    (group,), vector = problem.groups, vectors[kind]
    s, values = group.stretches, values_of(problem, group, vector)
    how = scheme(group, values)
    assert how.stiff and how.substeps == 24 and how.rough == (kind == "rubs")
    (path,) = run(problem, vector, starts_of(problem))
    plain = replace(how, stiff=False)
    with jax.enable_x64(True):

        def make(how):
            return np.asarray(
                simulate(group.model, values, s.time, s.stamp, s.command, s.start, how).x
            )

        true, lost = make(replace(plain, substeps=600)), make(replace(plain, substeps=12))
        long = make(replace(how, substeps=12))

    def off(x):
        return np.sqrt(np.mean((x[:, :2] - true[:, :2]) ** 2))

    assert np.abs(true[:, :2]).max() > 0.5
    assert not off(lost) < 0.1  # Runge and Kutta's method at these steps
    assert off(path.x) < 1e-3 and off(path.x) < 0.3 * off(long)
