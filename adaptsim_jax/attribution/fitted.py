"""Fitted models of a tree, what they predict of trials left out, and what a search selected."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptsim_jax.attribution.candidates import CandidateScore, JointCandidate
from adaptsim_jax.attribution.parameters import Normal, TreeFit, Vector
from adaptsim_jax.attribution.problem import TreeProblem, moving
from adaptsim_jax.attribution.simulate import Path
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.testing import deviates, jackknife
from adaptsim_jax.effects.base import Reach


@dataclass(frozen=True)
class HeldOut:
    """Prediction of left-out folds: loss [W] under given weights, squared error [W, 2n] (mean over
    a stretch), parameters [F, P]; normal equations by fold; paths by group.
    """

    loss: np.ndarray
    squared: np.ndarray
    vectors: np.ndarray
    normal: Normal
    paths: tuple[Path, ...]


@dataclass(frozen=True)
class FittedTree:
    """A set of effects fitted, its linearisation and its held-out prediction. hess [P, P]: the
    curvature, prior and all, of a model that was fitted along the measured motion, and has no
    linearisation.
    """

    added: tuple[JointCandidate, ...]
    fit: TreeFit
    lin: Any  # Linear; None where `hess` is told
    held: HeldOut
    hess: np.ndarray | None = None

    @property
    def spread(self) -> np.ndarray:
        """Standard errors [P] by the jackknife over folds."""
        return jackknife(self.held.vectors)

    @property
    def half_width(self) -> np.ndarray:
        """Half of the 90 % intervals [P]."""
        return deviates(len(self.held.vectors)) * self.spread


def held_error(problem: TreeProblem, model: FittedTree) -> np.ndarray:
    """Held-out error of each stretch and joint [W, n], rad or m."""
    return np.sqrt(model.held.squared[: len(problem.fold), : problem.joints])


def over_floor(problem: TreeProblem, model: FittedTree) -> float:
    """The same over the noise floor, median over stretches, at the joint at which it is most."""
    return float(np.max(times_floor(problem, held_error(problem, model))))


def times_floor(problem: TreeProblem, error: np.ndarray) -> np.ndarray:
    """Held-out error [W, n] over the noise floor, median over stretches [n]; zero of joints that do
    not move, which would hide what is left at the others.
    """
    return np.where(moving(problem), np.median(error, 0) / _noise(problem), 0.0)


def _noise(problem: TreeProblem) -> np.ndarray:
    return np.maximum(problem.floor[: problem.joints], 1e-12)


def astray(
    problem: TreeProblem, model: FittedTree, criteria: Criteria, null: FittedTree | None = None
) -> np.ndarray:
    """Stretches [W] of which much more is left than of most; and, where the declared model `null`
    is given, nearly as much as that leaves there (dry friction that a simulator lets creep, say,
    leaves more now and then, though it is the right effect).
    """
    error = held_error(problem, model)
    usual = np.maximum(_noise(problem), np.median(error, 0))
    outlying = (error > criteria.outlying * usual) & moving(problem)
    return np.any(
        outlying
        if null is None
        else outlying & (error > (1.0 - criteria.left) * held_error(problem, null)),
        1,
    )


@dataclass(frozen=True, kw_only=True)
class Selection(Finding):
    """What a search by simulated stretches found. last: scores at the last model of the forward
    search; shorter: over the beginnings of stretches only.
    """

    last: tuple[CandidateScore, ...]
    reach: Reach
    shorter: bool = False


Hint = tuple[Vector, tuple[JointCandidate, ...]]
