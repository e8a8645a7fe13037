"""How well values of a model simulate the stretches of a recording, from starts fitted to each by
plain least squares.

No weighting of an estimator enters: the start of a stretch is the one from which the simulated
angles come nearest to the measured ones, each radian (or metre) counting alike. Beside it, what a
straight line through the stretch leaves, and holding still: a model that does no better predicts
nothing, whatever it gains over another.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.attribution.estimate import refitted_start, usual
from adaptsim_jax.attribution.linear import linear
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.paths import ready, residuals, simulated, starts_of, widened
from adaptsim_jax.attribution.problem import Group, Problem
from adaptsim_jax.attribution.simulate import Path
from adaptsim_jax.attribution.weights import Fit, Weights

ROUNDS = 6


@dataclass(frozen=True)
class Forecast:
    """error [W, n] root mean square of each stretch, rad or m; measured, simulated, seen [W, L+1,
    n]; starts and paths by group.
    """

    error: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    seen: np.ndarray
    starts: tuple[np.ndarray, ...]
    paths: tuple[Path, ...]


def forecast(problem: Problem, vector: Vector) -> Forecast:
    """Simulate all stretches at a vector."""
    starts, paths = fitted_starts(problem, vector)
    measured, seen = observed(problem)
    out = np.zeros_like(measured)
    for group, path in zip(problem.groups, paths, strict=True):
        angles = path.sensed[:, : len(group.joints)].transpose(2, 0, 1)[: len(out)]
        out[..., list(group.joints)] = np.clip(np.nan_to_num(angles, nan=1e6), -1e6, 1e6)
    return Forecast(rms(measured - out, seen), measured, out, seen, starts, tuple(paths))


def observed(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Measured angles of the stretches [W, L+1, n], and where they were read (1) or not (0)."""
    count, rows = len(problem.fold), problem.groups[0].stretches.rows + 1
    measured, seen = (
        np.zeros((count, rows, problem.joints)),
        np.zeros((count, rows, problem.joints)),
    )
    for group in problem.groups:

        def swap(z):
            return z.transpose(2, 0, 1)[:count]

        own = list(group.joints)
        measured[..., own], seen[..., own] = swap(group.stretches.q), swap(group.stretches.seen)
    return measured, seen


def rms(off: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """[W, n] of what is off [W, L+1, n] where it was seen."""
    return np.sqrt(np.square(off * seen).sum(1) / np.maximum(seen.sum(1), 1))


def without_a_model(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """What a straight line through each stretch leaves of its angles [W, n], and holding still at
    their mean.
    """
    measured, seen = observed(problem)
    time = problem.groups[0].stretches.time.T[: len(measured), :, None] + 0.0 * measured
    count = np.maximum(seen.sum(1, keepdims=True), 1)

    def mean(z):
        return (z * seen).sum(1, keepdims=True) / count

    t, q = time - mean(time), measured - mean(measured)
    slope = (t * q * seen).sum(1, keepdims=True) / np.maximum(
        (t * t * seen).sum(1, keepdims=True), 1e-300
    )
    return rms(q - slope * t, seen), rms(q, seen)


def fitted_starts(
    problem: Problem,
    vector: Vector,
    rows: np.ndarray | None = None,
    rounds: int = ROUNDS,
    roughly: bool = False,
    starts: Sequence[np.ndarray] | None = None,
) -> tuple[tuple[np.ndarray, ...], Sequence[Path]]:
    """Starts by plain least squares on the angles, from the smoothed ones or those given, and the
    paths from there. rows [W, P]: other values for each stretch; roughly: a path is taken to follow
    its start as one that nothing acts on, which needs no derivatives; no step is taken that does
    not gain.
    """
    n, width = problem.joints, problem.groups[0].stretches.count
    weights = Weights(np.concatenate([np.ones(n), np.zeros(n)]), np.ones(width))
    made = ready(problem, vector, rows)
    starts = widened(made, starts_of(problem) if starts is None else starts)

    def by_lane(
        starts,
        # over all rows: of a long stretch a sum over some of them does not see a start that flings
        # a
        # joint away
    ):
        paths = simulated(made, starts)
        squares = [
            np.square(residuals(g, p)[..., : len(g.joints)]).sum((1, 2))
            for g, p in zip(problem.groups, paths, strict=True)
        ]
        return np.sum(squares, 0), paths

    best, paths = by_lane(starts)
    for _ in range(rounds):
        if roughly:
            moves = [
                _along_a_line(g, p, len(x))
                for g, p, x in zip(problem.groups, paths, starts, strict=True)
            ]
        else:
            lin = linear(problem, Fit(vector, starts, weights, best, "", 0), entries=())
            moves = [
                refitted_start(x, r, usual(problem, g))
                for g, x, r in zip(problem.groups, lin.start, lin.residual, strict=True)
            ]
        length, gained, fall = np.ones(width), np.zeros(width, bool), np.zeros(width)
        for _ in range(3):
            trial = tuple(x + length * d for x, d in zip(starts, moves, strict=True))
            loss, there = by_lane(trial)
            good = (loss < best) & ~gained

            def pick(a, b, good=good):
                return np.where(good, a, b)

            starts = tuple(pick(a, b) for a, b in zip(trial, starts, strict=True))
            paths = [
                Path(*(pick(a, b) for a, b in zip(p, q, strict=True)))
                for p, q in zip(there, paths, strict=True)
            ]
            fall = np.where(good, 1.0 - loss / np.maximum(best, 1e-300), fall)
            best = pick(loss, best)
            gained |= good
            if gained.all():
                break
            length = np.where(gained, 0.0, 0.3 * length)
        if np.max(fall) < 1e-4:
            break
    return starts, paths


def _along_a_line(group: Group, path: Path, rows: int) -> np.ndarray:
    """Change of starts [rows, W] by the straight line through what is left of the angles."""
    n = len(group.joints)
    left = residuals(group, path)[..., :n].transpose(1, 2, 0)  # [L+1, n, W]
    seen = group.stretches.seen
    time = (group.stretches.time - group.stretches.time[:1])[:, None, :] + 0.0 * left

    def total(z):
        return (z * seen).sum(0)

    count, first, second = total(1.0 + 0.0 * left), total(time), total(time * time)
    spread = np.maximum(count * second - first**2, 1e-12)
    slope = (count * total(time * left) - first * total(left)) / spread
    out = np.zeros((rows, left.shape[2]))
    out[:n], out[n : 2 * n] = (total(left) - slope * first) / np.maximum(count, 1), slope
    return out
