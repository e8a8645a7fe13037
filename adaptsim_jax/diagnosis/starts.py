"""A simulator as the search's problem: each stretch's start is fitted wherever it is asked about, and taken out of every column."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.diagnosis.folds import folds_of
from adaptsim_jax.diagnosis.problem import Candidate, Problem, Quantity
from adaptsim_jax.diagnosis.simulator import Simulator, linearise, residuals

ROUNDS = 3  # of a start's fit from its anchor
FRESH = 12  # of the anchors' own
ENOUGH = 1e-3  # of a stretch's loss; a step that gains less is its last


@dataclass(frozen=True)
class Settled:
    """starts `[W, S]` and what they leave: residual `[W, R C]`, over the noise."""

    starts: np.ndarray
    residual: np.ndarray


def settle(
    simulator: Simulator, values: np.ndarray, starts: np.ndarray, rounds: int, which: np.ndarray | None = None
) -> Settled:
    """Starts fitted by Gauss and Newton's damped steps with values `[B, P]` held, of stretches `which [B]` (all where None)."""
    which = np.arange(simulator.stretches.count) if which is None else which
    starts, r = starts.copy(), residuals(simulator, values, starts, which)
    on = np.arange(len(which)) if starts.shape[1] else np.zeros(0, int)
    for _ in range(rounds):
        if not len(on):
            break
        c = linearise(simulator, values[on], starts[on], which[on], np.zeros((0, values.shape[1])))[0]
        gram = np.einsum("brs,brt->bst", c, c)
        step = np.linalg.solve(
            gram + 1e-9 * (1.0 + np.trace(gram, axis1=1, axis2=2))[:, None, None] * np.eye(c.shape[2]),
            np.einsum("brs,br->bs", c, r[on])[..., None],
        )[..., 0]
        before, left = np.square(r[on]).sum(1), on
        for length in (1.0, 0.3, 0.1):
            inside = np.isin(on, left)
            tried = starts[left] + length * step[inside] * simulator.stretches.scale
            fresh = residuals(simulator, values[left], tried, which[left])
            better = np.square(fresh).sum(1) < np.square(r[left]).sum(1)
            starts[left[better]], r[left[better]] = tried[better], fresh[better]
            left = left[~better]
            if not len(left):
                break
        on = on[before - np.square(r[on]).sum(1) > ENOUGH * before]
    return Settled(starts, r)


def problem_of(
    simulator: Simulator, candidates: Sequence[Candidate] | None = None, begun: np.ndarray | None = None
) -> Problem:
    """The search's problem (`diagnosis.problem`) of a simulator: `residuals` and `columns` as functions of values alone.

    Args:
        simulator: see `simulator.Simulator`.
        candidates: those that are considered, the simulator's own where None.
        begun: points `[N, P]` from which the declared fit may begin; the neutral one where None.

    Returns:
        A problem whose trials are the stretches; folds are their trials, or blocks of these where there are fewer than five.
    """
    s, quantities = simulator.stretches, simulator.quantities
    neutral = np.array([q.neutral for q in quantities])
    anchor = settle(simulator, np.tile(neutral, (s.count, 1)), s.start, FRESH).starts
    fold, block, _ = folds_of(s.trial, s.names)

    def left(values: np.ndarray) -> np.ndarray:
        return settle(simulator, values, anchor, ROUNDS).residual

    def columns(values: np.ndarray, basis: np.ndarray) -> np.ndarray:
        rows = np.tile(values, (s.count, 1))
        at = settle(simulator, rows, anchor, ROUNDS).starts
        by_start, by_value = linearise(simulator, rows, at, np.arange(s.count), basis)
        return without(by_start, by_value)

    wanted = tuple(simulator.candidates if candidates is None else candidates)
    free = np.maximum((s.seen > 0).sum((1, 2)) - s.start.shape[1], 1)
    wanted = tuple(_begun_apart(c, quantities, columns) for c in wanted)
    return Problem(
        quantities, tuple(simulator.declared), wanted, left, columns,
        free, tuple(s.names[t] for t in s.trial), neutral[None] if begun is None else begun, channels=len(simulator.channels),
        fold=fold, block=block,
    )  # fmt: skip


def _begun_apart(candidate: Candidate, quantities: Sequence[Quantity], columns) -> Candidate:
    """A candidate of which nothing follows to first order where it is neutral (a lag of 0, a friction that only holds) begins at a few
    sizes instead: shapes of its own are kept."""
    index = {q.name: i for i, q in enumerate(quantities)}
    own = [quantities[index[name]] for name in candidate.quantities]
    if any(candidate.shapes):
        return candidate
    neutral = np.array([q.neutral for q in quantities])
    basis = np.zeros((len(own), len(quantities)))
    for row, q in zip(basis, own, strict=True):
        row[index[q.name]] = q.scale
    if np.any(np.abs(columns(neutral, basis)) > 1e-9):
        return candidate
    sizes = [{q.name: float(np.clip(q.neutral + k * q.scale, q.low, q.high)) for q in own} for k in (1.0, 10.0, 100.0)]
    return replace(candidate, shapes=tuple(sizes))


def without(by_start: np.ndarray, by_value: np.ndarray) -> np.ndarray:
    """Columns `[W, R, K]` less what a stretch's own start `[W, R, S]` would take up."""
    if not by_start.shape[2]:
        return by_value
    own, _ = np.linalg.qr(by_start)
    return by_value - np.einsum("wrs,wqs,wqk->wrk", own, own, by_value, optimize=True)
