"""Values that are computed once, however many directions a derivative is taken along.

XLA fuses an elementwise function into whatever uses it. In a derivative along many directions that
is each direction, and each of its outputs. A branch is not fused into, so what goes through one is
computed before.
"""

from typing import TypeVar

import jax
import jax.numpy as jnp

Tree = TypeVar("Tree")


def once(values: Tree, asked: jax.Array) -> Tree:
    """`values` as they are, a pytree of floats. asked: any array but an empty one that does not
    depend on the direction (a derivative's values do, those of the function itself do not).
    """
    first = jax.lax.stop_gradient(jnp.ravel(asked)[0])
    one = 1.0 + 0.0 * first  # the compiler cannot know it, or it would drop the branch
    return jax.lax.cond(
        first < 0, lambda z: jax.tree.map(lambda y: y * one.astype(y.dtype), z), lambda z: z, values
    )
