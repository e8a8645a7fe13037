"""What records of trials that a camera saw have in common: which trials were asked for, units, and
times that run forward.
"""

from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.table import LogTable
from adaptsim_jax.logs.table_checks import lost_digits

RowName = Callable[[int], str]
"""How messages call row k."""
Columns = Mapping[str, np.ndarray]
"""Of a table, by name, `[T]` each."""


class CameraTracks(NamedTuple):
    """Of one trial: rows `[R]` of the table, time `[R]` s, track `[R, 2]` m, and how its row k is
    named.
    """

    rows: np.ndarray
    time: np.ndarray
    track: np.ndarray
    row_name: RowName


def row_namer(path: object, table: LogTable) -> RowName:
    """How messages call row `i` of a table that was read from `path`."""
    return lambda i: f"{path}: {table.row_word} {table.lines[i]}"


def check_columns(
    columns: Container[str], needed: Iterable[str], where: object, words: str
) -> None:
    """BadInput where one of the columns `needed` is missing; words: these, with their units."""
    for name in needed:
        if name not in columns:
            raise BadInput(f"{where}: column '{name}' is missing; needed are {words}")


def trials_of(
    columns: Columns,
    at: RowName,
    where: str,
    asked: np.ndarray,
    most: float,
) -> dict[int, CameraTracks]:
    """The trials `asked [N]` by number. BadInput where one is missing, two have one track, or one
    lasts longer than `most` s.
    """
    observed = {}
    for number in map(int, asked):
        rows = np.flatnonzero(columns["trial"] == number)
        if not len(rows):
            known = ", ".join(map(str, asked))
            raise BadInput(
                f"{where}: trial {number} is missing; record trials {known} into one file, see "
                "actions.csv"
            )

        def trials(k, rows=rows, number=number):
            return f"{at(int(rows[k]))}: trial {number}"

        time = columns["time"][rows]
        check_increasing(time, trials)
        if time[-1] - time[0] > most:
            raise BadInput(
                f"{trials(-1)}: lasts {time[-1] - time[0]:.6g} s; is time in ms? write seconds"
            )
        observed[number] = CameraTracks(
            rows, time, np.stack([columns["x"][rows], columns["y"][rows]], 1), trials
        )
    check_different({n: trial.track for n, trial in observed.items()}, where)
    return observed


def check_numbers(numbers: np.ndarray, at: RowName, asked: np.ndarray) -> None:
    """BadInput at the first row of `numbers [T]` that is none of the trials `asked [N]`."""
    for i in np.flatnonzero(~np.isin(numbers, asked))[:1]:
        now, number = " and ".join(map(str, asked)), numbers[i]
        if number != np.round(number):
            raise BadInput(
                f"{at(i)}: trial {number:g} is no whole number; number the trials as in actions.csv"
            )
        if 0 < number < asked[0]:
            raise BadInput(f"{at(i)}: trial {number:g} was told already; name the file of {now}")
        raise BadInput(
            f"{at(i)}: trial {number:g} was never asked for; asked are {now}, see actions.csv"
        )


UNITS = {"mm": 1e-3, "cm": 1e-2, "inches": 0.0254}
"""Units that lengths are written in by mistake, in m."""


def unit_like(size: float, usual: float) -> str:
    """Which of `UNITS` brings `size` nearest to `usual` m, and which does about as well."""
    off = {name: abs(float(np.log(size * unit / usual))) for name, unit in UNITS.items()}
    return " or ".join(
        sorted((name for name in off if off[name] < min(off.values()) + 0.5), key=lambda n: off[n])
    )


def check_unit(
    columns: Columns,
    at: RowName,
    distant: float,
    what: str,
    usual: float = 0.0,
) -> None:
    """BadInput at the first place farther than `far` m. usual: How far from the origin bodies are
    seen, 0 where that may be any.
    """
    for name in ("x", "y"):
        for i in np.flatnonzero(np.abs(columns[name]) > distant)[:1]:
            mend = "is it in mm or cm? write metres"
            if usual:
                same = columns["trial"] == columns["trial"][i]
                x, y = columns["x"][same], columns["y"][same]
                alone = np.sum(np.maximum(np.abs(x), np.abs(y)) > distant) < 3
                unit = unit_like(float(np.median(np.hypot(x, y))), usual)
                if alone:
                    mend = f"{mend}, or remove that row"
                else:
                    mend = f"it looks like {unit}: write metres"
            raise BadInput(
                f"{at(i)}: {name} = {columns[name][i]:.6g} m is beyond any {what}; {mend}"
            )


