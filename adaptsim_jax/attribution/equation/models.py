"""What the balance of forces found, as models of the whole machine: fitted values, how they
predict, what is named.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter

import numpy as np

from adaptsim_jax.attribution.candidates import (
    CandidateScore,
    JointCandidate,
    body_mass_candidates,
    candidates,
)
from adaptsim_jax.attribution.criteria import PRIOR_WIDTH
from adaptsim_jax.attribution.equation.balance import Balance
from adaptsim_jax.attribution.equation.balance_objective import BalanceObjective
from adaptsim_jax.attribution.equation.searched import Searched, exact
from adaptsim_jax.attribution.equation.solve import ForceRows, Solved
from adaptsim_jax.attribution.fitted import FittedTree, HeldOut, Selection
from adaptsim_jax.attribution.forecast import fitted_starts
from adaptsim_jax.attribution.held_out import squared_error
from adaptsim_jax.attribution.parameters import BODY_MASS, INERTIA, TILT, Normal, TreeFit, Vector
from adaptsim_jax.attribution.paths import losses, weigh
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Named, Step
from adaptsim_jax.diagnosis.search import search
from adaptsim_jax.effects.base import Reach


@dataclass(frozen=True)
class GroupSearch:
    """What the balance of a group of joints says. null, final: vectors of its entries; added:
    effects in it; named: those that have a name; unnamed: those that have none, and why; steps;
    rows, base and whole: the sums.
    """

    balance: Balance
    null: Vector
    final: Vector
    errors: np.ndarray
    added: tuple[JointCandidate, ...]
    named: tuple[Named, ...]
    unnamed: tuple[tuple[JointCandidate, str], ...]
    steps: tuple[Step, ...]
    rows: ForceRows
    base: Solved = field(repr=False)
    whole: Solved = field(repr=False)
    state: Searched = field(repr=False)


def search_group(
    problem: TreeProblem,
    balance: Balance,
    null: Vector,
    reach: Reach,
    criteria: Criteria,
    commanded: bool = False,
) -> GroupSearch:
    """Search the balance of a group. null: entries of the group that are fitted whatever is named;
    commanded: the input is a command, which may be late at each joint, and no measured torque.
    """
    state = Searched(problem, balance, null, reach, criteria, commanded)
    every = [z for c in separable_candidates(state) if (z := _within(problem, c)) is not None]
    found = search(BalanceObjective(state, every))
    null, _ = exact(state, (), found.null.whole)
    final = found.final
    named = tuple(replace(n, models=()) for n in found.named)
    # how commands are read is told in words of its own
    unnamed = [(c, r) for c, r in found.unnamed if not (commanded and r.code == "as_logged")]
    return GroupSearch(
        balance,
        null,
        final.final,
        final.errors,
        final.added,
        named,
        tuple((c, r.words) for c, r in unnamed),
        found.trace,
        state.rows,
        found.null.whole,
        final.whole,
        state,
    )


def separable_candidates(state: Searched) -> list[JointCandidate]:
    """Candidates of which a group's balance can tell."""
    joints, speed = set(state.balance.group.joints), state.reach.speed
    out = []
    some = candidates(state.problem, state.null, state.reach)
    if state.problem.offers(BODY_MASS):
        some += body_mass_candidates(state.balance.group)
    for every in some:
        c = _of_group(every, joints)
        effect = state.problem.effect(c.effect)
        if not set(c.joints) <= joints or not effect.in_balance:
            continue
        slowest = state.limits.slowest * max(speed[j] for j in c.joints)
        of_command = c.sharing == "joint" and effect.place == "command"
        if c.shaped().get("speed", np.inf) > slowest and (state.commanded or not of_command):
            out.append(_trusted(c, effect.traits.prior))
    return out


def _within(problem: TreeProblem, c: JointCandidate) -> JointCandidate | None:
    """An effect in a range that leaves most of the rows; None where its shape does not."""
    shape, entries = c.shaped(), []
    for e in c.entries:
        if (most := problem.most.get((c.effect, e.name))) is not None:
            low, high = (z[list(e.joints)] for z in most)
            if not low.min() <= shape.get(e.name, e.start) <= high.max():
                return None
            e = replace(e, low=max(e.low, float(low.min())), high=min(e.high, float(high.max())))
        entries.append(e)
    return replace(c, entries=tuple(entries))


def refitted(found: GroupSearch, added: Sequence[JointCandidate]) -> GroupSearch:
    """With other effects, fitted as the search fits them; nothing is judged."""
    whole = found.state.set_of(added)
    final, errors = exact(found.state, added, whole, found.final)
    return replace(found, final=final, errors=errors, added=tuple(added), whole=whole)


def _of_group(c: JointCandidate, joints: set[int]) -> JointCandidate:
    """Of an effect with one value for all joints of the machine the one for those of a group: a
    late computer is late for each.
    """
    own = tuple(j for j in c.joints if j in joints)
    if c.sharing != "common" or c.effect == TILT or len(own) in (0, len(c.joints)):
        return c
    return replace(c, joints=own, entries=tuple(replace(e, joints=own) for e in c.entries))


