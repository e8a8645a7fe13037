"""What acts on the joints of an environment beside what MJX holds, one MJX step at a time.

The laws are those of `effects/`, and their sum is that of `replay` (`attribution.acting.forces`).
What has a memory (a delay, a lag, bristles, a rotor behind a spring) has it in `data.userdata`, so
that any environment's step takes it along. Numbers are leaves of a pytree; which effects are on is
static, so that what is off costs nothing.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.flatten_util import ravel_pytree

from adaptsim_jax.attribution import drive as drives
from adaptsim_jax.attribution.acting import (
    ActingModel,
    Values,
    actuated,
    drive_of,
    forces,
    rubs_dry,
)
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.lazy import mjx_module
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.mechanisms import equations

mjx_step = mjx_module().step  # itself: what traces an environment puts another in its place

ROWS = 3  # steps of what a law without a memory of its own is given
ROTOR_STEPS = drives.ROW_SUBSTEPS


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["model", "values", "damping", "stiffness"],
    meta_fields=["joints", "qpos", "dof", "ctrl", "act", "giving", "yielding", "past"],
)
@dataclass(frozen=True)
class Laws:
    """Laws at n joints, and what they need to know of the environment's model.

    - `model`, `values`: The effects, and their numbers `[n, 1]`; `values.actuator` is that of the
      environment's own actuators.
    - `damping [nv, 2]`, `stiffness [njnt, 2]`: MuJoCo's polynomials beyond the first coefficient,
      which MJX ignores; None where there are none.
    - `joints`: Names. `qpos`, `dof`, `ctrl`, `act`: Where each joint's angle, speed, command and
      activation are (-1: it has none).
    - `giving`, `yielding`: Joints whose drive gives, and whose dry friction does.
    - `past`: Steps of commands and readings that delays may reach back.
    """

    model: ActingModel
    values: Values
    damping: Any
    stiffness: Any
    joints: tuple[str, ...]
    qpos: tuple[int, ...]
    dof: tuple[int, ...]
    ctrl: tuple[int, ...]
    act: tuple[int, ...]
    giving: tuple[bool, ...]
    yielding: tuple[bool, ...]
    past: int

    def at(self, place: str) -> tuple[Effect, ...]:
        """The effects of a place."""
        return tuple(e for e in self.model.effects if e.place == place)

    @property
    def sensing(self) -> bool:
        """Whether readings are other than the joints' angles and speeds."""
        on_rotor = any(self.giving)
        return on_rotor or bool(self.at("measurement"))

    @property
    def of_commands(self) -> bool:
        """Whether they change nothing but commands."""
        return all(e.place == "command" for e in self.model.effects)

    @property
    def rubbing(self) -> bool:
        """Whether anything rubs dry."""
        return any(rubs_dry(e)[0] for e in self.model.effects)


class Memory(NamedTuple):
    """What the laws remember from one step to the next.

    `count []`: steps so far; `command`, `reading`: of each effect by name, rows `[K, ...]` of what
    it was given and its `state`; `bent [n]` of bristles; `ahead`, `rate [n]`: links beyond rotors;
    `q`, `v [n]`: what the sensors say.
    """

    count: Any
    command: Table
    reading: Table
    bent: Any
    ahead: Any
    rate: Any
    q: Any
    v: Any


def _is(effect: Effect, what: str) -> bool:
    return effect.shifts_time and effect.amplitudes[0].name == what


def _rows(laws: Laws, effect: Effect) -> int:
    return laws.past if _is(effect, "delay") else ROWS


def _began(laws: Laws, q, v, u) -> Memory:
    """Memory at the first step, `[n]` each: commands as the first one, readings as if the motion
    had gone on.
    """
    n, zero = len(laws.joints), jnp.zeros_like(q)
    command, reading = {}, {}
    for e in laws.at("command"):
        before = _numbers(laws, e).get("before", jnp.ones((1, n)))[0]
        rows = jnp.tile(before * u, (_rows(laws, e), 1))
        command[e.name] = {"rows": rows, "state": before * u}
    for e in laws.at("measurement"):
        rows = jnp.tile(jnp.stack([q, v, zero]), (_rows(laws, e), 1, 1))
        behind = _numbers(laws, e)["lag"][0] * v if _is(e, "lag") else zero
        reading[e.name] = {"rows": rows, "state": jnp.stack([behind, zero]), "out": rows[:ROWS, 0]}
    return Memory(jnp.zeros(()), command, reading, zero, zero, zero, q, v)


