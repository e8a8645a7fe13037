"""Whether an effect stays in the model, beside all others, and if not, why: the rules of
`backward.judged`.
"""

from collections.abc import Sequence

import numpy as np

from adaptsim_jax.attribution.held_out import Model, held_error
from adaptsim_jax.attribution.parameters import DAMPING_STEP, Entry
from adaptsim_jax.attribution.problem import Problem
from adaptsim_jax.attribution.score import Candidate
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.testing import Test, attainable, jackknife
from adaptsim_jax.effects.joints.forces import ARMATURE
from adaptsim_jax.effects.joints.friction import COULOMB, PRESLIDING, VISCOUS


def why_not(
    problem: Problem,
    model: Model,
    less: Model,
    c: Candidate,
    test: Test,
    steady: float,
    criteria: Criteria,
) -> str:
    """Why effect `c` of `model` does not stay, in words; empty if it stays.

    less: the model without it, refitted; test: of the two over left-out blocks; steady: its size
    over its scatter (`steadiness`).
    """
    if test.p > attainable(criteria.confidence, test.parts):
        return "left-out stretches do not confirm it"
    least = criteria.size * len(c.entries)
    if test.gain < least:
        return f"takes less than {100 * least:.0f} % off the squared error"
    if steady < criteria.steady:
        return f"its size differs between trials: {steady:.1f} times its scatter"
    if _at_bound(problem, model, c, criteria):
        return "its value is at the end of what such a machine may have"
    if _too_short(problem, model, c, criteria):
        return (
            f"a shift in time of less than {criteria.least_shift:g} sampling intervals: how "
            f"rows are read, not an effect"
        )
    if _trifling(model, c, criteria):
        return (
            f"changes what the model file declares by less than {100 * criteria.least_change:.0f} %"
        )
    if _unseen(problem, model, c):
        return (
            "its bristles break away within the sensors' noise: friction that turns smoothly, "
            "not an effect"
        )
    if eased(problem, less, model) < 0.0:
        return "the simulated angles do not come nearer to the measured ones"
    least = least_worth(problem, c, criteria)
    if worth(problem, less, model) < least:
        return (
            f"takes less than {100 * least:.0f} % off the squared error of any joint's "
            f"simulated angles"
        )
    return ""


def least_worth(problem: Problem, c: Candidate, criteria: Criteria) -> float:
    """What `worth` an effect must have: more where it is no law."""
    if problem.effect(c.effect).describes:
        return criteria.described
    return criteria.worth


def worth(problem: Problem, less: Model, model: Model) -> float:
    """Share of the squared held-out error of one joint's angles that a model takes off another's,
    at the joint where it is most: of the median stretch or of the ninth decile. An error within the
    noise floor counts as the floor, and so does one that is next to nothing beside what the
    declared model leaves (`Problem.least`).
    """
    before, after = (
        np.square(np.quantile(held_error(problem, m), [0.5, 0.9], axis=0)) for m in (less, model)
    )
    floor = np.square(np.maximum(np.maximum(problem.floor[: problem.joints], problem.least), 1e-12))
    return float(np.max((before - after) / np.maximum(before, floor)))


def eased(problem: Problem, less: Model, model: Model) -> float:
    """Share of the held-out error of the angles that a model takes off another's, geometric mean
    over joints: of the median stretch, or of the ninth decile where it is more (an effect that acts
    now and then).

    What only the estimator's weights see is of no use to who simulates.
    """
    before, after = (np.quantile(held_error(problem, m), [0.5, 0.9], axis=0) for m in (less, model))
    return 1.0 - float(
        np.exp(np.min(np.mean(np.log(np.maximum(after, 1e-12) / np.maximum(before, 1e-12)), 1)))
    )


def between_rows(problem: Problem, model: Model, c: Candidate, criteria: Criteria) -> bool:
    """Whether it is how commands are read: at all driven joints they act early, by no more than
    those of a controller that is faster than its log (half of the difference of both intervals), or
    late by less than the log resolves; or, where no `damping_step` is fitted, rotors differ by what
    damps a joint in a small part of a row.
    """
    stepped = any(e.owner == DAMPING_STEP for e in model.fit.vector.entries)
    if c.effect == ARMATURE.name and not stepped:
        return in_step(problem, model.fit.vector.entries, model.fit.vector.values, criteria)
    driven = {j for j in range(problem.joints) if problem.reach.peak[j] > 0.0}
    times = [
        z
        for e, z in zip(model.fit.vector.entries, model.fit.vector.values, strict=True)
        if e.key == c.entries[0].key
    ]
    between = (
        bool(times) and -criteria.within_row < times[0] / problem.reach.dt < criteria.least_shift
    )
    shifts = problem.effect(c.effect).pairs_rows and len(c.entries) == 1
    return shifts and between and driven <= set(c.joints)