def _trusted(c: JointCandidate, wide: float) -> JointCandidate:
    """With what is known beforehand of how far such a thing is off."""
    return replace(c, entries=tuple(replace(e, prior=min(e.prior, wide)) for e in c.entries))


def within(vector: Vector, factor: float = PRIOR_WIDTH.body_factor) -> Vector:
    """A vector whose bodies stay within a factor of the file's masses, lengths of gyration squared
    and shifts by these lengths.
    """
    wide = 0.5 * np.log(factor)
    entries = tuple(
        replace(e, low=-wide, high=wide) if e.owner == INERTIA else e for e in vector.entries
    )
    return Vector(
        entries, np.clip(vector.values, [e.low for e in entries], [e.high for e in entries])
    )


START_ROUNDS = 3  # rounds of the starts of stretches


@dataclass(frozen=True)
class TorqueSearch:
    """What the balances of all groups of joints say. null, final: vectors of the whole machine;
    errors [P] of the final one; vetoes: how names went that simulation does not bear out.
    """

    searches: tuple[GroupSearch, ...]
    null: Vector
    final: Vector
    errors: np.ndarray
    vetoes: tuple[Step, ...] = ()

    @property
    def added(self) -> tuple[JointCandidate, ...]:
        return tuple(c for w in self.searches for c in w.added)

    @property
    def named(self) -> tuple[Named, ...]:
        return tuple(n for w in self.searches for n in w.named)


def search_balances(
    problem: TreeProblem,
    balances: Sequence[Balance],
    null: Vector,
    reach: Reach,
    criteria: Criteria,
    commanded: bool,
    factor: float = PRIOR_WIDTH.body_factor,
) -> TorqueSearch:
    """Search the balances of all groups. null: what is fitted whatever is named; commanded, factor:
    as of `search_group`, `within`.
    """

    def own(b):
        return within(part_of(null, b), factor)

    found = tuple(
        parallel_map(
            lambda b: search_group(problem, b, own(b), reach, criteria, commanded), balances
        )
    )
    return merged(null, found)


def merged(null: Vector, searches: Sequence[GroupSearch]) -> TorqueSearch:
    """The vectors of the groups as those of the whole machine."""
    first = null.at(_values(null, [w.null for w in searches]))
    entries = [e for w in searches for e in w.final.entries if e.key not in null.index()]
    final = null.with_entries(entries)
    final = final.at(_values(final, [w.final for w in searches]))
    error = {e.key: s for w in searches for e, s in zip(w.final.entries, w.errors, strict=True)}
    return TorqueSearch(
        tuple(searches), first, final, np.array([error.get(e.key, 0.0) for e in final.entries])
    )


def _values(vector: Vector, parts: Sequence[Vector]) -> np.ndarray:
    known = {e.key: z for v in parts for e, z in v.pairs()}
    return np.array([known.get(e.key, z) for e, z in vector.pairs()])


def part_of(null: Vector, balance: Balance) -> Vector:
    """The entries of a vector that act in a group."""
    joints = set(balance.group.joints)
    at = [i for i, e in enumerate(null.entries) if set(e.joints) <= joints]
    return Vector(tuple(null.entries[i] for i in at), null.values[at])


def selection(
    problem: TreeProblem, found: TorqueSearch, null: FittedTree, reach: Reach
) -> Selection:
    """As a search by simulation hands it on: models that predict stretches, effects that are named,
    what was tried. null: the declared model.
    """
    final = model_of(problem, found, found.final, found.added)
    steps = [s for w in found.searches for s in w.steps]
    best: dict[tuple, CandidateScore] = {}
    for candidate, test in ((s.candidate, s.test) for s in steps):
        if test is None:
            continue
        score = CandidateScore(candidate, test.gain * null.fit.total, test.p)
        best[candidate.key] = max(best.get(candidate.key, score), score, key=_left_out)
    opening = sorted(best.values(), key=_left_out, reverse=True)
    found_by = (null, final, found.named, (*steps, *found.vetoes), tuple(opening))
    return Selection(*found_by, stages=(null,), last=(), reach=reach)


_left_out = attrgetter("held_out")


def model_of(
    problem: TreeProblem,
    found: TorqueSearch,
    vector: Vector,
    added: Sequence[JointCandidate],
    starts: Sequence[np.ndarray] | None = None,
) -> FittedTree:
    """A vector with how it simulates stretches, each from starts fitted to it, with the values of
    the folds that it is not in. starts: from which these are fitted, of a model that is nearly the
    same.
    """
    vectors = without_each(found, vector)
    rows = left_out_values(problem, found, vector, vectors)
    width = problem.groups[0].stretches.count
    rows = np.concatenate([rows, np.repeat(rows[-1:], width - len(rows), 0)])
    rounds = START_ROUNDS if starts is None else 1
    starts, paths = fitted_starts(problem, vector, rows, rounds, roughly=True, starts=starts)
    weights = weigh(problem, paths)
    loss = losses(problem, paths, weights)
    fit = TreeFit(vector, starts, weights, loss, "converged", 0)
    folds, size = vectors.shape
    nothing = Normal(np.zeros((folds, size, size)), np.zeros((folds, size)))
    held = HeldOut(loss, squared_error(problem, paths), vectors, nothing, tuple(paths))
    return FittedTree(tuple(added), fit, None, held, curvature(found, vector))


