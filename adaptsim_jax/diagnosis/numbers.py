"""The numbers of one machine by trial and by log: what each says of them by itself, which of them
contradict the others, and which numbers can be exchanged.

A part of the recording (a trial, a log) by itself is the fit of all, one Gauss and Newton's step on
by its own normal equations; what it does not show stays as all have it. How far it may be off is
told by leaving out its own parts in turn (blocks of a trial, trials of a log: the jackknife). A t
test of each part against all others, by Holm's step-down over parts and numbers, tells which are
apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import NUMBERS
from adaptsim_jax.diagnosis.testing import deviates, holm, jackknife, t_p


@dataclass(frozen=True)
class Number:
    """A number of a machine. slope: [P] by the vector; wide: half of its interval by the fit;
    fitted: whether it was, or is what the parts say on the mean.
    """

    name: str
    unit: str
    value: float
    wide: float
    slope: np.ndarray
    fitted: bool = True


@dataclass(frozen=True)
class Evidence:
    """What blocks of rows say of a vector, about a fit of all.

    Args:
        hess, slope: Normal equations [B, P, P], [B, P] by block, without the prior.
        prior, pull: The prior's curvature [P, P] and slope [P].
        trial: [B] number of the trial of each block.
    """

    hess: np.ndarray
    slope: np.ndarray
    prior: np.ndarray
    pull: np.ndarray
    trial: np.ndarray


@dataclass(frozen=True)
class Parts:
    """What U parts of a recording say of M numbers, each by itself: off [U, M] from the value of
    all, NaN where it tells nothing; variance [U, M], with so many degrees of freedom.
    """

    off: np.ndarray
    variance: np.ndarray
    freedom: int

    @property
    def weight(self) -> np.ndarray:
        """[U, M], 0 where nothing is told."""
        told = np.isfinite(self.off) & (self.variance > 0.0)
        return np.where(told, 1.0 / np.where(told, self.variance, 1.0), 0.0)

    @property
    def count(self) -> np.ndarray:
        """[M] parts that tell of a number."""
        return (self.weight > 0.0).sum(0)

    @property
    def mean(self) -> np.ndarray:
        """[M] weighted."""
        return _share(self.weight, np.nan_to_num(self.off)).sum(0)

    @property
    def scatter(self) -> np.ndarray:
        """[U, M] from the mean, 0 where nothing is told."""
        return np.where(self.weight > 0.0, np.nan_to_num(self.off) - self.mean, 0.0)


def _share(weight: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Parts [U, M] of a weighted mean."""
    return weight * z / np.maximum(weight.sum(0), 1e-300)


def tabled(
    numbers: Sequence[Number], evidence: Evidence, trials: Sequence[str], labels: Sequence[str]
) -> list[Table]:
    """Rows of `numbers` of a report.

    Args:
        numbers: Of one vector.
        evidence: What was recorded says of it.
        trials: Names of the trials.
        labels: Of the log of each trial; the trial's own name where there is one log.

    Returns:
        `{name, unit, value, low, high, trials, logs, each, apart, like}`: standard deviation over
        trials and over logs (None of one), what each log (of one log: trial) says by itself, which
        are outside of what the others allow, and with which numbers it can be exchanged. Numbers of
        which no part tells by itself are not there.
    """
    named = list(dict.fromkeys(labels))
    every, size, e = _scaled(evidence)
    by = size * np.stack([n.slope for n in numbers])
    cov = by @ np.linalg.pinv(every, rcond=1e-10, hermitian=True) @ by.T
    like = cov / np.sqrt(np.outer(np.diagonal(cov), np.diagonal(cov)) + 1e-300)
    blocks = np.arange(len(e.trial))
    by_trial = _alone(by, e, every, e.trial, blocks, len(trials))
    by_log, pooled = by_trial, named != list(trials)
    if pooled:
        log = np.array([named.index(label) for label in labels])[e.trial]
        free = len(trials) - len(named)
        within = e.trial if free >= NUMBERS.min_freedom else blocks
        by_log = _alone(by, e, every, log, within, len(named))
    spreads, apart = [_spread(p) for p in (by_trial, by_log)], _apart(by_log)
    half = deviates(max(by_log.freedom, 1) + 1) * np.sqrt(by_log.variance)
    values = [n.value + off * (not n.fitted) for n, off in zip(numbers, by_log.mean, strict=True)]
    rows = []
    for m in np.flatnonzero(by_log.count > 0):
        wide, count = numbers[m].wide, by_log.count[m]
        if count >= NUMBERS.min_parts:  # the logs are a sample, too
            wide = max(wide, deviates(count) * spreads[1][m] / np.sqrt(count))
        some = np.flatnonzero(np.abs(like[m]) > NUMBERS.exchanged)
        rows.append(
            {
                "name": numbers[m].name,
                "unit": numbers[m].unit,
                "value": values[m],
                "low": values[m] - wide,
                "high": values[m] + wide,
                "trials": spreads[0][m],
                "logs": spreads[1][m] if pooled else None,
                "each": [
                    {"of": name, "value": one, "low": one - wide, "high": one + wide}
                    for name, one, wide in zip(
                        named, numbers[m].value + by_log.off[:, m], half[:, m], strict=True
                    )
                    if np.isfinite(one)
                ],
                "apart": [named[u] for u in np.flatnonzero(apart[:, m])],
                "like": [
                    {"name": numbers[k].name, "correlation": like[m, k]} for k in some if k != m
                ],
            }
        )
    return rows


