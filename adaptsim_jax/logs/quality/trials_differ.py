"""Whether trials of one recording were made by one machine: zeros, loads, torque scales and offsets
that differ from trial to trial.

The torque that moves a mechanism is linear in its parameters (`quality.hypotheses`), and in small
changes of an angle's zero, of a load, of a torque's scale or of a constant torque. Each of these is
given to every trial by itself, fitted to some pieces of the trials and judged on the others, so
that what a model lacks alike in all trials is taken for nothing. Smooth forces of each joint's own
angle and speed, alike in all trials, stand for what it lacks. NumPy and SciPy alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from adaptsim_jax.logs.criteria import TRIAL
from adaptsim_jax.logs.quality.hypotheses import Design, Track
from adaptsim_jax.logs.quality.trial_windows import (
    PIECES,
    WindowRows,
    fitted,
    jointly,
    normal,
    of_motion,
    over_blocks,
    part_of,
    regress,
    rows_of,
    solved,
    unexplained_of,
)

TAKES = {
    "zero": TRIAL.takes_zero,
    "torque_scale": TRIAL.takes_scale,
    "torque_offset": TRIAL.takes_offset,
    "load": TRIAL.takes_load,
}
"""Share of the unexplained torque's square that a difference must take away in pieces that it was
not fitted to. Drives that saturate or play have another scale in every trial by themselves.
"""
ROUNDS = 4
"""Refits: sizes no longer change in three digits."""
ZERO = 0.1
"""rad: size of zeros before anything is observed, and the longest step of their fit."""
SMALL = 1e-3
"""rad by which a zero is moved for its derivative: gravity is linear over it."""


@dataclass(frozen=True)
class OutlierTrial:
    """A trial apart from the others: its unexplained torque is `times` theirs. `kind`: what of it
    is otherwise, by `size [S]` (see `Differ`); empty where none of the kinds explains it.
    """

    trial: str
    times: float
    kind: str = ""
    size: tuple[float, ...] = ()


@dataclass(frozen=True)
class Differ:
    """What differs between trials.

    - `error [T]`: RMS of the unexplained torque over the torque's spread, NaN where not judged.
    - `kind`: What differs in all of them, empty for nothing; `size [T, S]` of it from the middle
      trial's (rad or m, N m, or a share of the torque that goes with it).
    - `takes`: Share of the unexplained torque's square that goes with it.
    - `alike`: Kinds that do about as well.
    - `outlier`: Trials apart from the rest.
    """

    names: tuple[str, ...]
    error: np.ndarray
    kind: str = ""
    size: np.ndarray | None = None
    takes: float = 0.0
    alike: tuple[str, ...] = ()
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
        distant = np.nanmax(np.abs(np.nan_to_num(self.size)), axis=1)
        usual = float(np.median(distant[np.isfinite(self.error)]))
        few = distant > np.maximum(TRIAL.times * usual, TRIAL.outlying * distant.max())
        if 3 * few.sum() <= len(distant):
            return tuple(n for n, x in zip(self.names, few, strict=True) if x)
        return ()


Columns = Callable[[WindowRows, np.ndarray], np.ndarray]
"""`(rows, parameters [P]) -> [K, n, S]`: torque by unit of each number that a trial has of its own.
"""


def trials_differ(names: Sequence[str], tracks: Sequence[Track], design: Design) -> Differ | None:
    """What differs between trials, and which of them are apart; None where that cannot be told.

    Args:
        names, tracks: `[T]`.
        design: Torque by unit of each of the mechanism's parameters, as of
            `hypotheses.unexplained`.
    """
    rows = rows_of(tracks, design)
    if rows is None:
        return None
    observed = np.unique(rows.trial)
    error = _errors(rows, observed)
    whole = np.full(len(names), np.nan)
    whole[observed] = error
    outlying = [int(t) for t in observed[_are_outliers(error)]]
    rest = part_of(rows, np.flatnonzero(~np.isin(rows.trial, outlying)))
    if len(np.unique(rest.trial)) >= TRIAL.min_trials:
        common = _common(rest, len(names))
    else:
        common = ("", None, 0.0, ())
    usual = float(np.median(error))
    outlier = tuple(_reason(rows, rest, t, names[t], float(whole[t]) / usual) for t in outlying)
    return Differ(tuple(names), whole, *common, outlier)


def _errors(rows: WindowRows, observed: np.ndarray) -> np.ndarray:
    """RMS by trial of what parameters from the other trials leave, with or without smooth forces,
    odd trials counting less.
    """
    plain = rows.rigid + 3 * rows.tau.shape[1]
    return np.minimum(*(_left_out(rows, observed, width) for width in (plain, 0)))


def _left_out(rows: WindowRows, observed: np.ndarray, width: int) -> np.ndarray:
    worth = np.ones(len(observed))
    grams = [normal(rows, rows.trial == t, width) for t in observed]
    error = worth
    for _ in range(ROUNDS):
        gram = sum(w * g[0] for w, g in zip(worth, grams, strict=True))
        right = sum(w * g[1] for w, g in zip(worth, grams, strict=True))
        by_others = (
            solved(gram - w * g[0], right - w * g[1]) for w, g in zip(worth, grams, strict=True)
        )
        left = (
            unexplained_of(part_of(rows, rows.trial == t), x)
            for t, x in zip(observed, by_others, strict=True)
        )
        error = np.array([np.sqrt(np.mean(rest**2)) for rest in left])
        usual = max(float(np.median(error)), 1e-12)
        worth = 1.0 / np.square(np.maximum(1.0, error / usual))
    return error


def _are_outliers(error: np.ndarray) -> np.ndarray:
    """Trials whose error is far above the others', by the median and the median absolute deviation
    of its logarithm.
    """
    log = np.log(np.maximum(error, 1e-12))
    middle = float(np.median(log))
    spread = 1.4826 * float(np.median(np.abs(log - middle)))
    return (log - middle > np.maximum(TRIAL.deviations * spread, np.log(TRIAL.times))) & (
        error**2 > TRIAL.error
    )


def kinds(n: int) -> dict[str, Columns]:
    """Ways in which trials may differ, of a mechanism of `n` joints."""

    def each(value):
        return value[:, :, None] * np.eye(n)

    return {
        "zero": _moved,
        "torque_scale": lambda rows, x: -each(rows.tau),
        "torque_offset": lambda rows, x: each(np.ones_like(rows.tau)),
        "load": lambda rows, x: rows.table[:, :, : rows.rigid],
    }


def _moved(rows: WindowRows, x: np.ndarray) -> np.ndarray:
    """Torque by rad that each joint's angle reads too much."""
    n, own = rows.fine.q.shape[1], x[: rows.rigid]
    out = []
    for j in range(n):
        step = np.where(np.arange(n) == j, SMALL, 0.0)
        up, down = (
            over_blocks(rows.design, replace(rows.fine, q=rows.fine.q + s * step))
            for s in (1.0, -1.0)
        )
        out.append(rows.averaged(-(up - down) @ own / (2.0 * SMALL)))
    return np.stack(out, 2)


