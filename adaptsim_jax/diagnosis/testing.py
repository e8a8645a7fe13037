"""Whether a difference is more than chance: tests over left-out blocks, of scores, and of several
effects at once.

Functions take arrays and know no problem, so that every objective is judged by the same tests.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from adaptsim_jax.diagnosis.criteria import PAIRED, REPORT


@dataclass(frozen=True)
class Test:
    """Of one model against another. gain: the share of the loss that it takes off (geometric mean
    over folds); p of a sign-flip test over `parts` blocks; better: folds in which it is better.
    overall: of a part of the joints, the share that it takes off of all of them.
    """

    gain: float
    p: float
    better: int
    folds: int
    parts: int
    overall: float = np.nan


def means(z: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Means [U, ...] of z [K, ...] over the members of each unit."""
    count = np.bincount(unit)
    out = np.zeros((len(count), *z.shape[1:]))
    np.add.at(out, unit, z)
    return out / count.reshape(-1, *(1,) * (z.ndim - 1))


def log_ratio(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Logarithms of losses [U, ...] of units over others of the same units."""
    usual = PAIRED.added_loss * np.median(before, 0)
    return np.log((before + usual) / (after + usual))


def share(ratio: np.ndarray) -> float:
    """Of logarithms of ratios the share that is taken off, geometric mean."""
    return 1.0 - float(np.exp(-ratio.mean()))


def sign_flip(d: np.ndarray) -> float:
    """One-sided p of the mean of paired differences [U] under random signs (Fisher, 1935).

    Of up to `PAIRED.all_signs` differences all patterns are taken, of more a sample.
    """
    count = len(d)
    if count <= PAIRED.all_signs:
        signs = 1.0 - 2.0 * ((np.arange(2**count)[:, None] >> np.arange(count)) & 1)
    else:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (PAIRED.drawn_signs, count))
        signs[0] = 1.0
    return float(np.mean(signs @ d >= d.sum() * (1.0 - 1e-12)))


def compare(by_fold: np.ndarray, by_block: np.ndarray) -> Test:
    """The test of logarithms of ratios, averaged over folds [F] and over blocks [B]."""
    better = int((by_fold > 0).sum())
    return Test(share(by_fold), sign_flip(by_block), better, len(by_fold), len(by_block))


def paired_test(
    before: np.ndarray,
    after: np.ndarray,
    fold: np.ndarray | None = None,
    block: np.ndarray | None = None,
) -> Test:
    """Whether a model predicts left-out units better than another, one-sided.

    Ratios are averaged over a fold or a block, so that no unit that runs away decides for its
    trial.

    Args:
        before: losses [U] of units by the first model, left out.
        after: losses [U] by the second.
        fold: which are left out together [U]. Each unit where None.
        block: which stand together in the test [U]. Each unit where None.
    """
    ratio = log_ratio(before, after)
    by_fold, by_block = (ratio if unit is None else means(ratio, unit) for unit in (fold, block))
    return compare(by_fold, by_block)


def smallest_p(blocks: int) -> float:
    """What a sign-flip test over so many blocks shows at most, all of them better."""
    return 2.0**-blocks


def attainable(level: float, blocks: int, family: int = 1) -> float:
    """The level of a test that is one of `family`, at least what so few blocks can show."""
    return max(level / family, 1.01 * smallest_p(blocks))


def best_of(p: float, points: int) -> float:
    """p of the best of so many tests, as if they were independent (Sidak, 1967): a grid that is
    finer than the data resolve makes it too large, never too small.
    """
    if p >= 1.0:
        return 1.0
    return float(-np.expm1(points * np.log1p(-p)))


def best_along(p: float, scores: np.ndarray) -> float:
    """p of the best of N tests, whose scores [W, N] of clusters change little from one to the next.

    At most that of independent tests, and that of all along the curve through their directions, by
    the length of its arcs (Hotelling, 1939; Naiman, 1986): the points of a grid that is finer than
    the data resolve count as few.
    """
    size = np.maximum(np.sqrt(np.square(scores).sum(0)), 1e-300)
    unit = scores / size
    alike = np.abs((unit[:, 1:] * unit[:, :-1]).sum(0))
    arcs = float(np.arccos(np.minimum(alike, 1.0)).sum())
    along = p + arcs / np.pi * np.exp(-0.5 * stats.norm.isf(0.5 * p) ** 2)
    return float(min(best_of(p, scores.shape[1]), along))


def holm(p: Sequence[float], level: float, blocks: int) -> np.ndarray:
    """Level [K] up to which the p of each of several effects holds (Holm's step-down, 1979).

    The smallest p is held against the level over all, the next over all but one. From the first
    that fails on none holds, and the level is 0.

    Args:
        p: of each effect [K].
        level: probability of one false effect or more.
        blocks: of each test; with few of them no p can be smaller than all better shows.
    """
    each = np.asarray(p, float)
    out, order = np.zeros(len(each)), np.argsort(each, kind="stable")
    for rank, k in enumerate(order):
        own = attainable(level, blocks, len(each) - rank)
        if each[k] > own:
            break
        out[k] = own
    return out


def false_discovery(p: Sequence[float], rate: float, asked: int) -> float:
    """Up to which p effects are taken, of which a share of `rate` may be false (Benjamini and
    Hochberg, 1995).

    Args:
        p: of each effect that is asked about now.
        rate: share of false ones among those taken.
        asked: how many were asked about in all.
    """
    ranked = np.sort(p)
    good = ranked <= rate * np.arange(1, len(ranked) + 1) / asked
    if not good.any():
        return 0.0
    return float(ranked[good].max())


def jackknife(values: np.ndarray) -> np.ndarray:
    """Standard errors [...] of what was fitted [F, ...] without each fold (Tukey, 1958)."""
    count = len(values)
    return np.sqrt((count - 1) / count * np.square(values - values.mean(0)).sum(0))


def deviates(count: int, level: float = REPORT.parameter_level) -> float:
    """Standard errors from the middle of an interval to its ends, where `count` folds or trials
    gave the standard error: Student's t; infinite of one.
    """
    if count < 2:
        return np.inf
    return float(stats.t.isf(0.5 * (1.0 - level), count - 1))


def t_p(t: np.ndarray, freedom: int) -> np.ndarray:
    """Two-sided p of Student's t."""
    return 2.0 * stats.t.sf(np.abs(t), freedom)


def typical_interval(errors: np.ndarray, unit: np.ndarray) -> list[float] | None:
    """Ends of an interval of the median error, where errors [W, ...] of one unit (a trial) are
    alike; None of one unit.

    Logarithms of the units' medians are taken as a sample of a normal distribution: percentiles of
    a bootstrap are too narrow for so few.
    """
    usual = np.array([np.median(errors[unit == u]) for u in np.unique(unit)])
    if len(usual) < 2:
        return None
    middle = float(np.median(errors))
    logs = np.log(np.maximum(usual, max(1e-6 * middle, np.finfo(float).tiny)))
    half = deviates(len(logs), REPORT.error_level) * logs.std(ddof=1) / np.sqrt(len(logs))
    low, high = (float(np.exp(logs.mean() + way * half)) for way in (-1.0, 1.0))
    return [min(low, middle), max(high, middle)]


def correlated_rows(residual: np.ndarray) -> float:
    """Rows over which residuals [T, R, C] hang together: one and twice the sum of their
    autocorrelation while it is above the noise.
    """
    power, total = float(np.square(residual).sum()), 1.0
    for lag in range(1, min(PAIRED.max_lag, residual.shape[1] - 1)):
        rho = float((residual[:, lag:] * residual[:, :-lag]).sum()) / max(power, 1e-12)
        if rho < PAIRED.min_correlation:
            break
        total += 2.0 * rho
    return total


def score_f(gain: float, loss: float, count: float, added: int, fitted: int, rows: float) -> float:
    """p of an F test that what a step takes off is chance, where units are few.

    Args:
        gain: what the step takes off of the sum of squares.
        loss: sum of squares before it.
        count: of residuals.
        added: numbers of the step.
        fitted: numbers of the model before it.
        rows: over which residuals hang together (`correlated_rows`).
    """
    rest = max(count / rows - fitted - added, 2.0)
    variance = rows * max(loss - gain, 1e-9) / max(count - fitted - added, 1.0)
    return float(stats.f.sf(gain / added / variance, added, rest))


def score_p(slope: np.ndarray) -> float:
    """p that scores [W, K] of clusters have mean zero.

    Of one direction it is Student's t. Of several it is the smaller of two, twice: a sum of
    squares, which sees many directions in few clusters, and Hotelling's T^2, which sees a few that
    are alike and differ.
    """
    slope = slope[np.any(slope != 0.0, axis=1)]
    count = len(slope)
    if slope.size == 0 or count < 3:
        return 1.0
    t = np.sqrt(count) * slope.mean(0) / np.maximum(slope.std(0, ddof=1), 1e-300)
    alike = np.atleast_2d(np.corrcoef(slope.T))
    if len(t) == 1:
        return float(t_p(t[0], count - 1))
    return min(1.0, 2.0 * min(_sum_of_squares(t, alike, count), _hotelling(t, alike, count)))


def _sum_of_squares(t: np.ndarray, alike: np.ndarray, count: int) -> float:
    """Student's t [K] as normal deviates, whose correlation `alike` [K, K] makes the sum of their
    squares a scaled chi square of fewer degrees of freedom (Satterthwaite's approximation; Rao and
    Scott, 1981).
    """
    z, k = stats.norm.isf(np.maximum(stats.t.sf(np.abs(t), count - 1), 1e-300)), len(t)
    # squares of correlations are too large by chance, by so much (Srivastava, 2005)
    excess = float(np.square(alike).sum()) - k**2 / (count - 1)
    squares = excess * (count - 1) ** 2 / ((count - 2) * (count + 1))
    freedom = k**2 / max(squares, k)
    return float(stats.chi2.sf(float(z @ z) * freedom / k, freedom))


def _hotelling(t: np.ndarray, alike: np.ndarray, count: int) -> float:
    """Hotelling's T^2 of Student's t [K], of the directions that are there and, at most, half as
    many as clusters tell apart.
    """
    value, vector = np.linalg.eigh(alike)
    keep = value > 1e-9 * value[-1]
    keep[: max(0, len(t) - (count - 1) // 2)] = False
    k = int(keep.sum())
    square = float(np.sum(np.square(t @ vector[:, keep]) / value[keep]))
    return float(stats.f.sf(square * (count - k) / (k * (count - 1)), k, count - k))


def preferred(test: Test, size: float, level: float, family: int = 1) -> bool:
    """Whether an alternative is taken instead of the declared model, before effects are searched.
    Both are fitted to the same recording and compared on what was left out.

    | alternative | where |
    | --- | --- |
    | dry friction that is sharp, or gives as a simulator's | `attribution/equation/rubbing.py` |
    | bodies and damping of the file, or fitted | `attribution/equation/confirmed.py` |
    | what like joints have, at all of them | `attribution/equation/balance_objective.py` |
    | values and effects of another objective | `attribution/tree_objective.py` |
    | another shape of the piece | `tasks/scooping/diagnosis/passes.py` |
    | numbers of a servo's law | `simulators/closed_loop/identified.py`, over whole trials |

    Args:
        test: of the alternative against the declared model, by what was left out.
        size: share of the loss that it must take off.
        level: probability of a false choice.
        family: places at which the same was asked.
    """
    return test.gain > size and test.p * family <= level
