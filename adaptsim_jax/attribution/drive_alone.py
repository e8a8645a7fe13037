"""One joint whose drive would give, by itself beside the motion of a rigid one: what a score test
goes by.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.attribution.drive import sprung, yielded
from adaptsim_jax.effects.base import Drive, Effect

FINE = 8  # steps of a row


class Local(NamedTuple):
    """One joint by itself, [n, 1, 1] each: inertia of rotor and link kg m^2; what its controller
    answers, N m/rad and N m s/rad.
    """

    rotor: Any
    link: Any
    stiffness: Any
    damping: Any


@partial(jax.jit, static_argnames="effect")
def logged_alone(local, p, carries, dt, effect: Effect):
    """Logged angles and speeds [3, L+1, 2n, W] of drives that give beside those of rigid ones: as
    they carry so much, and swinging from a start of 1 rad or 1 rad/s ahead.
    """
    drive = effect.apply({k: z[:, None] for k, z in p.items()})

    def of(z):
        return z[0] + drive.link[None] * (z[1] - z[0])

    def seen(*how):
        return jnp.concatenate([of(z) for z in _moved(drive, local, *how)], 1)

    one, none = jnp.ones_like(carries[:, 0]), jnp.zeros_like(carries[:, 0])
    swings = (seen(0.0 * carries, dt, some) for some in ((one, none), (none, one)))
    return jnp.stack([seen(carries, dt), *swings])


def _shared(local: Local, ahead):
    """Rotors and links [2, n, .] so far from their common middle."""
    link = local.rotor / (local.rotor + local.link)
    return jnp.stack([(link - 1.0) * ahead, link * ahead])


def _moved(drive: Drive, local: Local, carries, dt, swung=None):
    """How rotors and links of drives [n, 1] move beside the motion of rigid ones, which carry [n,
    L, W] N m: angles and speeds [2, L+1, n, W] of each joint by itself, with its controller. dt [L,
    W] s. swung: how far links are ahead of rotors at the start and at which rate, [n, W] each; at
    rest where None.
    """
    local = Local(*(z[:, 0] for z in local))

    def substep(_, state, carries, h):
        q, v = state
        ahead, rate = q[1] - q[0], v[1] - v[0]
        over = sprung(drive, ahead, rate) - carries
        held = (
            local.stiffness * (q[0] + drive.control * ahead) + local.damping * drive.control * rate
        )
        damped = 1.0 + h * local.damping / local.rotor
        v = jnp.stack(
            [(v[0] - h * (over + held) / local.rotor) / damped, v[1] + h * over / local.link]
        )
        return jnp.stack([q[0] + h * v[0], q[1] + h * v[1]]), v

    def row(state, now):
        carries, dt = now
        new = jax.lax.fori_loop(
            0, FINE, lambda i, s: substep(i, s, carries, dt[None] / FINE), state
        )
        return new, new

    if swung is None:
        ahead, rate = (yielded(drive, carries[:, 0]), 0.0 * carries[:, 0])
    else:
        ahead, rate = swung
    start = _shared(local, ahead), _shared(local, rate)
    _, path = jax.lax.scan(row, start, (jnp.moveaxis(carries, 1, 0), dt))
    return tuple(
        jnp.swapaxes(jnp.concatenate([a[None], b]), 0, 1) for a, b in zip(start, path, strict=True)
    )
