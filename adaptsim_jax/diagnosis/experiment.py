"""The next experiment: which stretches separate look-alikes most, or what shows each of them by
itself; and what this one could have found.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy import stats

from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import REPORT, Criteria
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.fit import jacobian
from adaptsim_jax.diagnosis.models import Model, begun_at
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.report import Label
from adaptsim_jax.diagnosis.simulator import Simulator, linearise
from adaptsim_jax.diagnosis.starts import settle, taken_up, without
from adaptsim_jax.diagnosis.testing import correlated_rows
from adaptsim_jax.effects.base import Effect


def discriminating(
    simulator: Simulator, found: Finding, proposals: Mapping[str, Simulator]
) -> Table | None:
    """Where a named effect has a look-alike: which of the proposals parts the two most, or which
    recorded trial does where there are none; None where every name stands alone.

    The distance of a stretch is that of both models' predictions over the noise, less what its own
    start would take up.
    """
    for n in found.named:
        for rival, model in zip(n.alternatives, n.models, strict=True):
            tried = dict(proposals) or {"": simulator}
            separation = {
                (key, trial): size
                for key, sim in tried.items()
                for trial, size in _distances(sim, found.final, model).items()
            }
            (key, trial), size = max(separation.items(), key=lambda item: item[1])
            if key:
                where = f"proposal {key}"
            else:
                where = f"motions like those of trial {trial}"
            pair = f"{n.candidate.name} and {rival.name}"
            text = f"{pair} differ most in {where}: by {size:.2g} times the noise over a stretch."
            if size < REPORT.visible:
                text += " That is hardly seen: another kind of experiment is needed."
            return {
                "message": text,
                "separates": [n.candidate.name, rival.name],
                "distance": size,
                "proposal": key or trial,
            }
    return None


def separated_by(
    found: Finding,
    label: Callable[[Any], Label],
    called: Callable[[Label], str],
    shown_by: Callable[[Label], str],
    text: str,
) -> Table | None:
    """Where a named effect has a look-alike: what shows either by itself; None where every name
    stands alone, or nothing is known to show it.

    Args:
        found: Names and their look-alikes.
        label: How a candidate is called.
        called: The same in a sentence.
        shown_by: What shows an effect, '' where nothing is known to.
        text: The message, with places for both and for what shows them.
    """
    for n in found.named:
        same = [Label(*s.split("@")) for s in getattr(n.candidate, "same", ())]
        own, rivals = label(n.candidate), [*map(label, n.alternatives), *same]
        advice = dict.fromkeys(words for x in (own, *rivals) if (words := shown_by(x)))
        if rivals and advice:
            return {
                "message": text.format(called(own), called(rivals[0]), "; or ".join(advice)),
                "separates": [own.name, rivals[0].name],
            }
    return None


def _distances(simulator: Simulator, one: Model, other: Model) -> dict[str, float]:
    """By trial the largest distance of a stretch's predictions by two models, over the noise."""
    s, which = simulator.stretches, np.arange(simulator.stretches.count)

    def rows(m):
        return np.tile(m.fit.values, (s.count, 1))

    noise = np.array([c.noise for c in simulator.channels])
    starts = settle(simulator, rows(one), s.start, 0).starts
    off = (
        simulator.predict(rows(one), starts, which) - simulator.predict(rows(other), starts, which)
    ) / noise
    off = (np.nan_to_num(off) * (s.seen > 0)).reshape(s.count, -1)
    by_start = linearise(simulator, rows(one), starts, which, np.zeros((0, len(one.fit.values))))[0]
    size = np.sqrt(np.square(without(taken_up(by_start), off[..., None])[..., 0]).sum(1))
    return {s.names[t]: float(size[s.trial == t].max()) for t in np.unique(s.trial)}


def power_rows(problem: Problem, found: Finding, criteria: Criteria) -> list[Table]:
    """Rows of `power`: a candidate's quantity, a size that matters (`Quantity.scale`), and the
    share of recordings like this one in which an effect of that size would pass the score test (its
    level corrected for the number of candidates and of their shapes).

    The score of a quantity of size `a` has the noncentrality `a^2 H / (tau s^2)`: `H` its squared
    column freed of starts and fitted quantities, `s^2` what the final model leaves, `tau` the rows
    over which that hangs together (Rao's test; Cox and Hinkley, 1974).
    """
    model, fit = found.final, found.final.fit
    count = float(problem.counts.sum())
    left = max(fit.loss / count, 1e-12) * correlated_rows(problem.by_channel(fit.residual))
    level = criteria.alpha / max(len(problem.effects), 1)
    out = []
    for e in problem.effects:
        if e in model.added:
            continue
        name, information = _best(problem, fit, e)
        q = problem.quantities[problem.index[name]]
        least = stats.chi2.isf(level / len(e.points), 1)
        power = float(stats.ncx2.sf(least, 1, max(information / left, 1e-12)))
        size = {"size": q.scale, "unit": q.unit, "power": power}
        out.append({"name": e.name, "where": e.place} | size)
    return sorted(out, key=lambda row: row["power"])


def _best(problem: Problem, fit, e: Effect) -> tuple[str, float]:
    """The quantity of a candidate that tells most, and the squared length of its freed column in a
    step of its scale.
    """
    inner = fit.columns.reshape(
        -1 if fit.columns.size else fit.residual.size, fit.columns.shape[-1]
    )
    gram = np.linalg.inv(inner.T @ inner + 1e-9 * np.eye(inner.shape[1]))
    best = e.names[0], 0.0
    for shape in e.points:
        for name in [q for q in e.names if q not in shape and q not in fit.free]:
            c = jacobian(problem, begun_at(problem, fit.values, shape), [name]).reshape(-1)
            size = float(c @ c - (inner.T @ c) @ gram @ (inner.T @ c))
            best = max(best, (name, size), key=lambda pair: pair[1])
    return best
