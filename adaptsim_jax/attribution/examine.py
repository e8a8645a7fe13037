"""Which objective judges, and by it which effects: the balance of torques along the motion, or
simulated stretches, each checked by the other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from adaptsim_jax.attribution.equation.balance import Balance, balances
from adaptsim_jax.attribution.equation.confirmed import confirmed, searched, without_bodies
from adaptsim_jax.attribution.equation.models import (
    TorqueSearch,
    held_missing,
    model_of,
    part_of,
    search_balances,
    selection,
    within,
)
from adaptsim_jax.attribution.equation.rubbing import rubbing
from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.fitted import FittedTree, Hint, Selection, over_floor
from adaptsim_jax.attribution.held_out import modelled
from adaptsim_jax.attribution.inquiry import Examined, Inquiry, Keep, with_null
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import (
    STRETCHES,
    TORQUE,
    Measure,
    headline,
    of_torque,
)
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.posed import (
    DiagnosisSetting,
    catalogue_of,
    declared_vector,
    factor_of,
    posed,
)
from adaptsim_jax.attribution.problem import TreeProblem, own_inertia, scaled_reach
from adaptsim_jax.attribution.tree_objective import (
    DECLARED_ROUNDS,
    TreeObjective,
    select,
    select_shorter,
)
from adaptsim_jax.core.progress import Note, no_notes
from adaptsim_jax.diagnosis.finding import Named
from adaptsim_jax.diagnosis.search import backward_elimination
from adaptsim_jax.diagnosis.steps import NotFinite
from adaptsim_jax.effects.base import Reach


@dataclass(frozen=True)
class Balanced:
    """The balances of a machine's torques, searched.

    Args:
        balances: Of each group of joints.
        reach: What the data cover.
        words: The search whose names count.
        free: That with bodies fitted, where both were made.
        declared: The fitted declared model.
        each: Whether bodies were chosen joint by joint.
        bare: Whether bodies and damping are the file's.
    """

    balances: tuple[Balance, ...]
    reach: Reach
    words: TorqueSearch
    free: TorqueSearch
    declared: FittedTree
    each: bool
    bare: bool

    def measure(self, problem: TreeProblem, search: TorqueSearch, final: bool) -> Measure:
        """How much torque a search's declared or final model leaves missing."""
        vector = search.final if final else search.null
        made = of_torque(problem, self.balances, vector, held_missing(search)[final])
        assert made is not None
        return made


def examine(inquiry: Inquiry) -> Examined:
    """Judge by the objective that tells most of the declared model, before anything is named.

    Command errors count with what they name, since a late command hides all else of them.
    """
    q, balanced = inquiry, ()
    if q.factor is not None:
        balanced = balances(q.problem, q.machine.tracks)
    if not balanced:
        return _by_stretches(q, _why_stretches(q))
    q.notify("balance of torques")
    try:
        q, balanced, reach = _with_friction_law(q, balanced)
        torques = _search_torques(q, balanced, reach)
    except NotFinite as error:  # the other objective goes on by itself
        why = f"the torque along the motion tells nothing ({error})"
        return _by_stretches(replace(q, hint=None), why)
    before = q.simulated(torques.declared)
    before[TORQUE] = torques.measure(q.problem, torques.words, final=False)
    judge, why = _objective(q, torques, before)
    words, by_torque = torques.words, None
    if judge == TORQUE:
        by_torque = _by_torque(q, torques, before, why)
        near = q.criteria.near if q.follows else q.criteria.explained
        # of very many joints stretches are not searched: what is left is reported
        if q.asked or q.many or over_floor(q.problem, by_torque.found.final) < near:
            return by_torque
        words = by_torque.by_torque
        judge, why = (
            STRETCHES,
            f"what {_SHOWN[q.follows]} shows leaves far more than noise in simulated stretches",
        )
    found = by_simulation(replace(q, hint=_hint_of(q, words)))
    before, after = (
        q.simulated(m) | {TORQUE: of_torque(q.problem, torques.balances, m.fit.vector)}
        for m in (found.null, found.final)
    )
    if by_torque is not None and not q.follows and _worth(after) < _worth(by_torque.after):
        return by_torque
    return Examined(q, found, words, before, after, judge, why)


