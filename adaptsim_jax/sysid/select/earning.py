"""What an effect must earn to be added: likelihood for its price, and a torque that matters."""

import numpy as np

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fitted import Fit, force_ratio, gain, likeliest, rough_gain
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.select.trace import Trace


def choose(problem: Problem, trials: list[Fit], base: Fit) -> Fit | None:
    """The likeliest for its price; or one with fewer parameters that leaves nothing more that would matter, and would be named if
    that one would."""
    best = likeliest(trials, problem.criteria.price)
    if best is None:
        return None
    named = earns(problem, best, base, base)
    simpler = [t for t in trials if t.size < best.size and (not named or earns(problem, t, base, base))]
    enough = [t for t in simpler if not matters(problem, best, t, base, 0.2)]
    return likeliest(enough, problem.criteria.price) or best


def matters(problem: Problem, new: Fit, old: Fit, base: Fit, strict: float = 1.0) -> bool:
    """Whether the torque that `new` explains beyond `old` matters: to the joint, and beside what was unexplained. A base model
    that went astray leaves forces beyond the torques themselves, beside which nothing would matter: then beside what `old` leaves."""
    own = np.maximum(old.moving - new.moving, 0.0)
    share = felt(problem, new, old)
    astray = np.any(base.moving > np.square(problem.torque_scale))
    beside = np.sqrt(own.sum() / max((old if astray else base).moving.sum(), 1e-300))
    return bool(share > strict * problem.criteria.least_share and beside > strict * problem.criteria.least_fall)


def felt(problem: Problem, new: Fit, old: Fit) -> float:
    """The torque that `new` explains beyond `old`, as a share of what moves the joint; of the joint where that is most."""
    return float(np.max(np.sqrt(np.maximum(old.moving - new.moving, 0.0)) / problem.torque_scale))


def pays(new: Fit, old: Fit, criteria: Criteria) -> bool:
    """More likely by more than the price of its parameters and the selection it was picked from."""
    return _enough(gain(new, old), new, old, criteria)


def pays_roughly(new: Fit, old: Fit, criteria: Criteria) -> bool:
    """The same where `old` may have been judged about another model."""
    return _enough(rough_gain(new, old), new, old, criteria)


def _enough(gained: float, new: Fit, old: Fit, criteria: Criteria) -> bool:
    return gained > criteria.price * (new.size - old.size) + 6.0


def earns(problem: Problem, new: Fit, old: Fit, base: Fit) -> bool:
    """Whether what was added since `old` pays, and its torque matters: to the joint, and beside what was unexplained."""
    if not pays_roughly(new, old, problem.criteria) or force_ratio(new, old) > 1.0 - problem.criteria.least_fall:
        return False
    return matters(problem, new, old, base) or _small_but_all(new, old, base, problem.criteria)


def _small_but_all(new: Fit, old: Fit, base: Fit, criteria: Criteria) -> bool:
    """Whether one effect or two, small as they may be beside the torque, are nearly all that the declared model lacks, and surely
    no chance."""
    count = len(new.active) - len(base.active)
    sure = rough_gain(new, base) > criteria.surely * count
    return old is base and count <= 2 and sure and force_ratio(new, base) < criteria.clear


def completes(problem: Problem, new: Fit, old: Fit, base: Fit) -> bool:
    """Whether what was added to a named effect, small as it may be beside that one, is needed all the same: it brings what is left
    down to what a name may leave (friction that differs by direction is an effect and a small bias), or is most of what was left
    and matters to its joint (a spring beside ten times as much friction)."""
    criteria = problem.criteria
    if old is base or not pays_roughly(new, old, criteria):
        return False
    if force_ratio(new, old) < criteria.explained and felt(problem, new, old) > criteria.least_share:
        return True
    falls = force_ratio(new, old) < 1.0 - criteria.least_fall
    left = force_ratio(new, base) < criteria.explained < force_ratio(old, base)
    return falls and left and matters(problem, new, base, base)


def needed(problem: Problem, new: Fit, without: Fit, found: Trace) -> bool:
    """Whether an effect of a set earns its place. Where none of the set would by itself, half the usual gain will do."""
    criteria = problem.criteria
    alone = len(new.active) - len(found.final.active) == 1
    if alone:
        return earns(problem, new, without, found.base)
    if force_ratio(new, without) > 1.0 - 0.5 * criteria.least_fall or not pays(new, without, criteria):
        return False
    small = _small_but_all(new, found.base, found.base, criteria) and gain(new, without) > criteria.surely
    return small or matters(problem, new, without, found.base)
