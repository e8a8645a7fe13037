"""Conventions told from data: one cheap refit for each way in which columns or lengths are commonly
taken wrongly.

The torque that moves a mechanism is linear in what is unknown of it (Khalil and Dombre 2002, ch.
9), so that a convention is judged by one non-negative least-squares fit of inertial parameters,
dampings and dry frictions to block means of the motion. Where the declared convention leaves most
of the torque and another one next to nothing, the columns are told to contradict the model. NumPy
and SciPy alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import nnls

from adaptsim_jax.logs.criteria import BLOCK
from adaptsim_jax.logs.quality.findings import WORDS

SHIFTS = np.arange(-60.0, 61.0, 1.0) * 1e-3
"""s by which the torque is moved."""


@dataclass(frozen=True)
class BlockMeans:
    """Block means `q, v, a, tau [K, n]` in SI units."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray


@dataclass(frozen=True)
class Track:
    """A trial: `time [T]` s, `q, tau [T, n]`, `v [T, n]` or None; the torque holds from its row to
    the next.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray | None
    tau: np.ndarray


Design = Callable[[BlockMeans, bool], np.ndarray]
"""`(motion, gravity) -> [K, n, P]`: torque at each joint by unit of each parameter that is at least
0.
"""


def as_logged(motion: BlockMeans) -> BlockMeans:
    """The motion as it was logged."""
    return motion


@dataclass(frozen=True)
class Hypothesis:
    """What may be otherwise than declared. `motion`: the motion as it would be then; `design` where
    the mechanism is another.
    """

    name: str
    statement: str
    mend: str
    motion: Callable[[BlockMeans], BlockMeans] = as_logged
    design: Design | None = None
    gravity: bool = True


def hypothesis(
    code: str,
    motion: Callable[[BlockMeans], BlockMeans] = as_logged,
    design: Design | None = None,
    **facts: Any,
) -> Hypothesis:
    """Make a hypothesis with the words of its code (`words.toml`), which name the `facts`."""
    words = WORDS["hypothesis"][code]
    texts = (words[key].format(**facts) for key in ("statement", "mend"))
    return Hypothesis(code, *texts, motion=motion, design=design)


def motion_of(tracks: Sequence[Track], shift: float = 0.0, sharp: bool = False) -> BlockMeans:
    """Compute block means of all trials, with the torque of `shift` s later taken to act."""
    parts = [blocks(t, shift, sharp) for t in tracks]
    joined = [np.concatenate([p[k] for p in parts]) for k in range(4)]
    if len(joined[0]):
        keep = np.unique(
            np.linspace(0, len(joined[0]) - 1, min(BLOCK.max_blocks, len(joined[0]))).astype(int)
        )
    else:
        keep = []
    return BlockMeans(*(x[keep] for x in joined))


def blocks(track: Track, shift: float = 0.0, sharp: bool = False) -> tuple[np.ndarray, ...]:
    """Block means `q, v, a, tau [K, n]` of one trial, none beside a gap in time, and their numbers
    `[K]`.

    Args:
        sharp: Short blocks, with accelerations from the speeds at their ends: exact where motion is
            fast, and as rough as the sensors.
    """
    track = _complete_rows(track)
    time, n = track.time, track.q.shape[1]
    if len(time) < BLOCK.min_count:
        return *(np.zeros((0, n)),) * 4, np.zeros(0, int)
    step = float(np.median(np.diff(time)))
    size = max(BLOCK.sharp_length, step) if sharp else max(BLOCK.length, BLOCK.min_rows * step)
    edges = np.arange(time[0] + BLOCK.edge, time[-1] - BLOCK.edge, size)
    if len(edges) < 8:
        return *(np.zeros((0, n)),) * 4, np.zeros(0, int)
    q = _means(time, track.q, edges)
    if track.v is None:
        v = np.gradient(q, size, axis=0)
    else:
        v = _means(time, track.v, edges)
    a = _mean_accelerations(track, q, edges) if sharp else np.gradient(v, size, axis=0)
    impulses = np.diff(time)[:, None] * track.tau[:-1]
    held = np.concatenate([np.zeros((1, n)), np.cumsum(impulses, axis=0)])
    at_edges = (np.interp(edges + shift, time, held[:, j]) for j in range(n))
    tau = np.stack([np.diff(impulse) / size for impulse in at_edges], 1)
    # a hole within or beside a block says nothing of it
    gap = np.flatnonzero(np.diff(time) > BLOCK.max_gap_rows * step)
    is_clear = np.ones(len(edges) - 1, bool)
    for g in gap:
        before = edges[1:] + 2 * size < time[g]
        after = edges[:-1] - 2 * size > time[g + 1]
        is_clear &= before | after
    is_clear[[0, -1]] = False
    return q[is_clear], v[is_clear], a[is_clear], tau[is_clear], np.flatnonzero(is_clear)


def _complete_rows(track: Track) -> Track:
    """Return the rows in which nothing is missing."""
    parts = [x for x in (track.q, track.v, track.tau) if x is not None]
    is_complete = np.all(np.isfinite(np.concatenate(parts, 1)), 1)
    v = None if track.v is None else track.v[is_complete]
    return Track(track.time[is_complete], track.q[is_complete], v, track.tau[is_complete])


def _mean_accelerations(track: Track, q: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Mean accelerations `[K, n]` of blocks from the speeds at their ends, which are differences of
    `q` where none were logged.
    """
    size = float(edges[1] - edges[0])
    if track.v is not None:
        ends = np.stack([np.interp(edges, track.time, v) for v in track.v.T], 1)
    else:
        inner = np.diff(q, axis=0) / size
        ends = np.concatenate(
            [inner[:1], inner, inner[-1:]]
        )  # blocks at the ends of a trial are left out
    return np.diff(ends, axis=0) / size


