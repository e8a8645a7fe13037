"""First-order columns of effects beside differences of the simulation itself, and the score test on
them.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from adaptsim_jax.attribution.candidates import candidates
from adaptsim_jax.attribution.estimate import _without_lost, linear
from adaptsim_jax.attribution.parameters import INERTIA, Entry, TreeFit, Vector
from adaptsim_jax.attribution.paths import run, starts_of, weigh
from adaptsim_jax.attribution.problem import (
    nuisances,
    own_inertia,
    prepare,
    scaled_reach,
    values_of,
)
from adaptsim_jax.attribution.stretches import JointTrack
from adaptsim_jax.diagnosis.testing import score_p
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.mechanisms.mjcf import read_mechanism

XML = """<mujoco><compiler angle="radian"/><worldbody><body name="upper" pos="0 0 1"><joint name="a" axis="0 1 0" damping="0.1"/>
<inertial pos="0 0 -0.2" mass="1" diaginertia="0.01 0.01 0.01"/><body name="lower" pos="0 0 -0.4"><joint name="b" axis="0 1 0"/>
<inertial pos="0 0 -0.15" mass="0.7" diaginertia="0.006 0.006 0.001"/></body></body></worldbody></mujoco>"""  # noqa: E501
LAWS = {
    "torque": None,
    "position": np.array(
        [[40.0] * 2, [0.0] * 2, [-40.0] * 2, [-1.0] * 2, [-np.inf] * 2, [np.inf] * 2]
    ),
}
NAMES = (
    "torque_gain",
    "torque_coupling",
    "friction_coupling",
    "drive_compliance",
    "drive_play",
    "encoder_offset",
)


@pytest.fixture(scope="module", params=LAWS)
def fitted(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(XML)
    time = np.arange(500) / 250.0
    q = np.stack([0.4 * np.sin(3.0 * time), 0.5 * np.cos(4.0 * time)], 1)
    tracks = [JointTrack(str(k), time, q, None, q[:, ::-1] + 0.1 * k) for k in range(5)]
    effects = tuple(e for e in MACHINE if e.name in ("viscous", *NAMES) or e.place == "model")
    problem = prepare(read_mechanism(path).tree, tracks, effects, LAWS[request.param])
    vector, starts = nuisances(problem, inertia=False), starts_of(problem)
    paths = run(problem, vector, starts)
    return problem, TreeFit(
        vector,
        starts,
        weigh(problem, paths),
        np.zeros(problem.groups[0].stretches.count),
        "stopped",
        0,
    )


@pytest.mark.parametrize("name", NAMES)
def test_columns_are_those_of_differences(fitted, name):
    problem, fit = fitted
    reach = scaled_reach(problem, *own_inertia(problem, fit.vector))
    found = [
        c
        for c in candidates(problem, fit.vector, reach)
        if c.effect == name and c.sharing == "joint"
    ]
    assert found
    for entry in (e for c in found for e in c.entries):
        one = fit.vector.with_entries([entry])

        def at(value, one=one):
            return run(problem, one.at(np.append(fit.vector.values, value)), fit.starts)[0].sensed

        lin = linear(problem, replace(fit, vector=one))
        flat = lin.counted[0].flat(((at(1e-5) - at(-1e-5)) / 2e-5).transpose(2, 0, 1))
        assert np.linalg.norm(flat) > 0.0
        # a force is taken as held over a row, which makes a per cent under a stiff controller
        assert np.linalg.norm(lin.shared[0][:, :, -1] - flat) < 0.03 * np.linalg.norm(flat)


def test_a_body_whose_inertia_is_not_fitted_is_a_candidate_and_no_other(fitted):
    problem, fit = fitted
    reach = scaled_reach(problem, *own_inertia(problem, fit.vector))
    kept = candidates(problem, fit.vector, reach)
    assert [c.joints for c in kept if c.effect == INERTIA] == [(0,), (1,)]
    assert all(len(c.entries) == 10 for c in kept if c.effect == INERTIA)
    free = nuisances(problem)
    assert not [c for c in candidates(problem, free, reach) if c.effect == INERTIA]


def test_values_of_many_stretches_are_those_of_each(fitted):
    problem, _ = fitted
    vector = nuisances(problem)
    rows = vector.values + np.array([[0.0], [0.05], [0.0]])
    rows[:, -2:] = vector.values[-2:]
    many = values_of(problem, problem.groups[0], vector, rows).inertial
    for k in range(3):
        one = values_of(problem, problem.groups[0], vector.at(rows[k])).inertial
        np.testing.assert_allclose(many[..., k], one[..., 0], rtol=1e-12)


def test_the_score_test_of_one_direction_is_students_t():
    scores = np.random.default_rng(0).normal(0.3, 1.0, (40, 1))
    assert score_p(scores) == pytest.approx(stats.ttest_1samp(scores[:, 0], 0.0).pvalue)


@pytest.mark.parametrize("mix", ["apart", "alike", "uneven"])
def test_the_score_test_holds_its_level(mix):
    rng = np.random.default_rng(1)
    root = {
        "apart": np.eye(10),
        "alike": np.ones((10, 10)) + 0.03 * rng.normal(size=(10, 10)),
        "uneven": rng.normal(size=(10, 10)),
    }[mix]
    low = [score_p(rng.normal(size=(30, 10)) @ root) < 0.05 for _ in range(600)]
    assert 0.02 < np.mean(low) < 0.08


def test_the_score_test_sees_many_small_effects_in_few_stretches():
    rng = np.random.default_rng(2)
    seen = [score_p(0.5 + rng.normal(size=(23, 12))) < 1e-3 for _ in range(100)]
    assert np.mean(seen) > 0.9


def test_the_score_test_sees_what_directions_that_are_alike_differ_in():
    rng = np.random.default_rng(3)
    root = np.linalg.qr(rng.normal(size=(10, 10)))[0] * 10.0 ** -np.linspace(0, 3, 10)
    shift = np.zeros(10)
    shift[5] = 1.2  # along a direction of a hundredth of the size of the first
    seen = [score_p((shift + rng.normal(size=(60, 10))) @ root.T) < 1e-3 for _ in range(100)]
    assert np.mean(seen) > 0.9


def test_a_step_is_found_where_rounding_left_no_positive_matrix():
    vector = Vector(
        tuple(Entry("a", str(k), (0,), 0.0, 0.0, -9.0, 9.0, "1") for k in range(2)), np.zeros(2)
    )
    step = vector.bounded_step(
        np.array([[1e-14, 3e-14], [3e-14, 1e-14]]), np.array([1e-14, 2e-14]), 1e-9
    )
    assert np.all(np.isfinite(step)) and np.all(np.abs(step) <= 9.0)
    whole = vector.bounded_step(np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([1.0, 1.0]), 0.0)
    np.testing.assert_allclose(
        whole, np.linalg.solve([[2.0, 0.5], [0.5, 1.0]], [1.0, 1.0]), rtol=1e-8
    )


def test_a_stretch_that_ran_away_beyond_all_numbers_pulls_nowhere():
    slopes, residual = np.ones((3, 4, 2)), np.ones((3, 4))
    slopes[1, 2, 0] = np.inf
    _without_lost(residual, slopes)
    assert not residual[1].any() and not slopes[1].any()
    assert residual[[0, 2]].all() and slopes[[0, 2]].all()
