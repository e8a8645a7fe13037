"""What the balance of a group of joints says: candidates of which it can tell, and their search."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from adaptsim_jax.attribution.criteria import PRIOR_WIDTH
from adaptsim_jax.attribution.equation.balance import Balance
from adaptsim_jax.attribution.equation.balance_objective import BalanceObjective
from adaptsim_jax.attribution.equation.exact import exact
from adaptsim_jax.attribution.equation.searched import Searched
from adaptsim_jax.attribution.equation.solve import ForceRows, Solved
from adaptsim_jax.attribution.parameters import INERTIA, TILT, Vector
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.score import JointCandidate, candidates
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Named, Step
from adaptsim_jax.diagnosis.search import search
from adaptsim_jax.effects.base import Reach


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
    return GroupSearch(
        balance,
        null,
        final.final,
        final.errors,
        final.added,
        tuple(replace(n, models=()) for n in found.named),
        # how commands are read is told in words of its own
        tuple((c, r.words) for c, r in found.unnamed if not (commanded and r.code == "as_logged")),
        found.trace,
        state.rows,
        found.null.whole,
        final.whole,
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
