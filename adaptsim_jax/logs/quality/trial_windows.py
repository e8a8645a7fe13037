"""The torque of all trials as one linear regression over short windows, with numbers that some of
the rows have of their own.

Blocks of `quality.hypotheses`, sharp ones, are averaged over windows by Hann's weights, which leave
motion exact and take the noise of accelerations out. Smooth forces of each joint's own angle and
speed stand for what the model lacks in all trials alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from adaptsim_jax.logs.criteria import BLOCK, TRIAL
from adaptsim_jax.logs.quality.hypotheses import BlockMeans, Design, Track, blocks, rubbing

PIECES = 4
"""Contiguous parts of a trial: every other one is fitted to while the rest judge."""
WINDOW, STRIDE = 24, 6
"""Blocks of a window (0.24 s: noise of accelerations averages out), and to the next one."""
ROWS = 8 * BLOCK.most
"""Blocks of all trials that are looked at."""


@dataclass(frozen=True)
class WindowRows:
    """Means over windows of all trials: `table [K, n, P]` of the design's columns (the first
    `rigid`), friction and smooth forces; `tau [K, n]`, `trial [K]`, `piece [K]`, `weight [n]` 1/N
    m. `mean [K, N]` takes them from blocks, whose motion is `fine` and whose trial `origin [N]`.
    """

    fine: BlockMeans
    design: Design
    origin: np.ndarray
    mean: sparse.csr_array
    table: np.ndarray
    tau: np.ndarray
    rigid: int
    trial: np.ndarray
    piece: np.ndarray
    weight: np.ndarray

    @property
    def half(self) -> np.ndarray:
        return self.piece % 2

    def averaged(self, x: np.ndarray) -> np.ndarray:
        """`[N, ...]` of blocks as `[K, ...]` of windows."""
        return np.asarray(self.mean @ x.reshape(len(x), -1)).reshape(-1, *x.shape[1:])


def rows_of(tracks: Sequence[Track], design: Design) -> WindowRows | None:
    """Windows of trials that are long enough; None where there are too few of these, or they do not
    move.
    """
    parts = [blocks(t, sharp=True) for t in tracks]
    most = ROWS // max(1, len(parts))
    motion, means, trial, piece, origin = [], [], [], [], []
    for t, part in enumerate(parts):
        *own, number = (z[:most] for z in part)
        count, mean = _windows(number)
        if count < TRIAL.min_windows or not all(np.all(np.isfinite(z)) for z in own):
            continue
        motion.append(own)
        means.append(mean)
        trial.append(np.full(count, t))
        piece.append(np.arange(count) * PIECES // count)
        origin.append(np.full(len(number), t))
    if len(motion) < TRIAL.min_trials:
        return None
    m = BlockMeans(*(np.concatenate([part[k] for part in motion]) for k in range(4)))
    mean = sparse.csr_array(sparse.block_diag(means))
    spread = np.std(m.tau, axis=0)
    if not np.all(np.std(m.q, axis=0) > BLOCK.moving) or not np.any(spread > 1e-9):
        return None
    weight = 1.0 / np.maximum(spread, 1e-3 * spread.max())
    one = BlockMeans(*(z[:1] for z in (m.q, m.v, m.a, m.tau)))
    width = design(one, True).shape[2]
    made = WindowRows(
        m,
        design,
        np.concatenate(origin),
        mean,
        m.tau,
        m.tau,
        width,
        np.concatenate(trial),
        np.concatenate(piece),
        weight,
    )
    return replace(of_motion(made, m), tau=made.averaged(m.tau))


def _windows(number: np.ndarray) -> tuple[int, sparse.csr_array]:
    """How many, and `[K, N]` their means over `WINDOW` neighbouring blocks, by Hann's weights,
    which take the noise of accelerations out.
    """
    begins = np.arange(0, max(0, len(number) - WINDOW + 1), STRIDE)
    if len(begins):
        begins = begins[number[begins + WINDOW - 1] - number[begins] == WINDOW - 1]
    hann = np.hanning(WINDOW + 2)[1:-1]
    column = begins[:, None] + np.arange(WINDOW)
    data = np.broadcast_to(hann / hann.sum(), column.shape)
    row = np.broadcast_to(np.arange(len(begins))[:, None], column.shape)
    mean = sparse.csr_array(
        (data.ravel(), (row.ravel(), column.ravel())), shape=(len(begins), len(number))
    )
    return len(begins), mean


def _smooth(m: BlockMeans) -> np.ndarray:
    """`[K, n, 8 n]`: forces of each joint's own angle and speed, for what the model lacks in all
    trials alike.
    """
    n, q = m.q.shape[1], m.q
    speed = m.v / np.maximum(np.max(np.abs(m.v), axis=0), 1e-9)
    rub = [np.tanh(k * speed) for k in (10.0, 200.0, 1000.0)]
    shapes = (np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q), speed * np.abs(speed), *rub)
    return np.concatenate([z[:, :, None] * np.eye(n) for z in shapes], 2)


def over_blocks(design: Design, motion: BlockMeans) -> np.ndarray:
    """`design` over any number of rows."""

    def cut(i):
        return BlockMeans(
            *(z[i : i + BLOCK.most] for z in (motion.q, motion.v, motion.a, motion.tau))
        )

    return np.concatenate([design(cut(i), True) for i in range(0, len(motion.q), BLOCK.most)])


def part_of(rows: WindowRows, pick: np.ndarray) -> WindowRows:
    cut = {k: getattr(rows, k)[pick] for k in ("mean", "table", "tau", "trial", "piece")}
    return replace(rows, **cut)


def solved(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Of normal equations that may be singular: what the data do not fix stays small."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / size / size[:, None]
    return np.linalg.solve(scaled + 1e-9 * np.eye(len(gram)), right / size) / size


def normal(rows: WindowRows, keep: np.ndarray, width: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of the first `width` columns (0: all) over rows `keep [K]`."""
    table = rows.table[keep][:, :, : width or None]
    a = (table * rows.weight[:, None]).reshape(-1, table.shape[2])
    return a.T @ a, a.T @ (rows.tau[keep] * rows.weight).ravel()


