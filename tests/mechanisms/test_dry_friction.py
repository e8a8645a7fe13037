"""Dry friction over a step: a joint that slides, that stops and is held, that turns round; and
between two joints that move each other, against SciPy.
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


def rubs(v, torque, level=LEVEL):
    one = jnp.ones_like(v)
    return mean_friction(v, torque, level * one, INERTIA * one, STEP * one)


def test_a_joint_slides_is_held_or_turns_round():
    with jax.enable_x64(True):
        v = jnp.array([0.3, 0.0, 0.0, 0.01, 0.01])
        torque = jnp.array([0.02, 0.03, 0.2, 0.05, -0.3])
        mean, rise = rubs(v, torque)
        slow = (LEVEL - 0.05) / INERTIA  # m/s^2 that brake the fourth, until it is held
        share = 0.01 / slow / STEP
        np.testing.assert_allclose(
            mean[:4], [-LEVEL, -0.03, -LEVEL, -LEVEL * share - 0.05 * (1 - share)]
        )
        turn = 0.01 * INERTIA / (LEVEL + 0.3) / STEP
        np.testing.assert_allclose(mean[4], LEVEL * (1.0 - 2.0 * turn))
        np.testing.assert_allclose(rise[:3], 0.0, atol=1e-15)


def test_derivatives_are_finite_at_rest():
    with jax.enable_x64(True):
        v = jnp.array([0.0, 1e-3, 0.2, 3.0])
        for torque in (0.0, 0.5 * LEVEL, 3.0 * LEVEL):
            for level in (0.0, LEVEL):
                slopes = jax.jacobian(lambda *z: jnp.stack(rubs(*z)), argnums=(0, 1, 2))(
                    v, jnp.full_like(v, torque), jnp.asarray(level)
                )
                assert all(np.isfinite(s).all() for s in slopes)


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
FRICTION = (0.02, 0.06, 1.5)  # level, excess, speed


@pytest.mark.slow
def test_friction_that_changes_with_speed_is_of_second_order_where_joints_move_each_other():
    once, plant, theta = _slide(1, True)
    twice = _slide(2, True)[0]
    level, excess, speed = FRICTION

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
