"""One mass that says what all fitted bodies say of the torque along the measured motion."""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.attribution.candidates import body_mass_candidates
from adaptsim_jax.attribution.equation.models import GroupSearch
from adaptsim_jax.attribution.equation.solve import compared
from adaptsim_jax.attribution.parameters import BODY_MASS, INERTIA

HELD = 1e-6  # standard deviation (1) of a body's coordinates that stay at the file's


@dataclass(frozen=True)
class Carried:
    """A mass that the file lacks. joint: of the machine, whose body carries it; mass, error: kg;
    share: of what all bodies together take off left-out losses, in logarithms.
    """

    joint: int
    mass: float
    error: float
    share: float


def carried(found: GroupSearch) -> Carried | None:
    """The mass at one body, the others as the file has them, by which left-out windows are
    predicted nearly as well as with all bodies fitted, both beside what like joints have; of
    several bodies the last. None where there is none, or where another mass has a name.
    """
    if not found.state.problem.offers(BODY_MASS) or any(c.effect == BODY_MASS for c in found.added):
        return None
    state, limits, best = found.state, found.state.limits, None
    held = copy(state)
    entries = (replace(e, prior=HELD) if e.owner == INERTIA else e for e in state.null.entries)
    held.null = replace(state.null, entries=tuple(entries))
    added = [c for c in found.added if state.likely(c)]
    bare, free = held.set_of(added), state.set_of(added)
    for c in body_mass_candidates(found.balance.group):
        c = held.settled(added, c)
        alone, own = held.set_of([*added, c]), state.own(c)
        test = compared(state.rows, bare, alone, own)
        bodies = compared(state.rows, bare, free, own).gain
        at = len(alone.entries) - len(c.entries)
        mass, error = float(alone.step[at]), float(alone.error[at])
        if test.p > limits.level or test.gain < limits.gain * len(c.entries):
            continue
        share = np.log1p(-test.gain) / np.log1p(-max(bodies, test.gain))
        if share >= 1.0 - state.criteria.alike and abs(mass) > limits.steady * error:
            best = Carried(c.joints[0], mass, error, float(share))
    return best