def _common(rows: WindowRows, count: int) -> tuple[str, np.ndarray | None, float, tuple[str, ...]]:
    """The kind that takes most of what is unexplained in trials, its size by trial `[count, S]`,
    what it takes, and kinds alike.
    """
    observed, x = np.unique(rows.trial), fitted(rows)
    own = {name: columns(rows, x) for name, columns in kinds(rows.tau.shape[1]).items()}
    takes = {}
    for name, columns in own.items():
        shared = name != "torque_scale"
        # pieces of a trial do not fix every number of a load by itself
        if name == "load" or _steady(rows, columns, observed, shared):
            takes[name] = _takes(rows, columns, shared)
    found = {name: t for name, t in takes.items() if t >= TAKES[name]}
    if not found:
        return "", None, 0.0, ()
    best = next(iter(found))
    # the first, which is the commonest, stands where another does about as well
    for name, t in found.items():
        best = name if 1.0 - t < TRIAL.alike * (1.0 - found[best]) else best
    size = np.full((count, own[best].shape[2]), np.nan)

    def plain():
        return _numbers(rows, own[best], rows.trial, observed, best != "torque_scale")[1]

    size[observed] = _refined_zeros(rows, observed) if best == "zero" else plain()
    left = 1.0 - found[best]
    alike = tuple(n for n, t in found.items() if n != best and TRIAL.alike * (1.0 - t) < left)
    centred = size - np.nanmedian(size, axis=0)
    return best, _as_reported(best, rows, own[best], x, centred), found[best], alike


def _takes(rows: WindowRows, own: np.ndarray, shared: bool) -> float:
    """Share of the square of what is left in half of the pieces that goes with numbers of each
    trial's own from the other half.
    """
    before = after = 0.0
    for half in (0, 1):
        known, tested = part_of(rows, rows.half == half), part_of(rows, rows.half != half)
        observed = np.intersect1d(known.trial, tested.trial)
        x, mine = _numbers(known, own[rows.half == half], known.trial, observed, shared)
        more = np.einsum(
            "kns,ks->kn", own[rows.half != half], mine[np.searchsorted(observed, tested.trial)]
        )
        after += float(np.sum((unexplained_of(tested, x) - more * rows.weight) ** 2))
        before += float(np.sum(unexplained_of(tested, fitted(known)) ** 2))
    return 1.0 - after / max(before, 1e-300)


