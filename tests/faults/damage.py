"""Damages of recordings, drawn by seed: what loggers, drivers, trackers and people do to columns,
clocks, units and labels.

A damage takes a recording, a generator and what its columns are, and gives a recording. Cells may
be text; `tests.faults.readers` writes them as each format can.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

Columns = dict[str, np.ndarray | list]


@dataclass(frozen=True)
class Recording:
    """Columns of each trial and, of trials that were asked for, the table of what was asked."""

    trials: list[Columns]
    actions: Columns | None = None


@dataclass(frozen=True)
class Kind:
    """angles: rad; optional: columns that may be left out, all together; needed: columns that may
    not; lengths: m; placed: of these, where another origin is another meaning; mirrored: where
    another sign is told; turn: of a quaternion, w first; scales: units of time, as a factor of s;
    sizes: name -> factor of an action in another unit.
    """

    angles: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()
    lengths: tuple[str, ...] = ()
    placed: tuple[str, ...] = ()
    mirrored: str = ""
    turn: tuple[str, ...] = ()
    scales: tuple[float, ...] = (1e3, 1e6, 1e9)
    sizes: tuple[tuple[str, float], ...] = ()


Damage = Callable[[Recording, np.random.Generator, Kind], Recording]


def on_trials(one: Callable[[Columns, np.random.Generator, Kind], Columns]) -> Damage:
    """A damage of one trial, or of all of them alike."""

    def damage(recording: Recording, rng: np.random.Generator, kind: Kind) -> Recording:
        trials, count = recording.trials, len(recording.trials)
        which = int(rng.integers(-1, count)) if count > 1 else 0
        seed = int(rng.integers(2**31)) if count > 1 else None

        def draw():
            return rng if seed is None else np.random.default_rng(seed)

        changed = [one(c, draw(), kind) if which in (-1, k) else c for k, c in enumerate(trials)]
        return replace(recording, trials=changed)

    damage.__name__ = one.__name__
    return damage


def on_all(one: Callable[[Columns, np.random.Generator, Kind], Columns]) -> Damage:
    """A damage of all trials alike, as of the frame that one camera gives."""

    def damage(recording: Recording, rng: np.random.Generator, kind: Kind) -> Recording:
        seed = int(rng.integers(2**31))
        return replace(
            recording, trials=[one(c, np.random.default_rng(seed), kind) for c in recording.trials]
        )

    damage.__name__ = one.__name__
    return damage


def scaled_time(c, rng, kind):
    return c | {"time": c["time"] * float(rng.choice(kind.scales))}


def epoch(c, rng, kind):
    time = c["time"] + 1.7e9
    return c | {"time": time.astype(np.float32) if rng.integers(2) else time}


def wrapped(c, rng, kind):
    def wrap(x, period=2 * np.pi):
        return (x + period / 2) % period - period / 2

    return c | {k: wrap(c[k] + 2 * np.pi * int(rng.integers(-1, 2))) for k in kind.angles}


def emptied(c, rng, kind):
    optional = rng.integers(2) and kind.optional
    names = kind.optional if optional else (str(rng.choice(kind.needed)),)
    return c | {k: [str(rng.choice(["", "nan", "NaN", "null"]))] * len(c["time"]) for k in names}


CELLS = ["", "nan", "inf", "-inf", "x", "1,5", "1e400", "0x10", "--", "1 2"]


def one_cell(c, rng, kind):
    name, at = str(rng.choice(list(c))), int(rng.integers(len(c["time"])))
    cells = [f"{x:.12g}" for x in c[name]]
    cells[at] = str(rng.choice(CELLS))
    return c | {name: cells}


def rows(c, rng, kind):
    """Lost, repeated, exchanged or cut off."""
    n, how = len(c["time"]), int(rng.integers(4))
    begin, longest = (20, 60) if n > 140 else (n // 4, n // 3)
    at, size = int(rng.integers(begin, n - longest - 20)), int(rng.integers(2, longest))
    order = np.arange(n)
    if how == 0:
        order = np.delete(order, slice(at, at + size))
    elif how == 1:
        order = np.insert(order, at, at)
    elif how == 2:
        order[at], order[at + size] = order[at + size], order[at]
    else:
        order = order[: int(rng.integers(0, n))]
    return {k: x[order] for k, x in c.items()}


def clock(c, rng, kind):
    """Set forward or back."""
    n = len(c["time"])
    margin = 20 if n > 140 else n // 4
    at, step = int(rng.integers(margin, n - margin)), float(rng.choice([-1.0, -0.05, 0.5, 3600.0]))
    return c | {"time": np.where(np.arange(n) >= at, c["time"] + step, c["time"])}


def commas(c, rng, kind):
    names = list(c) if rng.integers(2) else [str(rng.choice(list(c)))]
    return c | {k: ['"' + f"{x:.6f}".replace(".", ",") + '"' for x in c[k]] for k in names}


def unit(c, rng, kind):
    """Lengths in mm, cm or inches."""
    factor = float(rng.choice([1e3, 100.0, 1 / 0.0254]))
    return c | {k: c[k] * factor for k in kind.lengths}


def elsewhere(c, rng, kind):
    """From another origin, as of another trial's piece."""
    name = str(rng.choice(kind.placed))
    return c | {name: c[name] + float(rng.choice([-0.7, 0.7]))}


