"""What the torque along the motion shows of an effect beside the others of a set: evidence for the
rules.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptsim_jax.attribution.equation.searched import Searched
from adaptsim_jax.attribution.equation.solve import Solved
from adaptsim_jax.attribution.score import JointCandidate
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.rules import Evidence
from adaptsim_jax.diagnosis.testing import Test
from adaptsim_jax.effects.base import Traits


@dataclass(frozen=True)
class BalanceEvidence(Evidence):
    """Evidence of the torque along the motion: a set of effects `whole`, with a candidate in it.

    less, model: without it and with it (`BalanceModel`); alike: joints at which what like drives
    have is in the set; naming: whether it is asked about a name, and no more about its place in the
    set.
    """

    state: Searched
    whole: Solved
    candidate: JointCandidate
    test: Test
    price: float
    level: float
    less: Any = None
    model: Any = None
    alike: int = 0
    naming: bool = False
    units = "blocks"
    loss = "squared missing torque"

    @property
    def criteria(self) -> Criteria:
        return self.state.criteria

    @property
    def traits(self) -> Traits:
        return self.state.problem.effect(self.candidate.effect).traits

    @property
    def gain(self) -> float:
        return self.test.gain * self.state.carry(self.candidate)

    @property
    def steadiness(self) -> float:
        return steadiness(self.whole, self.candidate)

    @property
    def min_steadiness(self) -> float:
        return self.state.limits.steady

    @property
    def at_bound(self) -> bool:
        return at_bound(self.whole, self.candidate)

    @property
    def read_so(self) -> bool:
        """Whether it is a shift that may be how rows are read."""
        return read_so(self.state, self.whole, self.candidate)

    @property
    def stays_unnamed(self) -> bool:
        """What like drives have together, and takes something off here too, is fitted everywhere
        and named where it holds out alone.
        """
        return self.alike > 1 and self.test.gain > 0.0

    @property
    def values(self) -> np.ndarray:
        return self.whole.step[_numbers(self.whole, self.candidate)]

    @property
    def unresolved_shift(self) -> float | None:
        """Of a single joint, or of some; that of all of them is fitted and not named."""
        if self.candidate.sharing == "common" or not self.state.commanded or not self.read_so:
            return None
        return float(self.values[0]) / self.state.reach.dt

    @property
    def gain_error(self) -> float | None:
        if not self.state.follows or not self.traits.scales_drive:
            return None
        return float(np.max(np.abs(self.values)))

    @property
    def torque_share(self) -> tuple[float, float] | None:
        """Root mean squares. What predicts stays in the model of a machine that is driven by torque,
        and has no name; of one that follows commands, whose command errors show
        trifles that no motion does, it goes.
        """
        if self.read_so or not (self.naming or self.state.follows):
            return None
        return share_of_torque(self.state, self.whole, self.candidate)


def share_of_torque(state: Searched, whole: Solved, c: JointCandidate) -> tuple[float, float]:
    """Root mean square of an effect's torque over that of the joint at which it is most, and the
    least of that by which it has a name.
    """
    at = _numbers(whole, c)
    force = whole.columns[..., at] @ whole.step[at]
    size = np.sqrt(np.mean(np.square(force), 0))
    share = float(np.max(size / np.maximum(state.torque, 1e-300)))
    carried = state.follows and state.problem.effect(c.effect).traits.at_parents
    return share, state.limits.follower_worth if carried else state.limits.worth


def read_so(state: Searched, whole: Solved, c: JointCandidate) -> bool:
    """Whether it is a shift of all commands by less than a row, or of measured torques by as much as
    loggers pair them with angles: how rows are read, and no effect. A delay and a lag of the same
    joints are one filter: their sum counts.
    """
    if not _shifts(state, c.effect):
        return False
    value = sum(
        z
        for e, z in zip(whole.entries, whole.step, strict=True)
        if set(e.joints) == set(c.joints) and _shifts(state, e.owner)
    )
    value = float(value) / state.reach.dt
    if not state.commanded:
        return abs(value) < state.limits.paired
    return -state.criteria.within_row < value < state.criteria.min_shift


def _shifts(state: Searched, effect: str) -> bool:
    problem = state.problem
    return problem.offers(effect) and problem.effect(effect).shifts_commands


def _numbers(whole: Solved, c: JointCandidate) -> list[int]:
    keys = {e.key for e in c.entries}
    return [i for i, e in enumerate(whole.entries) if e.key in keys]


def steadiness(whole: Solved, c: JointCandidate) -> float:
    """Its amplitudes over their standard errors, root mean square: a torque of two numbers has
    twice the chance that one is large.
    """
    at = _numbers(whole, c)
    return float(np.sqrt(np.mean(np.square(whole.step[at] / np.maximum(whole.error[at], 1e-300)))))


def at_bound(whole: Solved, c: JointCandidate, share: float = Criteria.bound) -> bool:
    entries = [(whole.entries[i], whole.step[i]) for i in _numbers(whole, c)]
    return any(e.at_bound(e.start + step, share) for e, step in entries)
