"""Effects of a set fitted with their shapes, which lie on grids while a search goes on, and which
of them are needed then.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.attribution.equation.balance import residual
from adaptsim_jax.attribution.equation.columns import EffectTable
from adaptsim_jax.attribution.equation.searched import Searched
from adaptsim_jax.attribution.equation.solve import ForceRows, Solved, Sums, solved
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.score import JointCandidate, shape_entries
from adaptsim_jax.diagnosis.steps import Point, bounded_step, fit_values
from adaptsim_jax.effects.base import NINETY

SHAPE_ROUNDS = 8  # rounds of steps of shapes, at most


def exact(
    state: Searched, added: Sequence[JointCandidate], whole: Solved, near: Vector | None = None
) -> tuple[Vector, np.ndarray]:
    """The vector of null and effects, shapes too, by Gauss and Newton's steps from the linear one,
    or from the values of a fit that is `near`, where that is better; standard errors [P].
    """
    entries, values = (
        list(whole.entries),
        list(np.array([*state.null.values]) + whole.step[: len(state.null)]),
    )
    values += [
        e.start + z
        for e, z in zip(whole.entries[len(values) :], whole.step[len(values) :], strict=True)
    ]
    vector = Vector(tuple(entries), np.array(values))
    vector = vector.at(np.clip(vector.values, vector.low, vector.high))
    for c in added:
        vector = vector.with_entries(shape_entries(state.problem, state.reach, c))

    point = _at(state, vector)
    if near is not None:
        known = {e.key: z for e, z in zip(near.entries, near.values, strict=True)}
        pairs = zip(vector.entries, vector.values, strict=True)
        close = _at(state, vector.at(np.array([known.get(e.key, z) for e, z in pairs])))
        point = min(point, close, key=lambda p: p.loss)
    fitted: list[Solved] = []

    def around(point: Point) -> Callable[[float], Point]:
        here = point.state
        fitted[:] = [_linearised(state, here)]
        hess, slope = fitted[0].hess, fitted[0].slope
        ends = here.low - here.values, here.high - here.values
        return lambda damping: _at(
            state, here.at(here.values + bounded_step(hess, slope, *ends, damping))
        )

    found = fit_values(point, around, SHAPE_ROUNDS, damping=0.0)
    return found.point.state, fitted[0].error


def _at(state: Searched, vector: Vector) -> Point:
    """A vector with its loss."""
    missing = residual(state.problem, state.balance, vector)
    return Point(_cost(state.rows, missing, vector), vector)


def _linearised(state: Searched, vector: Vector) -> Solved:
    """The columns of a vector at its values, fitted."""
    table = EffectTable(state.problem, state.balance, vector)
    free = [i for i, e in enumerate(vector.entries) if e.low < e.high]
    missing = table.missing()
    columns = np.zeros((*missing.shape, len(vector)))
    columns[..., free] = table.stack([vector.entries[i] for i in free])
    sums = Sums(replace(state.rows, missing=missing))
    sums.add("", columns)
    return solved(sums, [""], vector.entries, vector.values)


def needed(
    state: Searched, added: Sequence[JointCandidate], asked: Sequence[JointCandidate]
) -> tuple[list[JointCandidate], Vector, np.ndarray]:
    """Effects without those of `asked` that only made up for a shape on a grid: with all shapes
    fitted their interval includes none of them, and the rest leaves as little. With the vector of
    these and its errors, as of `exact`.
    """
    added = list(added)
    whole = exact(state, added, state.set_of(added))
    final, errors = whole
    for c in sorted(asked, key=lambda c: _sure(*whole, c)):
        if _sure(final, errors, c) > NINETY:
            break
        rest = [k for k in added if k is not c]
        less = exact(state, rest, state.set_of(rest), final)
        left = [_left(state, v)[state.own(c)].sum() for v in (less[0], final)]
        if left[0] - left[1] < state.limits.gain * len(c.entries) * left[0]:
            added, (final, errors) = rest, less
    return added, final, errors


def _sure(final: Vector, errors: np.ndarray, c: JointCandidate) -> float:
    """Of its amplitudes the farthest from none, in standard errors."""
    keys = {e.key for e in c.entries}
    rows = zip(final.entries, final.values, errors, strict=True)
    return max(abs(value - e.off) / max(error, 1e-300) for e, value, error in rows if e.key in keys)


def _left(state: Searched, vector: Vector) -> np.ndarray:
    """Weighted squares of what is missing [n]."""
    return np.square(residual(state.problem, state.balance, vector) * state.rows.weight).sum(0)


def _cost(rows: ForceRows, missing: np.ndarray, vector: Vector) -> float:
    off = vector.values - vector.start
    finite = np.isfinite(vector.precision)
    prior = float(np.sum((vector.precision * off * off)[finite]))
    return 0.5 * (float(np.square(missing * rows.weight).sum()) + prior)
