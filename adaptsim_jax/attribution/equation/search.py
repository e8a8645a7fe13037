"""Which effects the torque along the measured motion asks for: friction first, forward by left-out
blocks, then each beside the others.

Everything is linear but for a few shapes, which lie on grids, so that no set of effects is a
minimum to be stuck in, and thousands of sets are judged in seconds.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from adaptsim_jax.attribution.backward import adjacent
from adaptsim_jax.attribution.equation.balance import Balance
from adaptsim_jax.attribution.equation.exact import exact, needed
from adaptsim_jax.attribution.equation.searched import Searched, ranked
from adaptsim_jax.attribution.equation.solve import ForceRows, Solved, compared
from adaptsim_jax.attribution.equation.stays import (
    Balanced,
    at_bound,
    nameless,
    read_so,
    steadiness,
)
from adaptsim_jax.attribution.parameters import DAMPING_STEP, INERTIA, TILT, Vector
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.score import JointCandidate, candidates
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Named, Step
from adaptsim_jax.diagnosis.rules import refusal, step_reason
from adaptsim_jax.diagnosis.testing import false_discovery
from adaptsim_jax.effects.base import Reach

FACTOR = 3.0  # within which a body's mass and moments are taken to be those of the file


AS_LOGGED = "loggers pair torques with angles as early or late as this"
OF_LIKE_JOINTS = "like joints have it, but it could not be shown by itself in these data"


@dataclass(frozen=True)
class GroupSearch:
    """What the balance of a group of joints says. null, final: vectors of its entries; added:
    effects in it; named: those that have a name; unnamed: those that have none, and why; steps; rows,
    base and whole: the sums.
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
    state: "Searched" = field(repr=False)


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
    steps: list[Step] = []
    added = likely_first(state, every, steps)
    while len(added) < 3 * balance.joints + criteria.most_effects:
        best = _forward(state, added, every, steps)
        if best is None:
            break
        added = [*added, best]
    driven = {j for j, k in state.local.items() if np.any(state.averaged[:, k])}
    asked = Counter(k.effect for c in added for k in c.split() if driven & set(k.joints))
    stay: list[JointCandidate] | None = None
    while stay is None or len(stay) < len(added):  # what stands beside one that goes is judged anew
        added, unnamed = _backward(state, added if stay is None else stay, steps, asked)
        while (simpler := _one_for_two(state, added, every, steps)) is not None:
            added, unnamed = _backward(state, simpler, steps, asked)
        stay, final, errors = needed(state, added, [c for c in added if c not in unnamed])
        why = step_reason("shape_artefact")
        steps += [Step("dropped", c, None, why) for c in added if c not in stay]
    whole = state.set_of(added)
    named = []
    for c in added:
        if read_so(state, whole, c):
            if not commanded:
                unnamed[c] = AS_LOGGED
            continue
        if c in unnamed:
            continue
        if why := nameless(state, whole, c):
            unnamed[c] = why
            continue
        less = state.set_of([k for k in added if k is not c])
        test = compared(state.rows, less, whole, state.own(c))
        named.append(
            Named(c, test, steadiness(whole, c), _alike(state, added, c, less, whole, every))
        )
    base = state.set_of(())
    first = exact(state, (), base)[0]
    return GroupSearch(
        balance,
        first,
        final,
        errors,
        tuple(added),
        tuple(named),
        tuple(unnamed.items()),
        tuple(steps),
        state.rows,
        base,
        whole,
        state,
    )


def separable_candidates(state: Searched) -> list[JointCandidate]:
    """Candidates of which a group's balance can tell."""
    joints, speed, slowest = (
        set(state.balance.group.joints),
        state.reach.speed,
        state.limits.slowest,
    )
    effect = state.problem.effect
    return [
        _trusted(c, effect(c.effect).traits.prior)
        for c in (_of_group(c, joints) for c in candidates(state.problem, state.null, state.reach))
        if set(c.joints) <= joints
        and effect(c.effect).in_balance
        and c.shaped().get("speed", np.inf) > slowest * max(speed[j] for j in c.joints)
        and (state.commanded or not (c.sharing == "joint" and effect(c.effect).place == "command"))
    ]


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


