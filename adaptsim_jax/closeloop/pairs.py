"""Two effects at once, where no single one explains anything: each hides the other from a search that adds one at a time.

Declared parameters that bent to the one effect leave residuals which the other alone makes no better (a drag and a ripple at one
joint). So those that each of the two linear scores puts first are refitted in pairs, with the sensors as the only noise: under a
covariance that both effects have inflated, a refit stays where it is.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product

import numpy as np

from adaptsim_jax.closeloop.leaders import NEW
from adaptsim_jax.closeloop.problem import Diverged, Problem
from adaptsim_jax.closeloop.rivals import Fitted, Instance, fitted_plainly, settled
from adaptsim_jax.closeloop.start import merged, started
from adaptsim_jax.closeloop.view import Ranked, View

MOST = 4  # plain refits, one from where the other ended
POOL = 5  # candidates of each score that pairs are made of

Pair = tuple[Ranked, Ranked]


def leading_pairs(problem: Problem, seen: View, exclude: Sequence[Instance]) -> list[Pair]:
    """Each of the leaders of one score with each of the other's, unless one is a look-alike of the other."""
    layout = problem.model.layout
    alike = lambda a, b: a[1] == b[1] and a[0] in layout.instances[layout.index(*b)].effect.look_alikes
    leaders = [
        [r.instance for r in seen.ranked(exclude, plain=plain) if r.score.retained > NEW][:POOL]
        for plain in (False, True)
    ]
    couples = {frozenset(p) for p in product(*leaders)}
    pairs = sorted(sorted(c) for c in couples if len(c) == 2)
    return [_scored(seen, a, b) for a, b in pairs if not alike(a, b) and not alike(b, a)]


def _scored(seen: View, a: Instance, b: Instance) -> Pair:
    """Both with the shape of each chosen beside the other, and the amplitudes of the two together."""
    scorer, atoms = seen.scorer, seen.instances
    first, second = scorer.best_shape(atoms[a]), scorer.best_shape(atoms[b])
    for _ in range(2):
        first = scorer.best_shape(atoms[a], [second])
        second = scorer.best_shape(atoms[b], [first])
    score, cut = scorer.score([first, second]), len(first.columns)
    one = Ranked(a, first, replace(score, amplitude=score.amplitude[:cut]), len(atoms[a]))
    return one, Ranked(b, second, replace(score, amplitude=score.amplitude[cut:]), len(atoms[b]))


def refit_pair(problem: Problem, base: Fitted, pair: Pair, seen: View) -> Fitted | None:
    """The model with both effects, refitted whole from their linear amplitudes; None where that runs away."""
    active = (*base.candidate.active, *(r.instance for r in pair))
    eff = merged(problem, started(problem, base, pair[0]), started(problem, base, pair[1]), pair[1].instance)
    with suppress(Diverged, np.linalg.LinAlgError):
        return fitted_plainly(problem, active, base.candidate, eff, base.parts, seen.response)
    return None


def settled_plainly(problem: Problem, model: Fitted, seen: View) -> Fitted:
    """Refitted with the sensors as the only noise until that gains no more, then under its own covariance."""
    for _ in range(MOST):
        with suppress(Diverged, np.linalg.LinAlgError):
            new = fitted_plainly(
                problem, model.active, model.candidate, model.candidate.eff, model.parts, seen.response
            )
            gain = new.total - model.total
            model = new if gain > 0 else model
            if gain > 1.0:
                continue
        break
    return settled(problem, model, seen.response)
