"""Output-error estimation: Gauss and Newton's steps, damped, over stretches with a free start each.

Starts are eliminated stretch by stretch (variable projection; Golub and Pereyra, 1973). Channels are weighted by the size of their
own residuals, so that radians, metres and their rates need no common unit; a stretch that runs away counts less.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from adaptsim_jax.attribution.columns import Columns, Shapes
from adaptsim_jax.attribution.parameters import Entry, Vector
from adaptsim_jax.attribution.paths import ready, residuals, simulated, starts_of, widened
from adaptsim_jax.attribution.problem import Group, Problem
from adaptsim_jax.attribution.simulate import Path, linearise, respond, responded_start

SAMPLES = 48  # of a stretch that enter the sums, evenly spread
CONVERGED = 1e-4  # share of the loss that a round takes off, below which a fit ends
GOING_ON = 0.03  # the same of a fit that is only to be compared
WILD = 3.0  # times the median error of a stretch, from which it counts less


@dataclass(frozen=True)
class Weights:
    """channel [2n]: 1 / size of a residual of each channel (0: not measured); stretch [W]."""

    channel: np.ndarray
    stretch: np.ndarray


@dataclass(frozen=True)
class Fit:
    """A model fitted: its vector, starts by group [2n, W] (see `simulate`), weights, loss by stretch [W], and how it ended."""

    vector: Vector
    starts: tuple[np.ndarray, ...]
    weights: Weights
    loss: np.ndarray
    code: str
    rounds: int

    @property
    def total(self) -> float:
        return float(self.loss.sum())


@dataclass(frozen=True)
class Linear:
    """A fit linearised. By group: residual [W, R], start and parameter columns [W, R, 2n], [W, R, P]; weights in all of them."""

    fit: Fit
    residual: tuple[np.ndarray, ...]
    start: tuple[np.ndarray, ...]
    shared: tuple[np.ndarray, ...]
    paths: tuple[Columns, ...]
    slopes: tuple[tuple[np.ndarray, np.ndarray], ...]
    picked: np.ndarray


def _as_long(x: np.ndarray, rows: int) -> np.ndarray:
    """The first rows of x [R, W], with rows of zeros where it has fewer."""
    return x[:rows] if len(x) >= rows else np.concatenate([x, np.zeros((rows - len(x), *x.shape[1:]))])


def _own(weights: Weights, group: Group, joints: int) -> np.ndarray:
    """Channel weights [2 n_g] of a group."""
    j = np.array(group.joints)
    return np.concatenate([weights.channel[j], weights.channel[joints + j]])


def losses(problem: Problem, paths: Sequence[Path], weights: Weights) -> np.ndarray:
    """Half the weighted sum of squares of each stretch [W], over the samples that count."""
    total = np.zeros(len(weights.stretch))
    for group, path in zip(problem.groups, paths, strict=True):
        r = residuals(group, path)[:, picked(problem)] * _own(weights, group, problem.joints)
        total += 0.5 * np.square(r).sum((1, 2))
    return total * weights.stretch


def picked(problem: Problem) -> np.ndarray:
    """Rows of a stretch that enter the sums."""
    rows = problem.groups[0].stretches.rows
    return np.unique(np.linspace(0, rows, min(SAMPLES, rows + 1)).round().astype(int))


def weigh(problem: Problem, paths: Sequence[Path]) -> Weights:
    """Weights from the residuals themselves, by medians over stretches, so that none that ran away decides."""
    n, width = problem.joints, problem.groups[0].stretches.count
    channel, share, over = np.zeros(2 * n), np.zeros((width, 2 * n)), []
    for group, path in zip(problem.groups, paths, strict=True):
        r = residuals(group, path)
        seen = np.concatenate([group.stretches.seen, group.stretches.seen_v], 1).transpose(2, 0, 1)
        count = seen.sum(1)
        rms = np.sqrt(np.square(r).sum(1) / np.maximum(count, 1))
        j = np.array(group.joints)
        for k, at in enumerate([*j, *(n + j)]):
            have = count[:, k] > 0
            if have.any():
                size = np.median(rms[have, k])
                channel[at] = 1.0 / max(size, problem.floor[at], 1e-9)
                over.append(size / max(problem.floor[at], 1e-9))
                share[:, at] = rms[:, k] * channel[at]
    used = channel > 0
    size = np.sqrt(np.square(share[:, used]).mean(1))
    usual = max(float(np.median(size[size > 0])), 1e-12) if np.any(size > 0) else 1.0
    # what a model lacks moves a stretch's residuals together: beside the prior, they count as one where it is most of them
    alike = np.clip(np.median(over), 1.0, np.sqrt(SAMPLES)) if over else 1.0
    return Weights(channel / alike, 1.0 / np.square(np.maximum(1.0, size / (WILD * usual))))


def linear(problem: Problem, fit: Fit, entries: Sequence[Entry] | None = None) -> Linear:
    """Linearise a fit, by the starts and by `entries` (those of its vector where None)."""
    entries = fit.vector.entries if entries is None else entries
    at = picked(problem)
    residual, start, shared, columns, slopes = [], [], [], [], []
    with jax.enable_x64(True):
        made = ready(problem, fit.vector)
        for (group, values, _, how), x0 in zip(made, widened(made, fit.starts), strict=True):
            s = group.stretches
            path, a, f = linearise(group.model, values, s.time, s.stamp, s.command, x0, how)
            path = Path(*(np.asarray(z) for z in path))
            by_state, by_force = (np.array(z).transpose(3, 0, 1, 2) for z in (a, f))
            slope = (by_state, by_force)
            own = Columns(problem, group, fit.vector, jax.tree.map(jnp.asarray, values), path)
            weight = _own(fit.weights, group, problem.joints) * np.sqrt(fit.weights.stretch)[:, None, None]
            seen = np.concatenate([s.seen, s.seen_v], 1).transpose(2, 0, 1)
            weight = (weight * seen)[:, at]
            flat = lambda z, w=weight: (z[:, at] * w[..., None]).reshape(len(z), -1, z.shape[-1])
            residual.append((residuals(group, path)[:, at] * weight).reshape(len(seen), -1))
            n, g = len(group.joints), how.giving
            free = np.concatenate([np.arange(2 * n), 2 * n + g, 3 * n + g])
            by_start = np.zeros((len(by_state), by_state.shape[1] + 1, 2 * n, len(x0)))
            by_start[..., free] = responded_start(by_state, n, len(free))
            start.append(flat(by_start))
            columns.append(own)
            slopes.append(slope)
            shared.append(_output(own, slope, [(e, None) for e in entries], flat))
            _without_lost(residual[-1], start[-1], shared[-1], *slope)
    return Linear(fit, tuple(residual), tuple(start), tuple(shared), tuple(columns), tuple(slopes), at)


def _without_lost(*by_lane: np.ndarray) -> None:
    """Stretches [W, ...] that ran away beyond all numbers say nothing of where to go: their rows become zero, in place."""
    lost = ~np.all([np.isfinite(z).reshape(len(z), -1).all(1) for z in by_lane], 0)
    for z in by_lane if lost.any() else ():
        z[lost] = 0.0


def _output(made: Columns, slope: tuple[np.ndarray, np.ndarray], entries, flat) -> np.ndarray:
    """Output columns [W, R, K]; zero, at no cost, for entries of other groups."""
    own = [k for k, (e, _) in enumerate(entries) if set(e.joints) & set(made.group.joints)]
    parts = [np.zeros((*flat(np.zeros((*slope[0].shape[:1], slope[0].shape[1] + 1, 2 * made.n, 1))).shape[:2], 0))]
    for first in range(0, len(own), 48):
        force, output = made.stack([entries[k] for k in own[first : first + 48]])
        y = respond(*slope, force, made.n)
        parts.append(flat(y if output is None else y + output))
    found = np.concatenate(parts, 2)
    out = np.zeros((*found.shape[:2], len(entries)))
    out[..., own] = found
    return out


def candidate_columns(
    problem: Problem, lin: Linear, entries: Sequence[tuple[Entry, Shapes | None]]
) -> list[np.ndarray]:
    """Output columns [W, R, K] of more parameters, by group, weighted as those of `lin`. Those of drives that would give are freed of
    how these swing from a start that nobody knows."""
    out = []
    for group, made, slope, start in zip(problem.groups, lin.paths, lin.slopes, lin.start, strict=True):
        s = group.stretches
        seen = np.concatenate([s.seen, s.seen_v], 1).transpose(2, 0, 1)
        weight = _own(lin.fit.weights, group, problem.joints) * np.sqrt(lin.fit.weights.stretch)[:, None, None]
        weight = (weight * seen)[:, lin.picked]
        flat = lambda z, w=weight: (z[:, lin.picked] * w[..., None]).reshape(len(z), -1, z.shape[-1])
        columns = _output(made, slope, list(entries), flat)
        for k, (e, shape) in enumerate(entries):
            effect = problem.effect(e.owner)
            if effect.place == "drive" and e.name in (shape or {}) and e.joints[0] in group.joints:
                at = [group.joints.index(e.joints[0]) + n for n in (0, made.n)]
                swings = np.zeros((len(seen), made.path.x.shape[0], 2 * made.n, 2))
                swings[:, :, at] = made.alone(effect, e.name, shape)[1:, :, at].transpose(3, 1, 2, 0)
                columns[..., k : k + 1] = project(np.concatenate([start, flat(swings)], 2), columns[..., k : k + 1])[0]
        out.append(columns)
    return out


def project(start: np.ndarray, *columns: np.ndarray) -> list[np.ndarray]:
    """Columns [W, R, .] less what the free starts explain of them."""
    scale = np.sqrt(np.square(start).sum(1, keepdims=True))
    q, r = np.linalg.qr(start / np.where(scale > 0, scale, 1.0))
    good = (np.abs(np.diagonal(r, axis1=1, axis2=2)) > 1e-9)[:, None, :]
    q = q * good
    return [c - q @ (np.swapaxes(q, 1, 2) @ c) for c in columns]


@dataclass(frozen=True)
class Normal:
    """Normal equations by fold: hess [F, P, P], slope [F, P]; of the shared parameters with starts eliminated."""

    hess: np.ndarray
    slope: np.ndarray


def normal(problem: Problem, residual: Sequence[np.ndarray], start, shared) -> Normal:
    """Summed over groups, by fold."""
    count, folds = shared[0].shape[2], len(problem.folds)
    hess, slope = np.zeros((folds, count, count)), np.zeros((folds, count))
    for r, x, s in zip(residual, start, shared, strict=True):
        live = np.flatnonzero(np.any(s != 0.0, axis=(0, 1)))
        rp, sp = project(x, r[..., None], s[..., live])
        fold = padded_fold(problem, len(r))
        for k in range(folds):
            mine = rows(sp[fold == k])
            hess[k][np.ix_(live, live)] += mine.T @ mine
            slope[k][live] += mine.T @ rp[fold == k].reshape(-1)
    return Normal(hess, slope)


def rows(columns: np.ndarray) -> np.ndarray:
    """[W, R, K] as [W R, K]."""
    return columns.reshape(columns.shape[0] * columns.shape[1], columns.shape[2])


def padded_fold(problem: Problem, width: int) -> np.ndarray:
    return (
        np.concatenate([problem.fold, np.full(width - len(problem.fold), -1)])
        if width > len(problem.fold)
        else problem.fold
    )


def bounded_step(hess: np.ndarray, slope: np.ndarray, vector: Vector, damping: float) -> np.ndarray:
    """Step [P] of the damped normal equations with the prior, within the bounds: entries that push against one stay."""
    prior = vector.precision
    hess = hess + np.diag(prior)
    slope = slope - prior * (vector.values - vector.start)
    low, high = vector.low - vector.values, vector.high - vector.values
    free = np.diagonal(hess) > 0.0
    step = np.zeros(len(slope))
    for _ in range(8):
        size = np.sqrt(np.maximum(np.diagonal(hess), 1e-300))
        scaled = hess / size / size[:, None]
        scaled[np.diag_indices_from(scaled)] += damping + 1e-10
        held = ~free
        right = (slope - hess[:, held] @ step[held]) / size
        if free.any():
            step[free] = _solved(scaled[np.ix_(free, free)], right[free]) / size[free]
        out = free & ((step < low) | (step > high))
        if not out.any():
            break
        step[out] = np.clip(step[out], low[out], high[out])
        free &= ~out
    return np.clip(step, low, high)


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """By Cholesky's factors, or by least squares, many times the work, where rounding left the matrix without: of a parameter of which
    one fold says all, little but rounding is left without it."""
    try:
        return scipy.linalg.cho_solve(scipy.linalg.cho_factor(matrix), right)
    except np.linalg.LinAlgError:
        return np.linalg.lstsq(matrix, right, rcond=1e-12)[0]


def start_steps(lin: Linear, step: np.ndarray) -> list[np.ndarray]:
    """Change of the starts [2n, W] that goes with a step of the parameters: [P], or [W, P] for each stretch."""
    out = []
    for r, x, s in zip(lin.residual, lin.start, lin.shared, strict=True):
        left = r - (s @ (step if step.ndim == 1 else step[:, : s.shape[2], None])).reshape(r.shape)
        out.append(refitted_start(x, left))
    return out


def refitted_start(start: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Least-squares change of the starts [2n, W] for residuals [W, R]."""
    scale = np.sqrt(np.square(start).sum(1))
    scale = np.where(scale > 0, scale, 1.0)
    x = start / scale[:, None]
    normal = np.swapaxes(x, 1, 2) @ x + 1e-9 * np.eye(x.shape[2])
    return (np.linalg.solve(normal, np.swapaxes(x, 1, 2) @ left[..., None])[..., 0] / scale).T


