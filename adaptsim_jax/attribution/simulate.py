"""Simulation of stretches by a tree of joints with effects, and its linearisation along the
simulated path. Stretches lie last.

A step solves for dry friction first (the force that would stop each joint within the step, within
its level: Gauss and Seidel's sweeps over the joints, as in time-stepping of rigid contact; Stewart
and Trinkle, 1996) and then integrates everything else by Runge and Kutta's fourth order under that
force. So a joint that sticks does not creep. Bristles that yield (presliding) are a spring in the
same place: a third state of each joint, their deflection, where any model has them; drives that
give are two more (`drive.py`). Ends of declared ranges (`stops.py`) are in the same sweeps. Where
controllers are too fast for that (`stiff`: a light joint, rows far apart), a Rosenbrock method of
second order stands in, which damps what it cannot follow (ROS2; Verwer et al., SIAM J. Sci. Comput.
20, 1999); its Jacobian holds their stiffness and damping only, and adds to the inertia.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.attribution import drive as drives
from adaptsim_jax.attribution import stops
from adaptsim_jax.attribution.acting import (
    ActingModel,
    Values,
    bent_at,
    carried,
    drive_of,
    forces,
    held_by,
)
from adaptsim_jax.mechanisms import equations

SWEEPS = 3  # sweeps of Gauss and Seidel over the joints of a row
RUNGE_KUTTA = np.array([[0.0, 0.0, 1 / 6], [0.5, 0.0, 1 / 3], [0.5, 0.0, 1 / 3], [1.0, 0.0, 1 / 6]])
ROSENBROCK = np.array([[0.0, 0.0, 1.5], [1.0, 2.0, 0.5]])
"""Stages: how far on, how much of the stage before is taken off, weight."""
IMPLICIT = 1.0 - np.sqrt(0.5)  # gamma of ROS2, with which it is L-stable


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["substeps", "rough", "giving"],
    meta_fields=["past", "bristles", "stiff"],
)
@dataclass(frozen=True)
class Scheme:
    """How stretches are stepped through. substeps of a row; rough: whether anything rubs dry;
    giving [G]: the joints whose drives give; and, static, past: rows of the command before a
    stretch, bristles: whether these have a state, stiff: whether controllers are faster than the
    substeps.
    """

    substeps: Any
    rough: Any
    giving: Any
    past: int
    bristles: bool = False
    stiff: bool = False

    @property
    def gives(self) -> bool:
        """Whether any drive does."""
        return len(self.giving) > 0


class DrivenRows(NamedTuple):
    """What drives the rows: u [L, n, W] mean command, t [L, W] s, dt [L, W] s."""

    u: Any
    t: Any
    dt: Any


def _implicit(hold, part, v):
    """Inertia and force [n, W] that stiffness and damping come to over a part [1, W] s of a step,
    at speeds v.
    """
    stiffness, damping = hold
    return part * (damping + part * stiffness), -part * stiffness * v


class SchemeEquations(NamedTuple):
    """Equations of motion in the coordinates of a scheme: forces(x, t), accelerations(x, force,
    inertia) of what friction rubs on, rates(x, force, inertia), answers(x, inertia) `[n, n, .]`,
    speeds(x) of what friction rubs on.
    """

    forces: Any
    accelerations: Any
    rates: Any
    answers: Any
    speeds: Any


def _rigid(model: ActingModel, values: Values, u) -> SchemeEquations:
    """Of states [2n, W]."""
    n = model.tree.n

    def accelerate(x, force, inertia):
        return equations.acceleration(
            model.tree, values.inertial, x[:n], x[n:], force, inertia, values.gravity
        )

    def speeds(x):
        return x[n:]

    return SchemeEquations(
        lambda x, t: forces(model, values, x[:n], x[n:], u, t),
        accelerate,
        lambda x, force, inertia: jnp.concatenate([speeds(x), accelerate(x, force, inertia)]),
        lambda x, inertia: equations.inverse_mass(model.tree, values.inertial, x[:n], inertia),
        speeds,
    )


def _giving(model: ActingModel, values: Values, u, giving, pushed) -> SchemeEquations:
    """Of states [2n + 2G, W] where the drives of the joints `giving` [G] give, under forces
    `pushed` [G, W] on their links besides.
    """
    drive = drive_of(model, values)
    more = jnp.zeros((model.tree.n, pushed.shape[1]), pushed.dtype).at[giving].set(pushed)

    def parts(x):
        return drives.parts_of(drive, giving, x)

    def accelerate(q, v, force, inertia):
        return equations.acceleration(
            model.tree, values.inertial, q, v, force, inertia, values.gravity
        )

    def inverse_mass(q, inertia):
        return equations.inverse_mass(model.tree, values.inertial, q, inertia)

    def both(x, force, inertia):
        return drives.accelerations(drive, parts(x), accelerate, force, inertia, more)

    def acting(x, t):
        at = parts(x)
        return forces(model, values, at.q, at.v, u, t, drives.observed(drive, at))

    return SchemeEquations(
        acting,
        lambda x, force, inertia: both(x, force, inertia)[0],
        lambda x, force, inertia: drives.rates(drive, giving, parts(x), *both(x, force, inertia)),
        lambda x, inertia: drives.answers(drive, parts(x), inverse_mass, inertia),
        lambda x: parts(x).v,
    )


class Substep(NamedTuple):
    """A step within a row: at t [1, W] s, over h [W] s, under extra [n, W] N m; bent [n, W] rad,
    the deflection of bristles when it begins; hold: stiffness and damping [n, W] that are stepped
    implicitly, None where none are.
    """

    t: Any
    h: Any
    extra: Any
    bent: Any
    hold: Any


def _held(moving: SchemeEquations, model: ActingModel, values: Values, x, step: Substep):
    """Dry friction [n, W] held over a step, the deflection of bristles by its end [n, W], and the
    force of the ends of declared ranges [n, W].
    """
    t, h, extra, bent, hold = step
    v = moving.speeds(x)
    n = len(v)
    act = moving.forces(x, t)
    more, pull = (0.0, 0.0) if hold is None else _implicit(hold, h[None], v)
    inertia = act.inertia + more
    force = act.smooth + extra + pull
    free = moving.accelerations(x, force, inertia)
    answer = moving.answers(x, inertia)  # column j: force of 1 at joint j
    level = jnp.maximum(act.level, 0.0)
    safe = jnp.where(h > 0, h, 1.0)
    own = jnp.stack([answer[j, j] for j in range(n)])
    ends = stops.limited(model.tree)
    still = jnp.zeros_like(v)
    # where friction gives (MuJoCo's): the share of a speed that it ends in a step
    rate, softness = jnp.asarray(model.tree.friction_softness).T[..., None]
    softness = softness * values.ease
    braked = jnp.where(softness > 0.0, jnp.minimum(safe[None] * rate, 1.0), 1.0)

    def turn(carry, j):  # a loop: written out for each joint it takes many times as long to compile
        after, force, stop = carry
        rise = after[j] - v[j] - safe * own[j] * force[j]
        slide = bent[j] + safe * (braked[j] * v[j] + rise)  # by the end of the step, without it
        new = jnp.clip(
            -slide / (act.yielding[j] + safe**2 * (own[j] + softness[j])), -level[j], level[j]
        )
        after = after + h[None] * answer[:, j] * (new - force[j])[None]
        return (after, force.at[j].set(new), stop), None

    if len(ends):
        side, reference, give, out = stops.hold_within(model.tree, x[:n], x[n : 2 * n])
        give = give * values.ease[ends]
        place = jnp.asarray(np.searchsorted(ends, np.arange(n)).clip(0, len(ends) - 1))
        ended = jnp.asarray(np.isin(np.arange(n), ends))

    def turn_and_end(carry, j):
        (after, force, stop), _ = turn(carry, j)
        k = place[j]
        rise = (after[j] - v[j]) / safe - own[j] * stop[j]  # without the end's force
        wanted = jnp.maximum((reference[k] - side[k] * rise) / (own[j] + give[k]), 0.0) * side[k]
        new = jnp.where(out[k] & ended[j], wanted, 0.0)
        after = after + h[None] * answer[:, j] * (new - stop[j])[None]
        return (after, force, stop.at[j].set(new)), None

    order = jnp.tile(jnp.arange(n), SWEEPS if n > 1 else 1)
    (_, rub, stop), _ = jax.lax.scan(
        turn_and_end if len(ends) else turn, (v + h[None] * free, still, still), order
    )
    return rub, -act.yielding * rub, stop


def _advanced(moving: SchemeEquations, x, now, wide, pushed, hold):
    """State after a step of `wide` [1, W] s from x at `now` [1, W] s, by the stages of the method.

    Args:
        pushed: Forces [n, W] that are held over it, a pair.
        hold: As of `Substep`.
    """
    extra, held = pushed
    n = len(extra)

    def slope(x, at, k, less):
        act = moving.forces(x, now + at)
        force, inertia = act.smooth + extra + held, act.inertia
        if not hold:
            return moving.rates(x, force, inertia)
        # what is solved for is k + less * (k of the stage before), which spares its product
        # with the mass matrix
        rate = x[n:] - less * k[:n]
        more, pull = _implicit(hold, IMPLICIT * wide, rate)
        a = (
            moving.accelerations(x, force + pull + less * more * k[n:], inertia + more)
            - less * k[n:]
        )
        return jnp.concatenate([rate + IMPLICIT * wide * a, a])

    def stage(carry, part):
        k, total = carry
        on, less, weight = part
        k = slope(x + on * wide * k, on * wide, k, less)
        return (k, total + weight * k), None

    stages = jnp.asarray(ROSENBROCK if hold else RUNGE_KUTTA, x.dtype)
    (_, total), _ = jax.lax.scan(stage, (jnp.zeros_like(x), jnp.zeros_like(x)), stages)
    return x + wide * total


def row_step(model: ActingModel, values: Values, x, row: DrivenRows, extra, scheme: Scheme):
    """State after a row, [2n, W] (2G more where drives give, then n of the deflection of bristles),
    and the mean dry friction over it [n, W]. row: what drives it, u [n, W], t and dt [W]; extra
    [n, W] N m on the joints, and [G, W] on the links whose drives give.
    """
    u, t, dt = row
    n = model.tree.n
    moves = 2 * (n + len(scheme.giving))
    h = dt / scheme.substeps
    wide = h[None]
    if scheme.stiff:
        hold = tuple(jnp.maximum(z, 0.0).astype(x.dtype) for z in held_by(values))
    else:
        hold = None
    if scheme.gives:
        moving = _giving(model, values, u, scheme.giving, extra[n:])
    else:
        moving = _rigid(model, values, u)
    extra = extra[:n]

    def substep(i, carry):
        whole, rubbed = carry
        now = t[None] + i * wide
        x = whole[:moves]
        still = jnp.zeros_like(extra)
        bent = whole[moves:] if len(whole) > moves else still

        def rubs():
            return _held(moving, model, values, x, Substep(now, h, extra, bent, hold))

        if any(model.tree.limited):
            rub, yielded, stop = rubs()
        else:
            rub, yielded, stop = jax.lax.cond(scheme.rough, rubs, lambda: (still, still, still))
        after = _advanced(moving, x, now, wide, (extra, rub + stop), hold)
        if len(whole) > moves:
            after = jnp.concatenate([after, yielded])
        return after, rubbed + rub / scheme.substeps

    return jax.lax.fori_loop(0, scheme.substeps, substep, (x, jnp.zeros_like(extra)))


def command_rows(model: ActingModel, values: Values, stamp, command, past: int, rows: int):
    """The command [L, n, W] as it reaches the joints: effects of the place `command` act on a
    longer piece of it.
    """
    u = command
    for effect in model.effects:
        if effect.place == "command" and effect.name in values.effects:
            p = {k: z[None] for k, z in values.effects[effect.name].items()}
            u = effect.apply(p, stamp[:, None, :], u)
    return u[past : past + rows]


def measure(model: ActingModel, values: Values, time, x, u):
    """What the sensors say [L+1, 2n, W] of states x [L+1, 2n, W] at time [L+1, W] s under commands
    u [L, n, W].
    """
    n = x.shape[1] // 2
    q, v = x[:, :n], x[:, n:]
    for effect in model.effects:
        if effect.place == "measurement" and effect.name in values.effects:
            p = {k: z[None] for k, z in values.effects[effect.name].items()}
            also = (carried(values, x, u),) if effect.carried else ()
            q, v = effect.apply(p, time[:, None, :], q, v, values.read, *also)
    return jnp.concatenate([q, v], 1)


class Path(NamedTuple):
    """x [L+1, 2n, W]; sensed [L+1, 2n, W]; rub [L, n, W] mean dry friction; u [L, n, W] command as
    it arrived; ahead [L+1, 2n, W]: of drives that give, how far links are ahead of rotors and at
    which rate ([L+1, 0, W] where none does).
    """

    x: Any
    sensed: Any
    rub: Any
    u: Any
    ahead: Any


@jax.jit
def simulate(model: ActingModel, values: Values, time, stamp, command, x0, scheme: Scheme) -> Path:
    """Stretches from x0 [2n, W], [4n, W] where drives give."""
    drive, begin = _begin(model, values, time, stamp, command, x0, scheme)
    nothing = jnp.zeros_like(x0[: model.tree.n + len(scheme.giving)])

    def row(x, now):
        new, rub = row_step(model, values, x, now, nothing, scheme)
        return new, (x, rub)

    last, (x, rub) = jax.lax.scan(row, begin, drive)
    return _path(model, values, time, jnp.concatenate([x, last[None]]), rub, drive.u, scheme)


@jax.jit
def linearise(model: ActingModel, values: Values, time, stamp, command, x0, scheme: Scheme):
    """(Path, derivatives of each row's end by its start [L, S, S, W] and by a force held over the
    row [L, S, F, W]).

    S = 2n states and F = n forces; where G drives give 2G states (how far their links are ahead,
    and the rates) and G forces (on these links) more, with bristles n states more.
    """
    drive, begin = _begin(model, values, time, stamp, command, x0, scheme)
    (states, width), forced = begin.shape, model.tree.n + len(scheme.giving)
    zero = jnp.zeros((forced, width), x0.dtype)
    ways = jnp.eye(states + forced, dtype=x0.dtype)[:, :, None] * jnp.ones((1, 1, width), x0.dtype)

    def row(x, now):
        def end(x, extra):
            return row_step(model, values, x, now, extra, scheme)

        along = jax.vmap(lambda a, b: jax.jvp(end, (x, zero), (a, b)), out_axes=(None, 0))
        (new, rub), (slopes, _) = along(ways[:, :states], ways[:, states:])
        return new, (x, rub, jnp.swapaxes(slopes, 0, 1))

    last, (x, rub, slopes) = jax.lax.scan(row, begin, drive)
    path = _path(model, values, time, jnp.concatenate([x, last[None]]), rub, drive.u, scheme)
    return path, slopes[:, :, :states], slopes[:, :, states:]


def _path(model: ActingModel, values: Values, time, states, rub, u, scheme: Scheme) -> Path:
    n, count = model.tree.n, len(scheme.giving)
    x = states[:, : 2 * n]
    ahead = x[:, :0]
    if scheme.gives:
        some = states[:, 2 * n : 2 * (n + count)]
        at = jnp.concatenate([scheme.giving, n + scheme.giving])
        ahead = jnp.zeros_like(x).at[:, at].set(some)
    return Path(x, measure(model, values, time, x, u), rub, u, ahead)


def _begin(model: ActingModel, values: Values, time, stamp, command, x0, scheme: Scheme):
    """What drives the rows, and the state that they begin at."""
    rows, n = len(time) - 1, model.tree.n
    u = command_rows(model, values, stamp, command, scheme.past, rows)
    drive = DrivenRows(u, time[:-1], jnp.diff(time, axis=0))
    begin = x0
    if scheme.gives:
        begin = jnp.concatenate([x0[: 2 * n], x0[2 * n + scheme.giving], x0[3 * n + scheme.giving]])
    if scheme.bristles:
        begin = jnp.concatenate([begin, bent_at(model, values, x0, drive.u[0], drive.t[0])])
    return drive, begin


@partial(jax.jit, static_argnames="past")
def with_drives(model: ActingModel, values: Values, time, stamp, command, x0, past: int):
    """Starts [4n, W] of stretches that begin at x0 [2n, W] where drives give: at rest in their
    springs.
    """
    u = command_rows(model, values, stamp, command, past, len(time) - 1)
    q, v = jnp.split(x0, 2)
    act = forces(model, values, q, v, u[0], time[0][None])
    a = equations.acceleration(
        model.tree, values.inertial, q, v, act.smooth, act.inertia, values.gravity
    )
    carried_there = act.smooth - act.inertia * a
    return jnp.concatenate([x0, drives.yielded(drive_of(model, values), carried_there), 0.0 * v])


def respond(
    by_state: np.ndarray, by_force: np.ndarray, force: np.ndarray, rows, channels
) -> np.ndarray:
    """Change of what is logged [W, T, C, K] at some rows, in some channels, under force columns [W,
    L, F, K]; slopes [W, L, S, S] and [W, L, S, F] of S states, of which the first are angles and
    speeds.
    """
    width, count, _, columns = force.shape
    out = np.zeros((width, len(rows), len(channels), columns))
    place = {int(row): i for i, row in enumerate(rows)}
    now = np.zeros((width, by_state.shape[2], columns))
    for k in range(count):
        now = by_state[:, k] @ now + by_force[:, k] @ force[:, k]
        if k + 1 in place:
            out[:, place[k + 1]] = now[:, channels]
    return out


def responded_start(by_state: np.ndarray, starts: int, rows, channels) -> np.ndarray:
    """The same [W, T, C, starts] under a change of the start, of the first states."""
    width, count, states, _ = by_state.shape
    out = np.zeros((width, len(rows), len(channels), starts))
    place = {int(row): i for i, row in enumerate(rows)}
    now = np.broadcast_to(np.eye(states)[:, :starts], (width, states, starts))
    for k in range(count + 1):
        if k in place:
            out[:, place[k]] = now[:, channels]
        if k < count:
            now = by_state[:, k] @ now
    return out
