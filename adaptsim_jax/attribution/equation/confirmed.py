"""What the balance of torques named, held against simulation, without a fit by it.

A command error is small beside what drives it, so that trifles of a servo's law show in it which no
motion shows. Where the declared model simulates to within a few times its noise, stretches tell all
that there is. In both cases each effect must also simulate left-out stretches better than the
balance refitted without it. Elsewhere simulation has a veto: no joint at which it tells anything
may be simulated worse with a name than without. Where it tells nothing it has no say: stiff arms
simulate worse with right frictions.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from adaptsim_jax.attribution.backward import separable_in_turn
from adaptsim_jax.attribution.equation.models import TorqueSearch, model_of, without
from adaptsim_jax.attribution.forecast import without_a_model
from adaptsim_jax.attribution.held_out import FittedTree, held_error, over_floor, paired
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.score import JointCandidate
from adaptsim_jax.attribution.stays import eased, worth
from adaptsim_jax.attribution.weights import losses
from adaptsim_jax.attribution.yardsticks import WORTH
from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.folds import BLOCKS, pieces
from adaptsim_jax.diagnosis.testing import paired_test

HARM = 0.1
"""Of the squared error of a joint's angles (5 % of the error), that may be left more with a name than
without. Over 27 reports right names left 1.5 % of the error more at most, wrong ones 20 % at least.
"""


def confirmed(
    problem: TreeProblem,
    found: TorqueSearch,
    whole: FittedTree,
    criteria: Criteria,
    null: FittedTree | None = None,
) -> TorqueSearch:
    """Without the effects that simulation does not bear out, the weakest first and with it those
    that are not beside it, refitted by the balance. One that takes far more than the least off is
    not asked again. Where all together take nothing off, none is asked (closed testing; Marcus,
    Peritz and Gabriel, 1976). whole: the model of all that is found; null: the declared model of a
    machine that is driven by torque, whose stretches may tell nothing.
    """
    sure: set[tuple] = set()
    near = null is None or over_floor(problem, null) <= criteria.near
    if not near and not any(informative_joints(problem, null, criteria)):
        return found
    if near and len(found.named) > 1:
        bare = _gone(without(problem, found, [n.candidate for n in found.named], []))
        model = model_of(problem, bare, bare.final, bare.added, whole.fit.starts)
        if _gain(problem, model, whole, criteria)[0] <= criteria.size:
            return bare
    while found.named:

        def weighed(
            c: JointCandidate, found=found, whole=whole
        ) -> tuple[float, bool, JointCandidate, TorqueSearch]:
            less = without(problem, found, [c], [])
            model = model_of(problem, less, less.final, less.added, whole.fit.starts)
            gain, stays = _gain(problem, model, whole, criteria)
            if not near:
                stays = not any(harmed(problem, null, model, whole, _shown(found, c), criteria))
            return gain, stays, c, less

        asked = [n.candidate for n in found.named if n.candidate.key not in sure]
        tests = parallel_map(weighed, asked)
        weak = [(gain, c, less) for gain, stays, c, less in tests if not stays]
        if not weak and not near and (together := _harmful(problem, found, null, whole, criteria)):
            weak = [z[:1] + z[2:] for z in tests if z[2] is together]
        if not weak and not near:
            return found
        if not weak:
            return _separable(problem, found, whole, criteria)
        if near:
            sure |= {c.key for gain, stays, c, _ in tests if stays and gain > criteria.apart}
        gone = separable_in_turn(sorted(weak, key=lambda w: w[0]), lambda w: w[1])
        found = _gone(
            gone[0][2] if len(gone) == 1 else without(problem, found, [c for _, c, _ in gone], [])
        )
        whole = model_of(problem, found, found.final, found.added, whole.fit.starts)
    return found


def _separable(
    problem: TreeProblem, found: TorqueSearch, whole: FittedTree, criteria: Criteria
) -> TorqueSearch:
    """With those alternatives of each effect alone that simulate left-out stretches as well in its
    place.
    """

    def as_well(pair: tuple[JointCandidate, JointCandidate]) -> bool:
        c, other = pair
        instead = without(problem, found, [c], [other])
        model = model_of(problem, instead, instead.final, instead.added, whole.fit.starts)
        test = paired(
            problem, losses(problem, model.held.paths, whole.fit.weights), whole.held.loss
        )
        return test.p > criteria.confidence or test.gain < criteria.gap

    pairs = [
        (k.candidate, other) for w in found.searches for k in w.named for other in k.alternatives
    ]
    alike = {
        (c.key, o.key)
        for (c, o), good in zip(pairs, parallel_map(as_well, pairs), strict=True)
        if good
    }

    def separable(k):
        return replace(
            k, alternatives=tuple(o for o in k.alternatives if (k.candidate.key, o.key) in alike)
        )

    searches = tuple(replace(w, named=tuple(separable(k) for k in w.named)) for w in found.searches)
    if pairs:
        return replace(found, searches=searches)
    return found


def informative_joints(
    problem: TreeProblem, null: FittedTree | None, criteria: Criteria
) -> list[bool]:
    """At which joints simulated stretches of the declared model `null` tell anything: they come
    within a few times the noise, or beat what needs no model.
    """
    if null is None:
        return [True] * problem.joints
    error = np.median(held_error(problem, null), 0)
    nothing = np.min([np.median(z, 0) for z in without_a_model(problem)], 0)
    near = error <= criteria.near * problem.floor[: problem.joints]
    return list(near | (error < (1.0 - WORTH) * nothing))


def harmed(
    problem: TreeProblem,
    null: FittedTree | None,
    less: FittedTree,
    more: FittedTree,
    joints: Iterable[int],
    criteria: Criteria,
) -> list[int]:
    """Those of `joints` that `more` simulates worse than `less`, beyond its own test, where stretches
    tell anything.
    """
    informative = informative_joints(problem, null, criteria)
    count = len(problem.fold)
    block = pieces(problem.groups[0].stretches.trial[:count], BLOCKS)
    one, two = (np.square(held_error(problem, m)) for m in (less, more))
    out = []
    for j in joints:
        test = paired_test(two[:, j], one[:, j], problem.fold, block)
        if informative[j] and test.gain > HARM and test.p <= criteria.confidence:
            out.append(j)
    return out


def _shown(found: TorqueSearch, c: JointCandidate) -> list[int]:
    """Joints of the machine at which an effect shows."""
    for w in found.searches:
        if any(k is c for k in w.added):
            return [w.balance.group.joints[k] for k in w.state.own(c)]
    return list(c.joints)


def _harmful(
    problem: TreeProblem,
    found: TorqueSearch,
    null: FittedTree | None,
    whole: FittedTree,
    criteria: Criteria,
) -> JointCandidate | None:
    """Of the names at joints that all of them together harm the one that gains least."""
    worse = set(harmed(problem, null, null or whole, whole, range(problem.joints), criteria))
    some = [n for n in found.named if worse & set(_shown(found, n.candidate))]
    if not some:
        return None
    return min(some, key=lambda n: n.test.gain).candidate


def _gone(less: TorqueSearch) -> TorqueSearch:
    """What is found less, without the names that are no longer in it."""

    def names(w):
        return tuple(k for k in w.named if any(k.candidate is c for c in w.added))

    return replace(less, searches=tuple(replace(w, named=names(w)) for w in less.searches))


def _gain(
    problem: TreeProblem, less: FittedTree, whole: FittedTree, criteria: Criteria
) -> tuple[float, bool]:
    """Share of the left-out loss that an effect takes off, and whether it stays."""
    test = paired(problem, losses(problem, less.held.paths, whole.fit.weights), whole.held.loss)
    holds = test.p <= criteria.confidence and test.gain > criteria.size
    stays = (
        holds
        and eased(problem, less, whole) > 0.0
        and worth(problem, less, whole) >= criteria.worth
    )
    return test.gain, stays