def _numbers(laws: Laws, effect: Effect) -> Table:
    """`[1, n]` by parameter."""
    return {k: z[:, 0][None] for k, z in laws.values.effects[effect.name].items()}


def room(laws: Laws) -> Array:
    """`userdata` before the first step."""
    zero = jnp.zeros(len(laws.joints))
    return ravel_pytree(_began(laws, zero, zero, zero))[0].astype(jnp.float32)


def _pushed(rows, new):
    return jnp.concatenate([rows[1:], new[None]])


def _late(rows, delay, step):
    """Two neighbours of `rows [K, ..., n]`, as many whole steps late as `delay [1, n]` says, and
    what is left of the delay `[1, n]`.
    """
    delay = jnp.clip(delay, 0.0, (len(rows) - 2) * step)
    whole = jnp.floor(delay / step + 1e-4).astype(jnp.int32)
    newest = len(rows) - 1 - whole.reshape((1,) * (rows.ndim - 1) + (-1,))
    index = jnp.clip(jnp.concatenate([newest - 1, newest]), 0, len(rows) - 1)
    index = jnp.broadcast_to(index, (2, *rows.shape[1:]))
    return jnp.take_along_axis(rows, index, 0), jnp.clip(delay - whole * step, 0.0, step)


def _arrived(laws: Laws, command: dict, u, step):
    """Mean command `[n]` that reaches the joints within a step, and what is remembered of it."""
    new = {}
    for e in laws.at("command"):
        p, was = _numbers(laws, e), command[e.name]
        rows, state = _pushed(was["rows"], u), was["state"]
        sure = p | {"before": jnp.ones_like(u)[None]}
        if _is(e, "delay"):
            (older, newer), rest = _late(rows, p["delay"], step)
            t = step * jnp.arange(3.0)[:, None]
            u = e.apply(sure | {"delay": rest}, t, jnp.stack([older, newer, newer]))[1]
        elif _is(e, "lag"):  # a row of no time begins it where it was
            t = step * jnp.array([0.0, 0.0, 1.0])[:, None]
            mean = e.apply(sure, t, jnp.stack([state, u, u]))[1]
            lag = p["lag"][0]
            follows = state + step / jnp.maximum(lag, 1e-6) * (u - mean)
            u, state = mean, jnp.where(lag > 1e-6, follows, u)
        else:
            t = step * jnp.arange(ROWS + 1.0)[:, None]
            u = e.apply(sure, t, jnp.concatenate([rows, rows[-1:]]))[ROWS - 1]
        new[e.name] = {"rows": rows, "state": state}
    return u, new


def _read(laws: Laws, reading: dict, now, step):
    """What the sensors say `[2, n]` of angle, speed and torque of the drives `now [3, n]`, and what
    is remembered of it.
    """
    new = {}
    for e in laws.at("measurement"):
        p, was = _numbers(laws, e), reading[e.name]
        rows, state, out = _pushed(was["rows"], now), was["state"], was["out"]
        t = step * jnp.arange(ROWS * 1.0)[:, None]
        if _is(e, "delay"):
            two, rest = _late(rows, p["delay"], step)
            q, v = e.apply(p | {"delay": rest}, t[:2], two[:, 0], two[:, 1], two[0, 0])
        elif _is(e, "lag"):
            q, v, state = _lagged(e, p, rows, state, step)
        else:
            also = (rows[-ROWS:, 2],) if e.carried else ()
            q, v = e.apply(p, t, rows[-ROWS:, 0], rows[-ROWS:, 1], out[0], *also)
        now = jnp.stack([q[-1], v[-1], now[2]])
        new[e.name] = {"rows": rows, "state": state, "out": _pushed(out, now[0])}
    return now[:2], new