def weighted(problem: Problem, lin: Linear, group: Group, path: Path) -> np.ndarray:
    """Residuals [W, R] of a path with the weights of `lin`."""
    s = group.stretches
    seen = np.concatenate([s.seen, s.seen_v], 1).transpose(2, 0, 1)
    weight = _own(lin.fit.weights, group, problem.joints) * np.sqrt(lin.fit.weights.stretch)[:, None, None] * seen
    return (residuals(group, path) * weight)[:, lin.picked].reshape(len(seen), -1)


def settled(
    problem: Problem,
    lin: Linear,
    vector: Vector,
    options: Sequence[Sequence[np.ndarray]],
    rows: np.ndarray | None = None,
    refine: int = 1,
) -> tuple[tuple[np.ndarray, ...], np.ndarray, list[Path]]:
    """Starts, loss [W] and paths at given parameters: of the options stretch by stretch the better, refined `refine` times by least
    squares with the derivatives of `lin`. A stretch that sticks and slips need not follow them: no step is taken on trust."""
    best: list = []
    made = ready(problem, vector, rows)

    def offer(starts: Sequence[np.ndarray]) -> None:
        starts = widened(made, starts)
        paths = simulated(made, starts)
        loss = losses(problem, paths, lin.fit.weights)
        if not best:
            best[:] = [tuple(starts), loss, paths]
            return
        good = loss < best[1]
        pick = lambda a, b: np.where(good, a, b)
        best[0] = tuple(pick(a, b) for a, b in zip(starts, best[0], strict=True))
        best[2] = [
            Path(*(pick(a, b) for a, b in zip(new, old, strict=True))) for new, old in zip(paths, best[2], strict=True)
        ]
        best[1] = pick(loss, best[1])

    for starts in options:
        offer(starts)
    for _ in range(refine):
        moves = [
            refitted_start(x, weighted(problem, lin, g, p))
            for g, p, x in zip(problem.groups, best[2], lin.start, strict=True)
        ]
        offer([x + _as_long(d, len(x)) for x, d in zip(best[0], moves, strict=True)])
    return best[0], best[1], best[2]