def without_each(found: TorqueSearch, vector: Vector) -> np.ndarray:
    """Values [F, P] of a vector without each fold of the windows."""
    count = max((len(w.whole.by_fold) for w in found.searches), default=1)
    out, index = np.repeat(vector.values[None], count, 0), vector.index()
    for w in found.searches:
        solved = w.base if len(vector) == len(found.null) else w.whole
        for i, e in enumerate(solved.entries):
            if e.key in index:
                off = solved.by_fold[:, i] - solved.step[i]
                out[: len(off), index[e.key]] += off
    return np.clip(out, vector.low, vector.high)


def left_out_values(
    problem: TreeProblem, found: TorqueSearch, vector: Vector, vectors: np.ndarray
) -> np.ndarray:
    """Values [W, P] that each stretch is predicted with: of `vectors` [F, P], those without the
    windows that lie there.
    """
    out = np.repeat(vector.values[None], len(problem.fold), 0)
    for w in found.searches:
        joints = set(w.balance.group.joints)
        own = [i for i, e in enumerate(vector.entries) if joints & set(e.joints)]
        fold = fold_of_windows(problem, w.balance, w.rows.fold)
        seen = np.flatnonzero(fold >= 0)
        out[np.ix_(seen, own)] = vectors[np.ix_(fold[seen], own)]
    return out


def fold_of_windows(problem: TreeProblem, balance: Balance, fold: np.ndarray) -> np.ndarray:
    """Which fold of the windows has most of those in each stretch [W]; -1 where there are none. A
    trial that is shorter than a stretch has windows alone. fold [K]: of the windows.
    """
    s, count, trials = problem.groups[0].stretches, len(problem.fold), np.unique(balance.trial)
    begun = np.array([balance.clock[run.start] for run in balance.runs])
    since = balance.time - begun[np.searchsorted(trials, balance.trial)]
    first, last = (s.time[k, :count, None] for k in (0, -1))
    inside = (s.trial[:count, None] == balance.trial) & (since >= first) & (since <= last)
    shared = inside @ np.eye(fold.max() + 1)[fold]
    return np.where(np.any(shared, 1), np.argmax(shared, 1), -1)


def curvature(found: TorqueSearch, vector: Vector) -> np.ndarray:
    """Of the balance's loss by the values of a vector [P, P], with the prior."""
    out, index = np.diag(np.maximum(vector.precision, 1e-12)), vector.index()
    for w in found.searches:
        solved = w.base if len(vector) == len(found.null) else w.whole
        at = [(i, index[e.key]) for i, e in enumerate(solved.entries) if e.key in index]
        here, there = [i for i, _ in at], [j for _, j in at]
        out[np.ix_(there, there)] = solved.hess[np.ix_(here, here)]
    return out


def without(
    problem: TreeProblem,
    found: TorqueSearch,
    gone: Sequence[JointCandidate],
    instead: Sequence[JointCandidate],
) -> TorqueSearch:
    """Refitted without some effects, with others in their place."""
    out = []
    for w in found.searches:
        joints = set(w.balance.group.joints)
        less = [c for c in w.added if c not in gone] + [
            c for c in instead if set(c.joints) <= joints
        ]
        out.append(w if len(less) == len(w.added) and not instead else refitted(w, less))
    return merged(replace(found.null, values=found.null.values), out)


Span = tuple[str, float, float]
"""A part of a log: its trial, and from when to when it goes, s."""


def made_apart(found: TorqueSearch) -> Iterator[tuple[Span, TorqueSearch]]:
    """Each part of the log (trials, or thirds of one) with the same effects fitted without it."""
    one = found.searches[0]
    for part in np.unique(one.rows.part):
        mine = one.rows.part == part
        trial, time = one.balance.trial[mine][0], one.balance.time[mine]
        less = [refitted(replace(w, state=w.state.without(part)), w.added) for w in found.searches]
        yield (one.balance.names[trial], time[0], time[-1]), merged(found.null, less)


def held_missing(found: TorqueSearch) -> tuple[dict[int, np.ndarray], dict[int, np.ndarray]]:
    """What is missing of the torque in windows that were left out [K, n], by balance: of the
    declared model, fitted, and of the final.
    """
    out: tuple[dict[int, np.ndarray], dict[int, np.ndarray]] = ({}, {})
    for k, w in enumerate(found.searches):
        for shares, solved in zip(out, (w.base, w.whole), strict=True):
            shares[k] = solved.left_out(w.rows)
    return out
