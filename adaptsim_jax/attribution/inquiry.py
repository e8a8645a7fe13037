"""What a diagnosis of a machine asks, and what it found."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.attribution.criteria import PRIOR_WIDTH
from adaptsim_jax.attribution.equation.models import TorqueSearch
from adaptsim_jax.attribution.fitted import FittedTree, Hint, Selection, held_error
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import STRETCHES, of_simulation
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem, held
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import Criteria


@dataclass(frozen=True)
class Inquiry:
    """A machine whose recording is examined, and how.

    Args:
        machine, problem: The machine, and its stretches of `horizon` s.
        null: What is fitted whatever is named.
        criteria: What counts as an effect.
        horizon: s.
        notify: Called with what is done.
        keep: With what a search has found so far.
        asked: The objective that is to judge, where it is not the one that tells most.
        factor: Within which bodies are those of the file along the motion; None: the balance of
            torques is not looked at.
        hint: What the search of stretches goes on from where the balance says nothing.
    """

    machine: Machine
    problem: TreeProblem
    null: Vector
    criteria: Criteria
    horizon: float
    notify: Callable[[str], None] = lambda note: None
    keep: Callable[[Selection], None] = lambda found: None
    asked: str | None = None
    factor: float | None = PRIOR_WIDTH.body_factor
    hint: Hint | None = None

    @property
    def follows(self) -> bool:
        """Whether an actuator follows commands."""
        commands = self.machine.log.input_kind == "command"
        return commands and bool(np.any(held(self.machine.actuator)))

    @property
    def many(self) -> bool:
        """Whether there are too many joints for stretches to be searched."""
        return self.problem.joints > self.criteria.torque.simulated

    def simulated(self, model: FittedTree) -> Table:
        """What a model leaves of simulated stretches, by objective."""
        error = held_error(self.problem, model)
        return {STRETCHES: of_simulation(self.problem, error, STRETCHES, self.horizon)}


@dataclass(frozen=True)
class Examined:
    """What was found, by which objective, and why by that one.

    Args:
        inquiry: What was examined.
        found: Effects by the objective that judged.
        by_torque: What the balance of torques says, None where it cannot.
        before, after: Measures by objective of the declared model, fitted, and of the final one,
            None where one tells nothing.
        judge, why: The objective, and why.
    """

    inquiry: Inquiry
    found: Selection
    by_torque: TorqueSearch | None
    before: Table
    after: Table
    judge: str
    why: str

    @property
    def problem(self) -> TreeProblem:
        return self.inquiry.problem


def with_null(e: Examined, null: FittedTree) -> Examined:
    """With `null` as the model of which the report says what it leaves."""
    before = e.before | e.inquiry.simulated(null)
    return replace(e, found=replace(e.found, null=null), before=before)


Keep = Callable[[Inquiry, Selection], None]
"""Called with what is examined and what a search has found so far."""