def _scaled(e: Evidence) -> tuple[np.ndarray, np.ndarray, Evidence]:
    """Curvature of all [P, P] by entries of size 1, their sizes [P], and what blocks say of them,
    each with its part of the prior's pull.
    """
    every = e.hess.sum(0) + e.prior
    every += np.diag(np.diagonal(every) <= 0.0)  # of these nobody tells
    size = 1.0 / np.sqrt(np.diagonal(every))
    both = np.outer(size, size)
    slope = (e.slope + e.pull / len(e.slope)) * size
    return every * both, size, Evidence(e.hess * both, slope, e.prior * both, 0.0 * size, e.trial)


def _alone(
    by: np.ndarray, e: Evidence, every: np.ndarray, part: np.ndarray, within: np.ndarray, count: int
) -> Parts:
    """What parts say by themselves.

    Args:
        by: [M, P] numbers by entries.
        e, every: As of `_scaled`.
        part: [B] of each block, of `count`.
        within: [B] what is left out in turn, of each block.
    """
    held = NUMBERS.held * every
    off = np.full((count, len(by)), np.nan)
    modelled, times, freedom = np.ones_like(off), np.full_like(off, np.nan), 0
    for u in np.unique(part):
        mine = part == u
        hess, slope = e.hess[mine].sum(0), e.slope[mine].sum(0)
        way = np.linalg.solve(hess + held, by.T).T
        told = 2.0 * np.einsum("mp,pq,mq->m", way, held, way) < np.einsum("mp,mp->m", way, by)
        off[u] = np.where(told, way @ slope, np.nan)
        modelled[u] = np.einsum("mp,pq,mq->m", way, hess, way)
        left = [mine & (within == k) for k in np.unique(within[mine])]
        if len(left) > 1:
            freedom += len(left) - 1
            less = [(hess - e.hess[k].sum(0) + held, slope - e.slope[k].sum(0)) for k in left]
            error = jackknife(np.stack([np.linalg.solve(*each) for each in less]) @ by.T)
            times[u] = np.where(told, np.square(error) / np.maximum(modelled[u], 1e-300), np.nan)
    known = np.isfinite(times).any(0)
    factor = np.nanmean(np.where(known, times, 0.0), 0)
    return Parts(off, factor * modelled, freedom)


def _spread(parts: Parts) -> np.ndarray:
    """Standard deviation [M] of what parts say, weighted; NaN of one."""
    count = np.where(parts.count > 1, parts.count, np.nan)
    square = _share(parts.weight, np.square(parts.scatter)).sum(0)
    return np.sqrt(square * count / (count - 1.0))


def _apart(parts: Parts) -> np.ndarray:
    """Which parts [U, M] are outside of what the others say, by Holm's step-down over all parts
    and numbers; of each number the farthest first, then of the others again. Of two both are.
    """
    apart = np.zeros(parts.off.shape, bool)
    while True:
        left = Parts(np.where(apart, np.nan, parts.off), parts.variance, parts.freedom)
        p = _against_others(left)
        p[:, apart.any(0) & (left.count < NUMBERS.min_parts)] = np.nan
        asked = np.argwhere(np.isfinite(p))
        found = asked[holm(p[tuple(asked.T)], NUMBERS.level, NUMBERS.blocks) > 0.0]
        if not len(found):
            return apart
        for m in np.unique(found[:, 1]):
            far = [np.nanargmin(p[:, m])] if left.count[m] > 2 else np.isfinite(p[:, m])
            apart[far, m] = True


def _against_others(parts: Parts) -> np.ndarray:
    """p [U, M] of each part having the value of the others; NaN where there is no other."""
    weight = parts.weight
    rest = weight.sum(0) - weight
    known = (weight > 0.0) & (rest > 0.0) & (parts.freedom > 0)
    off = np.nan_to_num(parts.off)
    others = ((weight * off).sum(0) - weight * off) / np.where(known, rest, 1.0)
    error = np.sqrt(1.0 / np.where(known, weight, 1.0) + 1.0 / np.where(known, rest, 1.0))
    p = t_p((off - others) / error, max(parts.freedom, 1))
    return np.where(known, p, np.nan)


def add_numbers(
    report: Table, evidence: Table, rows: Sequence[Table], labels: Sequence[str]
) -> None:
    """Put the table into a report, and a warning for each log that is apart from the others, in
    place; odd trials of one log are told of by themselves (`quality.trial_words`).

    Args:
        report, evidence: What the page is made of.
        rows: Of `tabled`.
        labels: Of the logs, none of one.
    """
    report["numbers"] = list(rows)
    for label in labels:
        told = [
            f"{row['name']} ({one['value']:.3g} {row['unit']}, of all {row['value']:.3g})"
            for row in rows
            for one in row["each"]
            if one["of"] == label in row["apart"]
        ]
        if not told:
            continue
        more = len(told) - NUMBERS.told
        line = (
            f"The log {label} contradicts the others: {'; '.join(told[: NUMBERS.told])}"
            f"{f'; and {more} more' if more > 0 else ''}. Was something else mounted, or logged, "
            "there? Diagnose without it, and it alone."
        )
        report["warnings"] = [*report.get("warnings", []), line]
        mark = {"severity": "warn", "where": label, "message": line}
        evidence["audit"] = [mark, *evidence.get("audit", [])]
