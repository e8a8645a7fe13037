"""Backward: each effect tested beside all others, and against its look-alikes."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

from adaptsim_jax.attribution.estimate import fit
from adaptsim_jax.attribution.held_out import FittedTree, attempted, modelled, paired, refit
from adaptsim_jax.attribution.parameters import TILT, Vector
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.score import CandidateScore, JointCandidate, candidates, table
from adaptsim_jax.attribution.stays import SimulatedEvidence, between_rows, steadiness
from adaptsim_jax.attribution.weights import losses
from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Named, Step
from adaptsim_jax.diagnosis.rules import Reason, refusal, step_reason
from adaptsim_jax.diagnosis.testing import Test
from adaptsim_jax.effects.base import Reach

T = TypeVar("T")


def scored(
    problem: TreeProblem,
    model: FittedTree,
    reach: Reach,
    laws: bool,
    near: JointCandidate | None = None,
) -> list[CandidateScore]:
    """Scores of all candidates that are laws, or of those that only describe. near: of those alone
    that act beside it.
    """
    every = candidates(problem, model.fit.vector, reach)
    if near is not None:
        every = [c for c in every if adjacent(c, near)]
    return table(
        problem, model.lin, [c for c in every if problem.effect(c.effect).describes is not laws]
    )


def more(large: FittedTree, small: FittedTree) -> int:
    """Fitted parameters that one model has more than another."""

    def fitted(m):
        return sum(e.low < e.high for e in m.fit.vector.entries)

    return fitted(large) - fitted(small)


def keys_of(model: FittedTree, c: JointCandidate) -> list[tuple]:
    """Keys of an effect's entries in a model, shapes too."""
    return [
        e.key
        for e in model.fit.vector.entries
        if e.owner == c.effect and set(e.joints) <= set(c.joints)
    ]


def adjacent(c: JointCandidate, other: JointCandidate) -> bool:
    """Whether two effects act at the same joints or at ones next to each other in number, where one
    may stand in for the other.
    """
    return any(abs(j - k) < 2 for j in c.joints for k in other.joints)


def separable_in_turn(some: Sequence[T], effect: Callable[[T], JointCandidate]) -> list[T]:
    """The first, and each later one that is beside none taken before it: these may go at once."""
    taken: list[T] = []
    for one in some:
        if not any(adjacent(effect(one), effect(other)) for other in taken):
            taken.append(one)
    return taken


def without(
    problem: TreeProblem, model: FittedTree, gone: JointCandidate, criteria: Criteria
) -> FittedTree:
    """The model without one of its effects, refitted under the same weights."""
    vector = model.fit.vector.without(keys_of(model, gone))
    less = tuple(c for c in model.added if c is not gone)
    return compared(problem, model, less, model, vector, model.fit.starts, gone.joints, criteria)


def compared(
    problem: TreeProblem,
    model: FittedTree,
    added,
    like: FittedTree,
    vector: Vector,
    starts,
    joints,
    criteria: Criteria,
) -> FittedTree:
    """Another model, refitted under the weights of `model` as far as it takes to compare them: to
    the end where it might do as well. like: one that is the same but at `joints`.
    """
    weights, most = model.fit.weights, criteria.rounds
    fitted = refit(problem, vector, starts, joints, most, weights, 2 * criteria.glance)
    other = modelled(problem, added, fitted, weights, like)
    left = most - fitted.rounds
    separable = paired(problem, other.held.loss, model.held.loss).gain > criteria.apart
    if separable or left <= 0 or fitted.code == "stuck":
        return other
    fitted = refit(problem, fitted.vector, fitted.starts, joints, left, weights)
    return modelled(problem, added, fitted, weights, like)


def from_afar(
    problem: TreeProblem, settle: Callable[..., FittedTree], vector: Vector, starts, rounds: int
) -> FittedTree:
    """settle(vector, starts), which fits under given weights; where that is stuck at once, also
    after a fit by weights of its own: what weighs after a good fit is a narrow valley from afar. Of
    both the one that leaves less.
    """
    found = settle(vector, starts)
    if found.fit.code != "stuck":
        return found
    near = fit(problem, vector, starts, rounds=rounds)
    return min(found, settle(near.vector, near.starts), key=lambda m: m.fit.total)


