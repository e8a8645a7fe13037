"""What the rows of measured trials say of their clock, and of trackers that froze."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.noise import difference_noise


@dataclass(frozen=True)
class TrialClockCriteria:
    """What decides whether the clock of tracks is refused.

    Args:
        moved: m from its first place at which a body counts as moving: above any noise, and
            early.
        window: Share of the time until then over which its greatest speed is taken. Of any clock
            it is the same part of the motion.
        never: s that stand for an arm that never reaches its body.
        slow: Times by which a clock must be slow or fast to be refused. What is less is an effect
            that is named.
        agree: Times that time and speed may disagree: a soft body leaves slowly, a hard one fast.
        on_time: Natural logarithm by which a beginning is sure, as `agree` is for a speed.
    """

    moved: float = 0.01
    window: float = 0.17
    never: float = 100.0
    slow: float = 1.4
    agree: float = 1.5
    on_time: float = 0.1


CLOCK = TrialClockCriteria()


ARMS = np.geomspace(0.1, 10.0, 41)
"""Times the commanded speed at which an arm may run instead."""


@dataclass(frozen=True)
class Touch:
    """What commands say if arms run `f` times as fast as commanded, `[T]`: `reached(f)` s at which
    bodies have moved by `CLOCK.moved`, and `speed(f)` m/s that they then have, as usual.
    """

    reached: Callable[[float], np.ndarray]
    speed: Callable[[float], np.ndarray]


def began(time: np.ndarray, places: np.ndarray) -> tuple[float, float]:
    """When a body has moved by `CLOCK.moved`, s, and its greatest speed from then on, m/s.

    Places `[R, 2]` m are of `time [R]` s. NaN where it never does, or moves as it is first seen.
    """
    distant = np.linalg.norm(places - places[0], axis=1)
    k = int(np.argmax(distant > CLOCK.moved))
    if k < 1 or len(time) < 8 or distant[2] > CLOCK.moved / 2:
        return float("nan"), float("nan")
    at = float(np.interp(CLOCK.moved, [distant[k - 1], distant[k]], [time[k - 1], time[k]]))
    # a few rows at least, so that noise is no speed
    step = max(3, round(CLOCK.window * at / float(np.median(np.diff(time)))))
    a = np.arange(k - 1, len(time) - step)
    if not len(a):
        return at, float("nan")
    b = a + step
    speed = np.linalg.norm(places[b] - places[a], axis=1) / (time[b] - time[a])
    return at, float(np.max(speed))


def clock_rate(observed: Sequence[tuple[float, float]], touch: Touch) -> float | None:
    """How many times too slow the clock is (below 1: too fast) by what `began` says of each trial
    `[T]`; None where it need not be.
    """
    at, speed = np.asarray(observed, float).T
    known = np.isfinite(at) & np.isfinite(speed) & (at > 0) & (speed > 0)
    if 2 * known.sum() < len(known) or not known.any():
        return None

    def off(f: float) -> tuple[float, float]:
        late, slow = np.log(at / touch.reached(f)), np.log(touch.speed(f) / speed)
        return float(np.median(late[known])), float(np.median(slow[known]))

    by_time, by_speed = off(1.0)
    minimum, most = sorted((by_time, by_speed))
    slow, agree = np.log(CLOCK.slow), np.log(CLOCK.agree)
    if not (minimum > slow or most < -slow) or most - minimum > agree:
        return None

    def cost(late, slow):
        return (late / CLOCK.on_time) ** 2 + (slow / np.log(CLOCK.agree)) ** 2

    clock = min(cost(by_time - r, by_speed - r) for r in np.linspace(minimum, most, 9))
    arm = min(cost(*off(float(f))) for f in ARMS)
    if clock < arm:
        return float(np.exp(by_time))
    return None


def check_clock_rate(
    observed: Sequence[tuple[float, float]], touch: Touch, where: str, body: str
) -> None:
    """BadInput, naming `where`, where the clock of the trials runs several times too slow or too
    fast.
    """
    rate = clock_rate(observed, touch)
    if rate is None:
        return
    at, speed = np.nanmedian(np.asarray(observed, float), axis=0)
    due, usual = float(np.median(touch.reached(1.0))), float(np.median(touch.speed(1.0)))
    if rate > 1:
        times, slow, mend = (rate, "slow", "divide")
    else:
        times, slow, mend = (1 / rate, "fast", "multiply")
    raise BadInput(
        f"{where}: {body} begins to move at {at:.2g} s and goes {speed:.2g} m/s, where the arm as "
        f"commanded reaches it at {due:.2g} s and gives it {usual:.2g} m/s: time looks about "
        f"{times:.2g} times too {slow} (frames counted at another rate than the camera's?); {mend} "
        f"column time by {times:.2g}; if all is as declared, add --as-declared"
    )


@dataclass(frozen=True)
class FrozenCriteria:
    """What decides whether a tracker froze.

    Args:
        goes_on: m that a body must go on for its standing still to be doubted.
        sure: Standard deviations of a difference of two rows that count as noise.
        ending: s at a track's end that are refused: one row that repeats the last does no harm.
        grip: m/s^2 with which friction stops a body at most: a coefficient of 1.2.
        still_going: m/s that a body must have left at the first repeated row, whatever stops it.
        held: Share of a moving body's rows that repeat the one before, from which on the tracker
            is slower than the log.
    """

    goes_on: float = 0.005
    sure: float = 3.0
    ending: float = 0.05
    grip: float = 12.0
    still_going: float = 0.05
    held: float = 0.4


FROZEN = FrozenCriteria()


def repeats(places: np.ndarray) -> list[tuple[int, int]]:
    """First and last row of each run of rows of `places [R, C]` that are the same to the digit, two
    rows or more.
    """
    same = np.concatenate([[False], np.all(np.diff(places, axis=0) == 0, axis=1), [False]])
    edges = np.flatnonzero(np.diff(same.astype(int)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def check_frozen(
    time: np.ndarray,
    places: np.ndarray,
    trials: Callable[[int], str],
    body: str,
    grip: float = FROZEN.grip,
) -> None:
    """BadInput where a track `places [R, C]` m at `time [R]` s holds its value while the body must
    move. told: Names a row. body: As messages call it; grip: m/s^2 that may stop it.
    """
    runs = repeats(places)
    if not runs:
        return
    moved = np.linalg.norm(np.diff(places, axis=0), axis=1)
    blur = FROZEN.sure * max(_noise(places), _step(places))
    _check_held(time, moved, blur, trials, body)
    for first, last in runs:
        mend = (
            "a tracker that lost it repeats its last value: leave x and y empty in these rows, or "
            "remove them; if all is as declared, add --as-declared"
        )
        stood = (
            f"{trials(first + 1)}: {body} stands still to the digit from {time[first]:.4g} to "
            f"{time[last]:.4g} s and"
        )
        if last + 1 < len(time):
            leap, then = moved[last], moved[last + 1 : last + 3]
            if len(then) and leap > 2.0 * then.max() + FROZEN.goes_on + blur:
                raise BadInput(f"{stood} then leaps {1e3 * leap:.0f} mm: {mend}")
        elif time[last] - time[first] > FROZEN.ending:
            left = _left(time, moved, first, blur, grip)
            if left > FROZEN.still_going:
                raise BadInput(
                    f"{stood} no friction stops it so suddenly (from {left:.2g} m/s or more): "
                    f"{mend}"
                )


def _check_held(
    time: np.ndarray, moved: np.ndarray, blur: float, trials: Callable[[int], str], body: str
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
    if (
        b - a >= 4
        and np.mean(between == 0) >= FROZEN.held
        and between.max() > FROZEN.goes_on + blur
    ):
        every = round(len(between) / np.sum(between > 0))
        raise BadInput(
            f"{trials(a + 1)}: places of {body} change only once in {every} rows from "
            f"{time[a]:.4g} s on, though it moves: the tracker is slower than the log; keep the "
            "rows at which they change; if all is as declared, add --as-declared"
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
    minimum = float(d.min()) if len(d) >= 5 else 0.0
    for step in minimum / np.arange(1.0, 5.0):  # a fast body may skip the nearest places
        if step > 1e-4 and np.all(np.abs(d / step - np.round(d / step)) < 0.05):
            return float(step) / 3.0
    return 0.0