def _numbers(
    rows: WindowRows, own, label: np.ndarray, observed: np.ndarray, shared: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters `[P]` and numbers `[T, S]` of each label's own.

    Args:
        shared: Together; else the numbers after the parameters, since all torques and all
            parameters may shrink alike.
    """
    if shared:
        return jointly(rows, own, label, observed)
    x = fitted(rows)
    left, weighed = unexplained_of(rows, x), own * rows.weight[:, None]
    numbers = [
        regress(weighed[label == t].reshape(-1, own.shape[2]), left[label == t].ravel())
        for t in observed
    ]
    return x, np.stack(numbers)


def _refined_zeros(rows: WindowRows, observed: np.ndarray) -> np.ndarray:
    """Zeros `[T, n]` together with the parameters, by Gauss and Newton's steps: wide zeros move the
    parameters too.
    """
    n = rows.tau.shape[1]
    size, now = np.zeros((len(observed), n)), rows
    for _ in range(ROUNDS):
        _, step = jointly(now, _moved(now, fitted(now)), now.trial, observed, ZERO)
        size = size + np.clip(step - np.median(step, axis=0), -ZERO, ZERO)
        own = np.zeros((int(rows.origin.max()) + 1, n))
        own[observed] = size
        now = of_motion(rows, replace(rows.fine, q=rows.fine.q - own[rows.origin]))
    return size


def _steady(rows: WindowRows, own: np.ndarray, observed: np.ndarray, shared: bool) -> bool:
    """Whether a trial's numbers agree between its pieces and differ between trials: an analysis of
    variance for each number.
    """
    label = rows.trial * PIECES + rows.piece
    table = _numbers(rows, own, label, np.unique(label), shared)[1].reshape(
        len(observed), PIECES, -1
    )
    middle = table.mean(1)
    between = PIECES * np.sum((middle - middle.mean(0)) ** 2, 0) / (len(observed) - 1)
    within = np.sum((table - middle[:, None]) ** 2, (0, 1)) / (len(observed) * (PIECES - 1))
    p = stats.f.sf(
        between / np.maximum(within, 1e-300), len(observed) - 1, len(observed) * (PIECES - 1)
    )
    return bool(np.min(p) < TRIAL.level / (4 * table.shape[2]))


def _as_reported(
    name: str, rows: WindowRows, own: np.ndarray, x: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """Sizes as they are told: of a load, as a share of the torque of the whole mechanism."""
    if name != "load":
        return size
    whole = rows.table[:, :, : rows.rigid] @ x[: rows.rigid]
    out = np.full((len(size), 1), np.nan)
    for t in np.flatnonzero(np.all(np.isfinite(size), axis=1)):
        here = rows.trial == t
        torque = whole[here]
        along = np.sum((own[here] @ size[t]) * torque)
        out[t] = along / max(float(np.sum(torque**2)), 1e-300)
    return out


def _reason(rows: WindowRows, rest: WindowRows, t: int, name: str, times: float) -> OutlierTrial:
    """What of trial `t` is otherwise than in `rest`: the kind that takes most of its error in
    pieces not fitted to.
    """
    mine = part_of(rows, rows.trial == t)
    x = fitted(rest)
    left = unexplained_of(mine, x)
    best = OutlierTrial(name, times)
    most = TRIAL.takes_outlier
    for kind, columns in kinds(rows.fine.q.shape[1]).items():
        own = columns(mine, x) * rows.weight[:, None]

        def fit(keep, own=own):
            return regress(own[keep].reshape(-1, own.shape[2]), left[keep].ravel())

        after = 0.0
        for h in (0, 1):
            tested = mine.half != h
            miss = left[tested] - own[tested] @ fit(~tested)
            after += float(np.sum(miss**2))
        takes = 1.0 - after / max(float(np.sum(left**2)), 1e-300)
        if takes > most:
            size = np.full((t + 1, own.shape[2]), np.nan)
            size[t] = fit(np.ones(len(left), bool))
            shown = _as_reported(kind, mine, columns(mine, x), x, size)[t]
            if (kind == "load" and np.min(shown) < TRIAL.lightest) or (
                kind == "zero" and np.max(np.abs(shown)) > np.pi
            ):
                continue
            best, most = OutlierTrial(name, times, kind, tuple(float(z) for z in shown)), takes
    return best
