"""What all backends of the push share: profile, frictions, the ground's force, options, codes."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.engines import BACKENDS, make_backend, scene
from adaptsim_jax.tasks.pushing.model import PAPER, Frictions, PushOptions


def test_the_profile_rises_holds_and_ends():
    at = pushing.ramp([0.0, 0.01, 0.11, 0.21, 0.31, 0.56, 0.81, 1.3])
    np.testing.assert_allclose(at, [0, 0, 0.5, 1, 1, 0.5, 0, 0], atol=1e-12)
    steps = pushing.slopes(0.005, 260)
    np.testing.assert_allclose(
        np.cumsum(steps) * 0.005, pushing.ramp(np.arange(1, 261) * 0.005), atol=1e-12
    )


def test_friction_semantics():
    params = np.array([[0.1, 1e5, 0.5, 0.0], [0.1, 1e5, 0.8, 0.0]])
    clean = pushing.frictions(params, "clean")
    np.testing.assert_allclose(np.stack(clean), [[0.1, 0.1], [0.5, 0.8], [0.3, 0.3]])
    # Drake's measured values for the release's scene: 0.167 off the patch, 0.335 and 0.491 on it
    coupled = pushing.frictions(params, "coupled")
    np.testing.assert_allclose(coupled.table, [0.1667, 0.1778], atol=1e-4)
    np.testing.assert_allclose(coupled.patch, [0.335, 0.491], atol=3e-3)


def test_a_stiffer_bottle_meets_a_stiffer_spring_and_a_heavier_one_gives_way_less():
    e = np.array([1e4, 1e5, 1e6])
    k, b = pushing.spring(pushing.ELASTICITY, e, 0.6, pushing.NOMINAL_MASS)
    assert np.all(np.diff(k) > 0) and np.all(b > 0)
    heavy, _ = pushing.spring(pushing.ELASTICITY, e, 0.6, 2 * pushing.NOMINAL_MASS)
    np.testing.assert_allclose(heavy, k / 2)


def _standing(x, y=0.0, speed=0.5, mass=0.3):
    pose = np.zeros((1, 13))
    pose[0, :4] = x, y, pushing.HEIGHT / 2 - pushing.SOLE_SAG, 1.0
    pose[0, 7] = speed
    return pose


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [(0.60, 0.0, 0.1), (0.75, 0.0, 0.5), (0.70, 0.0, 0.3), (0.75, 0.05, 0.3)],
)
def test_ground_friction_is_what_the_sole_stands_on(x, y, expected):
    friction = Frictions(*(np.full((1, 1), v) for v in (0.1, 0.5, 0.3)))
    force = pushing.ground_friction(_standing(x, y), friction, np.zeros((1, 1)), 0.3, 0.005)[0]
    assert force[0] == pytest.approx(-expected * 0.3 * pushing.GRAVITY, rel=1e-5)
    assert abs(force[1]) < 1e-6 and force[2] == 0
    if y:  # its right half drags: the bottle is turned to the right
        assert force[5] < -1e-3
    else:
        assert abs(force[5]) < 1e-6


def test_ground_friction_of_a_bottle_at_rest_or_in_the_air_is_none():
    friction = Frictions(*(np.full((1, 1), v) for v in (0.1, 0.5, 0.3)))
    lifted = _standing(0.75)
    lifted[0, 2] += 0.01
    for pose in (_standing(0.75, speed=0.0), lifted):
        force = pushing.ground_friction(pose, friction, np.zeros((1, 1)), 0.3, 0.005)
        np.testing.assert_allclose(force, 0, atol=1e-9)


def test_ground_friction_is_the_same_in_jax(x64):
    rng = np.random.default_rng(0)
    pose = _standing(0.72, 0.02) + 1e-3 * rng.normal(size=(1, 13))
    friction = Frictions(*(np.full((1, 1), v) for v in (0.1, 0.5, 0.3)))
    here = pushing.ground_friction(pose, friction, np.zeros((1, 1)), 0.3, 0.005)
    with jax.numpy_rank_promotion("allow"):
        there = pushing.ground_friction(
            jnp.asarray(pose), friction, np.zeros((1, 1)), 0.3, 0.005, jnp
        )
    np.testing.assert_allclose(there, here, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"friction": "cleen"}, "use clean or coupled"),
        ({"duration": 1.303}, "no whole number of rows"),
        ({"row": 0.007}, "no multiple of 0.005"),
        ({"mass": 300.0}, "mass = 300.0 is not within"),
        ({"mass": float("nan")}, "mass = nan is not within"),
        ({"inertia": (1.0, 1.0, 3.0)}, "no body has it"),
        ({"com": (0.0, 0.0)}, "needs three finite numbers"),
    ],
)
def test_bad_options_are_refused_in_a_line(change, message):
    with pytest.raises(BadInput, match=message) as error:
        make_backend("native", dataclasses.replace(PAPER, **change))
    assert "\n" not in str(error.value)


def test_options_go_through_a_config_file():
    options = PushOptions(friction="coupled", mass=0.5, inertia=pushing.cylinder_inertia(0.5))
    assert config.from_table(PushOptions, config.to_table(options), "test") == options


def test_unknown_backends_are_refused():
    with pytest.raises(
        BadInput, match="backend 'mujoco' is unknown; known: native, mjx, planar, drake"
    ):
        make_backend("mujoco")
    assert set(BACKENDS) == {"native", "mjx", "planar", "drake"}


def test_bad_shapes_are_refused():
    params, actions, starts = pushing.draw(0, 3)
    simulate = make_backend("planar").simulate
    with pytest.raises(BadInput, match=r"commands: has shape \[2, 2\]; give \[3, 2\]"):
        simulate(params, actions[:2], starts)
    with pytest.raises(BadInput, match=r"params: has shape \[3, 3\]; give \[3, 4\]"):
        simulate(params[:, :3], actions, starts)


def test_states_without_a_motion_are_told_and_finite():
    batch = scene.checked(*pushing.draw(0, 5))
    state = np.zeros((5, 5, 13))
    state[:, :, 2:4] = 0.05, 1.0
    state[4, 2:, 2] = -0.02
    state[1, 3, 7] = np.nan
    state[2, 2:, 0] = 1e3
    state[3, 4, 3:5] = np.cos(0.3), np.sin(0.3)  # tilted by 0.6 rad
    out = scene.finished(state, batch)
    assert list(out.code) == [
        pushing.FINE,
        *2 * [pushing.DIVERGED],
        pushing.FALLEN,
        pushing.DIVERGED,
    ]
    assert np.isfinite(out.state).all() and set(out.code) <= set(pushing.MESSAGES)
