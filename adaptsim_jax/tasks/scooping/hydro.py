"""Scooping in JAX: one soft piece against table and spatula, with hydroelastic contact; the
simulator of this task.

Pressure fields after Elandt et al. (2019), discrete hydroelastic contact after Masterjohn et al.
(2022), contact solved as SAP's convex problem after Castro et al. (2022); see `hydro_shapes`,
`hydro_contact` and `hydro_sap`. The scene is symmetric about the vertical plane of the motion, so
the piece has three degrees of freedom. Everything is pure and traced: shape, height, friction,
modulus and action; float32 or, where JAX is told so, float64.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.tasks.engine import EngineKind, filled_batches, steps_a_row
from adaptsim_jax.tasks.scooping import hydro_contact as contact
from adaptsim_jax.tasks.scooping import hydro_sap as sap
from adaptsim_jax.tasks.scooping import hydro_shapes as shapes
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping import motion as spatula
from adaptsim_jax.tasks.scooping.model import Numerics, ScoopOptions, check_numerics

Array = Any


class PieceState(NamedTuple):
    """pose `[3]`: x, z m and angle rad (nose down); velocity `[3]` of the same."""

    pose: Array
    velocity: Array


class StepInfo(NamedTuple):
    """residual `[]`: Unbalanced share of the momentum; impulse `[3]` of the contacts, N s and N m
    s.
    """

    residual: Array
    impulse: Array


class Scoop(NamedTuple):
    """`T + 1` rows, the start included: `piece [T + 1, 3]` and `tip [T + 1, 3]`, each x, z m and
    angle rad; `ahead []`, `above []`: the piece's centre in the tip's frame at the end, m; `success
    []`: 1 or 0; `code []`: of `scooping.MESSAGES`.
    """

    piece: Array
    tip: Array
    ahead: Array
    above: Array
    success: Array
    code: Array


def steps_of(numerics: Numerics) -> int:
    """Steps of a trial."""
    return round(model.SECONDS / numerics.dt)


def step(
    piece: shapes.PieceBody,
    modulus: Array,
    state: PieceState,
    surfaces: contact.Surfaces,
    numerics: Numerics,
    gravity: tuple[float, float] = (0.0, -model.GRAVITY),
) -> tuple[PieceState, StepInfo]:
    """One step of `numerics.dt` of a piece against rigid `surfaces`: as many as `numerics.grid` has
    pairs.

    Contacts are found where things are at the start, and solved for the velocity at the end.
    """
    n, dtype = numerics, state.pose.dtype
    points = contact.touch(piece, modulus, state.pose, surfaces, n.grid)
    free = state.velocity + n.dt * jnp.array([*gravity, 0.0], dtype)
    fixed = sap.springs(points, piece, n.dt, n.relaxation, n.slip, n.near_rigid)
    found = sap.solve(fixed, contact.firsts(n.grid), piece, free, state.velocity, n.iterations)
    return (
        PieceState(state.pose + n.dt * found.velocity, found.velocity),
        StepInfo(found.residual, found.impulse),
    )


def at_rest(piece: shapes.PieceBody, modulus: Array) -> PieceState:
    """A piece that stands on the table, sunk in by its weight."""
    z = piece.hz - shapes.sink(piece, modulus, model.GRAVITY)
    zero = jnp.zeros_like(z)
    return PieceState(jnp.stack([zero, z, zero]), jnp.zeros_like(z) + jnp.zeros(3, z.dtype))


def rollout(
    params: Array,
    action: Array,
    options: ScoopOptions = ScoopOptions(),  # noqa: B008
    numerics: Numerics = Numerics(),  # noqa: B008
) -> Scoop:
    """The trial of `action [3]` on the piece of `params [4]`; pure, jit and vmap it. Noise is the
    caller's.

    Whatever the code, all numbers are finite: a piece whose motion ceases to be finite stays where
    it was.
    """
    params = jnp.asarray(params)
    action = jnp.asarray(action, params.dtype)
    fit = _fit(params, action)
    params = jnp.where(fit, params, jnp.asarray(model.LOW, params.dtype))
    action = jnp.where(fit, action, jnp.asarray(model.ACTION_LOW, params.dtype))
    friction, modulus = params[0], params[1]
    piece = shapes.body(params[2], params[3])
    tip = spatula.motion(action, steps_of(numerics), options)
    ground = contact.table(friction)

    def one(carry, row):
        state, lost, worst = carry
        now, after = row
        surfaces = contact.together(
            ground, contact.spatula(now, (after - now) / numerics.dt, friction)
        )
        new, info = step(piece, modulus, state, surfaces, numerics)
        lost = lost | ~in_room(new)
        state = jax.tree.map(lambda a, b: jnp.where(lost, a, b), state, new)
        worst = jnp.maximum(worst, jnp.where(lost, 0.0, info.residual))
        return (state, lost, worst), state.pose

    start = at_rest(piece, modulus)
    first = (start, jnp.zeros((), bool), jnp.zeros((), params.dtype))
    (end, lost, worst), poses = jax.lax.scan(one, first, (tip[:-1], tip[1:]))
    ahead, above = spatula.from_tip(tip[-1], end.pose[0], end.pose[1])
    code = jnp.where(worst > numerics.tolerance, model.UNSOLVED, model.FINE)
    code = jnp.where(fit, jnp.where(lost, model.DIVERGED, code), model.UNFIT)
    good = fit & ~lost
    success = jnp.where(good, model.on_blade(ahead, above), 0.0).astype(params.dtype)
    return Scoop(jnp.concatenate([start.pose[None], poses]), tip, ahead, above, success, code)


def observed_rows(numerics: Numerics) -> np.ndarray:
    """`[8]`: the rows of a trial at which the piece is seen."""
    return np.round(np.array(model.OBSERVED_AT) / numerics.dt).astype(int)


def in_room(state: PieceState) -> Array:
    """Whether all of `state` is finite and the piece where pieces can be `[]`."""
    finite = jnp.all(jnp.isfinite(state.pose)) & jnp.all(jnp.isfinite(state.velocity))
    return finite & (jnp.abs(state.pose[0]) < 2.0) & (jnp.abs(state.pose[1]) < 1.0)


def _fit(params: Array, action: Array) -> Array:
    """Whether the engine is made for these numbers; actions may exceed their range by an execution
    error.
    """
    low, high = (jnp.asarray(b, params.dtype) for b in (model.PHYSICAL_LOW, model.PHYSICAL_HIGH))
    most = jnp.array([0.35, 0.6, 0.1], params.dtype)
    inside = jnp.all(params >= low) & jnp.all(params <= high)
    return inside & jnp.all(jnp.isfinite(action)) & jnp.all(jnp.abs(action) <= most)


class HydroSettings(NamedTuple):
    """numerics: What makes up the simulator besides physics."""

    numerics: Numerics = Numerics()


def make_hydro(options: ScoopOptions, numerics: Numerics):
    """`simulate` of our own engine, in batches on the CPU."""
    check_numerics(numerics)
    every = steps_a_row("backend hydro", numerics.dt, model.ROW, 0.0025)

    @jax.jit
    @jax.vmap
    def run(params, action):
        out = rollout(params, action, options, numerics)
        rows = slice(every, None, every)
        return out.piece[rows, :2], out.tip[rows], out.code

    def simulate(params, commands, initial):
        params, actions, starts = model.checked_trials(params, commands, initial)
        count, kind = len(params), jnp.result_type(float)
        state = np.zeros((count, round(model.SECONDS / model.ROW), model.STATE))
        codes = np.zeros(count, int)
        for here, room in filled_batches(count, model.BATCH):
            found = run(jnp.asarray(params[room], kind), jnp.asarray(actions[room], kind))
            piece, tip, code = (np.asarray(x)[: here.stop - here.start] for x in found)
            state[here, :, 0], state[here, :, 2] = piece[..., 0], piece[..., 1]
            state[here, :, 3:], codes[here] = tip, code
        return model.placed(state, codes, starts)

    return simulate


HYDRO = EngineKind(HydroSettings, make_hydro)
