"""Sine and cosine together, vectorised in double precision too, and whose derivative does not
compute them again.

XLA calls the C library for the sine of each single double, which was a quarter of the time of a
pendulum's Jacobian, and, as it fuses them into whatever uses them, of a derivative along many
directions nine tenths were sines of the same angles. In a derivative along many directions what XLA
fuses is computed for each of them. A branch is not fused into, so what goes through one (`once`) is
computed before.
"""

import math
from typing import TypeVar

import jax
import jax.numpy as jnp

Tree = TypeVar("Tree")


def once(values: Tree, primal: jax.Array) -> Tree:
    """`values` as they are, a pytree of floats. asked: Any array but an empty one that does not
    depend on the direction (a derivative's values do, those of the function itself do not).
    """
    number = jax.lax.stop_gradient(jnp.ravel(primal)[0])
    one = 1.0 + 0.0 * number  # the compiler cannot know it, or it would drop the branch
    return jax.lax.cond(
        number < 0,
        lambda z: jax.tree.map(lambda y: y * one.astype(y.dtype), z),
        lambda z: z,
        values,
    )


# up to a quarter of pi the first terms that are left out are below a tenth of the last place
SINE = tuple((-1.0) ** n / math.factorial(2 * n + 1) for n in range(9))
COSINE = tuple((-1.0) ** n / math.factorial(2 * n) for n in range(9))
QUARTER = (
    1.5707963267341256,
    6.077100506506192e-11,
)  # of a turn, in two parts: multiples of the first are exact up to 2^20


@jax.custom_jvp
def sin_cos(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """`sin(x), cos(x)` of any shape but an empty one; in double precision to 2e-16 for angles up to
    a million.
    """
    x = jnp.asarray(x)
    return once(_series(x) if x.dtype == jnp.float64 else (jnp.sin(x), jnp.cos(x)), x)


@sin_cos.defjvp
def _sin_cos_jvp(primals, tangents):
    sin, cos = sin_cos(*primals)
    (dx,) = tangents
    return (sin, cos), (cos * dx, -sin * dx)


def _series(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Both by their Taylor series about the nearest quarter turn (the reduction in two parts is
    Cody and Waite's, 1980).
    """
    quarter_turns = jnp.round(x * (2.0 / math.pi))
    remainder = jnp.clip(
        (x - quarter_turns * QUARTER[0]) - quarter_turns * QUARTER[1], -1.0, 1.0
    )  # beyond a million: wrong, but a sine
    square = remainder * remainder
    sin, cos = remainder * _horner(square, SINE), _horner(square, COSINE)
    is_swapped = quarter_turns - 2.0 * jnp.floor(0.5 * quarter_turns) == 1.0
    is_negative = quarter_turns - 4.0 * jnp.floor(0.25 * quarter_turns) >= 2.0
    first, second = jnp.where(is_swapped, cos, sin), jnp.where(is_swapped, sin, cos)
    return jnp.where(is_negative, -first, first), jnp.where(
        is_negative != is_swapped, -second, second
    )


def _horner(x: jax.Array, terms: tuple[float, ...]) -> jax.Array:
    total = terms[-1] + 0.0 * x
    for term in terms[-2::-1]:
        total = total * x + term
    return total
