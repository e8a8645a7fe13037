import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners import replay


def test_blocks_overwrite_the_oldest():
    ring = replay.empty(jax.ShapeDtypeStruct((), jnp.float32), 6)
    for count in range(5):
        ring = replay.write(ring, jnp.full(2, float(count + 1)), jnp.asarray(count))
    np.testing.assert_array_equal(ring, [4, 4, 5, 5, 3, 3])


def test_sample_never_reads_what_was_not_written():
    ring = replay.write(
        replay.empty(jax.ShapeDtypeStruct((), jnp.float32), 100), jnp.ones(10), jnp.asarray(0)
    )
    drawn = replay.sample(jax.random.key(0), ring, jnp.asarray(10), (50, 4))
    assert drawn.shape == (50, 4)
    np.testing.assert_array_equal(drawn, 1.0)


def test_sample_is_uniform():
    ring = jnp.arange(8.0)
    drawn = np.asarray(replay.sample(jax.random.key(1), ring, jnp.asarray(8), (8000,)))
    counts = np.bincount(drawn.astype(int), minlength=8)
    # 1000 +- 4 standard deviations of a binomial with p = 1/8
    assert np.all(np.abs(counts - 1000) < 4 * np.sqrt(8000 / 8 * 7 / 8))


def test_capacity_that_blocks_do_not_tile_is_refused():
    with pytest.raises(BadInput, match="not a multiple of the 30 items written at once; use 90"):
        replay.check_capacity(100, 30)
