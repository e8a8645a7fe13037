"""Drives that give: a spring with play between a joint's rotor and its link, each with its own
motion (Spong, 1987).

A joint's `armature` is its rotor. Actuators, friction and all else that acts on a joint act on the
rotor; the link feels the spring alone. States of a stretch are what the log's encoder sees (of the
rotor or of the link) and how far the link is ahead of the rotor, so that rigid joints have the same
equations with nothing ahead.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.effects.base import Drive, Effect

MIN_INERTIA = 1e-9  # kg m^2: of a rotor that a step of a fit made nothing of


def sprung(drive: Drive, ahead, rate):
    """Torque of the springs on the links [n, .] where these are so far ahead of the rotors [n, .]
    rad, at such a rate.
    """
    half = 0.5 * drive.gap
    bent = ahead - jnp.clip(ahead, -half, half)
    stiffness = jnp.where(
        drive.compliance > 0.0, 1.0 / jnp.where(drive.compliance > 0.0, drive.compliance, 1.0), 0.0
    )
    return -stiffness * (bent + jnp.where(bent != 0.0, drive.damping * rate, 0.0))


class Parts(NamedTuple):
    """Motion of the parts of joints, [n, .] each: of the rotors and of the links, and how far these
    are ahead.
    """

    q: Any
    v: Any
    link_q: Any
    link_v: Any
    ahead: Any
    rate: Any


def parts_of(drive: Drive, giving, x) -> Parts:
    """Of states [2n + 2G, .]: logged angles and speeds; of the joints `giving` [G] how far their
    links are ahead, at which rate.
    """
    n, count = len(drive.compliance), len(giving)
    q, v, some = x[:n], x[n : 2 * n], x[2 * n :]
    ahead, rate = (jnp.zeros_like(q).at[giving].set(z) for z in (some[:count], some[count:]))

    def of(share, z, w):
        return z + share * w

    return Parts(
        of(-drive.link, q, ahead),
        of(-drive.link, v, rate),
        of(1.0 - drive.link, q, ahead),
        of(1.0 - drive.link, v, rate),
        ahead,
        rate,
    )


def observed(drive: Drive, at: Parts):
    """Angles and speeds [n, .] that the controllers of the joints see."""
    return at.q + drive.control * at.ahead, at.v + drive.control * at.rate


def accelerations(drive: Drive, at: Parts, accelerate: Callable, force, inertia, more):
    """Accelerations of rotors and of links.

    Args:
        accelerate: Accelerations [n, .] of the tree at angles, speeds, forces and rotors' inertia.
        force, inertia: On the rotors, and of them, [n, .].
        more: Force on the links [n, .].

    Returns:
        (of the rotors, of the links) [n, .].
    """
    give = drive.compliance > 0.0
    spring = sprung(drive, at.ahead, at.rate)
    on_link = jnp.where(give, spring, force) + more
    link = accelerate(at.link_q, at.link_v, on_link, jnp.where(give, 0.0, inertia))
    return jnp.where(give, (force - spring) / jnp.maximum(inertia, MIN_INERTIA), link), link


def rates(drive: Drive, giving, at: Parts, rotor, link):
    """Rate of change [2n + 2G, .] of the states at accelerations of rotors and links [n, .]."""
    speed = at.v + drive.link * at.rate
    return jnp.concatenate(
        [speed, rotor + drive.link * (link - rotor), at.rate[giving], (link - rotor)[giving]]
    )


def answers(drive: Drive, at: Parts, inverse_mass: Callable, inertia):
    """Accelerations [n, n, .] of the rotors (of the joints, where these are rigid) under a force of
    1 at one: second axis. inverse_mass: of the tree, at angles and rotors' inertia.
    """
    give = drive.compliance > 0.0
    give = give + jnp.zeros(inertia.shape, bool)
    whole = inverse_mass(at.link_q, jnp.where(give, 0.0, inertia))
    n = len(inertia)
    own = (
        jnp.eye(n).reshape((n, n) + (1,) * (inertia.ndim - 1))
        * (1.0 / jnp.maximum(inertia, MIN_INERTIA))[None]
    )
    return jnp.where(give[:, None] | give[None], own, whole)


def yielded(drive: Drive, carries):
    """How far links are ahead of rotors whose springs carry so much, N m."""
    return -jnp.where(
        drive.compliance > 0.0,
        drive.compliance * carries + 0.5 * drive.gap * jnp.sign(carries),
        0.0,
    )


ROW_SUBSTEPS = 8  # steps of a row: drives are faster than joints


class Local(NamedTuple):
    """One joint by itself, [n, 1, 1] each: inertia of rotor and link kg m^2. What its controller
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

    def observed(*how):
        return jnp.concatenate([of(z) for z in _moved(drive, local, *how)], 1)

    one, none = jnp.ones_like(carries[:, 0]), jnp.zeros_like(carries[:, 0])
    swings = (observed(0.0 * carries, dt, some) for some in ((one, none), (none, one)))
    return jnp.stack([observed(carries, dt), *swings])


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
            0, ROW_SUBSTEPS, lambda i, s: substep(i, s, carries, dt[None] / ROW_SUBSTEPS), state
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
