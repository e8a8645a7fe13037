"""What could have been found: the power of the score test at a size that matters, for each
candidate that is not named.
"""

from typing import Any

import numpy as np
from scipy import stats

from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.fit import jacobian
from adaptsim_jax.diagnosis.models import begun_at
from adaptsim_jax.diagnosis.problem import Candidate, Problem
from adaptsim_jax.diagnosis.testing import correlated_rows


def power_rows(problem: Problem, found: Finding, criteria: Criteria) -> list[dict[str, Any]]:
    """Rows of `power`: a candidate's quantity, a size that matters (`Quantity.scale`), and the
    share of recordings like this one in which an effect of that size would pass the score test (its
    level corrected for the number of candidates).

    The score of a quantity of size `a` has the noncentrality `a^2 H / (tau s^2)`: `H` its squared
    column freed of starts and fitted quantities, `s^2` what the final model leaves, `tau` the rows
    over which that hangs together (Rao's test; Cox and Hinkley, 1974).
    """
    model, fit = found.final, found.final.fit
    count = float(problem.counts.sum())
    left = max(fit.loss / count, 1e-12) * correlated_rows(problem.by_channel(fit.residual))
    level = stats.chi2.isf(criteria.alpha / max(len(problem.effects), 1), 1)
    out = []
    for e in problem.effects:
        if e in model.added:
            continue
        name, information = _best(problem, fit, e)
        q = problem.quantities[problem.index[name]]
        out.append(
            {
                "name": e.name,
                "where": e.where,
                "size": q.scale,
                "unit": q.unit,
                "power": float(stats.ncx2.sf(level, 1, max(information / left, 1e-12))),
            }
        )
    return sorted(out, key=lambda row: row["power"])


def _best(problem: Problem, fit, e: Candidate) -> tuple[str, float]:
    """The quantity of a candidate that tells most, and the squared length of its freed column in a
    step of its scale.
    """
    inner = fit.columns.reshape(
        -1 if fit.columns.size else fit.residual.size, fit.columns.shape[-1]
    )
    gram = np.linalg.inv(inner.T @ inner + 1e-9 * np.eye(inner.shape[1]))
    best = e.quantities[0], 0.0
    for shape in e.shapes:
        for name in [q for q in e.quantities if q not in shape and q not in fit.free]:
            c = jacobian(problem, begun_at(problem, fit.values, shape), [name]).reshape(-1)
            size = float(c @ c - (inner.T @ c) @ gram @ (inner.T @ c))
            best = max(best, (name, size), key=lambda pair: pair[1])
    return best