def _lagged(effect: Effect, p, rows, state, step):
    """A filter of angle and speed over one step, from `state [2, n]`: how far the angle trails, and
    the filtered acceleration. Rows of no time and a speed of our choice begin it there.
    """
    (q0, v0), (q1, v1) = rows[-2, :2], rows[-1, :2]
    t = step * jnp.array([0.0, 0.0, 1.0])[:, None]
    lag = jnp.maximum(p["lag"][0], 1e-9)
    first = [state[0] / lag, v0 - state[1]]
    angle, speed = (
        effect.apply(p, t, jnp.stack([q0, q0, q1]), jnp.stack([z, v0, v1]), q0) for z in first
    )
    new = jnp.stack([q1 - angle[0][-1], (v1 - speed[1][-1]) / lag])
    return angle[0], speed[1], new


class _Acting(NamedTuple):
    """What acts over a step, `[n]` each: `extra` force on the links beside MJX's own, `level` of
    dry friction, `inertia`; `ahead`, `rate` after it.
    """

    extra: Any
    level: Any
    inertia: Any
    ahead: Any
    rate: Any


def _acting(laws: Laws, at, acceleration, u, t, step) -> _Acting:
    """At angle, speed, links ahead of rotors and their rate `at [4, n]`, under the links'
    `acceleration [n]` of the step before.
    """
    q, v, ahead, rate = (z[:, None] for z in at)
    time = jnp.reshape(t, (1, 1))
    own = forces(laws.model, laws.values, q, v, u[:, None], time)
    plain = actuated(laws.values._replace(effects={}), q, v, u[:, None])[0]
    smooth, level, inertia = own.smooth, own.level, own.inertia
    if any(laws.giving):
        give = jnp.asarray(laws.giving)[:, None]
        link = (q, v, acceleration[:, None])
        spring, ahead, rate = _rotors(laws, link, (ahead, rate), u[:, None], (time, step))
        smooth = jnp.where(give, spring, smooth)
        level, inertia = jnp.where(give, 0.0, level), jnp.where(give, 0.0, inertia)
    return _Acting(*(z[:, 0] for z in (smooth - plain, level, inertia, ahead, rate)))


def _rotors(laws: Laws, link, state, u, when):
    """Mean torque of the springs on the links, and how far these are ahead after a step. link:
    their angle, speed and acceleration; all `[n, 1]`.
    """
    (q, v, a), (t, step) = link, when
    drive = drive_of(laws.model, laws.values)
    small = step / ROTOR_STEPS

    def move(carry, k):
        rotor, speed, total = carry
        s = (k + 0.5) * small
        place, pace = q + s * v + 0.5 * s * s * a, v + s * a
        ahead, rate = place - rotor, pace - speed
        spring = drives.sprung(drive, ahead, rate)
        seen = (rotor + drive.control * ahead, speed + drive.control * rate)
        own = forces(laws.model, laws.values, rotor, speed, u, t + s, seen)
        inertia = jnp.maximum(own.inertia, drives.MIN_INERTIA)
        free = speed + small * (own.smooth - spring) / inertia
        level = jnp.maximum(own.level, 0.0)
        rub = jnp.clip(-free * inertia / small, -level, level)
        speed = free + small * rub / inertia
        return (rotor + small * speed, speed, total + spring / ROTOR_STEPS), None

    start = (q - state[0], v - state[1], jnp.zeros_like(q))
    (rotor, speed, spring), _ = jax.lax.scan(move, start, jnp.arange(ROTOR_STEPS * 1.0))
    end = q + step * v + 0.5 * step * step * a
    give = drive.compliance > 0.0
    ahead, rate = (jnp.where(give, z, 0.0) for z in (end - rotor, v + step * a - speed))
    return spring, ahead, rate


