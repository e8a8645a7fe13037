"""Small matrices with the batch last, against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.control.small_matrix import batch_last, mm, mv, norm, solve


@pytest.mark.parametrize("n", [1, 2, 4, 5, 8])
def test_solve_pivots(x64, n):
    rng = np.random.default_rng(n)
    a, b = rng.normal(size=(n, n, 40)), rng.normal(size=(n, 3, 40))
    if n > 1:
        a[0, 0] = 0.0  # a zero first pivot is fatal without row exchange
    reference = np.linalg.solve(np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0))
    np.testing.assert_allclose(
        jnp.moveaxis(jax.jit(solve)(a, b), -1, 0), reference, rtol=1e-8, atol=1e-8
    )
    np.testing.assert_allclose(
        jax.jit(solve)(a[..., 0], b[..., 0]), reference[0], rtol=1e-8, atol=1e-8
    )


def test_products_and_norm(x64):
    rng = np.random.default_rng(0)
    a, b, x = rng.normal(size=(2, 3, 7)), rng.normal(size=(3, 4, 7)), rng.normal(size=(3, 7))
    np.testing.assert_allclose(mm(a, b), np.einsum("ijb,jkb->ikb", a, b), rtol=1e-12)
    np.testing.assert_allclose(mv(a, x), np.einsum("ijb,jb->ib", a, x), rtol=1e-12)
    np.testing.assert_allclose(norm(a), np.sqrt((a**2).sum((0, 1))), rtol=1e-12)
    assert float(norm(jnp.full((2, 2), 1e30, jnp.float32))) == pytest.approx(
        2e30
    )  # squares would overflow


def test_batch_last_sees_one_flat_trailing_axis():
    seen = []

    def core(a, x):
        seen.append(a.shape)
        return mv(a, x)

    f = batch_last(core)
    a, x = jnp.arange(24.0).reshape(2, 3, 2, 2), jnp.arange(4.0).reshape(2, 2)
    out = jax.vmap(jax.vmap(f, in_axes=(0, None)))(a, x)
    np.testing.assert_allclose(out, np.einsum("abij,aj->abi", a, x))
    assert seen[-1] == (2, 2, 6)
