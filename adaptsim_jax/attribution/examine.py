"""Which objective judges, and by it which effects: the balance of torques along the motion, or
simulated stretches, each checked by the other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from adaptsim_jax.attribution.criteria import CONFIRMATION, PRIOR_WIDTH
from adaptsim_jax.attribution.equation.balance import Balance, balances
from adaptsim_jax.attribution.equation.confirmed import confirmed
from adaptsim_jax.attribution.equation.filed import searched, without_bodies
from adaptsim_jax.attribution.equation.models import (
    TorqueSearch,
    model_of,
    part_of,
    search_balances,
    selection,
)
from adaptsim_jax.attribution.equation.rubbing import friction_notes, rubbing
from adaptsim_jax.attribution.equation.search import within
from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.held_out import FittedTree, held_error, modelled, over_floor
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import (
    STRETCHES,
    TORQUE,
    Measure,
    headline,
    of_simulation,
    of_torque,
    predicts_nothing,
)
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem, held, own_inertia, scaled_reach
from adaptsim_jax.attribution.report import account_of, evidence_of
from adaptsim_jax.attribution.score import candidates
from adaptsim_jax.attribution.select import Selection, select, select_shorter
from adaptsim_jax.attribution.torque_report import TorqueFound, by_torque, curves, held_missing
from adaptsim_jax.attribution.tree_objective import DECLARED_ROUNDS, Hint, TreeObjective
from adaptsim_jax.diagnosis.criteria import REPORT, Criteria
from adaptsim_jax.diagnosis.finding import Named
from adaptsim_jax.diagnosis.report import Account, report_of, withhold_names
from adaptsim_jax.diagnosis.search import backward_elimination
from adaptsim_jax.effects.base import Reach

NOTHING = "This model predicts nothing: by no yardstick does it do better than what needs no model, and no effect is named."


@dataclass(frozen=True)
class Inquiry:
    """A machine whose recording is examined, and how.

    Args:
        machine, problem: The machine, and its stretches of `horizon` s.
        null: What is fitted whatever is named.
        criteria: What counts as an effect.
        horizon: s.
        notify: Called with what is done.
        keep: With what a search has found so far.
        asked: The objective that is to judge, where it is not the one that tells most.
        factor: Within which bodies are those of the file along the motion; None: the balance of
            torques is not looked at.
        hint: What the search of stretches goes on from where the balance says nothing.
    """

    machine: Machine
    problem: TreeProblem
    null: Vector
    criteria: Criteria
    horizon: float
    notify: Callable[[str], None] = lambda note: None
    keep: Callable[[Selection], None] = lambda found: None
    asked: str | None = None
    factor: float | None = PRIOR_WIDTH.body_factor
    hint: Hint | None = None

    @property
    def follows(self) -> bool:
        """Whether an actuator follows commands."""
        return bool(np.any(held(self.machine.actuator)))

    @property
    def many(self) -> bool:
        """Whether there are too many joints for stretches to be searched."""
        torque = self.criteria.torque
        return self.problem.joints > (torque.whole if self.follows else torque.simulated)

    def simulated(self, model: FittedTree) -> dict[str, Any]:
        """What a model leaves of simulated stretches, by objective."""
        error = held_error(self.problem, model)
        return {STRETCHES: of_simulation(self.problem, error, STRETCHES, self.horizon)}


@dataclass(frozen=True)
class Examined:
    """What was found, by which objective, and why by that one.

    Args:
        inquiry: What was examined.
        found: Effects by the objective that judged.
        by_torque: What the balance of torques says, None where it cannot.
        before, after: Measures by objective of the declared model, fitted, and of the final one,
            None where one tells nothing.
        judge, why: The objective, and why.
        simulated: Whether errors are reported of simulated stretches, whoever judged.
    """

    inquiry: Inquiry
    found: Selection
    by_torque: TorqueSearch | None
    before: dict[str, Any]
    after: dict[str, Any]
    judge: str
    why: str
    simulated: bool = False

    @property
    def problem(self) -> TreeProblem:
        return self.inquiry.problem


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
    if q.factor is not None and informative(q.machine):
        balanced = balances(q.problem, q.machine.tracks)
    if not balanced:
        return _by_stretches(q, _why_stretches(q))
    q.notify("balance of torques")
    try:
        q, balanced, reach = _with_friction_law(q, balanced)
        torques = _search_torques(q, balanced, reach)
    except (ValueError, np.linalg.LinAlgError) as error:  # the other objective goes on by itself
        why = f"the torque along the motion tells nothing ({error})"
        return _by_stretches(replace(q, hint=None), why)
    before = q.simulated(torques.declared)
    before[TORQUE] = torques.measure(q.problem, torques.words, final=False)
    judge, why = _objective(q, torques, before)
    words, by_torque = torques.words, None
    if judge == TORQUE:
        by_torque = _by_torque(q, torques, before, why)
        near = q.criteria.near if q.follows else q.criteria.explained
        if (beyond := _beyond_balance(q, torques, by_torque)) is not None:
            return beyond
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


def _beyond_balance(q: Inquiry, torques: Balanced, by_torque: Examined) -> Examined | None:
    """What stretches of a machine of many joints show of effects that no balance can, such as a
    drive that gives; None where that is nothing.

    They are sought at joints that the balance's model simulates usefully, and yet leaves far more
    than the noise.
    """
    if q.follows or q.asked or not q.many:
        return None
    problem, measure = q.problem, by_torque.after[STRETCHES]
    left = measure.error > q.criteria.outlying * problem.floor[: problem.joints]
    joints = set(np.flatnonzero((measure.skills > REPORT.useful_skill) & left))
    known = {
        (e.name, j)
        for e in problem.effects
        for j in range(problem.joints)
        if e.in_balance or j not in joints
    }
    rest = replace(
        problem,
        effects=tuple(e for e in problem.effects if e.place != "model"),
        excluded=problem.excluded | known,
    )
    if not candidates(rest, torques.words.final, torques.reach):
        return None
    hint = _hint_of(q, by_torque.by_torque)
    found = select(rest, q.null, q.criteria, q.notify, q.keep, hint)
    if all(problem.effect(n.candidate.effect).in_balance for n in found.named):
        return None
    before, after = (q.simulated(m) for m in (found.null, found.final))
    why = "what simulated stretches show no balance of torques can"
    return Examined(q, found, by_torque.by_torque, before, after, STRETCHES, why)


def _hint_of(q: Inquiry, words: TorqueSearch) -> Hint | None:
    """Values and effects of the balance, from which the search of stretches goes on."""
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


def informative(machine: Machine) -> bool:
    """Whether the torque along the motion is known, up to a gain: that of a servo by its command
    error, where its gains are the file's.
    """
    return not machine.servo_times


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


def with_null(e: Examined, null: FittedTree) -> Examined:
    """With `null` as the model of which the report says what it leaves."""
    before = e.before | e.inquiry.simulated(null)
    return replace(e, found=replace(e.found, null=null), before=before)


def account(e: Examined) -> Account:
    """What the objective that judged contributes to the report, and what both say of the models."""
    q = e.inquiry
    made = account_of(q.machine, e.problem, e.found, q.criteria, q.horizon)
    if e.judge == TORQUE and e.by_torque is not None and not e.simulated:
        torques = TorqueFound(e.by_torque, e.before[TORQUE], e.after[TORQUE])
        made = by_torque(made, e.problem, torques, q.criteria)
    measures: dict[str, Any] = {"judge": e.judge, "why": e.why}
    for name, each in (("declared", e.before), ("mended", e.after)):
        measures[name] = {k: m.as_dict() for k, m in each.items() if m is not None}
    if predicts_nothing(e.after):
        measures["predicts_nothing"] = True
    notes = [*made.more["notes"], *_disagreement(e), *friction_notes(e.problem)]
    return replace(made, more={**made.more, "yardsticks": measures, "notes": notes})


@np.errstate(over="ignore", invalid="ignore")  # of stretches that run away
def reported(
    e: Examined, change: Callable[[Account], Account] = lambda made: made
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The report, and the arrays behind its page. change: of the account, what a task says
    otherwise.
    """
    report = report_of(e.found, change(account(e)))
    if predicts_nothing(e.after):
        withhold_names(report, NOTHING, left=True)
    evidence = evidence_of(e.problem, e.found, report)
    if e.by_torque is not None:
        evidence |= curves(e.problem, e.by_torque, e.found.final.fit.vector)
    return report, evidence


