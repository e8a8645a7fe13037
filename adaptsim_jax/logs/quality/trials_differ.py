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
LIKELY = {"zero": 0.1, "torque_scale": 1.0, "torque_offset": 10.0, "load": 1.0}
"""Size of a number before anything is observed (rad; spreads of the torque), for what a trial's own
motion does not fix.
"""
SMALL = 1e-3
"""rad by which a zero is moved for its derivative: gravity is linear over it."""
PIECES = 4
"""Contiguous parts of a trial: every other one is fitted to while the rest judge."""
WINDOW, STRIDE = 24, 6
"""Blocks of a window (0.24 s: noise of accelerations averages out), and to the next one."""
ROWS = 8 * BLOCK.most
"""Blocks of all trials that are looked at."""


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
    - `outliers`: Trials apart from the rest.
    """

    names: tuple[str, ...]
    error: np.ndarray
    kind: str = ""
    size: np.ndarray | None = None
    takes: float = 0.0
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


@dataclass(frozen=True)
class Windows:
    """Means over windows of all trials, over the spread of each joint's torque: `table [K, n, P]`
    of the design's columns (the first `rigid`), friction and smooth forces; `tau [K, n]`; `moved
    [K, n, P, n]`: the table by rad that each angle reads too much; `trial, half [K]`.
    """

    table: np.ndarray
    tau: np.ndarray
    moved: np.ndarray
    trial: np.ndarray
    half: np.ndarray
    rigid: int

    def of(self, pick: np.ndarray) -> "Windows":
        """The windows picked `[K]`."""
        own = ("table", "tau", "moved", "trial", "half")
        return replace(self, **{name: getattr(self, name)[pick] for name in own})


def trials_differ(names: Sequence[str], tracks: Sequence[Track], design: Design) -> Differ | None:
    """What differs between trials, and which of them are apart; None where that cannot be told.

    Args:
        names, tracks: `[T]`.
        design: Torque by unit of each of the mechanism's parameters, as of
            `hypotheses.unexplained`.
    """
    rows = _windows_of(tracks, design)
    if rows is None:
        return None
    observed = np.unique(rows.trial)
    plain = replace(rows, table=rows.table[:, :, : rows.rigid + 3 * rows.tau.shape[1]])
    error = np.minimum(_left_out(rows, observed), _left_out(plain, observed))
    apart = _are_outliers(error)
    whole = np.full(len(names), np.nan)
    whole[observed] = error
    rest = rows.of(~np.isin(rows.trial, observed[apart]))
    x = _fit(rest.table, rest.tau)
    outliers = []
    for t, times in zip(observed[apart], error[apart] / np.median(error), strict=True):
        kind, size, _ = _likeliest(
            rows.of(rows.trial == t), dict.fromkeys(TAKES, TRIAL.takes_outlier), x
        )
        outliers.append(OutlierTrial(names[t], float(times), kind, tuple(map(float, size[0]))))
    kind, size, takes = "", None, 0.0
    if len(np.unique(rest.trial)) >= TRIAL.min_trials:
        kind, own, takes = _likeliest(rest, TAKES)
    if kind:
        size = np.full((len(names), own.shape[1]), np.nan)
        size[np.unique(rest.trial)] = own - np.median(own, axis=0)
    return Differ(tuple(names), whole, kind, size, takes, tuple(outliers))


def _windows_of(tracks: Sequence[Track], design: Design) -> Windows | None:
    """Windows of trials that are long enough; None where there are too few of these, or they do not
    move.
    """
    parts = [blocks(t, sharp=True) for t in tracks]
    most = ROWS // max(1, len(parts))
    motion, begins, trial, half, count = [], [], [], [], 0
    for t, part in enumerate(parts):
        *own, number = (z[:most] for z in part)
        first = np.arange(0, max(0, len(number) - WINDOW + 1), STRIDE)
        first = first[number[first + WINDOW - 1] - number[first] == WINDOW - 1]
        if len(first) < TRIAL.min_windows or not all(np.all(np.isfinite(z)) for z in own):
            continue
        motion.append(own)
        begins.append(first + count)
        trial.append(np.full(len(first), t))
        half.append(np.arange(len(first)) * PIECES // len(first) % 2)
        count += len(number)
    if len(motion) < TRIAL.min_trials:
        return None
    m = BlockMeans(*(np.concatenate([part[k] for part in motion]) for k in range(4)))
    spread = np.std(m.tau, axis=0)
    if not np.all(np.std(m.q, axis=0) > BLOCK.moving) or not np.any(spread > 1e-9):
        return None
    hann, rows = np.hanning(WINDOW + 2)[1:-1], np.concatenate(begins)
    weight = 1.0 / np.maximum(spread, 1e-3 * spread.max())

    def averaged(x):
        mean = sum(w * x[rows + k] for k, w in enumerate(hann / hann.sum()))
        return mean * weight.reshape(1, -1, *[1] * (x.ndim - 2))

    moved = [
        _table(design, replace(m, q=m.q - by)) - _table(design, replace(m, q=m.q + by))
        for by in SMALL * np.eye(m.q.shape[1])
    ]
    one = BlockMeans(*(z[:1] for z in (m.q, m.v, m.a, m.tau)))
    return Windows(
        averaged(_table(design, m)),
        averaged(m.tau),
        averaged(np.stack(moved, 3) / (2.0 * SMALL)),
        np.concatenate(trial),
        np.concatenate(half),
        design(one, True).shape[2],
    )


def _smooth(m: BlockMeans) -> np.ndarray:
    """`[K, n, 8 n]`: forces of each joint's own angle and speed, for what the model lacks in all
    trials alike.
    """
    n, q = m.q.shape[1], m.q
    speed = m.v / np.maximum(np.max(np.abs(m.v), axis=0), 1e-9)
    rub = [np.tanh(k * speed) for k in (10.0, 200.0, 1000.0)]
    shapes = (np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q), speed * np.abs(speed), *rub)
    return np.concatenate([z[:, :, None] * np.eye(n) for z in shapes], 2)


def _table(design: Design, m: BlockMeans) -> np.ndarray:
    """`[K, n, P]` of any number of blocks: the design's columns, friction, smooth forces."""

    def cut(i):
        return BlockMeans(*(z[i : i + BLOCK.most] for z in (m.q, m.v, m.a, m.tau)))

    rigid = [design(cut(i), True) for i in range(0, len(m.q), BLOCK.most)]
    return np.concatenate([np.concatenate(rigid), rubbing(m)[:, :, :-1], _smooth(m)], 2)


def _solved(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Of normal equations that may be singular: what the data do not fix stays small."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / size / size[:, None]
    return np.linalg.solve(scaled + 1e-9 * np.eye(len(gram)), right / size) / size


def _normal(table: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a = table.reshape(-1, table.shape[2])
    return a.T @ a, a.T @ tau.ravel()


def _fit(table: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Parameters `[P]` by least squares."""
    return _solved(*_normal(table, tau))


def _left_out(rows: Windows, observed: np.ndarray) -> np.ndarray:
    """RMS by trial of what parameters from the other trials leave, odd trials counting less."""
    own = [rows.of(rows.trial == t) for t in observed]
    grams = [_normal(part.table, part.tau) for part in own]
    worth = error = np.ones(len(observed))
    for _ in range(ROUNDS):
        gram, right = (sum(w * g[k] for w, g in zip(worth, grams, strict=True)) for k in (0, 1))
        left = [
            part.tau - part.table @ _solved(gram - w * g[0], right - w * g[1])
            for part, w, g in zip(own, worth, grams, strict=True)
        ]
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


def _columns(rows: Windows, x: np.ndarray) -> dict[str, np.ndarray]:
    """Ways in which trials may differ: torque `[K, n, S]` by unit of each number of a trial's
    own.
    """
    own = x[: rows.rigid]  # a load is of each of them a share of its own
    each = np.eye(rows.tau.shape[1])
    return {
        "zero": np.einsum("knps,p->kns", rows.moved, x),
        "torque_scale": -rows.tau[:, :, None] * each,
        "torque_offset": np.broadcast_to(each, (len(rows.tau), *each.shape)),
        "load": rows.table[:, :, : rows.rigid] * own,
    }


def _likeliest(
    rows: Windows, least: dict[str, float], x: np.ndarray | None = None
) -> tuple[str, np.ndarray, float]:
    """The kind that takes most of what is unexplained, if it takes the least of it that counts; its
    numbers by trial `[T, S]`, and what it takes.

    Args:
        x: Parameters, where others have fitted them.
    """
    best = ("", np.zeros((1, 0)), 0.0)
    for kind in least:
        before = after = 0.0
        for half in (0, 1):
            known, tested = rows.of(rows.half == half), rows.of(rows.half != half)
            plain, _ = _numbers(known, "", x)
            found, own = _numbers(known, kind, x)
            more = _added(tested, kind, plain, own)
            before += float(np.sum((tested.tau - tested.table @ plain) ** 2))
            after += float(np.sum((tested.tau - tested.table @ found - more) ** 2))
        takes = 1.0 - after / max(before, 1e-300)
        if takes < least[kind] or 1.0 - takes > TRIAL.alike * (1.0 - best[2]):
            continue  # of two that do about as well the first, which is the commonest, stands
        plain, size = _numbers(rows, kind, x)
        if kind == "load":
            size = _shares(rows, _columns(rows, plain)[kind], size)
        if x is None or _possible(kind, size):
            best = (kind, size, takes)
    return best


def _shares(rows: Windows, own: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """`[T, 1]` of the torque of the whole mechanism, by trial."""
    _, place = np.unique(rows.trial, return_inverse=True)
    whole = np.sum(own, axis=2)
    along = np.einsum("kns,ks,kn->k", own, numbers[place], whole)
    square = np.bincount(place, np.sum(whole**2, axis=1))
    return (np.bincount(place, along) / square)[:, None]


def _possible(kind: str, size: np.ndarray) -> bool:
    """Whether a trial may be so far off: what takes more off the mechanism is no load."""
    if kind == "load":
        return float(np.min(size)) > TRIAL.lightest
    return kind != "zero" or float(np.max(np.abs(size))) < np.pi


def _numbers(rows: Windows, kind: str, x: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Parameters `[P]` of all trials, and numbers `[T, S]` of each trial's own, together by least
    squares; those of a trial are eliminated first.

    Args:
        kind: Of the numbers, empty for none.
        x: Parameters, where others have fitted them.
    """
    observed = np.unique(rows.trial)
    plain = _fit(rows.table, rows.tau) if x is None else x
    if not kind:
        return plain, np.zeros((len(observed), 0))
    own, left = _columns(rows, plain)[kind], rows.tau - rows.table @ plain
    doubt = float(np.mean(left**2)) / LIKELY[kind] ** 2
    p = rows.table.shape[2]
    gram, right, selected = np.zeros((p, p)), np.zeros(p), []
    for t in observed:
        here = rows.trial == t
        a, b, c = rows.table[here].reshape(-1, p), left[here].ravel(), own[here]
        c = c.reshape(len(b), -1)
        inner = c.T @ c + doubt * np.eye(c.shape[1])
        both = np.linalg.solve(inner, c.T @ np.column_stack([a, b]))
        gram += a.T @ a - a.T @ c @ both[:, :-1]
        right += a.T @ b - a.T @ c @ both[:, -1]
        selected.append(both)
    # torques and parameters may grow together: a scale is of what is left
    step = np.zeros(p) if x is not None or kind == "torque_scale" else _solved(gram, right)
    return plain + step, np.stack([both[:, -1] - both[:, :-1] @ step for both in selected])


def _added(rows: Windows, kind: str, x: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Torque `[K, n]` of each trial's own numbers."""
    _, place = np.unique(rows.trial, return_inverse=True)
    return np.einsum("kns,ks->kn", _columns(rows, x)[kind], numbers[place])
