"""What a search along the measured motion knows of a group: its columns, the entries that are
always fitted, rows and weights; and by what a candidate is ranked.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from adaptsim_jax.attribution.candidates import JointCandidate, shape_entries
from adaptsim_jax.attribution.criteria import BALANCE
from adaptsim_jax.attribution.equation.balance import (
    GAIN,
    Balance,
    acting,
    actuator_force,
    effect_force,
    force_of,
    in_proportion,
    read_more,
    read_wrong,
    residual,
    rms,
    tilting,
)
from adaptsim_jax.attribution.equation.solve import ForceRows, Solved, Sums, rows_of, solved
from adaptsim_jax.attribution.parameters import (
    BODY_MASS,
    BODY_NUMBERS,
    OF_BODIES,
    TILT,
    Entry,
    Vector,
)
from adaptsim_jax.attribution.problem import TreeProblem, values_of
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.steps import Point, bounded_step, fit_values
from adaptsim_jax.diagnosis.testing import deviates
from adaptsim_jax.effects.base import Effect, Reach
from adaptsim_jax.effects.joints.catalogue import TILTS
from adaptsim_jax.mechanisms.tree import ancestors

VALUE_STEP = 0.02  # share of a value, by which it is moved for a difference
MIN_VALUE_STEP = 1e-4  # SI unit of the value: by which it is moved at least for a difference


class EffectTable:
    """Columns [K, n] of entries of a vector and of candidates, made when asked for. About the
    values of `vector`.
    """

    def __init__(self, problem: TreeProblem, balance: Balance, vector: Vector):
        self.problem, self.balance, self.vector = problem, balance, vector
        self.values = values_of(problem, balance.group, vector)
        self.place = {j: k for k, j in enumerate(balance.group.joints)}
        self.explained: Any = (
            0.0  # of what is missing [K, n], by a set of columns that is fitted already
        )
        if GAIN in self.values.effects:
            own = self.values.effects[GAIN]["gain"][:, 0]
        else:
            own = np.zeros(balance.joints)
        self.scale = np.maximum(1.0 + own, BALANCE.min_scale)
        self._made: dict = {}

    def missing(self) -> np.ndarray:
        """Force that is missing [K, n]."""
        return self._cached(
            "missing", lambda: residual(self.problem, self.balance, self.vector, self._acting())
        )

    def driven(self) -> tuple[np.ndarray, np.ndarray]:
        """`actuator_force`."""
        return self._cached("driven", lambda: actuator_force(self.balance, self.values))

    def of(self, entry: Entry, shape: Mapping[str, float] | None = None) -> np.ndarray:
        """Column [K, n] of an entry, at the shapes of a candidate where it is one's."""
        if entry.owner == GAIN:
            return self._gain(entry)
        return self._of(entry, shape) / self.scale

    def _gain(self, entry: Entry) -> np.ndarray:
        """What the motion takes of an actuator, by the model: of what was told the noise would be
        read as a gain.
        """
        averaged = self._cached("told", lambda: self.balance.averaged(self.driven()[0]))
        needed = averaged + self.missing() - self.explained
        return needed / self.scale * np.isin(self.balance.group.joints, entry.joints)

    def _of(self, entry: Entry, shape: Mapping[str, float] | None) -> np.ndarray:
        if entry.owner in OF_BODIES:
            return self._inertia(self.place[entry.joints[0]], entry.name, shape or {})
        if entry.owner == TILT:
            way = np.cross(
                np.asarray(self.balance.group.model.tree.gravity),
                np.eye(3)[TILTS.index(entry.name)],
            )
            return tilting(self.balance, self.values.inertial[..., 0], way)
        effect = self.problem.effect(entry.owner)
        if effect.place == "measurement":
            return self._read(effect, entry)
        known = next((p for p in effect.parameters if p.name == entry.name), None)
        curved = known is None or known.shape or effect.jump or effect.place == "command"
        if curved and shape is None:
            return self._difference(entry) * self.scale
        column = self._everywhere(effect, entry.name, tuple(sorted((shape or {}).items())))
        if effect.pair:
            return self._paired(effect, entry, shape)
        own = np.zeros(column.shape[1])
        own[[self.place[j] for j in entry.joints if j in self.place]] = 1.0
        return column * own

    def stack(
        self, entries: Sequence[Entry], shape: Mapping[str, float] | None = None
    ) -> np.ndarray:
        """[K, n, E]."""
        if not entries:
            return np.zeros((*self.missing().shape, 0))
        return np.stack([self.of(e, shape) for e in entries], -1)

    def _inertia(self, body: int, name: str, to: Mapping[str, float]) -> np.ndarray:
        """Of a body's number; half way to the numbers `to` which it changes to."""
        group = self.balance.group

        def slope():
            numbers = self.vector.bodies(group.joints)
            for key, value in to.items():
                numbers[body, BODY_NUMBERS.index(key)] = 0.5 * value
            return group.inertias.at(numbers)[1][body]

        key = ("slope", body, tuple(sorted(to.items())))
        part = self.balance.regressor[:, :, 10 * body : 10 * body + 10]
        return -part @ self._cached(key, slope)[:, BODY_NUMBERS.index(name)]

    def _read(self, effect: Effect, entry: Entry) -> np.ndarray:
        way = 1.0 * np.isin(self.balance.group.joints, entry.joints)
        of = [share * way for share in read_more(effect, entry.name)]

        def slope():
            return -read_wrong(self.balance, self.values.inertial[..., 0], *of, slope=True)

        return self._cached((effect.name, entry.joints), slope)

    def _at(self, effect: Effect, shape: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Parameters [n] of an effect as they are, those of `shape` laid over its shapes."""
        now = self.values.effects[effect.name]
        out = {k: np.array(z[:, 0], float) for k, z in now.items()}
        for p in effect.shapes:
            if p.name in shape and not self._acts(effect):
                out[p.name][:] = shape[p.name]
        return out

    def _acts(self, effect: Effect) -> bool:
        return any(
            e.owner == effect.name and e.joints[0] in self.place for e in self.vector.entries
        )

    def _everywhere(self, effect: Effect, name: str, shape: tuple) -> np.ndarray:
        """Change of the mean force [K, n] per unit of a parameter at every joint."""
        key = (effect.name, name, shape)
        if key not in self._made:
            given = dict(shape)
            here = self._at(effect, given)
            size = self._size(effect, name, here, given)
            away = here | {name: here[name] + size}

            def act(p):
                return force_of(self.balance, self.values, effect, p, self.driven())

            self._made[key] = (act(away) - act(here)) / size
        return self._made[key]

    def _size(
        self, effect: Effect, name: str, here: Mapping[str, np.ndarray], given: Mapping[str, float]
    ) -> Any:
        """By which a parameter is moved for a column; of friction that gives over a band, as far as
        it may be off.
        """
        if effect.jump or effect.place == "command":
            return given.get(name, 0.01)
        if not np.any(self.balance.group.model.tree.friction_softness):
            return 1.0
        torque = self.problem.reach.torque[list(self.balance.group.joints)]
        own = self.balance.inertia * np.sqrt(
            np.mean(np.square(self.balance.acceleration), 0)
        )  # of a joint that nothing drives
        return np.maximum(
            0.5 * np.abs(here[name]),
            BALANCE.friction_off * np.where(torque > 0.0, torque, own + MIN_VALUE_STEP),
        )

    def _paired(self, effect: Effect, entry: Entry, shape) -> np.ndarray:
        here = self._at(effect, shape or {})
        own = np.zeros(self.balance.joints)
        own[[self.place[j] for j in entry.joints]] = 1.0

        def act(p):
            return effect_force(self.balance, self.values, effect, p, self.driven())

        def change():
            return act(here | {entry.name: here[entry.name] + own}) - act(here)

        key = (effect.name, entry.name, entry.joints, tuple(sorted((shape or {}).items())))
        return self._cached(key, change)

    def _difference(self, entry: Entry) -> np.ndarray:
        """Of an entry of the vector that does not act linearly."""
        at = self.vector.index()[entry.key]
        value = self.vector.values[at]
        size = max(VALUE_STEP * abs(value), MIN_VALUE_STEP)
        size = -size if value + size > entry.high else size
        effect = self.problem.effect(entry.owner)
        if effect.scales_torque or effect.place == "measurement":
            moved = self.vector.values.copy()
            moved[at] += size
            there = residual(self.problem, self.balance, self.vector.at(moved))
            return (self.missing() - there) / size
        here = {k: z[:, 0] for k, z in self.values.effects[effect.name].items()}
        own = np.isin(self.balance.group.joints, entry.joints)

        def act(p):
            return force_of(self.balance, self.values, effect, p, self.driven())

        now, share = self._cached((effect.name, "now"), lambda: act(here)), self._acting()[1]
        return (act(here | {entry.name: here[entry.name] + size * own}) - now) / size / share

    def _acting(self) -> tuple[np.ndarray, np.ndarray]:
        return self._cached("acting", lambda: acting(self.balance, self.values))

    def _cached(self, key: Hashable, make: Callable[[], Any]) -> Any:
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]


MIN_SHIFT = 1e-4  # s: smaller shifts in time make no column


class Searched:
    """The search of one group: its table of columns, the entries that are always fitted, the
    effects so far.
    """

    def __init__(
        self,
        problem: TreeProblem,
        balance: Balance,
        null: Vector,
        reach: Reach,
        criteria: Criteria,
        commanded: bool,
    ):
        self.problem, self.balance, self.reach, self.criteria = problem, balance, reach, criteria
        self.commanded, self.limits = commanded, criteria.torque
        self.table = EffectTable(problem, balance, null)
        self.null = null
        self.bends = {e.name for e in problem.effects if e.scales_torque} - {GAIN}
        self.base = self.table.stack(null.entries)
        missing = self.table.missing()
        self.averaged = balance.averaged(self.table.driven()[0])
        torque = rms(self.averaged)
        taken = self.averaged + missing  # by the motion, where nothing is told of what acts
        self.torque = np.where(torque > 0, torque, rms(taken))
        self.minimum = np.maximum(
            BALANCE.min_of_torque * torque, BALANCE.min_of_missing * rms(missing)
        )
        self._weighed(missing, missing)
        self.weigh(self.set_of(()))
        self.local = {j: k for k, j in enumerate(balance.group.joints)}

    def weigh(self, fitted: Solved) -> None:
        """Weights from what a set leaves."""
        self.table.explained = fitted.columns @ fitted.step
        self._weighed(self.rows.missing, self.rows.missing - self.table.explained)

    def without(self, part: int) -> "Searched":
        """Without a part of the log, whose rows have no weight."""
        less = copy(self)
        less.rows = replace(self.rows, weight=self.rows.weight * (self.rows.part != part)[:, None])
        less._summed()
        return less

    def _weighed(self, missing: np.ndarray, left: np.ndarray) -> None:
        """Rows and their sums, by what is left."""
        b = self.balance
        self.rows = rows_of(missing, left, b.trial, b.time, self.minimum, b.clear)
        self._summed()

    def _summed(self) -> None:
        self.sums = Sums(self.rows)
        self.sums.add("", self.base)

    def began(self, entries: Sequence[Entry]) -> np.ndarray:
        """Values [P] of entries, those of `null` first, at which their columns were made."""
        return np.array([*self.null.values, *(e.start for e in entries[len(self.null) :])])

    def set_of(self, added: Sequence[JointCandidate]) -> Solved:
        names: list[Any] = [""]
        entries = list(self.null.entries)
        for c in added:
            entries += c.entries
            names.append((c.key, c.shape))
            self.sums.add(names[-1], self.table.stack(c.entries, c.shaped()))
        found = solved(self.sums, names, entries, self.began(entries))
        changed = [i for i, e in enumerate(entries) if e.owner in self.bends]
        if not changed:
            return found
        driven = self.averaged + found.columns[..., changed] @ found.step[changed]
        return replace(found, loss=found.loss / np.square(in_proportion(self.averaged, driven)))

    def settled(self, added: Sequence[JointCandidate], c: JointCandidate) -> JointCandidate:
        """A shift with its column made at the value that it comes to: a lag of 60 ms scaled to one
        of 3 ms is none of 3 ms. Likewise another mass of a body.
        """
        if c.effect == BODY_MASS:
            for _ in range(2):
                numbers = self.set_of([*added, c]).step[-len(c.entries) :]
                to = zip((e.name for e in c.entries), numbers.tolist(), strict=True)
                c = replace(c, shape=tuple(to))
            return c
        if not c.shape or not self.problem.effect(c.effect).shifts_commands:
            return c
        for _ in range(2):
            value = float(self.set_of([*added, c]).step[-1]) + c.entries[0].start
            if abs(value) >= MIN_SHIFT:
                c = replace(c, shape=((c.shape[0][0], value),))
        return c

    def likely(self, c: JointCandidate) -> bool:
        """Whether like drives have it, so that it was put in at all joints: real joints rub."""
        traits = self.problem.effect(c.effect).traits
        return traits.family and traits.tried_first > 0

    def own(self, *some: JointCandidate) -> list[int]:
        """Local numbers of the joints at which effects show: a body, and where it is, at all that
        carry it.
        """
        tree = self.balance.group.model.tree

        def at_parents(c):
            return self.problem.effect(c.effect).traits.at_parents

        shows = set()
        for c in some:
            for k in (self.local[j] for j in c.joints if j in self.local):
                shows |= {k, *(ancestors(tree, k) if at_parents(c) else ())}
        return sorted(shows)

    def carry(self, c: JointCandidate) -> float:
        """How many joints tell of one at which an effect is: of a body all that carry it."""
        return len(self.own(c)) / len(c.joints)


def ranked(state: Searched, now: Solved, some: Sequence[JointCandidate]) -> list[JointCandidate]:
    """Candidates that are worth their numbers apart, by what they gain, the best shape of each."""
    return [c for worth, c in worth_apart(state, now, some) if worth > 0.0]


def worth_apart(
    state: Searched, now: Solved, some: Sequence[JointCandidate]
) -> list[tuple[float, JointCandidate]]:
    """What candidates take off parts of the log (trials, or thirds of one) that were left out, at
    first order, less the price of their numbers; the best shape of each, the most first.

    The shape by which a part is predicted is chosen without it, too.
    """
    if not some:
        return []
    rows = state.rows
    left = (rows.missing - now.columns @ now.step) * rows.weight
    total = np.maximum(np.square(left).sum(0), 1e-300)
    even = np.sqrt(total.mean() / total)  # joints count alike, whatever they leave

    def weigh(z):
        return (z * (rows.weight * even)[..., None]).reshape(left.size, z.shape[2])

    values = state.began(now.entries) + now.step
    free = [
        i for i, (e, z) in enumerate(zip(now.entries, values, strict=True)) if e.low < z < e.high
    ]
    a, y = weigh(now.columns[..., free]), left * even
    prior = np.diag([now.entries[i].prior ** -2.0 for i in free])
    inverse = np.linalg.pinv(a.T @ a + prior, rcond=1e-12, hermitian=True)
    part = np.repeat(rows.part, y.shape[1])
    order = np.argsort(part, kind="stable")
    begin, flat = np.unique(part[order], return_index=True)[1], y.ravel()[order]
    blocks = [state.table.stack(c.entries, c.shaped()) for c in some]
    wide = weigh(np.concatenate(blocks, 2))
    # each column by itself is read next
    freed = np.asfortranarray((wide - a @ (inverse @ (a.T @ wide)))[order])
    shapes: dict[tuple, list[tuple[JointCandidate, np.ndarray, np.ndarray]]] = {}
    at = 0
    for c, block in zip(some, blocks, strict=True):
        own = freed[:, at : at + block.shape[2]]
        at += block.shape[2]
        shapes.setdefault(c.key, []).append((c, *_gains(own, flat, begin, c)))
    out = []
    for one in shapes.values():
        inside, outside = (np.array([z[k] for z in one]) for k in (1, 2))  # [shapes, parts]
        c = one[int(outside.sum(1).argmax())][0]
        gain = outside[inside.argmax(0), range(len(begin))].sum()
        share = gain / (0.5 * total.mean() * len(state.own(c)))
        out.append((share * state.carry(c) - state.limits.gain * len(c.entries), c))
    return sorted(out, key=lambda z: -z[0])


def _gains(
    columns: np.ndarray, y: np.ndarray, begin: np.ndarray, c: JointCandidate
) -> tuple[np.ndarray, np.ndarray]:
    """Half the squares that amplitudes without each part take off the others [U], and off it [U].
    columns: [N, E], rows in the order of their parts; y: [N]; begin: the first row of each part.
    """
    hess = np.add.reduceat(columns[:, :, None] * columns[:, None], begin)
    slope = np.add.reduceat(columns * y[:, None], begin)
    low = np.array([e.low - e.start for e in c.entries])
    high = np.array([e.high - e.start for e in c.entries])
    prior = np.diag([e.prior**-2.0 for e in c.entries])
    rest, pull = hess.sum(0) - hess, slope.sum(0) - slope
    others = rest + prior
    others += 1e-9 * others * np.eye(len(prior))
    inverse = np.linalg.pinv(others, rcond=1e-10, hermitian=True)
    step = np.clip((pull[:, None] @ inverse)[:, 0], low, high)

    def taken(slope, hess):
        return np.sum(step * slope, 1) - 0.5 * np.einsum("fi,fij,fj->f", step, hess, step)

    return taken(pull, rest), taken(slope, hess)


SHAPE_ROUNDS = 8  # rounds of steps of shapes, at most


def exact(
    state: Searched, added: Sequence[JointCandidate], whole: Solved, near: Vector | None = None
) -> tuple[Vector, np.ndarray]:
    """The vector of null and effects, shapes too, by Gauss and Newton's steps from the linear one,
    or from the values of a fit that is `near`, where that is better; standard errors [P].
    """
    vector = Vector(whole.entries, state.began(whole.entries) + whole.step)
    vector = vector.at(np.clip(vector.values, vector.low, vector.high))
    for c in added:
        vector = vector.with_entries(shape_entries(state.problem, state.reach, c))

    point = _at(state, vector)
    if near is not None:
        known = near.known()
        values = [known.get(e.key, z) for e, z in vector.pairs()]
        close = _at(state, vector.at(np.array(values)))
        point = min(point, close, key=lambda p: p.loss)
    fitted: list[Solved] = []

    def around(point: Point) -> Callable[[float], Point]:
        here = point.state
        fitted[:] = [_linearised(state, here)]
        hess, slope = fitted[0].hess, fitted[0].slope
        ends = here.low - here.values, here.high - here.values
        return lambda damping: _at(
            state, here.at(here.values + bounded_step(hess, slope, *ends, damping))
        )

    found = fit_values(point, around, SHAPE_ROUNDS, damping=0.0)
    return found.point.state, fitted[0].error


def _at(state: Searched, vector: Vector) -> Point:
    """A vector with its loss."""
    missing = residual(state.problem, state.balance, vector)
    return Point(_cost(state.rows, missing, vector), vector)


def _linearised(state: Searched, vector: Vector) -> Solved:
    """The columns of a vector at its values, fitted."""
    table = EffectTable(state.problem, state.balance, vector)
    free = [i for i, e in enumerate(vector.entries) if e.low < e.high]
    missing = table.missing()
    columns = np.zeros((*missing.shape, len(vector)))
    columns[..., free] = table.stack([vector.entries[i] for i in free])
    sums = Sums(replace(state.rows, missing=missing))
    sums.add("", columns)
    return solved(sums, [""], vector.entries, vector.values)


def needed(
    state: Searched, added: Sequence[JointCandidate], asked: Sequence[JointCandidate]
) -> tuple[list[JointCandidate], Vector, np.ndarray]:
    """Effects without those of `asked` that only made up for a shape on a grid: with all shapes
    fitted their interval includes none of them, and the rest leaves as little. With the vector of
    these and its errors, as of `exact`.
    """
    added = list(added)
    whole = exact(state, added, state.set_of(added))
    final, errors = whole
    surely = deviates(len(np.unique(state.rows.fold)))
    for c in sorted(asked, key=lambda c: _sure(*whole, c)):
        if _sure(final, errors, c) > surely:
            break
        rest = [k for k in added if k is not c]
        less = exact(state, rest, state.set_of(rest), final)
        left = [_left(state, v)[state.own(c)].sum() for v in (less[0], final)]
        if left[0] - left[1] < state.limits.gain * len(c.entries) * left[0]:
            added, (final, errors) = rest, less
    return added, final, errors


def _sure(final: Vector, errors: np.ndarray, c: JointCandidate) -> float:
    """Of its amplitudes the farthest from none, in standard errors."""
    keys = {e.key for e in c.entries}
    rows = zip(final.entries, final.values, errors, strict=True)
    return max(abs(value - e.off) / max(error, 1e-300) for e, value, error in rows if e.key in keys)


def _left(state: Searched, vector: Vector) -> np.ndarray:
    """Weighted squares of what is missing [n]."""
    return np.square(residual(state.problem, state.balance, vector) * state.rows.weight).sum(0)


def _cost(rows: ForceRows, missing: np.ndarray, vector: Vector) -> float:
    off = vector.values - vector.start
    finite = np.isfinite(vector.precision)
    prior = float(np.sum((vector.precision * off * off)[finite]))
    return 0.5 * (float(np.square(missing * rows.weight).sum()) + prior)
