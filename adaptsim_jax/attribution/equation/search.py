"""Which effects the torque along the measured motion asks for: friction first, forward by left-out blocks, then each beside the
others.

Everything is linear but for a few shapes, which lie on grids, so that no set of effects is a minimum to be stuck in, and thousands
of sets are judged in seconds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from adaptsim_jax.attribution.equation.balance import ON_TORQUE, Balance, actuator_force, in_proportion, residual
from adaptsim_jax.attribution.equation.columns import Table, balanced
from adaptsim_jax.attribution.equation.solve import Compared, Rows, Solved, Sums, compared, rows_of, solved
from adaptsim_jax.attribution.parameters import INERTIA, Vector
from adaptsim_jax.attribution.problem import Problem
from adaptsim_jax.attribution.score import Candidate, candidates, shape_entries
from adaptsim_jax.diagnosis.criteria import Criteria, TorqueCriteria
from adaptsim_jax.effects.base import Reach

FIRST = ("coulomb", "armature")
"""Effects that are tried at all joints at once before any other: real joints rub."""
FACTOR = 3.0  # within which a body's mass and moments are taken to be those of the file
TRUSTED = {"torque_gain": 0.3, "encoder_scale": 0.3, "encoder_offset": 0.03, "tilt": 0.03}
"""Standard deviations beforehand: of a gain of torques that are told in N m, of an encoder's zero and of a base's tilt [rad]."""
ROUNDS = 8
LEAST_OF_TORQUE, LEAST_OF_MISSING = 0.03, 0.15
"""Of the torque, and of what the file misses of it: a joint that is missed by less does not outweigh the others for that."""


@dataclass(frozen=True)
class Step:
    """What the search did: action (added, refused, dropped, replaced), candidate, its test, why."""

    action: str
    candidate: Candidate
    test: Compared | None
    why: str


@dataclass(frozen=True)
class Kept:
    """An effect that stays: test beside all others; alternatives that do as well in its place; amplitudes over their errors."""

    candidate: Candidate
    test: Compared
    alternatives: tuple[Candidate, ...]
    steady: float


@dataclass(frozen=True)
class Witness:
    """What the balance of a group of joints says. null, final: vectors of its entries; added: effects in it; kept: those that
    hold out by themselves; steps; rows, base and whole: the sums."""

    balance: Balance
    null: Vector
    final: Vector
    errors: np.ndarray
    added: tuple[Candidate, ...]
    kept: tuple[Kept, ...]
    steps: tuple[Step, ...]
    rows: Rows
    base: Solved = field(repr=False)
    whole: Solved = field(repr=False)
    state: "_State" = field(repr=False)


class _State:
    """The search of one group: its table of columns, the entries that are always fitted, the effects so far."""

    def __init__(
        self, problem: Problem, balance: Balance, null: Vector, reach: Reach, criteria: Criteria, commanded: bool
    ):
        self.problem, self.balance, self.reach, self.criteria = problem, balance, reach, criteria
        self.commanded, self.limits = commanded, criteria.torque
        self.table = Table(problem, balance, null)
        self.null = null
        self.base = self.table.stack(null.entries)
        missing = self.table.missing()
        self.told = balance.averaged(actuator_force(balance, self.table.values)[0])
        torque = np.sqrt(np.mean(np.square(self.told), 0))
        size = np.sqrt(np.mean(np.square(missing), 0))
        taken = self.told + missing  # by the motion, where nothing is told of what acts
        self.torque = np.where(torque > 0, torque, np.sqrt(np.mean(np.square(taken), 0)))
        self.least = np.maximum(LEAST_OF_TORQUE * torque, LEAST_OF_MISSING * size)
        self.rows = rows_of(missing, missing, balance.trial, balance.time, self.least, balance.clear)
        self._summed()
        self.weigh(self.set_of(()))
        self.local = {j: k for k, j in enumerate(balance.group.joints)}

    def weigh(self, fitted: Solved) -> None:
        """Weights from what a set leaves."""
        self.table.explained = fitted.columns @ fitted.step
        left = self.rows.missing - self.table.explained
        self.rows = rows_of(
            self.rows.missing, left, self.balance.trial, self.balance.time, self.least, self.balance.clear
        )
        self._summed()

    def _summed(self) -> None:
        self.sums = Sums(self.rows)
        self.sums.add("", self.base)

    def set_of(self, added: Sequence[Candidate]) -> Solved:
        entries, names, now = list(self.null.entries), [""], list(self.null.values)
        for c in added:
            entries += c.entries
            now += [e.start for e in c.entries]
            names.append((c.key, c.shape))
            self.sums.add(names[-1], self.table.stack(c.entries, c.shaped()))
        found = solved(self.sums, names, entries, np.array(now))
        changed = [i for i, e in enumerate(entries) if e.owner in ON_TORQUE[1:]]
        if not changed:
            return found
        driven = self.told + found.columns[..., changed] @ found.step[changed]
        return replace(found, loss=found.loss / np.square(in_proportion(self.told, driven)))

    def own(self, c: Candidate) -> list[int]:
        return [self.local[j] for j in c.joints]


def witness(
    problem: Problem, balance: Balance, null: Vector, reach: Reach, criteria: Criteria, commanded: bool = False
) -> Witness:
    """Search the balance of a group. null: entries of the group that are fitted whatever is named; commanded: the input is a command,
    which may be late at each joint, and no measured torque."""
    state = _State(problem, balance, null, reach, criteria, commanded)
    joints = set(balance.group.joints)
    every = [
        _trusted(c) for c in candidates(problem, null, reach)
        if set(c.joints) <= joints and balanced(problem.effect(c.effect))
        and c.shaped().get("speed", np.inf) > criteria.torque.slowest * max(reach.speed[j] for j in c.joints)
        and (commanded or not (c.sharing == "joint" and problem.effect(c.effect).place == "command"))
    ]  # fmt: skip
    steps: list[Step] = []
    added: list[Candidate] = []
    added += _friction_first(state, every, steps)
    while len(added) < 3 * balance.joints + criteria.most_effects:
        best = _forward(state, added, every, steps)
        if best is None:
            break
        added = [*added, best]
    added, quiet = _backward(state, added, steps)
    kept = []
    whole = state.set_of(added)
    for c in (c for c in added if c not in quiet and not _only_read(state, whole, c)):
        less = state.set_of([k for k in added if k is not c])
        test = compared(state.rows, less, whole, state.own(c))
        kept.append(Kept(c, test, _alike(state, added, c, less, whole, every), _steady(whole, c)))
    final, errors = _exact(state, added, whole)
    base = state.set_of(())
    first = _exact(state, (), base)[0]
    return Witness(
        balance, first, final, errors, tuple(added), tuple(kept), tuple(steps), state.rows, base, whole, state
    )


def refitted(problem: Problem, found: Witness, added: Sequence[Candidate]) -> Witness:
    """With other effects, fitted as the search fits them; nothing is judged."""
    whole = found.state.set_of(added)
    final, errors = _exact(found.state, added, whole)
    return replace(found, final=final, errors=errors, added=tuple(added), whole=whole)


def _trusted(c: Candidate) -> Candidate:
    """With what is known beforehand of how far such a thing is off."""
    wide = TRUSTED.get(c.effect, np.inf)
    return replace(c, entries=tuple(replace(e, prior=min(e.prior, wide)) for e in c.entries))


def _split(c: Candidate) -> list[Candidate]:
    """A candidate at several joints with own values, as one a joint."""
    if c.sharing != "all":
        return [c]
    return [
        Candidate(c.effect, (j,), "joint", tuple(e for e in c.entries if e.joints == (j,)), c.shape) for j in c.joints
    ]


def _friction_first(state: _State, every: Sequence[Candidate], steps: list[Step]) -> list[Candidate]:
    """What all joints are likely to have, each kind at all of them as one candidate; joint by joint it is judged in the end, since one
    hides another (a file's damping and rotors that are not there: dry friction that is)."""
    added: list[Candidate] = []
    for name in FIRST:
        some = [c for c in every if c.effect == name and c.sharing == "joint"]
        if not some:
            continue
        less, more = state.set_of(added), state.set_of([*added, *some])
        joints = sorted({k for c in some for k in state.own(c)})
        test = compared(state.rows, less, more, joints)
        if test.gain > state.limits.gain and test.p <= state.limits.level:
            added = [*added, *some]
            state.weigh(state.set_of(added))
            steps += [Step("added", c, test, "at all joints") for c in some]
    return added


def _taken(added: Sequence[Candidate]) -> set[tuple[str, int]]:
    return {(c.effect, j) for c in added for j in c.joints}


def _open(state: _State, added: Sequence[Candidate], every: Sequence[Candidate]) -> list[Candidate]:
    taken = _taken(added)
    return [c for c in every if not any((c.effect, j) in taken for j in c.joints)]


def _forward(state: _State, added: list[Candidate], every, steps: list[Step]) -> Candidate | None:
    """The candidate that takes most off where it was left out, for the numbers that it has."""
    now = state.set_of(added)
    for laws in (True, False):
        some = [c for c in _open(state, added, every) if state.problem.effect(c.effect).describes is not laws]
        ranked = _ranked(state, now, some)[: state.limits.tried]
        best = None
        for c in ranked:
            more = state.set_of([*added, c])
            test = compared(state.rows, now, more, state.own(c))
            least = state.criteria.described if not laws else state.limits.gain * len(c.entries)
            why = _why_not(state, more, c, test, least, state.limits.level)
            steps.append(Step("refused" if why else "tried", c, test, why))
            value = test.gain - state.limits.gain * len(c.entries)
            if not why and (best is None or value > best[0]):
                best = value, c, test
        if best is not None:
            steps.append(Step("added", best[1], best[2], ""))
            return best[1]
    return None


def _level(p: Sequence[float], own: TorqueCriteria) -> float:
    """Up to which p an effect that like drives have is taken at each of them, by how many joints show it."""
    ranked = np.sort(p)
    good = ranked <= own.discovery * np.arange(1, len(p) + 1) / len(p)
    return max(own.level, float(ranked[good].max()) if good.any() else 0.0)


def _why_not(state: _State, whole: Solved, c: Candidate, test: Compared, least: float, level: float) -> str:
    """Why a candidate is not taken beside the others of a set; empty if it is."""
    if test.p > level:
        return "left-out blocks do not confirm it"
    if test.gain < least:
        return f"takes less than {100 * least:.0f} % off the squared missing torque"
    if test.overall < 0.0:
        return "the torques of all joints together are missed by more"
    if _steady(whole, c) < state.limits.steady:
        return f"its size is only {_steady(whole, c):.1f} times its error"
    if _at_bound(whole, c):
        return "its value is at the end of what such a machine may have"
    if _worth(state, whole, c) < state.limits.worth:
        return f"it is less than {100 * state.limits.worth:.0f} % of the joint's torque"
    return ""


def _worth(state: _State, whole: Solved, c: Candidate) -> float:
    """Root mean square of an effect's torque over that of the joint, at the joint where it is most."""
    at = _numbers(whole, c)
    force = np.sqrt(np.mean(np.square(whole.columns[..., at] @ whole.step[at]), 0))
    return float(np.max(force / np.maximum(state.torque, 1e-300)))


def _only_read(state: _State, whole: Solved, c: Candidate) -> bool:
    """A shift of all commands by less than a row, or of measured torques by as much as loggers pair them with angles: how rows are
    read, and no effect."""
    if c.effect not in ("delay", "actuator_lag"):
        return False
    value = float(whole.step[_numbers(whole, c)][0]) / state.reach.dt
    if not state.commanded:
        return abs(value) < state.limits.paired
    return c.effect == "delay" and -state.criteria.within_row < value < state.criteria.least_shift


def _numbers(whole: Solved, c: Candidate) -> list[int]:
    keys = {e.key for e in c.entries}
    return [i for i, e in enumerate(whole.entries) if e.key in keys]


def _steady(whole: Solved, c: Candidate) -> float:
    at = _numbers(whole, c)
    return float(np.max(np.abs(whole.step[at]) / np.maximum(whole.error[at], 1e-300)))


def _at_bound(whole: Solved, c: Candidate) -> bool:
    at = _numbers(whole, c)
    value = np.array([whole.entries[i].start for i in at]) + whole.step[at]
    ends = lambda i, z: (
        abs(z - (e := whole.entries[i]).high) < 1e-6 * abs(e.high)
        or (e.low < min(e.off, e.start) and abs(z - e.low) < 1e-6 * abs(e.low))
    )
    return any(ends(i, z) for i, z in zip(at, value, strict=True))


def _ranked(state: _State, now: Solved, some: Sequence[Candidate]) -> list[Candidate]:
    """Candidates by what they gain held out at first order, the best shape of each."""
    if not some:
        return []
    rows = state.rows
    weigh = lambda z: (z * rows.weight[..., None]).reshape(-1, z.shape[2])
    a, y = weigh(now.columns), ((rows.missing - now.columns @ now.step) * rows.weight)
    inverse = np.linalg.pinv(now.hess, rcond=1e-12, hermitian=True)
    fold = np.repeat(rows.fold, y.shape[1])
    flat, total = y.ravel(), np.square(y).sum(0)
    blocks = [state.table.stack(c.entries, c.shaped()) for c in some]
    wide = weigh(np.concatenate(blocks, 2))
    freed = wide - a @ (inverse @ (a.T @ wide))
    best: dict[tuple, tuple[float, Candidate]] = {}
    at = 0
    for c, block in zip(some, blocks, strict=True):
        own = freed[:, at : at + block.shape[2]]
        at += block.shape[2]
        gain = _gain(own, flat, fold, c) / max(0.5 * total[state.own(c)].sum(), 1e-300) - state.limits.gain * len(
            c.entries
        )
        if c.key not in best or gain > best[c.key][0]:
            best[c.key] = gain, c
    return [c for gain, c in sorted(best.values(), key=lambda z: -z[0]) if gain > 0.0]


def _gain(columns: np.ndarray, y: np.ndarray, fold: np.ndarray, c: Candidate) -> float:
    """Half the squares that amplitudes of the other folds take off each."""
    folds, count = fold.max() + 1, columns.shape[1]
    hess, slope = np.zeros((folds, count, count)), np.zeros((folds, count))
    for f in range(folds):
        mine = columns[fold == f]
        hess[f], slope[f] = mine.T @ mine, mine.T @ y[fold == f]
    low = np.array([e.low - e.start for e in c.entries])
    high = np.array([e.high - e.start for e in c.entries])
    prior = np.diag([e.prior**-2.0 for e in c.entries])
    gain = 0.0
    for f in range(folds):
        h = hess.sum(0) - hess[f] + prior
        step = np.linalg.lstsq(h + 1e-9 * np.diag(np.diagonal(h)), slope.sum(0) - slope[f], rcond=1e-10)[0]
        step = np.clip(step, low, high)
        gain += float(step @ slope[f] - 0.5 * step @ hess[f] @ step)
    return gain


def _backward(state: _State, added: Sequence[Candidate], steps: list[Step]) -> tuple[list[Candidate], list[Candidate]]:
    """Effects that do not hold out beside the others go, the weakest first; and which of those that stay are not shown by themselves:
    what like drives have together, and takes something off here too, is fitted everywhere and named where it holds out alone."""
    added, own = [k for c in added for k in _split(c)], state.limits
    while True:
        whole = state.set_of(added)
        tests = [
            (c, compared(state.rows, state.set_of([k for k in added if k is not c]), whole, state.own(c)))
            for c in added
        ]
        failing, quiet = [], []
        for c, test in tests:
            least = state.criteria.described if state.problem.effect(c.effect).describes else own.gain * len(c.entries)
            level = _level([t.p for k, t in tests if k.effect == c.effect], own) if c.effect in FIRST else own.level
            if why := _why_not(state, whole, c, test, least, level):
                if c.effect in FIRST and test.gain > 0.0 and len([k for k, _ in tests if k.effect == c.effect]) > 1:
                    quiet.append(c)
                else:
                    failing.append((test.gain, c, test, why))
        if not failing:
            return added, quiet
        _, c, test, why = min(failing, key=lambda f: f[0])
        steps.append(Step("dropped", c, test, why))
        added = [k for k in added if k is not c]


def _alike(state: _State, added, c: Candidate, less: Solved, whole: Solved, every) -> tuple[Candidate, ...]:
    """Effects that do nearly as well in its place."""
    rest = [k for k in added if k is not c]
    others = [k for k in _open(state, rest, every) if k.effect != c.effect and set(k.joints) & set(c.joints)]
    others = [k for k in others if not state.problem.effect(k.effect).describes]
    gained = compared(state.rows, less, whole, state.own(c)).gain
    gap = max(state.criteria.gap, 1.0 - (1.0 - gained) ** state.criteria.alike)
    out = []
    for k in _ranked(state, less, others)[:3]:
        other = state.set_of([*rest, k])
        test = compared(state.rows, other, whole, state.own(c))
        if test.gain < gap and not _at_bound(other, k):
            out.append(k)
    return tuple(out)


def _exact(state: _State, added: Sequence[Candidate], whole: Solved) -> tuple[Vector, np.ndarray]:
    """The vector of null and effects, shapes too, by Gauss and Newton's steps from the linear one; standard errors [P]."""
    problem, balance = state.problem, state.balance
    entries, values = list(whole.entries), list(np.array([*state.null.values]) + whole.step[: len(state.null)])
    values += [e.start + z for e, z in zip(whole.entries[len(values) :], whole.step[len(values) :], strict=True)]
    vector = Vector(tuple(entries), np.array(values))
    vector = vector.at(np.clip(vector.values, vector.low, vector.high))
    for c in added:
        vector = vector.with_entries(shape_entries(problem, state.reach, c))
    cost = lambda v: _cost(state.rows, residual(problem, balance, v), v)
    now = cost(vector)
    fitted = None
    for _ in range(ROUNDS):
        table = Table(problem, balance, vector)
        free = [i for i, e in enumerate(vector.entries) if e.low < e.high]
        columns = np.zeros((*table.missing().shape, len(vector)))
        columns[..., free] = table.stack([vector.entries[i] for i in free])
        rows = replace(state.rows, missing=table.missing())
        sums = Sums(rows)
        sums.add("", columns)
        fitted = solved(sums, [""], vector.entries, vector.values)
        for length in (1.0, 0.5, 0.2, 0.05):
            trial = vector.at(np.clip(vector.values + length * fitted.step, vector.low, vector.high))
            there = cost(trial)
            if there < now:
                break
        else:
            break
        done = there > (1.0 - 1e-4) * now
        vector, now = trial, there
        if done:
            break
    error = fitted.error if fitted is not None else np.zeros(len(vector))
    return vector, error


def _cost(rows: Rows, missing: np.ndarray, vector: Vector) -> float:
    off = vector.values - vector.start
    finite = np.isfinite(vector.precision)
    prior = float(np.sum((vector.precision * off * off)[finite]))
    return 0.5 * (float(np.square(missing * rows.weight).sum()) + prior)


def within(vector: Vector, factor: float = FACTOR) -> Vector:
    """A vector whose bodies stay within a factor of the file's masses, lengths of gyration squared and shifts by these lengths."""
    wide = 0.5 * np.log(factor)
    entries = tuple(replace(e, low=-wide, high=wide) if e.owner == INERTIA else e for e in vector.entries)
    return Vector(entries, np.clip(vector.values, [e.low for e in entries], [e.high for e in entries]))