def refitted(
    problem: TreeProblem, found: GroupSearch, added: Sequence[JointCandidate]
) -> GroupSearch:
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


def likely_first(
    state: Searched, every: Sequence[JointCandidate], steps: list[Step]
) -> list[JointCandidate]:
    """What all joints are likely to have, each kind at all of them as one candidate. Joint by joint
    it is judged in the end, since one hides another (a file's damping and rotors that are not
    there: dry friction that is).
    """
    added: list[JointCandidate] = []
    stepped = any(
        e.owner == DAMPING_STEP for e in state.null.entries
    )  # which is nearly rotors at all of them already
    first = [e for e in state.problem.effects if e.traits.tried_first]
    for effect in sorted(first, key=lambda e: e.traits.tried_first):
        if stepped and effect.inertia:
            continue
        sharing = "common" if effect.traits.shared else "joint"
        some = [c for c in every if c.effect == effect.name and c.sharing == sharing]
        if (
            effect.shifts_commands
        ):  # of all commands, where there are any, which else looks like rotors
            if state.commanded:
                some = ranked(state, state.set_of(added), some)[:1]
            else:
                some = []
        if not some:
            continue
        less, more = state.set_of(added), state.set_of([*added, *some])
        joints = sorted({k for c in some for k in state.own(c)})
        test = compared(state.rows, less, more, joints)
        if test.gain > state.limits.gain and test.p <= state.limits.level:
            added = [*added, *some]
            state.weigh(state.set_of(added))
            steps += [Step("added", c, test, step_reason("likely_first")) for c in some]
    return added


def _likely(state: Searched, c: JointCandidate) -> bool:
    """Whether like drives have it, so that it was put in at all joints: real joints rub."""
    traits = state.problem.effect(c.effect).traits
    return traits.family and traits.tried_first > 0


def _taken(added: Sequence[JointCandidate]) -> set[tuple[str, int]]:
    return {(c.effect, j) for c in added for j in c.joints}


def _open(
    state: Searched, added: Sequence[JointCandidate], every: Sequence[JointCandidate]
) -> list[JointCandidate]:
    taken = _taken(added)
    return [c for c in every if not any((c.effect, j) in taken for j in c.joints)]


def _forward(
    state: Searched, added: list[JointCandidate], every, steps: list[Step]
) -> JointCandidate | None:
    """The candidate that takes most off where it was left out, of all joints at which it shows, for
    the numbers that it has.
    """
    now = state.set_of(added)

    def shifts(c):
        return state.problem.effect(c.effect).shifts_commands

    late = {j for c in added if shifts(c) and not read_so(state, now, c) for j in c.joints}
    free = [c for c in _open(state, added, every) if not shifts(c) or not late & set(c.joints)]
    for laws in (True, False):
        some = [c for c in free if state.problem.effect(c.effect).describes is not laws]
        best = None
        for c in ranked(state, now, some)[: state.limits.tried]:
            c = state.settled(added, c)
            more = state.set_of([*added, c])
            test = compared(state.rows, now, more, state.own(c))
            if not laws:
                minimum = state.criteria.described
            else:
                minimum = state.limits.gain * len(c.entries)
            why = refusal(Balanced(state, more, c, test, minimum, state.limits.level))
            steps.append(Step("refused" if why else "tried", c, test, why))
            value = test.gain * state.carry(c) - state.limits.gain * len(c.entries)
            if not why and (best is None or value > best[0]):
                best = value, c, test
        if best is not None:
            steps.append(Step("added", best[1], best[2], None))
            return best[1]
    return None


