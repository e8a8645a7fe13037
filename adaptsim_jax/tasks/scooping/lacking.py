"""A scoop with what may be lacking in the declared one: the engine of `hydro` with an offset
command, a tilted table, drag.

With `NEUTRAL` it is `hydro.rollout`, number by number. Pure and traced in all values; the shape may
be traced, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from adaptsim_jax.tasks.scooping import hydro, model
from adaptsim_jax.tasks.scooping import hydro_contact as contact
from adaptsim_jax.tasks.scooping import hydro_shapes as shapes
from adaptsim_jax.tasks.scooping import motion as spatula
from adaptsim_jax.tasks.scooping.hydro import Numerics
from adaptsim_jax.tasks.scooping.model import ScoopOptions

Array = Any

NEUTRAL = {
    "speed_scale": 0.0,
    "lift_scale": 0.0,
    "pitch_offset": 0.0,
    "distance_offset": 0.0,
    "start_x": 0.0,
    "clearance": 0.0,
    "tilt": 0.0,
    "drag": 0.0,
    "adhesion": 0.0,
    "blade_friction": 0.0,
}
"""Shares of the declared speed, pitch rate and the blade's friction; rad; m, how far the blade
starts farther, and the piece lies ahead; m more under the blade; rad, downhill ahead; 1/s on the
table; m/s^2 towards the blade on it.
"""
NEAR = 1e-3  # m, over which drag and adhesion fade as a piece leaves table or blade


def rollout(
    values: Mapping[str, Array],
    action: Array,
    options: ScoopOptions = ScoopOptions(),  # noqa: B008
    numerics: Numerics = Numerics(),  # noqa: B008
) -> Array:
    """Poses `[N + 1, 3]` (x m from where the piece lies, z m, angle rad) every `numerics.dt` s of
    `action [3]` (rad, rad/s, m).

    values: mu, e Pa, g, h m (`model.PARAMETERS`) and what differs from `NEUTRAL`. Where the motion
    ceases to be finite it stays.
    """
    v = {**NEUTRAL, **values}
    piece = shapes.body(v["g"], v["h"])
    more = jnp.stack(
        [v["pitch_offset"], jnp.zeros_like(v["mu"]), v["distance_offset"] + v["start_x"]]
    )
    sliding = replace(options, clearance=options.clearance + v["clearance"])
    tip = spatula.motion(
        action + more.astype(action.dtype),
        hydro.steps_of(numerics),
        sliding,
        1.0 + v["speed_scale"],
        1.0 + v["lift_scale"],
    )
    ground, blade = contact.table(v["mu"]), v["mu"] * (1.0 + v["blade_friction"])
    rest = hydro.at_rest(piece, v["e"])

    def one(carry, row):
        state, lost = carry
        now, after = row
        surfaces = contact.together(
            ground, contact.spatula(now, (after - now) / numerics.dt, blade)
        )
        pull = _pull(v, piece, rest.pose[1], state, now)
        new, _ = hydro.step(piece, v["e"], state, surfaces, numerics, pull)
        lost = lost | ~hydro.in_room(new)
        # nothing of a lost step enters derivatives either
        return (jax.tree.map(lambda a, b: jnp.where(lost, a, b), state, new), lost), state.pose

    (end, _), poses = jax.lax.scan(one, (rest, jnp.zeros((), bool)), (tip[:-1], tip[1:]))
    return jnp.concatenate([poses, end.pose[None]])


def _pull(
    v, piece: shapes.Body, rest: Array, state: hydro.PieceState, tip: Array
) -> tuple[Array, Array]:
    """Acceleration along and up: gravity on a tilted table, drag near the table, adhesion near the
    blade.
    """
    x, z = state.pose[0], state.pose[1]
    on_table = jnp.exp(-jnp.maximum(z - rest, 0.0) / NEAR)
    ahead, above = spatula.seen_from_tip(tip, x, z)
    over = jax.nn.sigmoid((-ahead) / NEAR) * jax.nn.sigmoid((piece.hz + 3.0 * NEAR - above) / NEAR)
    stick_x, stick_z = spatula.turn(tip[2], jnp.zeros_like(x), -v["adhesion"] * over)
    along = model.GRAVITY * jnp.sin(v["tilt"]) - v["drag"] * on_table * state.velocity[0] + stick_x
    return along, -model.GRAVITY * jnp.cos(v["tilt"]) + stick_z
