"""What each parameter does to the measured outputs along a simulated path: one column a parameter,
in place at first order.

Forces enter through the response to a force held over a row, inertial parameters as the force that
they would take (the regressor of the equations of motion is linear in them), commands as the change
of the actuator's force, sensors directly.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.attribution.acting import (
    OF_CONTROLLERS,
    actuated,
    carried,
    compliant,
    drive_of,
    held_by,
)
from adaptsim_jax.attribution.criteria import FRICTION
from adaptsim_jax.attribution.drive import MIN_INERTIA, Local, logged_alone, sprung
from adaptsim_jax.attribution.parameters import BODY_NUMBERS, OF_BODIES, TILT, Entry, Vector
from adaptsim_jax.attribution.problem import Group, TreeProblem, group_inertia, off_value
from adaptsim_jax.attribution.simulate import Path, command_rows
from adaptsim_jax.effects.base import Drive, Dry, Effect, Motion
from adaptsim_jax.effects.joints.catalogue import TILTS
from adaptsim_jax.effects.joints.forces import ARMATURE
from adaptsim_jax.mechanisms import equations

SHIFT_STEP = 1e-3  # s, by which a delay or a lag is moved for its derivative
MAX_SHIFT_SHARE = 0.02  # of a value, by which it is moved at most for its derivative
RUNAWAY_DRIVE = 1e3  # rad (rad/s): drives that would run away so far do not enter columns

Shapes = Mapping[str, float]


def _middle(path: Path, dt):
    """Angles, speeds [n, L, W] in the middle of the rows, and mean accelerations."""
    n = path.x.shape[1] // 2
    x = jnp.moveaxis(path.x, 0, 1)
    mid = 0.5 * (x[:, 1:] + x[:, :-1])
    dt = dt[None]
    rise = (x[n:, 1:] - x[n:, :-1]) / jnp.where(dt > 0, dt, 1.0)
    return mid[:n], mid[n:], jnp.where(dt > 0, rise, 0.0)


def _mean_sign(x, n):
    """Mean sign of a speed that changes linearly over each row, [n, L, W]."""
    v = jnp.moveaxis(x, 0, 1)[n:]
    before, after = v[:, :-1], v[:, 1:]
    change = after - before
    even = jnp.abs(change) < 1e-9
    return jnp.where(
        even, jnp.sign(after), (jnp.abs(after) - jnp.abs(before)) / jnp.where(even, 1.0, change)
    )


def _bent(path: Path, yielding, rub, bristly, n: int):
    """What bristles of some compliance [n, L, W] change of dry friction `rub` (level, mean
    direction) along a path: as they bend by the angle and slide at the level. A joint that is held
    still says nothing of them, unless
    it has some already (bristly [n, L, W]).
    """
    level, turned = rub
    most = yielding * level
    q = jnp.moveaxis(path.x[:, :n], 0, 1)

    def row(bent, now):
        step, most = now
        new = jnp.clip(bent + step, -most, most)
        return new, 0.5 * (bent + new)

    start = jnp.clip(FRICTION.bent * path.x[0, n : 2 * n], -most[:, 0], most[:, 0])
    moved = (jnp.moveaxis(jnp.diff(q, axis=1), 1, 0), jnp.moveaxis(most, 1, 0))
    mean = jnp.moveaxis(jax.lax.scan(row, start, moved)[1], 0, 1)
    slides = (most > 0) & (bristly | (jnp.abs(turned) > FRICTION.sliding))
    return jnp.where(slides, level * turned - mean / jnp.where(yielding > 0, yielding, 1.0), 0.0)


class Way(NamedTuple):
    """Which number of which effect is changed."""

    effect: Effect
    parameter: str


class ChangePoint(NamedTuple):
    """Parameters {name: [n]} of an effect, and the size [n] of a change of one of them."""

    p: Any
    size: Any


@partial(jax.jit, static_argnames="way")
def _force(group_tree, values, path: Path, time, rub, point: ChangePoint, way: Way):
    """Change of the force [n, L, W] per unit of a parameter at every joint, or of a pair's [n, n,
    L, W], the parameter's joint first; the size is where a jump ends.
    """
    (p, direction), (effect, parameter) = point, way
    n = path.x.shape[1] // 2
    dt = jnp.diff(time, axis=0)
    q, v, a = _middle(path, dt)

    def wide(z):
        return z[:, None, :]

    ties = None if values.ties is None else values.ties[:, :, None]
    lanes = values._replace(actuator=values.actuator[:, :, None], gear=wide(values.gear), ties=ties)
    controllers = {
        k: jax.tree.map(wide, z) for k, z in values.effects.items() if k in OF_CONTROLLERS
    }
    lanes = lanes._replace(effects=controllers)
    u = jnp.moveaxis(path.u, 0, 1)
    tau, pull = actuated(lanes, q, v, u)

    def gravity(q):
        return equations.gravity_force(
            group_tree, values.inertial[:, :, None], q, values.gravity[:, None]
        )

    motion = Motion(q, v, tau, 0.5 * (time[1:] + time[:-1])[None], gravity, pull, u)
    turned = jnp.where(jnp.abs(rub[0]) > 0, rub[1], _mean_sign(path.x, n))

    def act(value):
        at = {k: z[:, None, None] for k, z in (p | {parameter: value}).items()}
        if effect.inertia:
            return -effect.apply(at) * a
        answer = effect.apply(at, motion)
        if not isinstance(answer, Dry):
            return answer + 0.0 * q
        bent = 0.0
        if not isinstance(answer.yielding, float):
            now = effect.apply({k: z[:, None, None] for k, z in p.items()}, motion).yielding
            bent = _bent(path, answer.yielding, rub, now > 0, n)
        return answer.force - answer.level * turned + bent

    if effect.jump:
        return (act(direction) - act(p[parameter])) / jnp.where(
            direction != p[parameter], direction - p[parameter], 1.0
        )[:, None, None]

    def along(ways):
        return jax.jvp(act, (p[parameter],), (ways,))[1]

    if effect.pair:
        return jax.vmap(along)(jnp.eye(n))
    return along(jnp.ones(n))


@partial(jax.jit, static_argnames=("effect", "parameter"))
def _spring(model, values, ahead, p, effect: str, parameter: str):
    """Change of the springs' torque on the links [n, L, W] per unit of a parameter of drives that
    give.
    """
    middle = jnp.moveaxis(0.5 * (ahead[1:] + ahead[:-1]), 0, 1)

    def torque(value):
        own = {k: z[:, None] for k, z in (p | {parameter: value}).items()}
        drive = drive_of(model, values._replace(effects=values.effects | {effect: own}))
        return sprung(Drive(*(z[:, None] for z in drive)), *jnp.split(middle, 2))

    return jax.jvp(torque, (p[parameter],), (jnp.ones_like(p[parameter]),))[1]


@jax.jit
def _regressor(tree, gravity, path: Path, time):
    q, v, a = _middle(path, jnp.diff(time, axis=0))
    return equations.regressor(tree, q, v, a, gravity[:, None] if gravity.ndim > 1 else gravity)


@jax.jit
def _gravity(tree, inertial, way, path: Path, time):
    q, _, _ = _middle(path, jnp.diff(time, axis=0))
    return equations.gravity_force(tree, inertial[:, :, None], q, way)


@partial(jax.jit, static_argnames=("past", "way"))
def _command(model, values, sent, path: Path, point: ChangePoint, past: int, way: Way):
    """Change of the force [n, L, W] per unit of a parameter of what acts on commands; sent: times
    and values of these.
    """
    (p, size), (effect, parameter), (stamp, command) = point, way, sent
    rows = path.u.shape[0]
    changed = dict(values.effects)
    changed[effect.name] = {k: z[:, None] for k, z in p.items()}
    moved = dict(changed)
    moved[effect.name] = changed[effect.name] | {parameter: (p[parameter] + size)[:, None]}

    def run(effects):
        return command_rows(model, values._replace(effects=effects), stamp, command, past, rows)

    by = (values.gear * values.actuator[0])[None]
    return jnp.moveaxis((run(moved) - run(changed)) * by / size[None, :, None], 0, 1)


_carried = jax.jit(carried)


@partial(jax.jit, static_argnames=("effect", "parameter"))
def _answered(values, x, u, p, effect: str, parameter: str):
    """Change of the actuators' forces in the middle of the rows [n, L, W] per unit of a parameter
    of an effect that they see.
    """
    n = x.shape[1] // 2
    between = 0.5 * (x[1:] + x[:-1])

    def force(value):
        lanes = values._replace(effects=values.effects | {effect: p | {parameter: value}})
        return jax.vmap(lambda x, u: actuated(lanes, x[:n], x[n:], u)[0], out_axes=1)(between, u)

    return jax.jvp(force, (p[parameter],), (jnp.ones_like(p[parameter]),))[1]


@partial(jax.jit, static_argnames="way")
def _sensed(time, x, read, torque, point: ChangePoint, way: Way):
    """Change of the outputs ([L+1, n, W] twice) per unit of a sensor's parameter at every joint;
    read [n, W]: what it gave first; torque [L+1, n, W] of the drives, for an effect that they
    matter to.
    """
    (p, size), (effect, parameter) = point, way
    n = x.shape[1] // 2
    also = (torque,) if effect.carried else ()

    def run(value):
        values = {k: z[None, :, None] for k, z in (p | {parameter: value}).items()}
        return effect.apply(values, time[:, None, :], x[:, :n], x[:, n:], read, *also)

    if effect.jump:
        on, off = run(p[parameter] + size), run(p[parameter])
        return tuple((a - b) / size[None, :, None] for a, b in zip(on, off, strict=True))
    return jax.jvp(run, (p[parameter],), (jnp.ones(n),))[1]


def _sides(model, values, path: Path) -> tuple[Path, Path]:
    """The path of the rotors and that of the links: the joints', where none of their drives
    gives.
    """
    if not path.ahead.shape[1]:
        return path, path
    link = np.tile(np.asarray(drive_of(model, values).link), (2, 1))
    return path._replace(x=path.x - link * path.ahead), path._replace(
        x=path.x + (1.0 - link) * path.ahead
    )


class GroupColumns:
    """Columns of a group at a point: force columns [W, L, n, K] or output columns [W, L+1, 2n, K]
    on demand, by entry.
    """

    def __init__(self, problem: TreeProblem, group: Group, vector: Vector, values, path: Path):
        self.problem, self.group, self.vector, self.values, self.path = (
            problem,
            group,
            vector,
            values,
            path,
        )
        s = group.stretches
        self.time, self.n = jnp.asarray(s.time), len(group.joints)
        self.known = vector.known()
        self._made: dict = {}
        self.rotor, self.link = _sides(group.model, values, path)
        self.gives = compliant(group.model, values)
        level = np.abs(np.asarray(path.rub)).max()
        moved = np.moveaxis(np.asarray(path.rub), 0, 1)
        if level > 0:
            self.rub = self._direction(moved)
        else:
            self.rub = (np.zeros_like(moved), np.zeros_like(moved))

    def _direction(self, rub: np.ndarray):
        """Dry friction as it acted, and the share of its level that it took, of the joints whose
        level is known to be there.
        """
        level = np.abs(rub).max((1, 2), keepdims=True)
        with_ = level > FRICTION.still * level.max()
        return np.where(with_, level, 0.0) + 0.0 * rub, np.where(
            with_, -rub / np.where(level > 0, level, 1.0), 0.0
        )

    def at(self, effect: Effect, shape: Shapes | None) -> dict[str, np.ndarray]:
        """Parameters [n] of an effect as they are, those of `shape` laid over them at joints where
        it is not in the vector.
        """
        out = {}
        for p in effect.parameters:
            row = []
            for j in self.group.joints:
                mine = next(
                    (
                        z
                        for k, z in self.known.items()
                        if k[0] == effect.name and k[1] == p.name and j in k[2]
                    ),
                    None,
                )
                base = off_value(self.problem, effect.name, p.name, j)
                given = (shape or {}).get(p.name) if p.shape else None
                row.append(mine if mine is not None else base if given is None else given)
            out[p.name] = np.array(row, float)
        return out

    def all_joints(self, effect: Effect, parameter: str, shape: Shapes | None):
        """('force', [n, L, W]) or ('output', [L+1, 2n, W]) with each joint's own column on its
        row.
        """
        key = (effect.name, parameter, tuple(sorted((shape or {}).items())))
        if key not in self._made:
            self._made[key] = self._make(effect, parameter, shape)
        return self._made[key]

    def _make(self, effect: Effect, parameter: str, shape: Shapes | None):
        p = self.at(effect, shape)
        g = self.group
        small = (effect.place == "force") & (p[parameter] > 0)
        size = p[parameter] + np.where(
            small, np.minimum(SHIFT_STEP, MAX_SHIFT_SHARE * p[parameter]), SHIFT_STEP
        )
        if shape and parameter in shape and effect.jump:
            size = np.full(self.n, float(shape[parameter]))
        way, step = Way(effect, parameter), size - p[parameter]
        with jax.enable_x64(True):
            if effect.place == "force":
                tree, point = g.model.tree, ChangePoint(p, size)
                made = _force(tree, self.values, self.rotor, self.time, self.rub, point, way)
                return "pair" if effect.pair else "force", np.asarray(made)
            if effect.place == "command":
                s = g.stretches
                sent, point = (s.stamp, s.command), ChangePoint(p, step)
                made = _command(g.model, self.values, sent, self.path, point, s.past, way)
                return "force", np.asarray(made)
            torque = self.torque() if effect.carried else None
            x, read = self.path.x, self.values.read
            dq, dv = _sensed(self.time, x, read, torque, ChangePoint(p, step), way)
            return "output", np.concatenate([np.asarray(dq), np.asarray(dv)], 1)

    def torque(self) -> np.ndarray:
        """Of the drives, [L+1, n, W] N m."""
        if "torque" not in self._made:
            with jax.enable_x64(True):
                self._made["torque"] = np.asarray(_carried(self.values, self.path.x, self.path.u))
        return self._made["torque"]

    def inertia(self, body: int, name: str) -> np.ndarray:
        """Force column [n, L, W] of an inertial entry of a body of the group."""
        if "inertia" not in self._made:
            y = self._regressed()
            numbers = self.vector.bodies(self.group.joints)
            self._made["inertia"] = (y, self.group.inertias.at(numbers)[1])
        y, slope = self._made["inertia"]
        part = y[:, 10 * body : 10 * body + 10]
        return -np.einsum("niLW,i->nLW", part, slope[body, :, BODY_NUMBERS.index(name)])

    def _regressed(self) -> np.ndarray:
        """Forces of the joints by inertial parameters [n, 10 n, L, W]."""
        if "regressor" not in self._made:
            with jax.enable_x64(True):
                gravity = jnp.asarray(np.asarray(self.values.gravity))
                self._made["regressor"] = np.asarray(
                    _regressor(self.group.model.tree, gravity, self.link, self.time)
                )
        return self._made["regressor"]

    def answered(self, effect: Effect, parameter: str, shape: Shapes | None) -> np.ndarray:
        """Change of the actuators' forces [n, L, W] per unit of a parameter of what their
        controllers' encoders see.
        """
        key = ("answered", effect.name, parameter, tuple(sorted((shape or {}).items())))
        if key not in self._made:
            with jax.enable_x64(True):
                p = {k: jnp.asarray(z)[:, None] for k, z in self.at(effect, shape).items()}
                self._made[key] = np.asarray(
                    _answered(self.values, self.path.x, self.path.u, p, effect.name, parameter)
                )
        return self._made[key]

    def tilt(self, name: str) -> np.ndarray:
        g = np.asarray(self.group.model.tree.gravity)
        way = np.cross(g, np.eye(3)[TILTS.index(name)])  # d(gravity)/d(angle) of a turned base
        with jax.enable_x64(True):
            force = _gravity(
                self.group.model.tree, self.values.inertial, jnp.asarray(way), self.link, self.time
            )
        return np.asarray(force)

    def spring(self, effect: Effect, parameter: str) -> np.ndarray:
        """Torque on the links [n, L, W] per unit of a parameter, of drives that give."""
        key = ("spring", effect.name, parameter)
        if key not in self._made:
            with jax.enable_x64(True):
                torque = _spring(
                    self.group.model,
                    self.values,
                    self.path.ahead,
                    self.at(effect, None),
                    effect.name,
                    parameter,
                )
            self._made[key] = np.where(self.gives[:, None, None], torque, 0.0)
        return self._made[key]

    def alone(self, effect: Effect, parameter: str, shape: Shapes) -> np.ndarray:
        """What the log would have [3, L+1, 2n, W] of drives that are rigid now, each joint by
        itself: per unit of a parameter at its size in `shape`, and swinging from two starts.
        """
        key = ("alone", effect.name, tuple(sorted(shape.items())))
        if key not in self._made:
            p = self.at(effect, shape) | {parameter: np.full(self.n, shape[parameter])}
            local, carries = self._carries()
            with jax.enable_x64(True):
                observed = np.array(
                    logged_alone(local, p, carries, jnp.diff(self.time, axis=0), effect)
                )
            there = ~np.tile(self.gives, 2)[:, None] & (np.abs(observed) < RUNAWAY_DRIVE)
            observed = np.where(there, observed, 0.0)
            observed[0] /= shape[parameter]
            self._made[key] = observed
        return self._made[key]

    def _carries(self):
        """Each joint by itself, and the torque [n, L, W] that its link takes of its drive."""
        if "carries" not in self._made:
            plain = jax.tree.map(np.asarray, self.values)
            rotor = plain.effects[ARMATURE.name]["inertia"][:, 0]
            link = np.maximum(group_inertia(plain, self.group)[0] - rotor, MIN_INERTIA)
            held = (np.asarray(z)[:, 0] + np.zeros(self.n) for z in held_by(plain))
            local = Local(
                *(z[:, None, None] for z in (np.maximum(rotor, MIN_INERTIA), link, *held))
            )
            y = self._regressed()
            self._made["carries"] = (
                local,
                np.einsum("niLW,i->nLW", y, plain.inertial[..., 0].reshape(-1)),
            )
        return self._made["carries"]

    def _acts(self, force, e: Entry, shape: Shapes | None, at: int, on_links: np.ndarray):
        """Add to `force` [W, L, F] what an entry of an effect does at the joint `at`.

        Returns:
            What it does to the output, [L+1, 2n, W] or None.
        """
        effect = self.problem.effect(e.owner)
        if effect.place == "drive":
            if self.gives[at]:
                torque = self.spring(effect, e.name)[at].T
                force[:, :, at] -= torque
                force[:, :, on_links[at]] += torque
            if shape is None or e.name not in shape:
                return None
            return self.alone(effect, e.name, shape)[0]
        place, z = self.all_joints(effect, e.name, shape)
        if place == "output":
            return z
        where = slice(None, self.n) if place == "pair" else at
        force[:, :, where] += np.moveaxis(z[at], -1, 0).swapaxes(1, -1)
        return None

    def stack(self, entries: Sequence[tuple[Entry, Shapes | None]]):
        """(force [W, L, F, K], output [W, L+1, 2n, K] or None) of some entries; zero where an entry
        is of another group. The F forces are on the n joints, and on the links of those whose
        drives give.
        """
        width, rows = self.path.x.shape[2], self.path.u.shape[0]
        giving = np.flatnonzero(self.gives)
        force = np.zeros((width, rows, self.n + len(giving), len(entries)))
        on_links = np.arange(self.n)
        on_links[giving] = self.n + np.arange(len(giving))
        output = None
        for k, (e, shape) in enumerate(entries):
            if e.owner == TILT:
                force[:, :, on_links, k] = self.tilt(e.name).transpose(2, 1, 0)
                continue
            for j in (j for j in e.joints if j in self.group.joints):
                at = self.group.joints.index(j)
                if e.owner in OF_BODIES:
                    force[:, :, on_links, k] += self.inertia(at, e.name).transpose(2, 1, 0)
                    continue
                z = self._acts(force[..., k], e, shape, at, on_links)
                if z is None:
                    continue
                if output is None:
                    output = np.zeros((width, rows + 1, 2 * self.n, len(entries)))
                for c in (at, self.n + at):
                    output[:, :, c, k] += z[:, c].T
                if e.owner in OF_CONTROLLERS and np.any(self.values.actuator[2, at]):
                    force[:, :, at, k] += self.answered(
                        self.problem.effect(e.owner), e.name, shape
                    )[at].T
        return force, output
