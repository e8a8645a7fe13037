"""A plant's accelerations balance its forces, and their derivatives are those of a general solver,
of any order and kind.
"""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.trig import once
from adaptsim_jax.mechanisms.registry import make_plant

THETA = {"rigid_body": [0.9, 0.21, 1.3, 0.4, 0.02, 0.03], "linearized": [1.1, 0.7, 0.3, 0.2]}


def solved(plant, theta, x, u, force, inertia):
    """`Plant.deriv` by a general solver, for JAX to differentiate as it is."""
    n = plant.joint_dim

    def one(x, u, force, inertia):
        mass = plant.mass_matrix(theta, x[:n]) + jnp.diag(inertia)
        return jnp.concatenate(
            [
                x[n:],
                jnp.linalg.solve(
                    mass, u + force + plant.push(plant.constants, theta, x[:n], x[n:])
                ),
            ]
        )

    return one(x, u, force, inertia) if x.ndim == 1 else jax.vmap(one, -1, -1)(x, u, force, inertia)


@pytest.fixture(params=sorted(THETA))
def case(request):
    """A plant and arguments of its `deriv` for five states at once."""
    rng = np.random.default_rng(7)
    plant = make_plant(request.param, "hanging", {"l1": 0.3})
    shapes = [(4, 5), (2, 5), (2, 5)]
    args = [
        THETA[request.param],
        *(rng.normal(size=s) for s in shapes),
        rng.uniform(0.0, 0.1, (2, 5)),
    ]
    return plant, args


@pytest.mark.slow
@pytest.mark.parametrize("x64", [False, True])
def test_values_are_those_of_a_general_solver(case, x64):
    plant, args = case
    with jax.enable_x64(x64):
        args = [jnp.asarray(a) for a in args]
        tolerance = 1e-12 if x64 else 2e-5
        chex.assert_trees_all_close(
            plant.deriv(*args), solved(plant, *args), rtol=tolerance, atol=tolerance
        )


@pytest.mark.slow
@pytest.mark.parametrize("way", [jax.jacfwd, jax.jacrev])
def test_derivatives_are_those_of_a_general_solver(case, way):
    plant, args = case
    with jax.enable_x64(True):
        args = [jnp.asarray(a) for a in args]
        every = tuple(range(5))
        ours, general = (way(f, every) for f in (plant.deriv, lambda *a: solved(plant, *a)))
        chex.assert_trees_all_close(jax.jit(ours)(*args), general(*args), rtol=1e-10, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("argument", range(5))
def test_a_derivative_by_one_argument_alone_and_the_second_one(case, argument):
    plant, args = case
    with jax.enable_x64(True):
        args = [jnp.asarray(a) for a in args]

        def alone(f, z):
            return f(*args[:argument], z, *args[argument + 1 :])

        ours, general = (
            lambda z, f=f: alone(f, z) for f in (plant.deriv, lambda *a: solved(plant, *a))
        )

        def close(a, b):
            return chex.assert_trees_all_close(a, b, rtol=1e-9, atol=1e-10)

        close(jax.jacfwd(ours)(args[argument]), jax.jacfwd(general)(args[argument]))
        way = jnp.ones_like(args[argument])

        def bend(f):
            return jax.jvp(lambda z: jax.jvp(f, (z,), (way,))[1], (args[argument],), (way,))[1]

        close(bend(ours), bend(general))


def test_by_the_constants_of_the_plant():
    """Geometry is a leaf too: its derivative is the same."""
    plant = make_plant("rigid_body", "upright", {"l1": 0.3})
    with jax.enable_x64(True):
        x, zero = jnp.array([0.3, -0.8, 1.0, 2.0]), jnp.zeros(2)
        theta = jnp.asarray(THETA["rigid_body"])

        def spin(l1, f):
            longer = jax.tree.unflatten(
                tree, [l1 if leaf is plant.constants["l1"] else leaf for leaf in leaves]
            )
            return f(longer, theta, x, zero, zero, zero)

        leaves, tree = jax.tree.flatten(plant)
        l1 = jnp.asarray(0.3)
        ours = jax.jacfwd(spin)(l1, lambda p, *a: p.deriv(*a))
        general = jax.jacfwd(spin)(l1, solved)
        chex.assert_trees_all_close(ours, general, rtol=1e-10)
        assert np.abs(ours).max() > 0.1


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
