"""Which objective judges, and by it which effects: the balance of torques along the motion, or
simulated stretches, each checked by the other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from adaptsim_jax.attribution.equation.balance import Balance, balances
from adaptsim_jax.attribution.equation.confirmed import confirmed
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
from adaptsim_jax.attribution.fitted import FittedTree, Hint, Selection, over_floor
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
    select,
    select_shorter,
)
from adaptsim_jax.core.progress import Note, no_notes
from adaptsim_jax.diagnosis.steps import NotFinite
from adaptsim_jax.effects.base import Reach


@dataclass(frozen=True)
class Balanced:
    """The balances of a machine's torques, searched.

    Args:
        balances: Of each group of joints.
        reach: What the data cover.
        search: What was found.
        declared: The fitted declared model.
    """

    balances: tuple[Balance, ...]
    reach: Reach
    search: TorqueSearch
    declared: FittedTree

    def measure(self, problem: TreeProblem, final: bool) -> Measure:
        """How much torque the declared or the final model leaves missing."""
        vector = self.search.final if final else self.search.null
        made = of_torque(problem, self.balances, vector, held_missing(self.search)[final])
        assert made is not None
        return made


def examine(inquiry: Inquiry) -> Examined:
    """Judge by the objective that tells most of the declared model, before anything is named."""
    q, balanced = inquiry, ()
    if q.factor is not None and not q.follows:
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
    before[TORQUE] = torques.measure(q.problem, final=False)
    judge, why = headline(before, q.asked)
    found_by_torque, by_torque = torques.search, None
    if judge == TORQUE:
        by_torque = _by_torque(q, torques, before, why)
        # of very many joints stretches are not searched: what is left is reported
        left = over_floor(q.problem, by_torque.found.final)
        if q.asked or q.many or left < q.criteria.explained:
            return by_torque
        found_by_torque = by_torque.by_torque
        judge = STRETCHES
        why = "what the torque along the motion shows leaves far more than noise in stretches"
    found = by_simulation(replace(q, hint=_hint_of(q, found_by_torque)))
    before, after = (
        q.simulated(m) | {TORQUE: of_torque(q.problem, torques.balances, m.fit.vector)}
        for m in (found.null, found.final)
    )
    if by_torque is not None and _worth(after) < _worth(by_torque.after):
        return by_torque
    return Examined(q, found, found_by_torque, before, after, judge, why)


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


def _with_friction_law(
    q: Inquiry, balanced: Sequence[Balance]
) -> tuple[Inquiry, Sequence[Balance], Reach]:
    """With the law of friction that the balances show, and what the data cover."""
    problem, reach = q.problem, scaled_reach(q.problem, *own_inertia(q.problem, q.null))

    def null_of(balance: Balance) -> Vector:
        assert q.factor is not None
        return within(part_of(q.null, balance), q.factor)

    problem, balanced = rubbing(
        problem, q.machine.tree, balanced, null_of, reach, q.criteria, _late_by_joint(q)
    )
    return replace(q, problem=problem), balanced, reach


def _late_by_joint(q: Inquiry) -> bool:
    """Whether the input may be late at each joint by itself: it is no measured torque."""
    return q.machine.log.input_kind != "torque"


def _search_torques(q: Inquiry, balanced: Sequence[Balance], reach: Reach) -> Balanced:
    """Search the balances."""
    assert q.factor is not None
    found = search_balances(
        q.problem, balanced, q.null, reach, q.criteria, _late_by_joint(q), q.factor
    )
    declared = model_of(q.problem, found, found.null, ())
    return Balanced(tuple(balanced), reach, found, declared)


def _by_torque(q: Inquiry, torques: Balanced, before: dict[str, Any], why: str) -> Examined:
    """What the balance names, confirmed by simulated stretches where it can be."""
    problem, search = q.problem, torques.search
    found = selection(problem, search, torques.declared, torques.reach)
    q.keep(found)
    search = confirmed(problem, search, found.final, q.criteria, torques.declared)
    if search is not torques.search:
        torques = replace(torques, search=search)
        found = selection(problem, search, torques.declared, torques.reach)
    after = q.simulated(found.final)
    after[TORQUE] = torques.measure(problem, final=True)
    return Examined(q, found, search, before, after, TORQUE, why)


def _hint_of(q: Inquiry, found: TorqueSearch | None) -> Hint | None:
    """Values and effects of the balance, from which the search of stretches goes on."""
    assert found is not None
    if not found.added:
        return None
    known = q.null.index()
    pairs = found.final.pairs()
    added = [(e, z) for e, z in pairs if e.key not in known]
    values = np.clip(found.final.values[: len(q.null)], q.null.low, q.null.high)
    start = q.null.at(values)
    return start.with_entries([e for e, _ in added], [z for _, z in added]), found.added


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