def _backward(
    state: Searched, added: Sequence[JointCandidate], steps: list[Step], asked: Mapping[str, int]
) -> tuple[list[JointCandidate], dict[JointCandidate, str]]:
    """Effects that do not hold out beside the others go, the weakest first; and which of those that
    stay are not shown by themselves, and why: what like drives have together, and takes something off here
    too, is fitted everywhere and named where it holds out alone. asked: of each effect at how many
    driven joints it was looked for.
    """
    added, own = [k for c in added for k in c.split()], state.limits
    while True:
        whole = state.set_of(added)
        tests = [
            (
                c,
                compared(
                    state.rows, state.set_of([k for k in added if k is not c]), whole, state.own(c)
                ),
            )
            for c in added
        ]
        failing, unnamed = [], {}
        for c, test in tests:
            if state.problem.effect(c.effect).describes:
                minimum = state.criteria.described
            else:
                minimum = own.gain * len(c.entries)
            like = [t.p for k, t in tests if k.effect == c.effect]
            likely = _likely(state, c)
            if likely:
                shown = false_discovery(like, own.discovery, max(1, asked[c.effect]))
                level = max(own.level, shown)
            else:
                level = own.level
            if why := refusal(Balanced(state, whole, c, test, minimum, level)):
                if likely and test.gain > 0.0 and len(like) > 1:
                    unnamed[c] = OF_LIKE_JOINTS
                else:
                    failing.append((test.gain, c, test, why))
        if not failing:
            return added, unnamed
        _, c, test, why = min(failing, key=lambda f: f[0])
        steps.append(Step("dropped", c, test, why))
        added = [k for k in added if k is not c]


def _one_for_two(
    state: Searched, added: Sequence[JointCandidate], every, steps: list[Step]
) -> list[JointCandidate] | None:
    """The set with one effect in the place of two of a joint, which forward steps took for it; None
    where none does as well, or one of the two does by itself (a trifle beside it does not make it
    another).
    """
    whole = state.set_of(added)
    for one, other in combinations(added, 2):
        if not set(one.joints) & set(other.joints):
            continue
        less = state.set_of(rest := [k for k in added if k is not one and k is not other])
        alone = [
            compared(state.rows, state.set_of([*rest, k]), whole, state.own(one, other)).gain
            for k in (one, other)
        ]
        if min(alone) < _gap(state, (one, other), less, whole):
            continue
        for k in _as_good(state, rest, (one, other), less, whole, every):
            test = compared(state.rows, less, more := state.set_of([*rest, k]), state.own(k))
            price = state.limits.gain * len(k.entries)
            if not refusal(Balanced(state, more, k, test, price, state.limits.level)):
                reason = step_reason("one_for_two", one=one.effect, other=other.effect)
                steps.append(Step("replaced", k, test, reason))
                return [*rest, k]
    return None


def _alike(
    state: Searched, added, c: JointCandidate, less: Solved, whole: Solved, every
) -> tuple[JointCandidate, ...]:
    """Effects that do nearly as well in its place."""
    return tuple(_as_good(state, [k for k in added if k is not c], (c,), less, whole, every))


def _as_good(
    state: Searched, rest, gone: Sequence[JointCandidate], less: Solved, whole: Solved, every
) -> list[JointCandidate]:
    """Single effects that do nearly as well beside `rest` as those that are gone from it: others at
    their joints, the same at joints beside. less, whole: without them, and with.
    """
    names, joints = {c.effect for c in gone}, {j for c in gone for j in c.joints}
    near = [
        k
        for k in _open(state, rest, every)
        if any(adjacent(k, c) or k.effect == c.effect == INERTIA for c in gone)
    ]
    others = [k for k in near if (k.effect in names) != bool(joints & set(k.joints))]
    others = [k for k in others if not state.problem.effect(k.effect).describes]
    gap, out = _gap(state, gone, less, whole), []
    for k in ranked(state, less, others)[:3]:
        k = state.settled(rest, k)
        other = state.set_of([*rest, k])
        if compared(state.rows, other, whole, state.own(*gone, k)).gain < gap and not at_bound(
            other, k
        ):
            out.append(k)
    return out


def _gap(state: Searched, gone: Sequence[JointCandidate], less: Solved, whole: Solved) -> float:
    """Share of the loss by which what stands in the place of `gone` may be worse and still do as
    well.
    """
    gain = compared(state.rows, less, whole, state.own(*gone)).gain
    return max(state.criteria.gap, 1.0 - (1.0 - gain) ** state.criteria.alike)


def within(vector: Vector, factor: float = FACTOR) -> Vector:
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