def fitted(rows: WindowRows) -> np.ndarray:
    """Parameters `[P]` by least squares."""
    return solved(*normal(rows, np.arange(len(rows.trial))))


def unexplained_of(rows: WindowRows, x: np.ndarray) -> np.ndarray:
    """Weighed residual `[K, n]` of the first columns, as many as `x` has."""
    return (rows.tau - rows.table[:, :, : len(x)] @ x) * rows.weight


def of_motion(rows: WindowRows, fine: BlockMeans) -> WindowRows:
    """The same of another motion."""
    table = np.concatenate(
        [over_blocks(rows.design, fine), rubbing(fine)[:, :, :-1], _smooth(fine)], 2
    )
    return replace(rows, fine=fine, table=rows.averaged(table))


def jointly(
    rows: WindowRows, own: np.ndarray, label: np.ndarray, labels: np.ndarray, likely: float = np.inf
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters `[P]` and numbers `[T, S]` of each label's own, together by least squares. Those
    of a label are eliminated first.

    Args:
        likely: Size of a number before anything was seen, for what a trial's own motion does not
            fix.
    """
    p = rows.table.shape[2]
    gram, right, selected = np.zeros((p, p)), np.zeros(p), []
    if np.isinf(likely):
        doubt = 0.0
    else:
        doubt = np.mean(np.square(unexplained_of(rows, fitted(rows)))) / likely**2
    for t in labels:
        here = label == t
        a = (rows.table[here] * rows.weight[:, None]).reshape(-1, p)
        c = (own[here] * rows.weight[:, None]).reshape(-1, own.shape[2])
        b = (rows.tau[here] * rows.weight).ravel()
        inner = c.T @ c
        inner += np.diag(1e-6 * np.maximum(np.diag(inner), 1e-12) + doubt)
        both = np.linalg.solve(inner, c.T @ np.column_stack([a, b]))
        gram += a.T @ a - a.T @ c @ both[:, :-1]
        right += a.T @ b - a.T @ c @ both[:, -1]
        selected.append(both)
    x = solved(gram, right)
    return x, np.stack([both[:, -1] - both[:, :-1] @ x for both in selected])


def regress(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return solved(a.T @ a, a.T @ b)
