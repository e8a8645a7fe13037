"""Every number by which readers of logs decide, each with its unit and reason."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TableCriteria:
    """Rows, cells and times of a table (`table_checks.py`, `table_clocks.py`)."""

    min_rows: int = 20  # of a trial: fewer tell no motion
    epoch: float = 1e6  # s: beyond are clock times, counted from the first row to lose no digit
    limit: float = 1e5  # SI: a larger value is damage, not data
    slowest: float = 0.25  # s from row to row: beyond it no motion is sampled at all
    fastest: float = 2e-5  # s from row to row: below it a declared unit of time is doubted
    joined: float = 0.3  # of the rows that lack something: the table is joined of topics
    seldom: float = 0.05  # of the rows that a column of states has at least
    kind: float = 0.1  # of the rows of which one kind of row is listed
    restart: float = 2.0  # steps from its first value, within which a clock starts again
    single: float = 1e4  # s: float32 holds smaller times to a millisecond
    repeated: float = 0.2  # of the steps that are none: digits are lost
    moving: float = 1e-3  # rad (m) of range, from which on a joint is taken to move
    unit_quaternion: float = 0.05  # by which its length may be off


@dataclass(frozen=True)
class ClockCriteria:
    """Messages with stamps of their own (`clock.py`, `ros.py`)."""

    window: int = 10  # messages on each side by which a stamp is judged
    min_stamps: int = 5  # below it no stamp is judged
    max_offset: int = 10**9  # ns by which delays of neighbours may differ: no network is slower
    rare: int = 5  # messages below which a joint tells no motion: it stays where it was
    gap: float = 10.0  # rows of its own, after which a series has a gap
    dense: float = 1.5  # times the usual rows of a stretch: two parts lie over each other
    set_back: float = 2.0  # usual rows that a clock steps back: less is order
    min_overlap: int = 4  # rows that lie there: fewer may be out of order
    first: int = 20  # messages of a topic that are looked at to know its joints
    better: float = 0.5  # of what the other reading of a trajectory leaves, that decides


@dataclass(frozen=True)
class UnitCriteria:
    """Units that a log betrays (`log_checks.py`, `unit_guess.py`, `scales.py`, `headings.py`)."""

    large: float = 4.0 * np.pi  # rad beyond which degrees are suspected where no speeds tell
    fast: float = 20.0  # rad/s beyond which such angles may be degrees though speeds agree
    outlier: float = 15.0  # times that one trial's angles may reach as far as the others'
    distant: float = 20.0  # declared ranges that a joint may move before its unit is refused
    hint: float = 3.0  # the same before a hint is given
    inside: float = 1.2  # declared ranges that it may move in the unit suspected instead
    long: float = 10.0  # m that a slide without a range may move before mm are hinted at
    alike: float = 0.1  # in log: two factors of units this near are one
    min_rows: int = 20  # with angle and speed, to compare both
    related: float = 0.9  # R2 of speeds and slopes, to take their ratio for a unit's
    agree: float = 1.2  # largest over smallest ratio of a log's joints
    swift: float = 60.0  # a second and more: of a joint within a turn if these are degrees
    min_samples: int = 20  # values that show a scale
    end: float = 1e-4  # of 100, what single precision and text leave of it
    cut: int = 3  # rows at exactly 1, from which on an angle is taken to be cut there
    degrees: float = 400.0  # whole numbers up to here may be degrees
    close: float = 1e-6  # share by which two scales of one unit may differ
    wide: float = 10.0  # rad that no pendulum on a bench reaches at such speeds
    swinging: float = 15.0  # speeds over sqrt(g / l) of these
    both: float = 5.0  # rad that its other joint reaches too, or one alone is in degrees
    follower: float = 0.05  # of its motion, by which a follower's readings may be off


@dataclass(frozen=True)
class SmootherCriteria:
    """The prior of a motion between its rows (`smoother.py`)."""

    window: int = 300  # samples: enough to tell noise, few enough for motion of one kind
    coarse: float = 0.0  # log signal over noise of a step, above which white snap is tried too
    rough: float = 2.5  # the same, above which white jerk is too rough and white snap is used
    different: float = 1.4  # ratio of both estimates: the motion between samples hides the noise
    speeds_off: float = 1.3  # of the angles' squared misfit, above which speeds are dropped


TABLE = TableCriteria()
CLOCK = ClockCriteria()
UNIT = UnitCriteria()
SMOOTHER = SmootherCriteria()
