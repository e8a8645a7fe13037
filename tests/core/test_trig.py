"""Sine and cosine are those of NumPy to the last place, with their derivatives of any order and
kind.
"""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.trig import once, sin_cos

ANGLES = np.linspace(-7.0, 9.0, 33)


@pytest.mark.slow
@pytest.mark.parametrize("x64", [False, True])
@pytest.mark.parametrize("turn", [1.0, -1.0])  # the first angle decides the branch
def test_values_and_derivatives(x64, turn):
    with jax.enable_x64(x64):
        x = jnp.asarray(turn * ANGLES)
        sin, cos = jax.jit(sin_cos)(x)
        chex.assert_trees_all_close((sin, cos), (jnp.sin(x), jnp.cos(x)), rtol=1e-6)
        assert sin.dtype == x.dtype
        one = jax.grad(lambda a: sin_cos(a)[0])
        chex.assert_trees_all_close(jax.vmap(one)(x), jnp.cos(x), rtol=1e-6, atol=1e-7)
        chex.assert_trees_all_close(jax.vmap(jax.grad(one))(x), -jnp.sin(x), rtol=1e-6, atol=1e-7)
        ways = jnp.stack([jnp.ones_like(x), 2.0 * jnp.ones_like(x)])
        along = jax.vmap(lambda way: jax.jvp(sin_cos, (x,), (way,))[1])(ways)
        chex.assert_trees_all_close(along[1][1], -2.0 * jnp.sin(x), rtol=1e-6, atol=1e-7)


def sines_in_wide_loops(force) -> int:
    """How many of the compiled Jacobian's loops over all directions have a sine in them."""
    x, ways = jnp.asarray(ANGLES), jnp.eye(len(ANGLES))
    jacobian = jax.jit(lambda x: jax.vmap(lambda way: jax.jvp(force, (x,), (way,))[1])(ways))
    loops = jacobian.lower(x).compile().as_text().split("\n\n")
    fused = [
        loop for loop in loops if not loop.startswith("ENTRY")
    ]  # what stands in the entry runs once
    return sum("sine(" in loop and f"[{len(x)},{len(x)}]" in loop for loop in fused)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="how the CPU's compiler fuses")
def test_a_derivative_along_many_directions_computes_no_further_sines():
    assert sines_in_wide_loops(lambda x: sin_cos(x)[0] * sin_cos(2.0 * x)[1]) == 0
    assert sines_in_wide_loops(lambda x: jnp.sin(x) * jnp.cos(2.0 * x)) > 0  # what it is for


def test_not_a_number_and_one_angle():
    sin, cos = sin_cos(jnp.array([jnp.nan, 1.0]))
    assert np.isnan(sin[0]) and np.isnan(cos[0]) and np.isclose(sin[1], np.sin(1.0))
    chex.assert_trees_all_close(sin_cos(0.3), (jnp.sin(0.3), jnp.cos(0.3)))


def test_double_precision_is_to_the_last_place():
    with jax.enable_x64(True):
        rng = np.random.default_rng(4)
        quarters = np.arange(-40, 41) * (0.5 * np.pi)
        for x in (
            rng.uniform(-4.0, 4.0, 4000),
            rng.uniform(-1e3, 1e3, 4000),
            rng.uniform(-1e6, 1e6, 4000),
            quarters,
        ):
            sin, cos = jax.jit(sin_cos)(jnp.asarray(x))
            np.testing.assert_allclose(sin, np.sin(x), rtol=0.0, atol=2.3e-16)
            np.testing.assert_allclose(cos, np.cos(x), rtol=0.0, atol=2.3e-16)


def test_an_angle_gone_astray_stays_a_sine():
    with jax.enable_x64(True):
        sin, cos = sin_cos(jnp.array([1e9, -1e300, jnp.inf]))
        assert np.all(np.abs(np.asarray([sin, cos]))[:, :2] <= 1.0 + 1e-9) and np.isnan(sin[2])


@pytest.mark.parametrize("asked", [1.0, -1.0, 0.0])
@pytest.mark.parametrize("x64", [False, True])
def test_what_goes_through_once_is_as_it_was(asked, x64):
    with jax.enable_x64(x64):
        values = {"a": jnp.array([1.5, -2.0]), "b": jnp.array(0.1)}

        def through(values):
            return once(values, jnp.array([asked, 3.0]))

        chex.assert_trees_all_equal(jax.jit(through)(values), values)
        chex.assert_trees_all_equal(jax.jvp(through, (values,), (values,))[1], values)
        chex.assert_trees_all_equal(
            jax.grad(lambda v: jnp.sum(through(v)["a"]))(values)["a"], jnp.ones(2)
        )
        many = jax.vmap(lambda a: once(values, a[None]))(jnp.array([asked, -asked]))
        chex.assert_trees_all_equal(jax.tree.map(lambda z: z[1], many), values)