def _why_stretches(q: Inquiry) -> str:
    """Why stretches judge where there is no balance."""
    if q.follows:
        return f"it follows commands; over {q.horizon:g} s a straight line says less"
    if q.factor is not None:
        return "no torque is known along the motion"
    return "stretches are this task's yardstick"


def _by_stretches(q: Inquiry, why: str) -> Examined:
    found = by_simulation(q)
    before, after = (q.simulated(m) for m in (found.null, found.final))
    return Examined(q, found, None, before, after, STRETCHES, why)


def _null_of(q: Inquiry, balance: Balance) -> Vector:
    """What is fitted of a group, with bodies within the factor of the file's."""
    assert q.factor is not None
    vector = without_bodies(q.null) if q.follows else q.null
    return within(part_of(vector, balance), q.factor)


def _with_friction_law(
    q: Inquiry, balanced: Sequence[Balance]
) -> tuple[Inquiry, Sequence[Balance], Reach]:
    """With the law of friction that the balances show, and what the data cover."""
    problem, reach = q.problem, scaled_reach(q.problem, *own_inertia(q.problem, q.null))
    commanded = q.machine.log.input_kind != "torque"
    problem, balanced = rubbing(
        problem,
        q.machine.tree,
        balanced,
        lambda b: _null_of(q, b),
        reach,
        q.criteria,
        commanded,
    )
    return replace(q, problem=problem), balanced, reach


def _search_torques(q: Inquiry, balanced: Sequence[Balance], reach: Reach) -> Balanced:
    """Search the balances, with bodies of the file and fitted ones where commands are followed."""
    commanded = q.machine.log.input_kind != "torque"

    def search(vector):
        assert q.factor is not None
        return search_balances(q.problem, balanced, vector, reach, q.criteria, commanded, q.factor)

    each = False
    if q.follows and len(without_bodies(q.null)) < len(q.null):
        words, free, each = searched(q.problem, search, q.null, q.criteria)
    else:
        words = free = search(q.null)
    bare = len(words.null) < len(q.null)
    declared = model_of(q.problem, words, words.null, ())
    return Balanced(tuple(balanced), reach, words, free, declared, each, bare)


def _objective(q: Inquiry, torques: Balanced, before: dict[str, Any]) -> tuple[str, str]:
    """The objective that judges, and why. before: measures of the declared model."""
    words, free = torques.words, torques.free
    usual = torques.measure(q.problem, free, final=False)
    if q.follows:  # a late command hides all that its errors tell until it is named
        named = torques.measure(q.problem, words, final=True)
        usual = max(usual, named, key=lambda m: m.skill)
    judge, why = headline(before | {TORQUE: usual}, q.follows, q.asked)
    if q.follows and q.many and judge != TORQUE and not q.asked:
        judge = TORQUE
        why = f"of {q.problem.joints} joints that follow commands stretches are not searched"
    if torques.bare and judge == TORQUE:
        other = "fitted ones were not sought"
        if len(free.null) > len(words.null):
            other = "fitted ones tell left-out torques no better"
        why = f"{why}; bodies and damping are the file's: {other}"
    return judge, why


def _by_torque(q: Inquiry, torques: Balanced, before: dict[str, Any], why: str) -> Examined:
    """What the balance names, confirmed by simulated stretches where it can be."""
    problem, words = q.problem, torques.words
    found = selection(problem, words, torques.declared, torques.reach)
    q.keep(found)
    if not q.follows or not torques.each:
        null_of = None if q.follows else torques.declared
        words = confirmed(problem, torques.words, found.final, q.criteria, null_of)
        if words is not torques.words:
            found = selection(problem, words, torques.declared, torques.reach)
    if q.follows and not q.many:
        found = _polished(q, found, torques.reach)
    after = q.simulated(found.final)
    after[TORQUE] = torques.measure(problem, words, final=True)
    return Examined(q, found, words, before, after, TORQUE, why, q.follows)


