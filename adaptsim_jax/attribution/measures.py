"""Three yardsticks of a model beside each other, each with a zero: what needs no model at all
leaves as much.

Stretches and whole trials are simulated, and set against a straight line and holding still. The
torque along the measured motion is set
against a torque that never changes. Skill = 1 - error / the better of these: 1 is perfect, 0 is
worth nothing, below it the model is worse
than none. Which of them tells most depends on the machine: over 0.5 s a slow arm moves along a
straight line, whatever its model; a joint with much friction and little inertia says all in its
torque. What follows commands shows over whole trials.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.attribution.criteria import BALANCE, WINDOW
from adaptsim_jax.attribution.equation.balance import Balance, actuator_force, residual
from adaptsim_jax.attribution.forecast import without_a_model
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem, values_of
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import REPORT

STRETCHES, WHOLE, TORQUE = "stretches", "whole", "torque"
NAMES = (STRETCHES, WHOLE, TORQUE)


@dataclass(frozen=True)
class Measure:
    """One yardstick by joint: error, line, still [n] (rad, m; of torques N m, and the size of the
    torque), over a span [s].
    """

    name: str
    span: float
    error: np.ndarray
    line: np.ndarray
    still: np.ndarray
    joints: tuple[str, ...]
    units: tuple[str, ...]

    @property
    def skills(self) -> np.ndarray:
        """[n]; NaN where nothing moved."""
        base = np.minimum(self.line, self.still)
        return np.where(base > 0, 1.0 - self.error / np.where(base > 0, base, 1.0), np.nan)

    @property
    def skill(self) -> float:
        """Mean over joints, each at least -1: one that runs away says no more than that it does."""
        some = self.skills[np.isfinite(self.skills)]
        if len(some):
            return float(np.mean(np.maximum(some, -1.0)))
        return float("nan")

    def as_dict(self) -> Table:
        """For a report or a program: by joint, and over all of them."""
        if self.name != TORQUE:
            words = ("error", "straight_line", "hold_still")
        else:
            words = ("missing", "constant", "torque")

        def row(e, a, b, s):
            return dict(zip((*words, "skill"), map(float, (e, a, b, s)), strict=True))

        columns = (self.error, self.line, self.still, self.skills)
        by = {
            name: row(*(z[j] for z in columns)) | {"unit": self.units[j]}
            for j, name in enumerate(self.joints)
        }
        if self.name == TORQUE:
            for j, name in enumerate(self.joints):
                by[name]["share"] = float(self.error[j] / max(self.still[j], 1e-300))
        one = len(set(self.units)) == 1
        pooled = [float(np.median(z)) if one else None for z in (self.error, self.line, self.still)]
        return {
            "span_s": self.span,
            **dict(zip(words, pooled, strict=True)),
            "skill": self.skill,
            "joints": by,
        }


def of_simulation(problem: TreeProblem, error: np.ndarray, name: str, span: float) -> Measure:
    """Of simulated stretches or trials, medians over them of error [W, n]."""
    line, still = without_a_model(problem)

    def middle(e):
        return np.median(e, 0)

    names = problem.joint_names
    return Measure(name, span, middle(error), middle(line), middle(still), names, problem.units)


def of_torque(
    problem: TreeProblem,
    balances: Sequence[Balance],
    vector: Vector,
    missing: Mapping[int, np.ndarray] | None = None,
) -> Measure | None:
    """Of the torque along the measured motion at a vector, over windows that count (not those at
    stops or limits, where a joint has others); missing {balance's number: [K, n]} where it is known
    already.
    """
    if not balances:
        return None
    n = problem.joints
    error, line, still = np.zeros(n), np.zeros(n), np.zeros(n)
    for k, b in enumerate(balances):
        own = list(b.group.joints)
        left = missing[k] if missing else residual(problem, b, vector)
        size = needed(problem, b)
        count = b.clear > BALANCE.no_weight
        count = np.where(np.any(count, 0), count, True)  # [K, n]

        def root(z, n=count):
            return np.sqrt(np.mean(np.square(z), 0, where=n))

        error[own], still[own], line[own] = (
            root(left),
            root(size),
            root(size - size.mean(0, where=count)),
        )
    units = problem.force_units
    return Measure(TORQUE, WINDOW.span, error, line, still, problem.joint_names, units)


def needed(problem: TreeProblem, balance: Balance) -> np.ndarray:
    """Torque [K, n] that a model has to tell: what actuators were told; of joints without one, what
    the declared bodies' motion takes.
    """
    values = values_of(problem, balance.group, Vector((), np.zeros(0)))
    averaged = balance.averaged(actuator_force(balance, values)[0])
    takes = balance.regressor @ values.inertial[..., 0].ravel()
    return np.where(np.any(averaged != 0.0, 0), averaged, takes)


def headline(measures: Mapping[str, Measure | None], asked: str | None = None) -> tuple[str, str]:
    """(The yardstick by which effects are judged, why), of those of the declared model, fitted.

    Chosen before anything is named. asked: the one that a person wants.
    """
    if asked is not None:
        return asked, "asked for"
    skill = {k: m.skill for k, m in measures.items() if m is not None and np.isfinite(m.skill)}

    def words(k):
        if skill[k] > 0:
            return f"{100 * skill[k]:.0f} % better than a straight line"
        return "no better than a straight line"

    if skill.get(STRETCHES, -1.0) >= REPORT.useful_skill:
        return STRETCHES, f"over stretches the declared model, fitted, is {words(STRETCHES)}"
    if skill.get(TORQUE, -1.0) > max(skill.get(STRETCHES, -1.0), 0.0):
        if STRETCHES in skill:
            suffix = f"; simulated stretches of it are {words(STRETCHES)}"
        else:
            suffix = ""
        return (
            TORQUE,
            f"the declared model, fitted, tells {100 * skill[TORQUE]:.0f} % of the torque along "
            f"the motion{suffix}",
        )
    return STRETCHES, "no yardstick tells much"


def predicts_nothing(measures: Mapping[str, Measure | None]) -> bool:
    """Whether a model is worth no more than none by every yardstick that there is."""
    skills = [m.skill for m in measures.values() if m is not None and np.isfinite(m.skill)]
    return bool(skills) and max(skills) < REPORT.worthless_skill
