"""What the balance of torques named of a machine that follows commands, held against simulation,
without a fit by it.

A command error is small beside what drives it, so that trifles of a servo's law show in it which no
motion shows. Each effect must therefore also simulate left-out stretches better than the balance
refitted without it.
"""

from dataclasses import replace

from adaptsim_jax.attribution.backward import apart_in_turn
from adaptsim_jax.attribution.equation.models import Said, model_of, without
from adaptsim_jax.attribution.held_out import Model, paired
from adaptsim_jax.attribution.problem import Problem
from adaptsim_jax.attribution.score import Candidate
from adaptsim_jax.attribution.stays import eased, worth
from adaptsim_jax.attribution.weights import losses
from adaptsim_jax.core.parallel import parallel_map
from adaptsim_jax.diagnosis.criteria import Criteria


def confirmed(problem: Problem, found: Said, whole: Model, criteria: Criteria) -> Said:
    """Without the effects that simulation does not bear out, the weakest first and with it those
    that are not beside it, refitted by the balance. One that takes far more than the least off is
    not asked again; where all together take nothing off, none is asked (closed testing; Marcus,
    Peritz and Gabriel, 1976). whole: the model of all that is found.
    """
    sure: set[tuple] = set()
    if len(found.named) > 1:
        bare = _gone(without(problem, found, [n.candidate for n in found.named], []))
        model = model_of(problem, bare, bare.final, bare.added, whole.fit.starts)
        if _gain(problem, model, whole, criteria)[0] <= criteria.size:
            return bare
    while found.named:

        def weighed(c: Candidate, found=found, whole=whole) -> tuple[float, bool, Candidate, Said]:
            less = without(problem, found, [c], [])
            model = model_of(problem, less, less.final, less.added, whole.fit.starts)
            return *_gain(problem, model, whole, criteria), c, less

        asked = [n.candidate for n in found.named if n.candidate.key not in sure]
        tests = parallel_map(weighed, asked)
        weak = [(gain, c, less) for gain, stays, c, less in tests if not stays]
        if not weak:
            return _told_apart(problem, found, whole, criteria)
        sure |= {c.key for gain, stays, c, _ in tests if stays and gain > criteria.apart}
        gone = apart_in_turn(sorted(weak, key=lambda w: w[0]), lambda w: w[1])
        found = _gone(
            gone[0][2] if len(gone) == 1 else without(problem, found, [c for _, c, _ in gone], [])
        )
        whole = model_of(problem, found, found.final, found.added, whole.fit.starts)
    return found


def _told_apart(problem: Problem, found: Said, whole: Model, criteria: Criteria) -> Said:
    """With those alternatives of each effect alone that simulate left-out stretches as well in its
    place.
    """

    def as_well(pair: tuple[Candidate, Candidate]) -> bool:
        c, other = pair
        instead = without(problem, found, [c], [other])
        model = model_of(problem, instead, instead.final, instead.added, whole.fit.starts)
        test = paired(
            problem, losses(problem, model.held.paths, whole.fit.weights), whole.held.loss
        )
        return test.p > criteria.confidence or test.gain < criteria.gap

    pairs = [
        (k.candidate, other) for w in found.witnesses for k in w.kept for other in k.alternatives
    ]
    alike = {
        (c.key, o.key)
        for (c, o), good in zip(pairs, parallel_map(as_well, pairs), strict=True)
        if good
    }

    def apart(k):
        return replace(
            k, alternatives=tuple(o for o in k.alternatives if (k.candidate.key, o.key) in alike)
        )

    witnesses = tuple(replace(w, kept=tuple(apart(k) for k in w.kept)) for w in found.witnesses)
    if pairs:
        return replace(found, witnesses=witnesses)
    return found


def _gone(less: Said) -> Said:
    """What is found less, without the names that are no longer in it."""

    def names(w):
        return tuple(k for k in w.kept if any(k.candidate is c for c in w.added))

    return replace(less, witnesses=tuple(replace(w, kept=names(w)) for w in less.witnesses))


def _gain(problem: Problem, less: Model, whole: Model, criteria: Criteria) -> tuple[float, bool]:
    """Share of the left-out loss that an effect takes off, and whether it stays."""
    test = paired(problem, losses(problem, less.held.paths, whole.fit.weights), whole.held.loss)
    holds = test.p <= criteria.confidence and test.gain > criteria.size
    stays = (
        holds
        and eased(problem, less, whole) > 0.0
        and worth(problem, less, whole) >= criteria.worth
    )
    return test.gain, stays
