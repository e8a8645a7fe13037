"""Dry friction over a step against SciPy: sharp, with a width, and between two joints that move
each other.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.mechanisms.dry_friction import mean_friction
from adaptsim_jax.mechanisms.registry import make_plant
from adaptsim_jax.mechanisms.stepping import Instant, Sample, make_model, row_step

INERTIA, LEVEL, STEP = 0.01, 0.1, 5e-3


def exact(v, torque, width):
    """Mean friction over the step, by an implicit method at tight tolerances."""

    def rate(t, v):
        return (torque - LEVEL * np.tanh(v / width)) / INERTIA

    def jac(t, v):
        return np.diag(-LEVEL / width / np.cosh(np.clip(v / width, -300, 300)) ** 2 / INERTIA)

    end = solve_ivp(rate, (0.0, STEP), [v], method="Radau", jac=jac, rtol=1e-8, atol=1e-10).y[0, -1]
    return (end - v) * INERTIA / STEP - torque


def mean(v, torque, width):
    with jax.enable_x64(True):
        one = jnp.ones_like(jnp.asarray(v))
        return np.asarray(
            mean_friction(v, torque, LEVEL * one, width * one, INERTIA * one, STEP * one)[0]
        )


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.002, 0.01, 0.05])
def test_the_mean_is_that_of_the_motion(width):
    rng = np.random.default_rng(5)
    torque = rng.normal(0.0, 1.5 * LEVEL, 150)
    creeping = width * np.arctanh(np.clip(torque / LEVEL, -0.95, 0.95)) + rng.normal(
        0.0, 0.2 * width, 150
    )
    v = np.where(rng.random(150) < 0.5, rng.normal(0.0, 0.1, 150), creeping)
    truth = np.array([exact(*pair, width) for pair in zip(v, torque, strict=True)])
    error = np.sqrt(np.mean((mean(v, torque, width) - truth) ** 2)) / LEVEL
    sharp = np.sqrt(np.mean((mean(v, torque, 0.0) - truth) ** 2)) / LEVEL
    assert error < 0.006
    assert error < 0.25 * sharp


@pytest.mark.parametrize("share", [-0.9, 0.3, 0.8])
def test_a_held_joint_creeps_at_its_equilibrium(share):
    width = 0.01
    v = np.array([width * np.arctanh(share)])
    np.testing.assert_allclose(mean(v, np.array([share * LEVEL]), width), -share * LEVEL, rtol=2e-3)
    np.testing.assert_allclose(
        mean(np.zeros(1), np.array([share * LEVEL]), 0.0), -share * LEVEL, rtol=1e-6
    )


@pytest.mark.slow
@pytest.mark.parametrize("x64", [False, True], ids=["float32", "x64"])
def test_derivatives_are_finite_at_rest_and_where_one_joint_is_sharp(x64):
    with jax.enable_x64(x64):
        v = jnp.array([0.0, 0.0, 1e-3, 1e-3, 0.2, 0.2, 0.0, 3.0])
        width = jnp.array([0.0, 0.01, 0.0, 1e-5, 0.0, 0.2, 1e-8, 1e-3])

        def rubs(v, torque, width):
            return jnp.stack(
                mean_friction(
                    v,
                    torque,
                    jnp.full_like(v, LEVEL),
                    width,
                    jnp.full_like(v, 1e-5),
                    jnp.full_like(v, STEP),
                )
            )

        for torque in (0.0, 0.5 * LEVEL, 3.0 * LEVEL):
            slopes = jax.jacobian(rubs, argnums=(0, 1, 2))(v, jnp.full_like(v, torque), width)
            assert all(np.isfinite(s).all() for s in slopes)


@pytest.mark.slow
@pytest.mark.parametrize("argument", range(5))
def test_slopes_are_those_of_differences(argument):
    """Also at rest, where a joint that is held creeps with the torque; reverse mode gives the
    same.
    """
    with jax.enable_x64(True):
        v = jnp.array([0.0, 0.003, -0.02, 0.2, 0.05, -0.003])
        torque = jnp.array([0.0, 0.03, 0.05, 0.12, -0.09, 0.0])
        width = jnp.array([0.001, 0.01, 0.0, 0.05, 0.0, 0.02])
        at = (v, torque, jnp.full_like(v, LEVEL), width, jnp.full_like(v, INERTIA))

        def rubs(*args):
            return jnp.stack(mean_friction(*args, jnp.full_like(v, STEP)))

        def way(size):
            return [
                size * (width > 0) if k == argument else jnp.zeros_like(v) for k in range(len(at))
            ]

        def move(size):
            return rubs(*(z + d for z, d in zip(at, way(size), strict=True)))

        slope = jax.jvp(rubs, at, tuple(way(1.0)))[1]
        np.testing.assert_allclose(slope, (move(1e-7) - move(-1e-7)) / 2e-7, rtol=1e-3, atol=1e-4)
        back = jax.grad(lambda z: rubs(*at[:argument], z, *at[argument + 1 :]).sum())(at[argument])
        np.testing.assert_allclose(
            jnp.where(width > 0, back, 0.0), slope.sum(0), rtol=1e-9, atol=1e-12
        )


def _slide(parts: int, x64: bool):
    """Both joints slide for 0.15 s, joint 2 with Stribeck's friction; the states after each 5 ms,
    in so many rows.
    """
    with jax.enable_x64(x64):
        plant = make_plant("rigid_body", "hanging", {"l1": 0.2, "l2": 0.2, "g": 9.81}, {})
        model = make_model(plant, tuple(e for e in catalogue() if e.name == "stribeck"))
        theta = jnp.array([0.08, 0.03, 0.27, 0.16, 0.001, 0.005])
        eff = np.array(model.layout.off())
        eff[model.layout.instances[model.layout.index("stribeck", "joint2")].at] = FRICTION
        zero, x = jnp.zeros((2, 1)), [jnp.array([z]) for z in START]
        step = jax.jit(
            lambda x: row_step(
                Sample(model, theta, jnp.asarray(eff)),
                Instant(x, (), zero, jnp.zeros((1,))),
                jnp.full((1,), STEP / parts),
            )[0]
        )
        seen = []
        for _ in range(30):
            for _ in range(parts):
                x = step(x)
            seen.append(np.concatenate([np.asarray(z) for z in x]))
        return np.array(seen), plant, np.asarray(theta)


START = (0.3, -0.9, -1.0, 4.0)
FRICTION = (0.02, 0.06, 1.5, 0.0)  # level, excess, speed, width


@pytest.mark.slow
def test_friction_that_changes_with_speed_is_of_second_order_where_joints_move_each_other():
    once, plant, theta = _slide(1, True)
    twice = _slide(2, True)[0]
    level, excess, speed, _ = FRICTION

    pushed = jax.jit(
        lambda x, rubs: plant.deriv(
            theta, x, jnp.zeros(2), jnp.stack([jnp.zeros(()), rubs]), jnp.zeros(2)
        )
    )

    def rate(t, x):
        with jax.enable_x64(True):
            return np.asarray(
                pushed(x, -np.sign(x[3]) * (level + excess * np.exp(-((x[3] / speed) ** 2))))
            )

    times = STEP * np.arange(1, 31)
    truth = solve_ivp(rate, (0.0, times[-1]), START, t_eval=times, rtol=1e-9, atol=1e-11).y.T
    assert (truth[:, 3] > 0.2).all()  # it slides throughout
    error, finer = (np.abs(run - truth)[:, :2].max() for run in (once, twice))
    assert error < 2e-5  # rad
    assert finer < error / 3.0
    np.testing.assert_allclose(_slide(1, False)[0], once, atol=2e-4)