def check_different(tracks: Mapping[float, np.ndarray], where: str) -> None:
    """BadInput where two trials have the very same track `[R, C]`."""
    names = list(tracks)
    for k, name in enumerate(names):
        for other in names[:k]:
            a, b = tracks[other], tracks[name]
            if len(a) == len(b) and np.any(a != a[0]) and np.array_equal(a, b, equal_nan=True):
                raise BadInput(
                    f"{where}: trials {other:g} and {name:g} have the same track, to the digit; "
                    "give each its own"
                )


def check_increasing(time: np.ndarray, trials: RowName) -> None:
    """BadInput at the first row of one trial's `time [T]` s that is not after the one before."""
    for k in np.flatnonzero(np.diff(time) <= 0)[:1] + 1:
        if lost := lost_digits(time):
            raise BadInput(f"{trials(0)}: {lost}")
        word = "repeats" if time[k] == time[k - 1] else "runs backwards"
        raise BadInput(
            f"{trials(k)}: time {word} ({time[k - 1]:.9g} then {time[k]:.9g}); sort or remove such "
            "rows"
        )


def check_gaps(time: np.ndarray, most: float, until: float, trials: RowName, again: str) -> None:
    """BadInput at the first gap of `time [T]` s longer than `most` that begins before `until`;
    again: The mend.
    """
    for k in np.flatnonzero((np.diff(time) > most) & (time[:-1] < until))[:1] + 1:
        raise BadInput(
            f"{trials(int(k))}: nothing was recorded from {time[k - 1]:.4g} to {time[k]:.4g} s; a "
            f"gap of at most {most:g} s can be filled: {again}"
        )


def check_leaps(
    time: np.ndarray,
    track: np.ndarray,
    trials: RowName,
    body: str,
    fastest: float,
    slip: float = 0.0,
) -> None:
    """BadInput at the first row of `track [T, C]` m that is farther from the one before than `slip`
    m and `fastest` m/s allow.
    """
    leap = np.linalg.norm(np.diff(track, axis=0), axis=1)
    for k in np.flatnonzero(leap > fastest * np.diff(time) + slip)[:1] + 1:
        raise BadInput(
            f"{trials(int(k))}: {body} jumps {100 * leap[k - 1]:.0f} cm between two rows; remove "
            "what is not it"
        )


@dataclass(frozen=True)
class TrackCriteria:
    """What decides whether rows of one track belong together.

    Args:
        whole_turns: rad that no yaw reaches: bodies that slide have turned by 7 rad.
        fastest_turn: rad/s that no body turns at: those that slide turn at 9 rad/s.
        turn_slip: rad that yaw may jump beside: markers that are seen upside down jump by pi.
        hole: s without a row from which on the gap is reported.
    """

    whole_turns: float = 30.0
    fastest_turn: float = 40.0
    turn_slip: float = 0.5
    hole: float = 0.1


TRACK = TrackCriteria()


def unwrapped(time: np.ndarray, yaw: np.ndarray, trials: RowName, body: str) -> np.ndarray:
    """One trial's `yaw [T]` rad at `time [T]` s without jumps by whole turns; NaN where it was not
    seen. BadInput at the first row in another unit, or that jumps otherwise.
    """
    observed = np.flatnonzero(~np.isnan(yaw))
    for k in observed[np.abs(yaw[observed]) > TRACK.whole_turns][:1]:
        raise BadInput(
            f"{trials(int(k))}: yaw = {yaw[k]:.6g} rad is several turns; is it in degrees? write "
            "radians"
        )
    out = yaw.copy()
    out[observed] = np.unwrap(yaw[observed])
    leap = np.abs(np.diff(out[observed]))
    most = TRACK.fastest_turn * np.diff(time[observed]) + TRACK.turn_slip
    for k in np.flatnonzero(leap > most)[:1]:
        raise BadInput(
            f"{trials(int(observed[k + 1]))}: {body} turns by {leap[k]:.2g} rad between two rows; "
            "empty the cells of yaw that are not it"
        )
    return out


def holes(time: np.ndarray) -> list[str]:
    """What to say of the parts of one trial's `time [T]` s in which nothing was recorded."""
    return [
        f"nothing was recorded from {time[k]:.4g} to {time[k + 1]:.4g} s"
        for k in np.flatnonzero(np.diff(time) > TRACK.hole)
    ]