def in_step(
    problem: Problem, entries: Sequence[Entry], values: np.ndarray, criteria: Criteria
) -> bool:
    """Whether all rotors that are fitted, of two joints or more, differ from the file's by less
    than their damping times the shift in time that the log resolves: damping that acts that much
    earlier does the same.
    """
    at = {e.key: z for e, z in zip(entries, values, strict=True)}
    damping = np.zeros(problem.joints)
    for g in problem.groups:
        damping[list(g.joints)] = -g.actuator[3] * g.gear**2
    damping += [at.get((VISCOUS.name, "damping", (j,)), 0.0) for j in range(problem.joints)]
    shift = criteria.least_shift * problem.reach.dt
    rotors = [
        (abs(at[e.key] - e.off), min(damping[j] for j in e.joints))
        for e in entries
        if e.owner == ARMATURE.name
    ]
    return len(rotors) > 1 and all(heavier < shift * damps for heavier, damps in rotors)


def _at_bound(problem: Problem, model: Model, c: Candidate, criteria: Criteria) -> bool:
    """Whether an amplitude of it lies at an end of its range."""
    keys = {
        e.key for e in c.entries if e.name in {a.name for a in problem.effect(c.effect).amplitudes}
    }
    vector = model.fit.vector
    return any(
        e.key in keys and e.at_bound(z, criteria.bound)
        for e, z in zip(vector.entries, vector.values, strict=True)
    )


def _too_short(problem: Problem, model: Model, c: Candidate, criteria: Criteria) -> bool:
    """Whether it is a shift in time of less than the log resolves."""
    times = [
        abs(z)
        for e, z in zip(model.fit.vector.entries, model.fit.vector.values, strict=True)
        if e.owner == c.effect and e.unit == "s"
    ]
    shifts = problem.effect(c.effect).shifts_time
    return bool(times) and shifts and max(times) < criteria.least_shift * problem.reach.dt


def _unseen(problem: Problem, model: Model, c: Candidate) -> bool:
    """Whether bristles bend by less than the noise of the angles before they break away, at every
    joint (of a simulator whose friction turns with tanh(v / width), say): no motion shows them.
    """
    if c.effect != PRESLIDING.name:
        return False
    values = {
        e.key: z for e, z in zip(model.fit.vector.entries, model.fit.vector.values, strict=True)
    }

    def level(j):
        return max(
            values.get((COULOMB.name, "level", (j,)), 0.0), 0.01 * float(problem.reach.torque[j])
        )

    bent = [
        values.get((c.effect, "compliance", (j,)), 0.0) * level(j) / max(problem.floor[j], 1e-12)
        for j in c.joints
    ]
    return max(bent) < 1.0


def _trifling(model: Model, c: Candidate, criteria: Criteria) -> bool:
    """Whether all that it does is to move what the file declares by a small share."""
    keys = {e.key for e in c.entries}
    own = [
        (e.off, z)
        for e, z in zip(model.fit.vector.entries, model.fit.vector.values, strict=True)
        if e.key in keys
    ]
    return bool(own) and all(
        off != 0.0 and abs(z - off) < criteria.least_change * abs(off) for off, z in own
    )


def steadiness(model: Model, c: Candidate) -> float:
    """An effect's amplitude over its scatter between folds: the largest of its amplitudes'."""
    return float(np.max(steady_each(model, c)))


def steady_each(model: Model, c: Candidate) -> np.ndarray:
    """The amplitudes of an effect [K] over their scatter between folds (jackknife, all other values
    held).

    With the others free, an amplitude that trades places with inertias would scatter, though every
    fold wants it.
    """
    at = [
        i for i, e in enumerate(model.fit.vector.entries) if any(e.key == k.key for k in c.entries)
    ]
    n = model.held.normal
    hess, own = n.hess[:, at][:, :, at], n.slope[:, at]
    ridge = 1e-9 * np.diag(np.diagonal(hess.sum(0)))
    moved = np.array(
        [
            np.linalg.lstsq(hess.sum(0) - h + ridge, -s, rcond=1e-12)[0]
            for h, s in zip(hess, own, strict=True)
        ]
    )
    off = np.array([model.fit.vector.entries[i].off for i in at])
    return np.abs(model.fit.vector.values[at] - off) / np.maximum(jackknife(moved), 1e-12)
