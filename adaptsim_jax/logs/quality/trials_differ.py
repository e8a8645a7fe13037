"""Whether trials of one recording were made by one machine: by trial, what is left of the torque
under parameters of the other trials, and which of a few numbers of the trial's own takes that away.

The torque that moves a mechanism is linear in its parameters (`quality.hypotheses`), and in small
changes of an angle's zero, of the weight, of a torque's scale or of a constant torque. Each is
fitted to some pieces of a trial and judged on the others, so that what a model lacks alike in all
trials is taken for nothing. Smooth forces of each joint's own angle and speed, alike in all trials,
stand for what it lacks. NumPy and SciPy alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.logs.criteria import BLOCK, TRIAL
from adaptsim_jax.logs.quality.hypotheses import BlockMeans, Design, Track, blocks, rubbing

MIN_EXPLAINED_SHARE = {
    "zero": TRIAL.min_share_zero,
    "torque_scale": TRIAL.min_share_scale,
    "torque_offset": TRIAL.min_share_offset,
    "load": TRIAL.min_share_load,
}
"""Share of the unexplained torque's square that a difference must take away in pieces that it was
not fitted to. Drives that saturate or play have another scale in every trial by themselves.
"""
ROUNDS = 4
"""Refits: sizes no longer change in three digits."""
LIKELY_SIZE = {"zero": 0.1, "torque_scale": 1.0, "torque_offset": 10.0, "load": 1.0}
"""Size of a number before anything is observed (rad; spreads of the torque), for what a trial's own
motion does not fix.
"""
SMALL = 1e-3
"""rad by which a zero is moved for its derivative: gravity is linear over it."""
PIECES = 4
"""Contiguous parts of a trial: every other one is fitted to while the rest judge."""
WINDOW, STRIDE = 24, 6
"""Blocks of a window (0.24 s: noise of accelerations averages out), and to the next one."""
ROWS = 8 * BLOCK.max_blocks
"""Blocks of all trials that are looked at."""


@dataclass(frozen=True)
class OutlierTrial:
    """A trial apart from the others: its unexplained torque is `times` theirs. `kind`: what of it
    is otherwise, by `size [S]` (see `TrialDifferences`); empty where none of the kinds explains it.
    """

    trial: str
    times: float
    kind: str = ""
    size: tuple[float, ...] = ()


@dataclass(frozen=True)
class TrialDifferences:
    """What differs between trials.

    - `error [T]`: RMS of the unexplained torque over the torque's spread, NaN where not judged.
    - `kind`: What differs in all of them, empty for nothing; `size [T, S]` of it from the middle
      trial's (rad or m, N m, or a share of the torque that goes with it).
    - `explained_share`: Share of the unexplained torque's square that goes with it.
    - `outliers`: Trials apart from the rest.
    """

    names: tuple[str, ...]
    error: np.ndarray
    kind: str = ""
    size: np.ndarray | None = None
    explained_share: float = 0.0
    outliers: tuple[OutlierTrial, ...] = ()

    @property
    def differs(self) -> bool:
        """Whether there is anything to say."""
        return bool(self.kind or self.outliers)

    @property
    def outlying(self) -> tuple[str, ...]:
        """Trials whose size is apart from those of the rest, where these are few."""
        if self.size is None:
            return ()
        largest = np.nanmax(np.abs(np.nan_to_num(self.size)), axis=1)
        usual_size = float(np.median(largest[np.isfinite(self.error)]))
        is_outlying = largest > np.maximum(
            TRIAL.min_error_ratio * usual_size, TRIAL.min_outlying_ratio * largest.max()
        )
        if 3 * is_outlying.sum() <= len(largest):
            return tuple(n for n, x in zip(self.names, is_outlying, strict=True) if x)
        return ()


@dataclass(frozen=True)
class Windows:
    """Means over windows of all trials, over the spread of each joint's torque: `table [K, n, P]`
    of the design's columns (the first `rigid`), friction and smooth forces; `tau [K, n]`; `by_zero
    [K, n, P, n]`: the table by rad that each angle reads too much; `trial, half [K]`.
    """

    table: np.ndarray
    tau: np.ndarray
    by_zero: np.ndarray
    trial: np.ndarray
    half: np.ndarray
    rigid: int

    def of(self, pick: np.ndarray) -> "Windows":
        """Return the windows `pick [K]` (bool)."""
        names = ("table", "tau", "by_zero", "trial", "half")
        return replace(self, **{name: getattr(self, name)[pick] for name in names})


def trials_differ(
    names: Sequence[str], tracks: Sequence[Track], design: Design
) -> TrialDifferences | None:
    """What differs between trials, and which of them are apart; None where that cannot be told.

    Args:
        names, tracks: `[T]`.
        design: Torque by unit of each of the mechanism's parameters, as of
            `hypotheses.unexplained`.
    """
    rows = _windows_of(tracks, design)
    if rows is None:
        return None
    trials = np.unique(rows.trial)
    plain = replace(rows, table=rows.table[:, :, : rows.rigid + 3 * rows.tau.shape[1]])
    error = np.minimum(_held_out_errors(rows, trials), _held_out_errors(plain, trials))
    is_outlier = _are_outliers(error)
    error_by_trial = np.full(len(names), np.nan)
    error_by_trial[trials] = error
    others = rows.of(~np.isin(rows.trial, trials[is_outlier]))
    x = _fit(others.table, others.tau)
    outliers = []
    for t, times in zip(trials[is_outlier], error[is_outlier] / np.median(error), strict=True):
        kind, size, _ = _best_kind(
            rows.of(rows.trial == t), dict.fromkeys(MIN_EXPLAINED_SHARE, TRIAL.min_share_outlier), x
        )
        outliers.append(OutlierTrial(names[t], float(times), kind, tuple(map(float, size[0]))))
    kind, size, explained_share = "", None, 0.0
    if len(np.unique(others.trial)) >= TRIAL.min_trials:
        kind, sizes, explained_share = _best_kind(others, MIN_EXPLAINED_SHARE)
    if kind:
        size = np.full((len(names), sizes.shape[1]), np.nan)
        size[np.unique(others.trial)] = sizes - np.median(sizes, axis=0)
    return TrialDifferences(
        tuple(names), error_by_trial, kind, size, explained_share, tuple(outliers)
    )


def _windows_of(tracks: Sequence[Track], design: Design) -> Windows | None:
    """Windows of trials that are long enough; None where there are too few of these, or they do not
    move.
    """
    parts = [blocks(t, sharp=True) for t in tracks]
    max_blocks = ROWS // max(1, len(parts))
    motion, starts, trial, half, count = [], [], [], [], 0
    for t, part in enumerate(parts):
        *means, number = (z[:max_blocks] for z in part)
        first = np.arange(0, max(0, len(number) - WINDOW + 1), STRIDE)
        first = first[number[first + WINDOW - 1] - number[first] == WINDOW - 1]
        if len(first) < TRIAL.min_windows or not all(np.all(np.isfinite(z)) for z in means):
            continue
        motion.append(means)
        starts.append(first + count)
        trial.append(np.full(len(first), t))
        half.append(np.arange(len(first)) * PIECES // len(first) % 2)
        count += len(number)
    if len(motion) < TRIAL.min_trials:
        return None
    m = BlockMeans(*(np.concatenate([part[k] for part in motion]) for k in range(4)))
    spread = np.std(m.tau, axis=0)
    if not np.all(np.std(m.q, axis=0) > BLOCK.min_motion) or not np.any(spread > 1e-9):
        return None
    hann, rows = np.hanning(WINDOW + 2)[1:-1], np.concatenate(starts)
    weight = 1.0 / np.maximum(spread, 1e-3 * spread.max())

    def averaged(x):
        mean = sum(w * x[rows + k] for k, w in enumerate(hann / hann.sum()))
        return mean * weight.reshape(1, -1, *[1] * (x.ndim - 2))

    by_zero = [
        _table(design, replace(m, q=m.q - by)) - _table(design, replace(m, q=m.q + by))
        for by in SMALL * np.eye(m.q.shape[1])
    ]
    one = BlockMeans(*(z[:1] for z in (m.q, m.v, m.a, m.tau)))
    return Windows(
        averaged(_table(design, m)),
        averaged(m.tau),
        averaged(np.stack(by_zero, 3) / (2.0 * SMALL)),
        np.concatenate(trial),
        np.concatenate(half),
        design(one, True).shape[2],
    )


def _smooth_forces(m: BlockMeans) -> np.ndarray:
    """`[K, n, 8 n]`: forces of each joint's own angle and speed, for what the model lacks in all
    trials alike.
    """
    n, q = m.q.shape[1], m.q
    speed = m.v / np.maximum(np.max(np.abs(m.v), axis=0), 1e-9)
    friction = [np.tanh(k * speed) for k in (10.0, 200.0, 1000.0)]
    shapes = (np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q), speed * np.abs(speed), *friction)
    return np.concatenate([z[:, :, None] * np.eye(n) for z in shapes], 2)


def _table(design: Design, m: BlockMeans) -> np.ndarray:
    """`[K, n, P]` of any number of blocks: the design's columns, friction, smooth forces."""

    def part(i):
        return BlockMeans(*(z[i : i + BLOCK.max_blocks] for z in (m.q, m.v, m.a, m.tau)))

    rigid = [design(part(i), True) for i in range(0, len(m.q), BLOCK.max_blocks)]
    return np.concatenate([np.concatenate(rigid), rubbing(m)[:, :, :-1], _smooth_forces(m)], 2)


def _solve(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve normal equations that may be singular: what the data do not fix stays small."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / size / size[:, None]
    return np.linalg.solve(scaled + 1e-9 * np.eye(len(gram)), right / size) / size


def _normal_equations(table: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a = table.reshape(-1, table.shape[2])
    return a.T @ a, a.T @ tau.ravel()


def _fit(table: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Parameters `[P]` by least squares."""
    return _solve(*_normal_equations(table, tau))


def _held_out_errors(rows: Windows, trials: np.ndarray) -> np.ndarray:
    """Compute by trial the RMS [T] of what parameters of the other trials leave; outlying trials
    count less.
    """
    parts = [rows.of(rows.trial == t) for t in trials]
    grams = [_normal_equations(part.table, part.tau) for part in parts]
    weights = error = np.ones(len(trials))
    for _ in range(ROUNDS):
        gram, right = (sum(w * g[k] for w, g in zip(weights, grams, strict=True)) for k in (0, 1))
        residuals = [
            part.tau - part.table @ _solve(gram - w * g[0], right - w * g[1])
            for part, w, g in zip(parts, weights, grams, strict=True)
        ]
        error = np.array([np.sqrt(np.mean(residual**2)) for residual in residuals])
        usual_error = max(float(np.median(error)), 1e-12)
        weights = 1.0 / np.square(np.maximum(1.0, error / usual_error))
    return error


def _are_outliers(error: np.ndarray) -> np.ndarray:
    """Trials whose error is far above the others', by the median and the median absolute deviation
    of its logarithm.
    """
    log = np.log(np.maximum(error, 1e-12))
    median = float(np.median(log))
    spread = 1.4826 * float(np.median(np.abs(log - median)))
    return (
        log - median > np.maximum(TRIAL.min_deviations * spread, np.log(TRIAL.min_error_ratio))
    ) & (error**2 > TRIAL.min_error_share)


def _columns_by_kind(rows: Windows, x: np.ndarray) -> dict[str, np.ndarray]:
    """Return by kind of difference the torque `[K, n, S]` by unit of each number of a
    trial's own.
    """
    inertias = x[: rows.rigid]  # a load is of each of them a share of its own
    identity = np.eye(rows.tau.shape[1])
    return {
        "zero": np.einsum("knps,p->kns", rows.by_zero, x),
        "torque_scale": -rows.tau[:, :, None] * identity,
        "torque_offset": np.broadcast_to(identity, (len(rows.tau), *identity.shape)),
        "load": rows.table[:, :, : rows.rigid] * inertias,
    }


def _best_kind(
    rows: Windows, min_share: dict[str, float], x: np.ndarray | None = None
) -> tuple[str, np.ndarray, float]:
    """Return the kind that explains most of the residual, if its share is the least that counts;
    its numbers by trial `[T, S]`, and that share.

    Args:
        x: Parameters, where others have fitted them.
    """
    best = ("", np.zeros((1, 0)), 0.0)
    for kind in min_share:
        before = after = 0.0
        for half in (0, 1):
            train, test = rows.of(rows.half == half), rows.of(rows.half != half)
            plain, _ = _fit_numbers(train, "", x)
            with_kind, numbers = _fit_numbers(train, kind, x)
            added = _added_torque(test, kind, plain, numbers)
            before += float(np.sum((test.tau - test.table @ plain) ** 2))
            after += float(np.sum((test.tau - test.table @ with_kind - added) ** 2))
        explained_share = 1.0 - after / max(before, 1e-300)
        if explained_share < min_share[
            kind
        ] or 1.0 - explained_share > TRIAL.max_ratio_to_other_kind * (1.0 - best[2]):
            continue  # of two that do about as well the first, which is the commonest, stands
        plain, size = _fit_numbers(rows, kind, x)
        if kind == "load":
            size = _load_shares(rows, _columns_by_kind(rows, plain)[kind], size)
        if x is None or _is_possible(kind, size):
            best = (kind, size, explained_share)
    return best


def _load_shares(rows: Windows, columns: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return loads by trial `[T, 1]` as shares of the torque of the whole mechanism."""
    _, trial_index = np.unique(rows.trial, return_inverse=True)
    torque = np.sum(columns, axis=2)
    along = np.einsum("kns,ks,kn->k", columns, numbers[trial_index], torque)
    square = np.bincount(trial_index, np.sum(torque**2, axis=1))
    return (np.bincount(trial_index, along) / square)[:, None]


def _is_possible(kind: str, size: np.ndarray) -> bool:
    """Whether a trial may be so far off: what takes more off the mechanism is no load."""
    if kind == "load":
        return float(np.min(size)) > TRIAL.min_load
    return kind != "zero" or float(np.max(np.abs(size))) < np.pi


def _fit_numbers(rows: Windows, kind: str, x: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Parameters `[P]` of all trials, and numbers `[T, S]` of each trial's own, together by least
    squares; those of a trial are eliminated first.

    Args:
        kind: Of the numbers, empty for none.
        x: Parameters, where others have fitted them.
    """
    trials = np.unique(rows.trial)
    plain = _fit(rows.table, rows.tau) if x is None else x
    if not kind:
        return plain, np.zeros((len(trials), 0))
    columns, residual = _columns_by_kind(rows, plain)[kind], rows.tau - rows.table @ plain
    regularisation = float(np.mean(residual**2)) / LIKELY_SIZE[kind] ** 2
    p = rows.table.shape[2]
    gram, right, own_solutions = np.zeros((p, p)), np.zeros(p), []
    for t in trials:
        is_trial = rows.trial == t
        a, b, c = rows.table[is_trial].reshape(-1, p), residual[is_trial].ravel(), columns[is_trial]
        c = c.reshape(len(b), -1)
        inner = c.T @ c + regularisation * np.eye(c.shape[1])
        solution = np.linalg.solve(inner, c.T @ np.column_stack([a, b]))
        gram += a.T @ a - a.T @ c @ solution[:, :-1]
        right += a.T @ b - a.T @ c @ solution[:, -1]
        own_solutions.append(solution)
    # torques and parameters may grow together: a scale is of what is left
    step = np.zeros(p) if x is not None or kind == "torque_scale" else _solve(gram, right)
    return plain + step, np.stack(
        [solution[:, -1] - solution[:, :-1] @ step for solution in own_solutions]
    )


def _added_torque(rows: Windows, kind: str, x: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Torque `[K, n]` of each trial's own numbers."""
    _, trial_index = np.unique(rows.trial, return_inverse=True)
    return np.einsum("kns,ks->kn", _columns_by_kind(rows, x)[kind], numbers[trial_index])