def so_far(q: Inquiry, found: Selection) -> dict[str, Any]:
    """The report on what a search has found until now."""
    return report_of(found, account_of(q.machine, q.problem, found, q.criteria, q.horizon))


def _disagreement(e: Examined) -> list[str]:
    """Where the two witnesses disagree, by numbers; and by which one it was judged."""
    notes = [f"Judged by {_WORDS[e.judge]}: {e.why}."]
    torque: tuple[Any, Any] = (e.before.get(TORQUE), e.after.get(TORQUE))
    other = e.before[STRETCHES], e.after[STRETCHES]
    if e.judge == TORQUE and e.found.named:
        skills = other[0].skill, other[1].skill
        if skills[1] < skills[0] - 0.05:
            notes.append(
                f"Simulated stretches disagree: skill against a straight line {skills[0]:.2f} "
                f"without and {skills[1]:.2f} with what is named; they tell little here."
            )
    elif e.found.named and torque[0] is not None and torque[1] is not None:
        shares = [float(np.mean(m.error / np.maximum(m.still, 1e-300))) for m in torque]
        if shares[1] > CONFIRMATION.contradicted * shares[0]:
            notes.append(
                f"The torque along the motion disagrees: {100 * shares[0]:.0f} % of it is missing "
                f"without and {100 * shares[1]:.0f} % with what is named."
            )
    return notes


_SHOWN = {True: "the command error", False: "the torque along the motion"}
_WORDS = {
    STRETCHES: "simulated stretches",
    "whole": "whole simulated trials",
    TORQUE: "the torque along the measured motion",
}
