"""Whether an effect stays beside the others of a set, by what the torque along the motion says of
left-out blocks, and if not, why.
"""

import numpy as np

from adaptsim_jax.attribution.equation.searched import Searched
from adaptsim_jax.attribution.equation.solve import Solved
from adaptsim_jax.attribution.score import Candidate
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.testing import Test


def why_not(
    state: Searched, whole: Solved, c: Candidate, test: Test, least: float, level: float
) -> str:
    """Why a candidate is not taken beside the others of a set; empty if it is."""
    traits = state.problem.effect(c.effect).traits
    if test.p > level:
        return "left-out blocks do not confirm it"
    if state.commanded and c.sharing != "common" and only_read(state, whole, c):
        return "a joint that is late by so little is how its rows are read"
    if (
        state.follows
        and traits.scales_drive
        and np.max(np.abs(whole.step[_numbers(whole, c)])) < state.limits.share
    ):
        return (
            f"a gain that is off by less than {100 * state.limits.share:g} % is how exactly "
            f"speeds are read"
        )
    if test.gain * state.carry(c) < least:
        return f"takes less than {100 * least:.0f} % off the squared missing torque"
    if test.overall < 0.0:
        return "the torques of all joints together are missed by more"
    if steadiness(whole, c) < state.limits.steady:
        return f"its size is only {steadiness(whole, c):.1f} times its error"
    if at_bound(whole, c):
        return "its value is at the end of what such a machine may have"
    if state.follows and traits.at_parents:
        least = state.limits.seen
    else:
        least = state.limits.worth
    if (
        not only_read(state, whole, c) and _worth(state, whole, c) < least
    ):  # what is read so is no name, however small
        return f"it is less than {100 * least:g} % of the joint's torque"
    return ""


def _worth(state: Searched, whole: Solved, c: Candidate) -> float:
    """Root mean square of an effect's torque over that of the joint, at the joint where it is
    most.
    """
    at = _numbers(whole, c)
    force = np.sqrt(np.mean(np.square(whole.columns[..., at] @ whole.step[at]), 0))
    return float(np.max(force / np.maximum(state.torque, 1e-300)))


def only_read(state: Searched, whole: Solved, c: Candidate) -> bool:
    """A shift of all commands by less than a row, or of measured torques by as much as loggers pair
    them with angles: how rows are read, and no effect.
    """
    if not state.problem.effect(c.effect).shifts_commands:
        return False
    value = float(whole.step[_numbers(whole, c)][0]) / state.reach.dt
    if not state.commanded:
        return abs(value) < state.limits.paired
    return -state.criteria.within_row < value < state.criteria.least_shift


def _numbers(whole: Solved, c: Candidate) -> list[int]:
    keys = {e.key for e in c.entries}
    return [i for i, e in enumerate(whole.entries) if e.key in keys]


def steadiness(whole: Solved, c: Candidate) -> float:
    """Its amplitudes over their standard errors, root mean square: a torque of two numbers has
    twice the chance that one is large.
    """
    at = _numbers(whole, c)
    return float(np.sqrt(np.mean(np.square(whole.step[at] / np.maximum(whole.error[at], 1e-300)))))


def at_bound(whole: Solved, c: Candidate, share: float = Criteria.bound) -> bool:
    entries = [(whole.entries[i], whole.step[i]) for i in _numbers(whole, c)]
    return any(e.at_bound(e.start + step, share) for e, step in entries)
