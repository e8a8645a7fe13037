"""A simulator as the search's problem: each stretch's start is fitted wherever it is asked about,
and taken out of every column.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from adaptsim_jax.diagnosis.criteria import FOLD, RESTART
from adaptsim_jax.diagnosis.folds import folds_of, pieces
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.simulator import Simulator, Stretches, linearise, residuals
from adaptsim_jax.diagnosis.steps import StretchLanes, best_of, fit_starts
from adaptsim_jax.effects.base import Effect, Quantity

START_ROUNDS = 3  # rounds of a start's fit from its anchor
MAX_SLOPES = 8  # slopes that an anchor is fitted by, one after the other
MIN_START_GAIN = 1e-3  # share of a stretch's loss; a step that gains less is its last
MIN_ANCHOR_GAIN = 0.05  # share of a stretch's loss; a slope that gains less is an anchor's last
START_DRAWS = 12  # draws of starts where fits are caught
DOWNWEIGHTED = (
    1.5,
    1,
)  # times the usual error, beyond which a stretch counts less, and by which power
CAUGHT = 1.25, 4  # the same of a model with names
MAX_POINTS = 6  # points that are stored with all their columns: memory
SAME_COLUMNS = 0.3  # of a quantity's scale, within which columns are not computed again
SAME_SLOPES = 1.0  # of a quantity's scale, within which slopes by starts are not computed again


@dataclass(frozen=True)
class Settled:
    """starts `[W, S]` and what they leave: residual `[W, R C]`, over the noise."""

    starts: np.ndarray
    residual: np.ndarray


@dataclass(frozen=True)
class StartSlope:
    """Derivatives by starts `[B, R C, S]` and the inverse of their squares `[B, S, S]`."""

    by_start: np.ndarray
    inverse: np.ndarray


@dataclass(frozen=True)
class LinearPoint:
    """Where a problem was linearised: values `[P]`, the starts that belong to them, their slope,
    what they take up (`taken_up`), the values `[P]` at which that slope was taken; columns: by row
    of a basis.
    """

    values: np.ndarray
    starts: np.ndarray
    slope: StartSlope
    taken: np.ndarray
    sloped: np.ndarray
    columns: dict[bytes, np.ndarray] = field(default_factory=dict)


def pull(stretches: Stretches) -> np.ndarray:
    """Weight `[S]` of a step of `scale` against the prior of starts, 0 where they have none."""
    if stretches.prior is None:
        return np.zeros(len(stretches.scale))
    return stretches.scale / stretches.prior


def slope_of(stretches: Stretches, by_start: np.ndarray) -> StartSlope:
    gram = np.einsum("brs,brt->bst", by_start, by_start) + np.diag(pull(stretches) ** 2)
    floor = 1e-9 * (1.0 + np.trace(gram, axis1=1, axis2=2))[:, None, None] * np.eye(gram.shape[1])
    return StartSlope(by_start, np.linalg.inv(gram + floor))


def settle(
    simulator: Simulator,
    values: np.ndarray,
    starts: np.ndarray,
    rounds: int,
    which: np.ndarray | None = None,
    slope: StartSlope | None = None,
) -> Settled:
    """Starts fitted by Gauss and Newton's damped steps with values `[B, P]` held, of stretches
    `which [B]` (all where None); by the derivatives `slope` of a point close by, where one is
    given, which costs a prediction a step.
    """
    s, weight = simulator.stretches, pull(simulator.stretches)
    which = np.arange(s.count) if which is None else which
    lengths = np.array([1.0, 0.3, 0.1] if slope is None else [1.0, 0.3])[:, None, None]
    none = np.zeros((0, values.shape[1]))

    def off(starts, lanes):
        return weight * (s.start[which[lanes]] - starts) / s.scale

    def evaluate(starts, lanes):
        left = residuals(simulator, values[lanes], starts, which[lanes])
        return left, np.square(left).sum(1) + np.square(off(starts, lanes)).sum(1)

    def propose(starts, left, lanes):
        if slope is None:
            by_start = linearise(simulator, values[lanes], starts, which[lanes], none)[0]
            here = slope_of(s, by_start)
        else:
            here = StartSlope(slope.by_start[lanes], slope.inverse[lanes])
        down = np.einsum("brs,br->bs", here.by_start, left) + weight * off(starts, lanes)
        return starts + lengths * (np.einsum("bst,bt->bs", here.inverse, down) * s.scale)

    begun = StretchLanes(starts, *evaluate(starts, np.arange(len(which))))
    found = fit_starts(begun, propose, evaluate, rounds if starts.shape[1] else 0, MIN_START_GAIN)
    return Settled(found.starts, found.left)


@dataclass(frozen=True)
class Linearised:
    """A simulator around the points where it was asked: what was fitted and differentiated there is
    used again close by.
    """

    simulator: Simulator
    points: list[LinearPoint]
    scale: np.ndarray
    weight: np.ndarray

    def near(self, values: np.ndarray) -> LinearPoint:
        away = [np.square((p.values - values) / self.scale).sum() for p in self.points]
        return self.points[int(np.argmin(away))]

    def anew(self, values: np.ndarray) -> None:
        """Find starts anew at values `[P]` from those of the nearest point: with what a model
        lacked others were caught at.
        """
        if self.simulator.stretches.start.shape[1]:
            self.points.append(anchored(self.simulator, values, self.near(values).starts))
            del self.points[1 : max(1, len(self.points) - MAX_POINTS)]
            self.weight[:] = weights(self.simulator, values, self.points[-1].starts, *CAUGHT)

    def residual(self, values: np.ndarray) -> np.ndarray:
        """`[W, R C]` with values `[W, P]`, starts settled by the slope of the nearest point, from
        the best of its own, those of the last point, and their first guess: else a model is better
        than another by where its starts were sought.
        """
        point, s = self.near(values.mean(0)), self.simulator.stretches
        starts = point.starts

        def evaluate(starts, lanes):
            left = residuals(self.simulator, values[lanes], starts, lanes)
            return left, np.square(left).sum(1)

        if starts.shape[1]:
            last = self.points[-1].starts
            starts = best_of(
                (starts, s.start, *([] if last is starts else [last])), evaluate
            ).starts
        found = settle(self.simulator, values, starts, START_ROUNDS, None, point.slope)
        return found.residual * self.weight[:, None]

    def columns(self, values: np.ndarray, basis: np.ndarray) -> np.ndarray:
        """Derivatives `[W, R C, K]` along the rows of a basis, less what starts would take up."""
        s = self.simulator.stretches
        if not len(basis):
            return np.zeros((s.count, s.measured[0].size, 0))
        point, count = self.near(values), s.count
        moved = bool(np.any(np.abs(point.values - values) > SAME_COLUMNS * self.scale))
        rows = np.tile(values if moved else point.values, (count, 1))
        if moved:
            starts = settle(
                self.simulator, rows, point.starts, START_ROUNDS, None, point.slope
            ).starts
        else:
            starts = point.starts
        known = {} if moved else point.columns
        fresh = [row for row in basis if row.tobytes() not in known]
        if moved or fresh:
            asked = np.array(fresh).reshape(-1, basis.shape[1])
            resloped = moved and bool(
                np.any(np.abs(point.sloped - values) > SAME_SLOPES * self.scale)
            )
            by_start, by_value = linearise(
                self.simulator, rows, starts, np.arange(count), asked, starts_too=resloped
            )
            if resloped:
                point = LinearPoint(
                    values.copy(),
                    starts,
                    slope_of(s, by_start),
                    taken_up(by_start, pull(s)),
                    values.copy(),
                )
            elif moved:
                point = replace(point, values=values.copy(), starts=starts, columns={})
            if moved:
                self.points.append(point)
                del self.points[1 : max(1, len(self.points) - MAX_POINTS)]
            known = point.columns
            retained = without(point.taken, by_value)
            known.update({row.tobytes(): retained[..., k] for k, row in enumerate(fresh)})
        return np.stack([known[row.tobytes()] for row in basis], -1) * self.weight[:, None, None]


def problem_of(
    simulator: Simulator,
    candidates: Sequence[Effect] | None = None,
) -> Problem:
    """The search's problem (`diagnosis.problem`) of a simulator: `residuals` and `columns` as
    functions of values alone.

    Args:
        simulator: see `simulator.Simulator`.
        candidates: those that are considered, the simulator's own where None.

    A stretch that is far worse followed than others (its start is caught at another contact) counts
    less, so that it does not decide.

    Returns:
        A problem whose trials are the stretches. Folds are their trials, or blocks of these where
        there are fewer than five.
    """
    s, quantities = simulator.stretches, simulator.quantities
    neutral = np.array([q.default for q in quantities])
    anchor = anchored(simulator, neutral)
    weight = weights(simulator, neutral, anchor.starts, *DOWNWEIGHTED)
    around = Linearised(simulator, [anchor], np.array([q.scale for q in quantities]), weight)
    fold, block = folds_of(s.trial), pieces(s.trial, FOLD.test_pieces)
    wanted = tuple(simulator.candidates if candidates is None else candidates)
    free = np.maximum((s.seen > 0).sum((1, 2)) - s.start.shape[1], 1)
    wanted = _started_separately(wanted, quantities, around)
    trials = tuple(s.names[t] for t in s.trial)
    return Problem(
        quantities,
        tuple(simulator.declared),
        wanted,
        around.residual,
        around.columns,
        free,
        trials,
        neutral[None],
        channels=len(simulator.channels),
        fold=fold,
        block=block,
        anew=around.anew,
        weight=weight,
    )


def weights(
    simulator: Simulator, values: np.ndarray, starts: np.ndarray, threshold: float, power: float
) -> np.ndarray:
    """Weights `[W]` of stretches by what they leave: less than 1 for those that leave more than
    `far` times the usual.
    """
    s = simulator.stretches
    left = np.square(
        residuals(simulator, np.tile(values, (s.count, 1)), starts, np.arange(s.count))
    )
    size = np.sqrt(left.sum(1) / np.maximum((s.seen > 0).sum((1, 2)), 1))
    return np.maximum(size / max(threshold * float(np.median(size)), 1.0), 1.0) ** -power


def anchored(
    simulator: Simulator, values: np.ndarray, begun: np.ndarray | None = None
) -> LinearPoint:
    """Starts fitted from `begun [W, S]` (their first guesses where None) with values `[P]`: each
    slope is used for a few steps before it is taken anew.
    """
    s = simulator.stretches
    starts = (s.start if begun is None else begun).copy()
    by_start = np.zeros((s.count, s.measured[0].size, s.start.shape[1]))
    on = np.arange(s.count)
    rows, none = np.tile(values, (s.count, 1)), np.zeros((0, len(values)))
    before = np.square(residuals(simulator, rows, starts, on)).sum(1)
    draw, shaken = np.random.default_rng(0).standard_normal, False
    for _ in range(MAX_SLOPES if starts.shape[1] else 0):
        by_start[on] = linearise(simulator, rows[on], starts[on], on, none)[0]
        found = settle(simulator, rows[on], starts[on], START_ROUNDS, on, slope_of(s, by_start[on]))
        starts[on], after = found.starts, np.square(found.residual).sum(1)
        gained, before = before - after > MIN_ANCHOR_GAIN * before, after
        on, before = on[gained], before[gained]
        if not len(on) and not shaken:
            shaken, on = True, np.arange(s.count)
            before = np.square(residuals(simulator, rows, starts, on)).sum(1)
            again = _shaken(simulator, rows, starts, by_start, before, on, draw)
            on, before = on[again], before[again]
        if not len(on):
            break
    return LinearPoint(values, starts, slope_of(s, by_start), taken_up(by_start, pull(s)), values)


def _shaken(simulator, rows, starts, by_start, before, on, draw) -> np.ndarray:
    """Starts moved, in place, to the best of a few draws about those that leave more than noise:
    where contact makes minima, the next may be better. Draws are as wide as what is left lets a
    start be. Returns whether a stretch is to be settled again.
    """
    s = simulator.stretches
    count = np.maximum((s.seen[on] > 0).sum((1, 2)), 1)
    bad, again = np.flatnonzero(before > RESTART.stretch_noises**2 * count), np.zeros(len(on), bool)
    if not len(bad):
        return again
    lanes, best = on[bad], before[bad].copy()
    wide = np.linalg.cholesky(slope_of(s, by_start[lanes]).inverse)
    wide = wide * np.sqrt(best / count[bad])[:, None, None]
    middle = starts[lanes].copy()
    for k in range(START_DRAWS):
        change = np.einsum("bst,bt->bs", wide, draw(middle.shape))
        tried = middle + (1.0, 0.3)[k % 2] * change * s.scale
        loss = np.square(residuals(simulator, rows[lanes], tried, lanes)).sum(1)
        better = loss < best
        starts[lanes[better]], best[better] = tried[better], loss[better]
    again[bad], before[bad] = best < before[bad], best
    return again


def _started_separately(
    wanted: Sequence[Effect], quantities: Sequence[Quantity], around: Linearised
) -> tuple[Effect, ...]:
    """A candidate of which nothing follows to first order where it is neutral (a lag of 0, a
    friction that only holds) begins at a few sizes instead: shapes of its own are kept.
    """
    index = {q.name: i for i, q in enumerate(quantities)}
    plain = sorted({index[q] for c in wanted if not any(c.points) for q in c.names})
    neutral = np.array([q.default for q in quantities])
    columns = around.columns(neutral, np.diag([q.scale for q in quantities])[plain])
    visible = np.any(np.abs(columns) > 1e-9, (0, 1))
    mask = {quantities[i].name for i, shown in zip(plain, visible, strict=True) if shown}
    out = []
    for c in wanted:
        if any(c.points) or mask & set(c.names):
            out.append(c)
            continue
        sizes = [
            {q.name: float(np.clip(q.default + k * q.scale, q.low, q.high)) for q in c.parameters}
            for k in (1.0, 10.0, 100.0)
        ]
        out.append(replace(c, grid=tuple(sizes)))
    return tuple(out)


def taken_up(by_start: np.ndarray, weight: np.ndarray | float = 0.0) -> np.ndarray:
    """Orthonormal columns `[W, R, S]` that span what a stretch's own start can take up, from its
    derivatives `[W, R, S]`; with a prior on starts (`pull [S]`) their upper rows, so that it takes
    up only as much as that lets it.
    """
    if not np.any(weight):
        if by_start.shape[2]:
            return np.linalg.qr(by_start)[0]
        return by_start
    count, rows, size = by_start.shape
    held = np.broadcast_to(np.diag(weight), (count, size, size))
    return np.linalg.qr(np.concatenate([by_start, held], 1))[0][:, :rows]


def without(taken: np.ndarray, by_value: np.ndarray) -> np.ndarray:
    """Columns `[W, R, K]` less what starts take up (`taken_up`)."""
    if not taken.shape[2] or not by_value.shape[2]:
        return by_value
    return by_value - np.einsum("wrs,wqs,wqk->wrk", taken, taken, by_value, optimize=True)