def backward_elimination(
    problem, model: FittedTree, reach, criteria: Criteria, trace, notify, rivals: bool = True
) -> tuple[FittedTree, tuple[Named, ...]]:
    """Backward: effects that do not hold out beside the others go, the weakest first and with it
    those that are not beside it. The rest against their look-alikes, of which the simplest has the
    name (unless rivals are not asked for).
    """
    model = of_members(problem, model, criteria, trace, notify)
    gone: set[tuple] = set()
    sure: set[tuple] = (
        set()
    )  # effects that were far from going: they are tested again once nothing else goes
    while True:

        def tested(
            c: JointCandidate, model=model
        ) -> tuple[JointCandidate, FittedTree, Test, float]:
            notify(f"without {c.effect} at {where(problem, c)}")
            less = without(problem, model, c, criteria)
            return c, less, paired(problem, less.held.loss, model.held.loss), steadiness(model, c)

        tests = parallel_map(tested, [c for c in model.added if c.key not in sure])
        read, failing = _weak(problem, model, tests, criteria)
        if sure and not read and not failing:
            tests += parallel_map(tested, [c for c in model.added if c.key in sure])
            read, failing = _weak(problem, model, tests, criteria)
        sure |= {c.key for c, _, test, _ in tests if test.gain > criteria.apart}
        if read:
            c, test = read
            trace.append(Step("read", c, test, step_reason(_read_code(problem, c))))
            model = replace(model, added=tuple(k for k in model.added if k is not c))
            continue
        also: list[tuple] = []
        if failing:
            (_, _, less, _, _), *others = weakest = separable_in_turn(
                sorted(failing, key=lambda f: f[0]), lambda f: f[1]
            )
            trace += [Step("dropped", c, test, why) for _, c, _, test, why in weakest]
            less = replace(
                less, added=tuple(c for c in less.added if all(c is not f[1] for f in others))
            )
            also = [key for f in others for key in keys_of(model, f[1])]
        else:
            others_of = partial(
                look_alikes, problem, model, reach=reach, criteria=criteria, notify=notify
            )
            alike = [others_of(less, c) if rivals else [] for c, less, _, _ in tests]
            simpler = [
                (c, other, test)
                for (c, *_), others in zip(tests, alike, strict=True)
                for other, test in others
                if other.added[-1].key not in gone
                and len(other.fit.vector) < len(model.fit.vector)
                and test.gain < max(criteria.gap, criteria.size * more(model, other))
            ]
            if not simpler:
                break
            c, less, test = min(simpler, key=lambda s: s[2].gain)
            gone.add(c.key)
            simpler_one = less.added[-1].effect
            reason = step_reason("simpler_has_the_name", test.gain, one=simpler_one)
            trace.append(Step("replaced", c, test, reason))
        own = fit(problem, less.fit.vector.without(also), less.fit.starts, rounds=criteria.rounds)
        model = modelled(problem, less.added, own)
    return model, tuple(
        Named(c, test, steady, tuple(other.added[-1] for other, _ in others))
        for (c, _, test, steady), others in zip(tests, alike, strict=True)
    )


