"""All candidates seen from one fitted model: two linear scores of each, and the generic dictionary beside them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from adaptsim_jax.logs.segments import folds
from adaptsim_jax.logs.types import Atom
from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.candidate import survey
from adaptsim_jax.sysid.estimate.fitted import Fit, Instance, Response, respond
from adaptsim_jax.sysid.estimate.generic_forces import generic_names
from adaptsim_jax.sysid.estimate.linearize import Path
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.estimate.variance import Linearised
from adaptsim_jax.sysid.score.scorer import Score, Scorer


@dataclass(frozen=True)
class Ranked:
    """One candidate instance as the linear score sees it, about some model."""

    instance: Instance
    atom: Atom
    score: Score
    tried: int  # shapes tried for it
    plain: bool = False  # scored as if the sensors were the only noise

    def corrected(self, instances: int) -> float:
        """p-value times the number of tests it was picked from."""
        return min(1.0, self.score.p_value * self.tried * instances)


@dataclass(frozen=True)
class ScoreTable:
    """All candidates scored about one model."""

    scorer: Scorer
    atoms: tuple[Atom, ...]
    response: Response
    path: Path

    @property
    def lin(self) -> Linearised:
        return self.response.lin

    @property
    def instances(self) -> dict[Instance, list[Atom]]:
        """Atoms of each candidate instance."""
        groups: dict[Instance, list[Atom]] = {}
        for atom in self.atoms:
            if atom.effect != "generic":
                groups.setdefault((atom.effect, atom.where), []).append(atom)
        return groups

    def generic(self) -> list[Atom]:
        return [a for a in self.atoms if a.effect == "generic"]

    def ranked(self, exclude: Sequence[Instance] = (), *, plain: bool = False) -> list[Ranked]:
        """Every instance at its best shape, by gain; `plain`: as if the sensors were the only noise."""
        scorer = self.plain if plain else self.scorer
        out = []
        for instance, atoms in self.instances.items():
            if instance not in exclude:
                best = scorer.best_shape(atoms)
                out.append(Ranked(instance, best, scorer.score([best]), len(atoms), plain))
        return sorted(out, key=lambda r: -r.score.gain)

    @cached_property
    def plain(self) -> Scorer:
        """Scores without the covariance of unexplained forces: blunt in size, but blind to nothing slow."""
        eye = np.broadcast_to(
            np.eye(self.lin.residual.shape[1]), (len(self.lin.residual), *[self.lin.residual.shape[1]] * 2)
        )
        white = variance.whiten(self.lin, eye)
        return Scorer(white, folds(white.trial, white.rows))


def view(problem: Problem, model: Fit) -> ScoreTable:
    """Linear scores of everything about a fitted model."""
    c = model.candidate
    atoms, lin, path, _ = survey(problem, c.active, c.theta, c.eff, c.refit.point.x0)
    response = respond(lin)
    white = variance.whiten(lin, variance.whitener(lin, model.parts, response.kernels))
    return ScoreTable(Scorer(white, folds(white.trial, white.rows)), atoms, response, path)


def generic_p_value(view: ScoreTable) -> float:
    """Smallest p-value of the generic dictionary's groups, corrected for their number."""
    atoms = view.generic()
    names = generic_names(view.path.u.shape[2])
    groups = list(dict.fromkeys(names))
    scores = [view.scorer.score([a for a, n in zip(atoms, names, strict=True) if n == g]) for g in groups]
    return min(1.0, min(s.p_value for s in scores) * len(groups))
