"""Sets of columns fitted to the missing forces, with what is known beforehand, and judged by blocks
that were left out.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from adaptsim_jax.attribution.criteria import WINDOW
from adaptsim_jax.attribution.parameters import Entry, Vector
from adaptsim_jax.diagnosis.criteria import FOLD
from adaptsim_jax.diagnosis.folds import apart_of, blocks_of_windows, folds_of, hop_of
from adaptsim_jax.diagnosis.testing import Test, compare, jackknife, log_ratio, means, share


@dataclass(frozen=True)
class ForceRows:
    """Missing forces [K, n] with their weights [K, n] (one over their size, and over the root of
    how many neighbours say the same; less
    where a joint hardly moves: what holds it is anything up to the level of its friction), size
    [n], fold, block and part [K]: trials, or thirds of one.
    """

    missing: np.ndarray
    weight: np.ndarray
    size: np.ndarray
    clear: np.ndarray
    fold: np.ndarray
    block: np.ndarray
    part: np.ndarray

    def loss(self, left: np.ndarray) -> np.ndarray:
        """Mean squares [B, n] of what is left [K, n] in each block, over the sizes."""
        return means(self.clear * np.square(left / self.size), self.block)


@dataclass(frozen=True)
class Solved:
    """A set of entries fitted. step [P] from the values at which its columns were made; by_fold [F,
    P]; loss [B, n] of left-out blocks, over the squared size of what was missing; hess [P, P] and
    slope [P] of the loss, with the prior.
    """

    entries: tuple[Entry, ...]
    columns: np.ndarray = field(repr=False)
    step: np.ndarray
    by_fold: np.ndarray
    loss: np.ndarray
    hess: np.ndarray = field(repr=False)
    slope: np.ndarray = field(repr=False)

    def left_out(self, rows: "ForceRows") -> np.ndarray:
        """What is missing [K, n] of windows by the values of the other folds."""
        return left_out(rows, self.columns, self.by_fold)

    @cached_property
    def error(self) -> np.ndarray:
        """Standard errors [P] by the jackknife over folds, at least those of the curvature."""
        inverse = np.linalg.pinv(self.hess, rcond=1e-12, hermitian=True)
        curved = np.sqrt(np.maximum(np.diagonal(inverse), 0.0))
        return np.maximum(jackknife(self.by_fold), curved)


def rows_of(
    missing: np.ndarray,
    left: np.ndarray,
    trial: np.ndarray,
    time: np.ndarray,
    minimum: np.ndarray,
    clear: np.ndarray,
) -> ForceRows:
    """Rows weighted by what is `left` [K, n] of the missing forces by the model so far, at least by
    sizes `least` [n].
    """
    block = blocks_of_windows(trial, time)
    usual = means(np.square(left) * clear, block) / means(clear, block)
    size = np.sqrt(np.maximum(np.median(usual, 0), np.square(minimum) + 1e-18))
    alike = _alike(left * np.sqrt(clear), trial, time)
    weight = np.sqrt(clear) / (size * np.sqrt(alike))
    fold = folds_of(trial, FOLD.min_windows)
    return ForceRows(missing, weight, size, clear, fold, block, apart_of(trial))


def _alike(left: np.ndarray, trial: np.ndarray, time: np.ndarray) -> np.ndarray:
    """How many neighbouring windows say the same [n]: one and twice the sum of the autocorrelation
    up to its first zero.
    """
    most = max(1, int(WINDOW.memory / max(hop_of(trial, time), 1e-6)))
    z = left - left.mean(0)
    power = np.square(z).mean(0) + 1e-300
    out, alive = np.ones(left.shape[1]), np.ones(left.shape[1], bool)
    for lag in range(1, min(most, len(left) - 1)):
        same = trial[lag:] == trial[:-lag]
        if not same.any():
            break
        r = (z[lag:][same] * z[:-lag][same]).mean(0) / power
        alive &= r > 0.05
        out += 2.0 * np.where(alive, r, 0.0)
    return out


class Sums:
    """Products of blocks of columns, by fold, kept for the many sets that share them. Blocks go by
    names.
    """

    def __init__(self, rows: ForceRows):
        self.rows = rows
        self.order = np.argsort(rows.fold, kind="stable")
        counts = np.bincount(rows.fold)
        ends = np.concatenate([[0], np.cumsum(counts)])
        self.parts = [slice(int(i), int(j)) for i, j in itertools.pairwise(ends)]
        self.y = (rows.missing * rows.weight)[self.order]
        self.blocks: dict = {}
        self.products: dict = {}

    def add(self, name, columns: np.ndarray) -> None:
        """A block [K, n, E]; joints of which it says nothing are left out of its products."""
        if name not in self.blocks:
            weighed = (columns * self.rows.weight[..., None])[self.order]
            live = np.flatnonzero(np.any(columns, axis=(0, 2)))
            self.blocks[name] = np.ascontiguousarray(weighed[:, live]), live, columns

    def product(self, one, other) -> np.ndarray:
        """[F, E1, E2]; with `None` for the other, the slopes [F, E1, 1]."""
        key = (one, other)
        if key not in self.products:
            a, live, _ = self.blocks[one]
            if other is None:
                b, there = self.y[..., None], np.arange(self.y.shape[1])
            else:
                b, there, _ = self.blocks[other]
            both = np.intersect1d(live, there)
            a, b = a[:, np.searchsorted(live, both)], b[:, np.searchsorted(there, both)]

            def flat(z, part):
                return z[part].reshape((part.stop - part.start) * z.shape[1], z.shape[2])

            self.products[key] = np.stack([flat(a, p).T @ flat(b, p) for p in self.parts])
            if other is not None:
                self.products[other, one] = np.swapaxes(self.products[key], 1, 2)
        return self.products[key]


def solved(sums: Sums, names: Sequence, entries: Sequence[Entry], now: np.ndarray) -> Solved:
    """Fit entries at values `now` [P] by the named blocks of columns; each fold predicted by the
    others.
    """
    vector, rows = Vector(tuple(entries), np.asarray(now, float)), sums.rows
    hess = np.concatenate(
        [np.concatenate([sums.product(i, j) for j in names], 2) for i in names], 1
    )
    slope = np.concatenate([sums.product(i, None)[..., 0] for i in names], 1)
    total, all_slope = hess.sum(0), slope.sum(0)
    step = vector.bounded_step(total, all_slope, 1e-9)
    by_fold = np.stack(
        [
            vector.bounded_step(total - h, all_slope - s, 1e-9)
            for h, s in zip(hess, slope, strict=True)
        ]
    )
    columns = np.concatenate([sums.blocks[name][2] for name in names], 2)
    left = left_out(rows, columns, by_fold)
    loss = rows.loss(left)
    prior = vector.precision
    pull = all_slope - prior * (vector.values - vector.start)
    return Solved(tuple(entries), columns, step, by_fold, loss, total + np.diag(prior), pull)


def left_out(rows: ForceRows, columns: np.ndarray, by_fold: np.ndarray) -> np.ndarray:
    """What columns [K, n, P] leave of the missing forces [K, n] of each fold, at the values [F, P]
    that go without it.
    """
    left = rows.missing.copy()
    for f, x in enumerate(by_fold):
        mine = rows.fold == f
        left[mine] -= columns[mine] @ x
    return left


def compared(rows: ForceRows, without: Solved, with_: Solved, joints: Sequence[int]) -> Test:
    """The second set of entries against the first, by left-out blocks; joints: the local numbers of
    those concerned, each by what it usually leaves: one that neither set explains does not outweigh
    the others. The gain is a mean over blocks.
    """
    own = list(joints)
    usual = np.maximum(np.median(without.loss, 0), 1e-300)
    before, after = without.loss / usual, with_.loss / usual
    by_block = log_ratio(before[:, own].mean(1), after[:, own].mean(1))
    fold = np.array([np.bincount(rows.fold[rows.block == b]).argmax() for b in range(len(before))])
    by_fold = means(by_block, np.unique(fold, return_inverse=True)[1])
    overall = share(log_ratio(before, after))
    return replace(compare(by_fold, by_block), gain=share(by_block), overall=overall)
