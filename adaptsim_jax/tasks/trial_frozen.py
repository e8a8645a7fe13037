"""A tracker that repeats its last value while the body must go on: rows that are the same to the
digit, and what friction can stop.
"""

from collections.abc import Callable

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.noise import difference_noise

BAR = 0.005
"""m that a body must go on for its standing still to be doubted."""
SURE = 3.0
"""Standard deviations of a difference of two rows that count as noise."""
LEAST = 0.05
"""s at a track's end that are told: one row that repeats the last does no harm."""
GRIP = 12.0
"""m/s^2 with which friction stops a body at most: a coefficient of 1.2."""
STILL_GOING = 0.05
"""m/s that a body must have left at the first repeated row, whatever stops it."""
HELD = 0.4
"""Share of a moving body's rows that repeat the one before from which on the tracker is slower than
the log.
"""


def repeats(places: np.ndarray) -> list[tuple[int, int]]:
    """First and last row of each run of rows of `places [R, C]` that are the same to the digit, two
    rows or more.
    """
    same = np.concatenate([[False], np.all(np.diff(places, axis=0) == 0, axis=1), [False]])
    edges = np.flatnonzero(np.diff(same.astype(int)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def check_frozen(
    time: np.ndarray, places: np.ndarray, told: Callable[[int], str], body: str, grip: float = GRIP
) -> None:
    """BadInput where a track `places [R, C]` m at `time [R]` s holds its value while the body must
    move. told: names a row; body: as messages call it; grip: m/s^2 that may stop it.
    """
    runs = repeats(places)
    if not runs:
        return
    moved = np.linalg.norm(np.diff(places, axis=0), axis=1)
    blur = SURE * max(_noise(places), _step(places))
    _check_held(time, moved, blur, told, body)
    for first, last in runs:
        mend = (
            "a tracker that lost it repeats its last value: leave x and y empty in these rows, or "
            "remove them"
            "; if all is as declared, add --as-declared"
        )
        stood = f"{told(first + 1)}: {body} stands still to the digit from {time[first]:.4g} to {time[last]:.4g} s and"
        if last + 1 < len(time):
            leap, then = moved[last], moved[last + 1 : last + 3]
            if len(then) and leap > 2.0 * then.max() + BAR + blur:
                raise BadInput(f"{stood} then leaps {1e3 * leap:.0f} mm: {mend}")
        elif time[last] - time[first] > LEAST:
            left = _left(time, moved, first, blur, grip)
            if left > STILL_GOING:
                raise BadInput(
                    f"{stood} no friction stops it so suddenly (from {left:.2g} m/s or more): "
                    f"{mend}"
                )


def _check_held(
    time: np.ndarray, moved: np.ndarray, blur: float, told: Callable[[int], str], body: str
) -> None:
    """BadInput where rows come faster than places do: each place stands in several rows, and then
    changes by several rows' worth.
    """
    steps = np.flatnonzero(moved > 0)
    if len(steps) < 4:
        return
    fast = np.flatnonzero(moved > 0.5 * moved.max())
    a, b = int(fast[0]), int(fast[-1])
    between = moved[a : b + 1]
    if b - a >= 4 and np.mean(between == 0) >= HELD and between.max() > BAR + blur:
        every = round(len(between) / np.sum(between > 0))
        raise BadInput(
            f"{told(a + 1)}: places of {body} change only once in {every} rows from {time[a]:.4g} "
            f"s on, though it moves: the "
            "tracker is slower than the log; keep the rows at which they change; if all is as "
            "declared, add --as-declared"
        )


def _left(time: np.ndarray, moved: np.ndarray, first: int, blur: float, grip: float) -> float:
    """m/s that the body must still have had at row `first`, from which it stands, were it stopped
    by `grip` m/s^2.
    """
    out = 0.0
    for rows in range(1, min(4, first) + 1):
        took = float(time[first] - time[first - rows])
        went = float(np.sum(moved[first - rows : first]))
        out = max(out, (went - np.sqrt(2.0) * blur) / took - grip * took / 2.0)
    return out


def _noise(places: np.ndarray) -> float:
    """m, one standard deviation of a coordinate, by rows that change."""
    change = np.any(np.diff(places, axis=0) != 0, axis=1)
    return float(difference_noise([places[np.append(True, change)]], pooled=True)[0])


def _step(places: np.ndarray) -> float:
    """m, a third of the grid that places are rounded to; 0 where they are not."""
    d: np.ndarray = np.concatenate([np.diff(np.unique(np.round(column, 7))) for column in places.T])
    d = d[d > 1e-7]
    least = float(d.min()) if len(d) >= 5 else 0.0
    for step in least / np.arange(1.0, 5.0):  # a fast body may skip the nearest places
        if step > 1e-4 and np.all(np.abs(d / step - np.round(d / step)) < 0.05):
            return float(step) / 3.0
    return 0.0