def frame(c, rng, kind):
    """A camera that is mirrored, upside down, or whose axes are exchanged."""
    how, (first, second) = int(rng.integers(3)), kind.lengths[:2]
    if how == 0 and kind.mirrored:
        return c | {kind.mirrored: -c[kind.mirrored]}
    if how < 2:
        return c | {first: -c[first], second: -c[second]}
    return c | {first: c[second], second: c[first]}


def turn(c, rng, kind):
    """A quaternion with w last, of another length, or (which changes nothing) of the other sign
    here and there.
    """
    w, x, y, z = (c[k] for k in kind.turn)
    how = int(rng.integers(3))
    if how == 0:
        told = (x, y, z, w)
    else:
        factor = np.where(rng.random(len(w)) < 0.3, -1.0, 1.0) * (1.0 if how == 1 else 1.5)
        told = tuple(factor * part for part in (w, x, y, z))
    return c | dict(zip(kind.turn, told, strict=True))


def renamed(c, rng, kind):
    """A column that is needed has another name, or is not there."""
    name = str(rng.choice(["time", *kind.needed]))
    return {
        (f"{name}_raw" if k == name else k): x for k, x in c.items() if k != name or rng.integers(2)
    }


def messages(c, rng, kind):
    """Of a bag: stamps that are missing or far off, names in another order or empty, arrays that
    lack a joint, another robot on the same topic, often or once, and a channel of another kind
    beside.
    """
    name = str(rng.choice(["unstamped", "reordered", "short", "other", "far", "seldom", "foreign"]))
    n = len(c["time"])
    share = {"far": 0.05, "seldom": 0.004, "foreign": 0.1}.get(name, 0.2)
    # the very first row is left, for it is the zero of the trial's times
    first = (
        (np.arange(n) > 0)
        & (np.arange(n) < int(rng.integers(2, 5)))
        & bool(name in ("unstamped", "far"))
    )
    return c | {name: ((rng.random(n) < share) & (np.arange(n) > 0)) | first}


def nameless(c, rng, kind):
    """All names of a bag's joint states are empty."""
    return c | {"nameless": np.ones(len(c["time"]), bool)}


def named(c, rng, kind):
    """Names of a data set that are not its numbers': one too few, twice the same, none."""
    return c | {"named": [str(rng.choice(["fewer", "twice", "none"]))] * len(c["time"])}


def scale(c, rng, kind):
    """Angles in per cent of a range that the motion reaches the ends of, or in steps of an
    encoder.
    """
    out = dict(c)
    steps = bool(rng.integers(2))
    for name in kind.angles:
        low, high = np.quantile(c[name], [0.02, 0.98])
        share = np.clip((c[name] - low) / (high - low), 0.0, 1.0)
        out[name] = (
            np.round(2048 + c[name] * 4096 / (2 * np.pi)) if steps else 200.0 * share - 100.0
        )
    return out


def beside(c, rng, kind):
    """Columns that are not ours: a frame's number, a remark."""
    n = len(c["time"])
    return c | {
        "frame": np.arange(n, dtype=float),
        "remark": ["ok" if rng.random() < 0.9 else "" for _ in range(n)],
    }


def actions(recording, rng, kind):
    """What was asked for in another unit, with a cell that is no number, or under other numbers."""
    asked, how = dict(recording.actions), int(rng.integers(4))
    n = len(asked["trial"])
    if how == 0:
        name, factor = kind.sizes[int(rng.integers(len(kind.sizes)))]
        asked[name] = asked[name] * factor
    elif how == 1:
        name = str(rng.choice(list(asked)))
        cells = [f"{x:.12g}" for x in asked[name]]
        cells[int(rng.integers(n))] = str(rng.choice(CELLS))
        asked[name] = cells
    elif how == 2:
        asked["trial"] = asked["trial"] + int(rng.choice([-1, 1, 100]))
    else:
        asked["trial"] = np.where(
            np.arange(n) == int(rng.integers(1, n)), asked["trial"][0], asked["trial"]
        )
    return replace(recording, actions=asked)


LOGS = tuple(map(on_trials, (scaled_time, epoch, wrapped, emptied, one_cell, rows, clock, commas)))
BAGS = tuple(
    map(
        on_trials, (scaled_time, epoch, wrapped, emptied, one_cell, rows, clock, messages, nameless)
    )
)
ARRAYS = LOGS[:-1]
SETS = (*ARRAYS, on_trials(named), on_trials(scale))
TRACKS = tuple(
    map(
        on_trials,
        (
            scaled_time,
            epoch,
            emptied,
            one_cell,
            rows,
            clock,
            commas,
            unit,
            elsewhere,
            renamed,
            beside,
        ),
    )
)
POSES = (*TRACKS, on_all(turn))
TRACKS = (*TRACKS, on_all(frame))
ASKED = (*TRACKS, actions)
