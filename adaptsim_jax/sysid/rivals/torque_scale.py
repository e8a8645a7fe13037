"""The same forces in another scale: a torque constant that is off at one joint is that of the other joint with all else to match.

Both sides of the equations of motion may be divided by `1 + gain`: the declared parameters and the forces of other effects shrink,
and the torque of the other joint is too small instead. No data tell the two apart, but a refit of the look-alike from where the
other model stands may rest far from that point where effects switch, so that it would pass for less likely.
"""

import numpy as np

from adaptsim_jax.effects.base import UNITS
from adaptsim_jax.effects.layout import Layout
from adaptsim_jax.sysid.estimate.fit import fit
from adaptsim_jax.sysid.estimate.fitted import Fit, Instance
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.score.table import ScoreTable
from adaptsim_jax.sysid.select.equivalence import class_of
from adaptsim_jax.sysid.select.trace import Trace

GAIN = "torque_gain"


def rescaled(problem: Problem, found: Trace) -> Trace:
    """`found` with the torque gain of the other joint among its classes, where it explains the data as well in its own scale."""
    gains = [a for a in found.added if a[0] == GAIN]
    joints = problem.plant.joints
    if len(gains) != 1 or len(joints) != 2 or np.any(problem.plant.low == problem.plant.high):
        return found
    (here,) = gains
    there = (GAIN, next(j for j in joints if j != here[1]))
    if there in found.classes.get(here, ()) or there in found.final.active:
        return found
    own, other = _both(problem, found.final, here, there, found.view)
    if own.ok and other.ok:
        alone = Trace(found.base, found.first, found.ranked).then("both scales", final=own, tried=(other,))
        if there in class_of(problem, here, alone):
            classes = found.classes | {here: (*found.classes.get(here, ()), there)}
            return found.then("told in another scale", tried=(other,), classes=classes)
    return found


def _both(problem: Problem, model: Fit, here: Instance, there: Instance, seen: ScoreTable) -> tuple[Fit, Fit]:
    """The model and that in the other scale, judged alike: likelihoods are of one linearisation, and the model's may be of another."""
    c = model.candidate
    theta, eff = other_scale(problem.model.layout, c.theta, c.eff, model.active, here, there)
    active = tuple(there if a == here else a for a in model.active)
    judged = lambda start: fit(problem, start, seen.response, rounds=0)
    return judged(model.start()), judged(model.start(active=active, theta=theta, eff=eff))


def other_scale(
    layout: Layout, theta: np.ndarray, eff: np.ndarray, active: tuple[Instance, ...], here: Instance, there: Instance
) -> tuple[np.ndarray, np.ndarray]:
    """`theta [P]` and `eff [E]` of the same motion with the torque gain of `here` at `there`. Forces scale as torques; what happens to
    a command before the gain does not."""
    at = {a: layout.instances[layout.index(*a)] for a in (*active, there)}
    scale = 1.0 + eff[at[here].at.start]
    out = eff.copy()
    for instance in (at[a] for a in active if a[0] != GAIN and at[a].effect.place == "force"):
        for k, p in enumerate(instance.effect.parameters):
            out[instance.at.start + k] /= scale ** UNITS[p.unit][0]
    out[at[here].at.start], out[at[there].at.start] = 0.0, 1.0 / scale - 1.0
    return theta / scale, out