def _means(time: np.ndarray, x: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Means of `x [T, n]`, straight between rows, over the blocks between `edges`."""
    areas = 0.5 * np.diff(time)[:, None] * (x[1:] + x[:-1])
    area = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(areas, axis=0)])
    size = np.diff(edges)
    at_edges = [np.interp(edges, time, x[:, j]) for j in range(x.shape[1])]
    out = []
    for j, at in enumerate(at_edges):
        i = np.clip(np.searchsorted(time, edges, side="right") - 1, 0, len(time) - 2)
        area_to_edge = area[i, j] + 0.5 * (edges - time[i]) * (x[i, j] + at)
        out.append(np.diff(area_to_edge) / size)
    return np.stack(out, 1)


def rubbing(motion: BlockMeans) -> np.ndarray:
    """`[K, n, 4 n]`: torque of each joint's damping, its dry friction, and a constant of either
    sign.
    """
    k, n = motion.q.shape
    speed_scale = np.maximum(BLOCK.slow_share * np.max(np.abs(motion.v), axis=0), 1e-9)
    joints = np.zeros((k, n, 4 * n))
    for j in range(n):
        joints[:, j, 4 * j] = motion.v[:, j]
        joints[:, j, 4 * j + 1] = np.tanh(motion.v[:, j] / speed_scale[j])
        joints[:, j, 4 * j + 2], joints[:, j, 4 * j + 3] = 1.0, -1.0
    return joints


@dataclass(frozen=True)
class LinearFit:
    """`unexplained_share`: share of the torque's square that the best parameters leave; `scale`:
    how many times larger the torque of the first columns is than with a parameter of 1 for each.
    """

    unexplained_share: float
    scale: float


def unexplained(motion: BlockMeans, design: Design, gravity: bool = True) -> float:
    """Share of the torque's square that the best parameters leave, the joints weighed alike."""
    return linear_fit(motion, design, gravity).unexplained_share


def linear_fit(
    motion: BlockMeans, design: Design, gravity: bool = True, first: int = 0
) -> LinearFit:
    """Fit parameters that are at least 0, the joints weighed alike; one without a drive as the
    median of the others.

    Args:
        first: Columns of the design whose scale is asked for (0: all).
    """
    k, n = motion.q.shape
    columns, joints = design(motion, gravity), rubbing(motion)
    spread = np.std(motion.tau, axis=0)
    is_driven = spread > 1e-9 * max(float(spread.max()), 1e-12)
    weight = 1.0 / np.where(
        is_driven, spread, np.median(spread[is_driven]) if is_driven.any() else 1.0
    )
    a = (np.concatenate([columns, joints], 2) * weight[None, :, None]).reshape(k * n, -1)
    b = (motion.tau * weight).reshape(-1)
    size = np.maximum(np.sqrt(np.mean(a**2, axis=0)), 1e-12)
    gram, right = (a / size).T @ (a / size), (a / size).T @ b
    # the normal equations have the solution of the whole system, and are small
    root = np.linalg.cholesky(gram + 1e-9 * np.trace(gram) / len(gram) * np.eye(len(gram)))
    x, _ = nnls(root.T, np.linalg.solve(root, right))
    total = float(np.sum((b - np.mean(b)) ** 2))
    rigid = slice(0, first or columns.shape[2])
    declared, fitted = a[:, rigid].sum(1), (a / size)[:, rigid] @ x[rigid]
    scale = float(declared @ fitted / max(float(declared @ declared), 1e-300))
    return LinearFit(float(np.sum((b - (a / size) @ x) ** 2) / max(total, 1e-12)), scale)