def _wound(laws: Laws, q, v, u, t):
    """How far links are ahead of rotors `[n]` at the start: at rest in their springs, as `replay`
    begins.
    """
    q, v, values, tree = q[:, None], v[:, None], laws.values, laws.model.tree
    act = forces(laws.model, values, q, v, u[:, None], jnp.reshape(t, (1, 1)))
    a = equations.acceleration(tree, values.inertial, q, v, act.smooth, act.inertia, values.gravity)
    carried = act.smooth - act.inertia * a
    return drives.yielded(drive_of(laws.model, values), carried)[:, 0]


def _bristles(laws: Laws, total, bent, speed, step):
    """`(force, level, inertia)` of friction that yields as a spring, `[n]` each: it holds where the
    spring is bent by less than what breaks it away, by an implicit step.

    Args:
        total: Level of all dry friction there, N m. speed: That is expected at the step's end.
    """
    zero = jnp.zeros_like(bent)[:, None]
    give = zero[:, 0]
    for e in laws.at("force"):
        if rubs_dry(e)[1]:
            give = give + _numbers(laws, e)["compliance"][0]
    on = jnp.asarray(laws.yielding) & (give > 0.0)
    soft = jnp.where(on, give, 1.0)
    wanted = -(bent + step * speed) / soft
    held = on & (jnp.abs(wanted) <= total)
    slides = on & ~held
    force = jnp.where(held, -bent / soft, 0.0)
    damping = jnp.where(held, step / soft, 0.0)
    push = jnp.where(slides, jnp.sign(wanted) * total, 0.0)
    return on, force + push, damping, jnp.where(on, total * soft, 0.0)


def stepped(laws: Laws, model: Any, data: Any, ctrl: Array, move: Any = mjx_step) -> Any:
    """`data` one of the model's steps later by `move(model, data)`, under `ctrl [nu]`."""
    given = data.qfrc_applied
    if not laws.joints:  # a file's polynomials alone
        pushed = given + _polynomials(laws, model, data)
        return move(model, data.replace(ctrl=ctrl, qfrc_applied=pushed)).replace(qfrc_applied=given)
    memory = _unravelled(laws)(data.userdata)
    step, n = model.opt.timestep, len(laws.joints)
    at, dof = jnp.asarray(laws.qpos), jnp.asarray(laws.dof)
    sent, has = jnp.asarray(laws.ctrl), jnp.asarray(laws.ctrl) >= 0
    q, v = data.qpos[at], data.qvel[dof]
    low, high = model.actuator_ctrlrange.T
    open_ = ~jnp.asarray(model.actuator_ctrllimited, bool)
    clipped = jnp.where(open_, ctrl, jnp.clip(ctrl, low, high))
    u = jnp.where(has, clipped[sent], 0.0) if clipped.size else jnp.zeros(n)
    fresh = _began(laws, q, v, u)
    memory = jax.tree.map(lambda a, b: jnp.where(memory.count > 0, a, b), memory, fresh)
    u, command = _arrived(laws, memory.command, u, step)
    late = ctrl.at[jnp.where(has, sent, ctrl.size)].set(u, mode="drop")
    if any(k >= 0 for k in laws.act):
        act = jnp.asarray(laws.act)
        u = jnp.where(act >= 0, data.act[act], u)
    ahead = memory.ahead
    if any(laws.giving):
        ahead = jnp.where(memory.count > 0, ahead, _wound(laws, q, v, u, data.time))
    state = jnp.stack([q, v, ahead, memory.rate])
    acting = _acting(laws, state, data.qacc[dof], u, data.time, step)
    force, level = acting.extra, model.dof_frictionloss[dof] + acting.level
    more = acting.inertia
    if any(laws.yielding):
        pace = v + step * data.qacc[dof]
        on, pull, damping, most = _bristles(laws, level, memory.bent, pace, step)
        force, more = force + pull - damping * v, more + step * damping
        level = jnp.where(on, 0.0, level)
    pushed = given.at[dof].add(force) + _polynomials(laws, model, data)
    edits = {"dof_armature": model.dof_armature.at[dof].add(more)}
    if laws.rubbing:
        edits["dof_frictionloss"] = model.dof_frictionloss.at[dof].set(jnp.maximum(level, 1e-6))
    after = move(model.tree_replace(edits), data.replace(ctrl=late, qfrc_applied=pushed))
    bent = memory.bent
    if any(laws.yielding):
        bent = jnp.clip(bent + step * after.qvel[dof], -most, most)
    q, v = after.qpos[at], after.qvel[dof]
    torque = actuated(laws.values, q[:, None], v[:, None], u[:, None])[0][:, 0]
    now = jnp.stack([q, v, torque])
    if any(laws.giving):
        link = drive_of(laws.model, laws.values).link[:, 0]
        back = jnp.stack([acting.ahead, acting.rate, jnp.zeros(n)])
        now = now - jnp.asarray(laws.giving) * (1.0 - link) * back
    (q, v), reading = _read(laws, memory.reading, now, step)
    new = Memory(memory.count + 1, command, reading, bent, acting.ahead, acting.rate, q, v)
    userdata = ravel_pytree(new)[0].astype(data.userdata.dtype)
    return after.replace(ctrl=ctrl, qfrc_applied=given, userdata=userdata)