def of_members(
    problem: TreeProblem, model: FittedTree, criteria: Criteria, trace, notify
) -> FittedTree:
    """The model whose effects at many joints are at those that show it: each joint is tested beside
    all else, as if it were an effect of its own. Those that do not hold out go together; where that
    predicts worse, the weaker half.
    """
    many = [c for c in model.added if c.sharing == "all" and len(c.joints) > 1]
    parts = [(c, one) for c in many for one in c.split()]

    def tested(
        part: tuple[JointCandidate, JointCandidate],
    ) -> tuple[float, JointCandidate, Test, Reason | None]:
        c, one = part
        notify(f"without {one.effect} at {where(problem, one)}")
        alone = replace(model, added=(*(k for k in model.added if k is not c), one))
        less = without(problem, alone, one, criteria)
        test = paired(problem, less.held.loss, model.held.loss)
        steady = steadiness(model, one)
        evidence = SimulatedEvidence(problem, model, less, one, test, steady, criteria)
        return test.gain, one, test, refusal(evidence)

    weak = sorted((t for t in parallel_map(tested, parts) if t[3]), key=lambda t: t[0])
    while weak:
        less = trimmed(
            problem, model, [e.key for _, one, *_ in weak for e in one.entries], criteria
        )
        test = paired(problem, losses(problem, less.held.paths, model.fit.weights), model.held.loss)
        if test.p > criteria.confidence or test.gain < criteria.size * more(model, less):
            trace += [Step("dropped", one, test, why) for _, one, test, why in weak]
            return less
        weak = weak[: len(weak) // 2]
    return model


def _read_code(problem: TreeProblem, c: JointCandidate) -> str:
    """By which code an effect is how rows are read."""
    if problem.effect(c.effect).shifts_time:
        return "commands_between_rows"
    return "rotors_are_steps"


def trimmed(
    problem: TreeProblem, model: FittedTree, keys: Sequence[tuple], criteria: Criteria
) -> FittedTree:
    """The model without some entries of its effects, refitted; as it is where there are none."""
    if not keys:
        return model
    added = []
    for c in model.added:
        left = [e for e in c.entries if e.key not in keys]
        added += [c if len(left) == len(c.entries) else c.at(left)] if left else []
    own = fit(problem, model.fit.vector.without(keys), model.fit.starts, rounds=criteria.rounds)
    return modelled(problem, added, own)


def _weak(problem: TreeProblem, model: FittedTree, tests, criteria: Criteria):
    """Of tested effects (candidate, model without it, test, steadiness) one that is only how rows
    are read, with its test, and those that do not stay.
    """
    read, failing = None, []
    for c, less, test, steady in tests:
        if between_rows(problem, model, c, criteria) and test.p <= criteria.confidence:
            read = c, test
        elif why := refusal(SimulatedEvidence(problem, model, less, c, test, steady, criteria)):
            failing.append((test.gain, c, less, test, why))
    return read, failing


def look_alikes(
    problem,
    model: FittedTree,
    less: FittedTree,
    c: JointCandidate,
    reach,
    criteria: Criteria,
    notify,
) -> list[tuple[FittedTree, Test]]:
    """Models with effects that do as well as `c` in its place (the last that each has), and the
    test of the model against them: of those that gain most without it at its joints or those beside
    them, and of those that it is mistaken for. What describes without a law is no rival of one: it
    does nearly as well as most.
    """
    scores = scored(problem, less, reach, True, c)
    if problem.effect(c.effect).describes:
        scores = sorted(scores + scored(problem, less, reach, False, c), key=lambda s: -s.held_out)
    own = next((s.held_out for s in scores if s.candidate.key == c.key), 0.0)
    alike = problem.effect(c.effect).look_alikes
    rivals = [
        s
        for s in scores
        if s.candidate.key != c.key
        and not (s.candidate.effect == c.effect and set(c.joints) & set(s.candidate.joints))
        and s.held_out > (0.5 if s.candidate.effect in alike else 0.8) * own
    ]
    gained = paired(problem, less.held.loss, model.held.loss).gain
    gap = max(criteria.gap, 1.0 - (1.0 - gained) ** criteria.alike)

    def instead(score: CandidateScore) -> tuple[FittedTree, Test]:
        notify(f"{score.candidate.effect} in place of {c.effect}")
        touched = (*c.joints, *score.candidate.joints)
        added = (*less.added, score.candidate)

        def settle(vector, starts):
            return compared(problem, model, added, less, vector, starts, touched, criteria)

        vector, starts, _ = attempted(problem, less, reach, score)
        other = from_afar(problem, settle, vector, starts, criteria.rounds)
        return other, paired(problem, other.held.loss, model.held.loss)

    return [
        (other, test)
        for other, test in parallel_map(instead, rivals[:3])
        if test.gain < gap or test.p > criteria.confidence
    ]


def where(problem: TreeProblem, c: JointCandidate) -> str:
    if c.effect == TILT:
        return "base"
    return ", ".join(problem.joint_names[j] for j in c.joints)