def _hint_of(q: Inquiry, words: TorqueSearch | None) -> Hint | None:
    """Values and effects of the balance, from which the search of stretches goes on."""
    assert words is not None
    if not words.added or q.follows:
        return None
    known = q.null.index()
    pairs = zip(words.final.entries, words.final.values, strict=True)
    added = [(e, z) for e, z in pairs if e.key not in known]
    values = np.clip(words.final.values[: len(q.null)], q.null.low, q.null.high)
    start = q.null.at(values)
    return start.with_entries([e for e, _ in added], [z for _, z in added]), words.added


def _polished(q: Inquiry, found: Selection, reach: Reach) -> Selection:
    """With the final values fitted by simulation, since along the motion a time or a gain is only
    so exact, and each of several names held against the others there.

    Values of the motion stay where they simulate to within the noise, with all names. Where what is
    fitted leaves so much that stretches will be torques (unless the balance was asked for),
    nothing more is asked.
    """
    problem, criteria = q.problem, q.criteria
    several, good = len(found.named) > 1, over_floor(problem, found.final) <= criteria.explained
    if good and not several:
        return found
    q.notify("fit by simulation")
    again = found.final.fit
    if not good:
        again = fit(problem, again.vector, again.starts, rounds=DECLARED_ROUNDS)
    whole = modelled(problem, tuple(n.candidate for n in found.named), again)
    if not several or (not q.asked and over_floor(problem, whole) >= criteria.near):
        return replace(found, final=whole)
    trace, known = list(found.trace), {n.candidate.key: n for n in found.named}
    objective = TreeObjective(problem, whole, reach, criteria, q.notify, alike=False)
    final, stay = backward_elimination(objective, whole, trace)
    named = tuple(
        Named(e.candidate, e.test, e.steadiness, known[e.candidate.key].alternatives) for e in stay
    )
    selected = found.final if good and len(stay) == len(known) else final
    return replace(found, final=selected, named=named, trace=tuple(trace))


def by_simulation(q: Inquiry) -> Selection:
    """The search by simulated stretches, over their beginnings where the whole names nothing and
    far more than noise is left.
    """
    found = select(q.problem, q.null, q.criteria, q.notify, q.keep, q.hint)
    if not found.named and over_floor(q.problem, found.final) > q.criteria.outlying:
        found = select_shorter(q.problem, q.null, q.criteria, found, q.notify)
    return found


def _worth(measures: dict[str, Measure | None]) -> float:
    """Skill of a model by all yardsticks together."""
    return sum(m.skill for m in measures.values() if m is not None)


_SHOWN = {True: "the command error", False: "the torque along the motion"}


@np.errstate(over="ignore", invalid="ignore")  # of stretches that run away, as a search expects
def examined(
    machine: Machine,
    setting: DiagnosisSetting | None = None,
    narrow: Callable[[Vector], Vector] = lambda vector: vector,
    notify: Note = no_notes,
    keep: Keep | None = None,
) -> Examined:
    """What was found of a machine. narrow: what stays of the vector that is fitted whatever is
    named; keep: called with what a search has found so far.
    """
    setting = setting or DiagnosisSetting()
    chosen, at_joints = catalogue_of(machine, setting)
    problem = replace(posed(machine, chosen, setting.horizon), excluded=at_joints)
    notify("declared model")
    null = narrow(declared_vector(machine, problem))
    inquiry = Inquiry(
        machine,
        problem,
        null,
        setting.criteria,
        setting.horizon,
        notify,
        asked=setting.objective,
        factor=factor_of(machine.log.meta) if setting.torques else None,
    )
    if keep is not None:
        inquiry = replace(inquiry, keep=partial(keep, inquiry))
    found = examine(inquiry)
    if not found.found.named:
        # how rows are read is no mend: the declared model is what it is with it
        return with_null(found, found.found.final)
    return found