def _unravelled(laws: Laws):
    zero = jnp.zeros(len(laws.joints))
    return ravel_pytree(_began(laws, zero, zero, zero))[1]


def _polynomials(laws: Laws, model: Any, data: Any):
    """Forces `[nv]` of what MuJoCo has as polynomials beyond their first coefficient."""
    out = jnp.zeros_like(data.qvel)
    if laws.damping is not None:
        speed = jnp.abs(data.qvel)
        out = out - (laws.damping[:, 0] + laws.damping[:, 1] * speed) * speed * data.qvel
    if laws.stiffness is not None:
        simple = [j for j, kind in enumerate(model.jnt_type) if int(kind) in (2, 3)]
        at, dof = model.jnt_qposadr[jnp.asarray(simple)], model.jnt_dofadr[jnp.asarray(simple)]
        stretch = data.qpos[at] - model.qpos_spring[at]
        first, second = laws.stiffness[jnp.asarray(simple)].T
        out = out.at[dof].add(-(first + second * jnp.abs(stretch)) * jnp.abs(stretch) * stretch)
    return out


def advanced(
    laws: Laws, model: Any, data: Any, ctrl: Array, substeps: int, other: Any = None
) -> Any:
    """`data` after `substeps` steps: what stands in the place of MJX's own.

    other: What steps instead of MJX, `(model, data, ctrl, substeps) -> data`; it has MuJoCo's
    polynomials by itself.
    """
    move = mjx_step
    if other is not None:
        laws = replace(laws, damping=None, stiffness=None)

        def move(model, data):
            return other(model, data.replace(userdata=data.userdata[:0]), data.ctrl, 1)

    def one(data, _):
        return stepped(laws, model, data, ctrl, move), None

    return jax.lax.scan(one, data, None, substeps)[0]


def read(laws: Laws, model: Any, data: Any) -> Any:
    """`data` with angles and speeds as the sensors say."""
    memory = _unravelled(laws)(data.userdata)
    at, dof = jnp.asarray(laws.qpos), jnp.asarray(laws.dof)
    q, v = data.qpos[at], data.qvel[dof]
    fresh = _began(laws, q, v, jnp.zeros_like(q))
    first, _ = _read(laws, fresh.reading, jnp.stack([q, v, 0.0 * q]), model.opt.timestep)
    q, v = jnp.where(memory.count > 0, jnp.stack([memory.q, memory.v]), first)
    return data.replace(qpos=data.qpos.at[at].set(q), qvel=data.qvel.at[dof].set(v))


def with_numbers(laws: Laws, numbers: dict[tuple[str, str, int], Any]) -> Laws:
    """The same with other numbers, by effect, parameter and joint."""
    effects = {name: dict(table) for name, table in laws.values.effects.items()}
    for (effect, parameter, joint), value in numbers.items():
        old = jnp.asarray(effects[effect][parameter], jnp.float32)
        effects[effect][parameter] = old.at[joint, 0].set(value)
    return replace(laws, values=laws.values._replace(effects=effects))
