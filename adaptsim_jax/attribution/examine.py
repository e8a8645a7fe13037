"""Which yardstick tells, and by it which effects: the balance of torques along the motion,
simulation, and each as the other's witness.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from adaptsim_jax.attribution.backward import backward_elimination
from adaptsim_jax.attribution.equation.balance import balances
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
from adaptsim_jax.attribution.equation.search import FACTOR, within
from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.held_out import FittedTree, held_error, modelled, over_floor
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem, held, own_inertia, scaled_reach
from adaptsim_jax.attribution.report import evidence_of, reported
from adaptsim_jax.attribution.select import ROUNDS, Hint, Selection, select, select_shorter
from adaptsim_jax.attribution.torque_report import (
    bound_notes,
    curves,
    held_missing,
    report_torque,
    unnamed_notes,
)
from adaptsim_jax.attribution.yardsticks import (
    STRETCHES,
    TORQUE,
    Measure,
    headline,
    of_simulation,
    of_torque,
    predicts_nothing,
)
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.schema import with_effects
from adaptsim_jax.effects.base import Reach

NOTHING = "This model predicts nothing: by no yardstick does it do better than what needs no model, and no effect is named."
CONTRADICTED = (
    1.05  # of the torque's missing part: what simulation names must not make more of it missing
)


@dataclass(frozen=True)
class Examined:
    """problem, what was found, what the balance of torques says (None where it cannot), yardsticks
    of the declared model, fitted, and of
    the final one, which of them judged and why.
    """

    problem: TreeProblem
    found: Selection
    by_torque: TorqueSearch | None
    before: dict[str, Any]  # Measure by yardstick, None where it tells nothing
    after: dict[str, Any]
    judge: str
    why: str
    simulated: bool = False  # errors are told of simulated stretches, whoever judged


def examine(
    machine: Machine,
    problem: TreeProblem,
    null: Vector,
    criteria: Criteria,
    horizon: float,
    notify: Callable[[str], None],
    keep: Callable[[Selection], None] = lambda found: None,
    asked: str | None = None,
    factor: float | None = FACTOR,
    hint: Hint | None = None,
) -> Examined:
    """Judge by the yardstick that tells most of the declared model, before anything is named
    (command errors also with what they name: a late command hides all else of them). null: what is
    fitted whatever is named;
    asked: another yardstick; factor: within which bodies are those of the file along the motion,
    None: the balance of torques is not looked at; hint: as of `select`, where the balance says
    nothing.
    """
    if factor is not None and informative(machine):
        balanced = balances(problem, machine.tracks)
    else:
        balanced = ()
    if not balanced or factor is None:
        found = by_simulation(problem, null, criteria, notify, keep, hint)
        before, after = (_simulated(problem, m, horizon) for m in (found.null, found.final))
        commanded = np.any(held(machine.actuator))
        if factor is not None:
            why = "no torque is known along the motion"
        else:
            why = "stretches are this task's yardstick"
        if commanded:
            why = f"it follows commands; over {horizon:g} s a straight line says less"
        return Examined(problem, found, None, before, after, STRETCHES, why)
    notify("balance of torques")
    follows = bool(np.any(held(machine.actuator)))
    reach = scaled_reach(problem, *own_inertia(problem, null))
    try:
        commanded = machine.log.input_kind != "torque"

        def part(b):
            return within(part_of(without_bodies(null) if follows else null, b), factor)

        problem, balanced = rubbing(
            problem, machine.tree, balanced, part, reach, criteria, commanded
        )

        def search(vector):
            return search_balances(problem, balanced, vector, reach, criteria, commanded, factor)

        if follows and len(without_bodies(null)) < len(null):
            words, free, each = searched(problem, search, null, criteria)
        else:
            words = free = search(null)
            each = False
        bare = len(words.null) < len(null)
        declared = model_of(problem, words, words.null, ())
    except (ValueError, np.linalg.LinAlgError) as error:  # the other witness goes on by itself
        found = by_simulation(problem, null, criteria, notify, keep)
        before, after = (_simulated(problem, m, horizon) for m in (found.null, found.final))
        return Examined(
            problem,
            found,
            None,
            before,
            after,
            STRETCHES,
            f"the torque along the motion tells nothing ({error})",
        )
    before = _simulated(problem, declared, horizon) | {
        TORQUE: of_torque(problem, balanced, words.null, held_missing(words)[0])
    }
    usual: Any = of_torque(problem, balanced, free.null, held_missing(free)[0])
    if follows:  # a late command hides all that its errors tell until it is named
        named: Any = of_torque(problem, balanced, words.final, held_missing(words)[1])
        usual = max(usual, named, key=lambda m: m.skill)
    judge, why = headline(before | {TORQUE: usual}, follows, asked)
    many = problem.joints > (criteria.torque.whole if follows else criteria.torque.simulated)
    if follows and many and judge != TORQUE and not asked:
        judge, why = (
            TORQUE,
            f"of {problem.joints} joints that follow commands stretches are not searched",
        )
    if bare and judge == TORQUE:
        sought = len(free.null) > len(words.null)
        if sought:
            other = "fitted ones tell left-out torques no better"
        else:
            other = "fitted ones were not sought"
        why = f"{why}; bodies and damping are the file's: {other}"
    by_torque = None
    if judge == TORQUE:
        found = selection(problem, words, declared, reach)
        keep(found)
        if not follows or not each:
            known = words
            null_of = None if follows else declared
            words = confirmed(problem, words, found.final, criteria, null_of)
            if words is not known:
                found = selection(problem, words, declared, reach)
        if follows and not many:
            found = _polished(problem, found, reach, criteria, notify, bool(asked))
        after = _simulated(problem, found.final, horizon)
        after[TORQUE] = of_torque(problem, balanced, words.final, held_missing(words)[1])
        by_torque = Examined(problem, found, words, before, after, judge, why, follows)
        good = over_floor(problem, found.final) < (criteria.near if follows else criteria.explained)
        if (
            asked or good or many
        ):  # of very many joints stretches are not searched: what is left is told
            return by_torque
        judge, why = (
            STRETCHES,
            f"what {_SHOWN[follows]} shows leaves far more than noise in simulated stretches",
        )
    hint = None
    if words.added and not follows:
        effects = [
            (e, z)
            for e, z in zip(words.final.entries, words.final.values, strict=True)
            if e.key not in null.index()
        ]
        start = null.at(_clipped(null, words.final.values[: len(null)]))
        hint = start.with_entries([e for e, _ in effects], [z for _, z in effects]), words.added
    found = by_simulation(problem, null, criteria, notify, keep, hint)
    before = _simulated(problem, found.null, horizon) | {
        TORQUE: of_torque(problem, balanced, found.null.fit.vector)
    }
    after = _simulated(problem, found.final, horizon) | {
        TORQUE: of_torque(problem, balanced, found.final.fit.vector)
    }
    if by_torque is not None and not follows and _worth(after) < _worth(by_torque.after):
        return by_torque
    return Examined(problem, found, words, before, after, judge, why)


def _polished(
    problem: TreeProblem,
    found: Selection,
    reach: Reach,
    criteria: Criteria,
    notify: Callable[[str], None],
    asked: bool,
) -> Selection:
    """With the final values fitted by simulation, since along the motion a time or a gain is only
    so exact, and each of several names held against the others there. Values of the motion stay
    where they simulate to within the noise, with all names. Where what is fitted leaves so much
    that stretches will be searched (unless this yardstick was asked for), nothing more is asked.
    """
    several, good = len(found.named) > 1, over_floor(problem, found.final) <= criteria.explained
    if good and not several:
        return found
    notify("fit by simulation")
    again = found.final.fit
    if not good:
        again = fit(problem, again.vector, again.starts, rounds=ROUNDS)
    whole = modelled(problem, tuple(n.candidate for n in found.named), again)
    if not several or (not asked and over_floor(problem, whole) >= criteria.near):
        return replace(found, final=whole)
    trace, known = list(found.trace), {n.candidate.key: n for n in found.named}
    final, stay = backward_elimination(problem, whole, reach, criteria, trace, notify, rivals=False)
    named = tuple(replace(n, alternatives=known[n.candidate.key].alternatives) for n in stay)
    selected = found.final if good and len(stay) == len(known) else final
    return replace(found, final=selected, named=named, trace=tuple(trace))


def informative(machine: Machine) -> bool:
    """Whether the torque along the motion is known, up to a gain: that of a servo by its command
    error, where its gains are the file's.
    """
    return not machine.servo_times


def _clipped(vector: Vector, values: np.ndarray) -> np.ndarray:
    return np.clip(values, vector.low, vector.high)


def by_simulation(
    problem: TreeProblem, null: Vector, criteria: Criteria, notify, keep, hint=None
) -> Selection:
    """The search by simulated stretches. Over their beginnings where the whole names nothing and
    far more than noise is left. hint: as of
    `select`.
    """
    found = select(problem, null, criteria, notify, keep, hint)
    if not found.named and over_floor(problem, found.final) > criteria.odd:
        found = select_shorter(problem, null, criteria, found, notify)
    return found


def _worth(measures: dict[str, Measure | None]) -> float:
    """Skill of a model by all yardsticks together."""
    return sum(m.skill for m in measures.values() if m is not None)


def _simulated(problem: TreeProblem, model: FittedTree, horizon: float) -> dict[str, Any]:
    return {STRETCHES: of_simulation(problem, held_error(problem, model), STRETCHES, horizon)}


def with_null(e: Examined, null: FittedTree, horizon: float) -> Examined:
    """With `null` as the model of which the report says what it leaves."""
    before = e.before | _simulated(e.problem, null, horizon)
    return replace(e, found=replace(e.found, null=null), before=before)


def report_of(
    machine: Machine, e: Examined, criteria: Criteria, horizon: float
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The report, and the arrays behind its page."""
    problem, found = e.problem, e.found
    report = reported(machine, problem, found, criteria, horizon)
    if e.judge == TORQUE and e.by_torque is not None and not e.simulated:
        report_torque(report, problem, e.by_torque, e.before[TORQUE], e.after[TORQUE], criteria)
        report["notes"] += [
            *unnamed_notes(problem, e.by_torque),
            *bound_notes(problem, e.by_torque),
        ]
    report["yardsticks"] = {
        "judge": e.judge,
        "why": e.why,
        **{
            name: {k: m.as_dict() for k, m in ms.items() if m is not None}
            for name, ms in (("declared", e.before), ("mended", e.after))
        },
    }
    report["notes"] += [*_disagreement(e), *friction_notes(problem)]
    if predicts_nothing(e.after):
        report["message"] = f"{NOTHING} {report['message']}"
        report["yardsticks"]["predicts_nothing"] = True
        if report["effects"]:
            report["not_established"] += [
                f"{row['name'].replace('_', ' ')} at {row['where']}: better than a model that "
                "predicts nothing"
                for row in report["effects"]
            ]
            with_effects(report, [], left=True)
    evidence = evidence_of(problem, found, report)
    if e.by_torque is not None:
        evidence |= curves(problem, e.by_torque, found.final.fit.vector)
    return report, evidence


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
        if shares[1] > CONTRADICTED * shares[0]:
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