def fit(
    problem: Problem,
    vector: Vector,
    starts: Sequence[np.ndarray] | None = None,
    *,
    rounds: int = 12,
    weights: Weights | None = None,
    glance: int | None = None,
) -> Fit:
    """Fit the vector and all starts. weights: fixed ones (made anew along the way where None); glance: rounds after which a fit
    that is only to be compared ends once a round gains little. Codes: converged, stopped (rounds
    are used up), stuck (no step lowers the loss), diverged (the start itself runs away)."""
    made = ready(problem, vector)
    starts = widened(made, starts_of(problem) if starts is None else starts)
    paths = simulated(made, starts)
    own = weights is None
    weights = weigh(problem, paths) if own else weights
    now = Fit(vector, starts, weights, losses(problem, paths, weights), "stopped", 0)
    damping = 1e-3
    for k in range(rounds):
        lin = linear(problem, now)
        n = normal(problem, lin.residual, lin.start, lin.shared)
        taken = None
        for _ in range(6):
            step = bounded_step(n.hess.sum(0), n.slope.sum(0), now.vector, damping)
            moves = start_steps(lin, step)
            trial = now.vector.at(now.vector.values + step)
            moved = tuple(x + d for x, d in zip(now.starts, moves, strict=True))
            at, loss, paths = settled(problem, lin, trial, (moved, now.starts))
            if _cost(loss, trial) < _cost(now.loss, now.vector):
                taken = replace(now, vector=trial, starts=at, loss=loss, rounds=k + 1)
                break
            damping = max(10.0 * damping, 1e-3)
        if taken is None:
            return replace(now, code="converged" if k and damping > 1e2 else "stuck", rounds=k)
        fall = 1.0 - _cost(taken.loss, taken.vector) / max(_cost(now.loss, now.vector), 1e-300)
        now, damping = taken, max(0.1 * damping, 1e-8)
        if own:
            weights = weigh(problem, paths)
            now = replace(now, weights=weights, loss=losses(problem, paths, weights))
        if fall < (CONVERGED if glance is None or k + 1 < glance else GOING_ON):
            return replace(now, code="converged")
    return now


def _cost(loss: np.ndarray, vector: Vector) -> float:
    off = vector.values - vector.start
    return float(loss.sum() + 0.5 * np.sum(vector.precision * off * off))
