"""A linear closed loop over time, sample after sample."""

import jax
import jax.numpy as jnp

from adaptsim_jax.control.small_matrix import mm
from adaptsim_jax.mechanisms.double_pendulum import linear


def linear_trajectory(
    A: jax.Array, B: jax.Array, gain: jax.Array, x0: jax.Array, times: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """States `[T, n]` and commands `[T, m]` under `u = -gain x` at equispaced `times: [T]` s from
    0.
    """
    T = times.shape[0]
    power = linear.transition(A - mm(B, gain), times[1] - times[0])
    states = x0[None]
    while states.shape[0] < T:  # the states so far, and the same ones that many samples later
        states = jnp.concatenate([states, states @ power.T])[:T]
        power = mm(power, power)
    return states, -states @ gain.T
