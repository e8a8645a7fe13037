"""Every number by which logs are read and checked, each with its unit and reason."""

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
    few: float = 0.05  # of the rows that may lack a number: more is no reading lost now and then
    joined: float = 0.3  # of the rows that lack something: the table is joined of topics
    seldom: float = 0.05  # of the rows that a column of states has at least
    kind: float = 0.1  # of the rows of which one kind of row is listed
    restart: float = 2.0  # steps from its first value, within which a clock starts again
    pause: float = 5.0  # s from row to row: what follows is a trial of its own
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
    usual_steps: float = 0.9  # of the steps between messages: those at rest say little
    contradicts: float = 3.0  # such steps that another sender's angles may be off
    leap: float = 0.2  # of an angle's range between two messages: no joint goes so far
    leaps: float = 0.02  # of the messages that do, and the next one back: no joint, nor a wrap
    fewer: float = 0.34  # of the messages, that another sender has at most


@dataclass(frozen=True)
class UnitCriteria:
    """Units that a log betrays (`scales.py`, `unit_guess.py`, `headings.py`)."""

    large: float = 4.0 * np.pi  # rad beyond which degrees are suspected where no speeds tell
    fast: float = 20.0  # rad/s beyond which such angles may be degrees though speeds agree
    outlier: float = 15.0  # times that one trial's angles may reach as far as the others'
    distant: float = 20.0  # declared ranges that a joint may move before its unit is refused
    hint: float = 3.0  # the same before a hint is given
    inside: float = 1.2  # declared ranges that it may move in the unit suspected instead
    long: float = 10.0  # m that a slide without a range may move before mm are hinted at
    alike: float = 0.1  # in log: two factors of units this near are one
    same: float = 0.02  # the same of ratios that are known so well
    shared: float = 0.05  # of a small ratio's logarithm, by which trials may differ in it
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
    gravity: float = 0.3  # of the earth's, by which a declared g may differ unasked
    follower: float = 0.05  # of its motion, by which a follower's readings may be off


@dataclass(frozen=True)
class SignalCriteria:
    """Of one joint of one trial (`quality/signals.py`, `quality/audit.py`)."""

    min_rows: int = 20  # rows with an angle: fewer say nothing of a joint
    moving: float = 0.2  # rad, or rad/s: range from which on a joint is taken to move
    still: float = 0.02  # rad, or m: range below which a trial teaches nothing
    gap: float = 5.0  # sampling intervals: longer ones are gaps, not jitter
    jitter: float = 0.05  # of an interval (std): a loop without a real-time clock has less
    min_rate: float = 45.0  # Hz: 50 Hz with its own jitter still passes
    frozen_rows: int = 5  # equal readings in a row: fewer are the encoder's steps
    frozen_sides: int = 4  # rows before and after a run, for the speed there
    frozen_steps: float = 10.0  # noises that the angle should have moved in the meantime
    spike: float = 30.0  # usual misses of the cubic through the neighbours
    spike_sides: float = 0.5  # of that miss, by which it sticks out from both neighbours
    spike_gap: float = 2.0  # sampling intervals: across longer ones no cubic is drawn
    two_valued: float = 0.9  # of the rows at the ends: a relay rests there and is not cut
    cut_rows: int = 5  # rows at an end: fewer are the top of a curve
    cut_runs: int = 2  # runs at an end: a single one may be chance
    cut_share: float = 0.01  # of the rows: less changes nothing
    cut_steps: float = 20.0  # of its resolution, that the signal would have gone on
    min_gain: float = 0.5  # speed over slope: below it is another unit, sign or gear
    max_gain: float = 2.0  # the same above
    gain_error: float = 0.03  # scale of a speed that filters and windows leave
    gain_errors: float = 5.0  # standard errors of that scale
    lag_rows: float = 0.5  # sampling intervals: less is how differences are taken
    lag: float = 1e-3  # s: less changes no fit
    derived_miss: float = 0.005  # of the speed (std): a difference of angles misses less
    derived_corr: float = 0.999  # correlation of both: measured speeds have noise of their own
    command_early: float = -4.0  # sampling intervals: what comes earlier is no answer
    command_min_gain: float = 0.7  # measured over commanded torque, below which a warning says so
    command_max_gain: float = 1.4  # the same above
    command_lag: float = 0.02  # s: slower than current loops are
    stale_steps: float = 6.0  # resolutions over two rows: the joint surely turns
    stale_rows: int = 50  # such rows: fewer give no share
    stale_share: float = 0.05  # of these that repeat a reading: chance alone makes fewer
    written: float = 1e-6  # of the range: nearer values are one, but for a table's digits
    rows_a_value: float = 4.0  # of an encoder, at least: its values are few
    slow: float = 0.02  # of the top speed: slower rows are not counted as turning round


@dataclass(frozen=True)
class AgreementCriteria:
    """When two records are related (`consistency.py`)."""

    span: float = 0.1  # s, over which slopes are taken: the noise of the angle averages out
    min_span: int = 8  # rows of it, where rows are few
    related: float = 0.5  # R2 of speed and slope: below it they are unrelated
    loud: float = 6.0  # noises of the slope, that the motion must be
    trimmed: float = 6.0  # robust standard deviations: a wrap or a lost row is beyond
    command_related: float = 0.3  # R2 of command and measured torque
    early_rows: int = 5  # rows by which a command may look early
    late_rows: int = 40  # rows by which it may be late: 40 ms at 1 kHz, 0.8 s at 50 Hz
    lattice_off: float = 0.15  # of a step: a value is on the lattice within it
    lattice_outliers: float = 0.02  # of the values, that may be off it
    lattice_same: float = 0.05  # of the steps that round to none: a finer lattice has more


@dataclass(frozen=True)
class RestCriteria:
    """Where a pendulum rests without torque (`quality/pendulum_design.py`)."""

    rows: int = 20  # at the beginning of a trial
    still: float = 0.003  # rad of range: an encoder's steps
    torque: float = 1e-3  # N m: what a drive that is off shows
    moves: float = 0.02  # rad of range in the whole trial, or it is stuck
    tilt: float = 0.6  # rad from hanging and from upright: friction holds less


@dataclass(frozen=True)
class JitterCriteria:
    """When rows count as evenly sampled, whatever their stamps say (`consistency.py`)."""

    even: float = 1e-3  # of an interval: a clock this even is even
    share: float = 0.7  # of the stamps' unevenness, that the angles must not follow
    errors: float = 10.0  # standard errors of that share
    min_rows: int = 10  # of a trial
    min_count: int = 50  # rows of all trials
    off: float = 2.0  # sampling intervals: stamps farther from even are no jitter


@dataclass(frozen=True)
class HoleCriteria:
    """Rows that are missing though stamps are even (`holes.py`)."""

    min_rows: int = 20  # of a trial
    doubted: float = 30.0  # usual squares that a cubic over a hole leaves
    clear: float = 30.0  # times less that it leaves with the rows put in
    longest: int = 8  # rows of a hole: over longer ones no cubic holds
    min_count: int = 3  # holes of all trials: fewer may be a slip of the machine
    least: float = 1e-9  # of an angle's range: what rounding leaves
    leap: float = 1.4  # times the way of a row beside it, that a joint goes over a hole
    slow: float = 3.0  # usual misses a row, by which the speed over a hole may be off


@dataclass(frozen=True)
class BlockCriteria:
    """Averages in which motion and torque are compared (`hypotheses.py`)."""

    mean: float = 0.03  # s: noise of 1 kHz encoders averages out, motion stays
    min_rows: float = 3.0  # sampling intervals of a block
    sharp: float = 0.01  # s of a sharp block, which is no shorter than a row
    edge: float = 0.05  # s at each end of a trial, where differences are one-sided
    gap: float = 4.0  # sampling intervals: blocks beside longer gaps are left out
    min_count: int = 12  # rows of a trial in which nothing is missing
    most: int = 1200  # blocks that are looked at, evenly drawn: a second of work
    enough: int = 60  # blocks: below, so many parameters explain anything
    slow: float = 0.02  # of the top speed, within which dry friction turns
    moving: float = 1e-3  # rad (std): of less motion nothing is said


@dataclass(frozen=True)
class ContradictionCriteria:
    """When another convention is named instead of the declared one (`contradictions.py`)."""

    doubted: float = 0.15  # of the torque's square, left as declared: friction alone leaves less
    explains: float = 0.1  # the same, that another convention may leave
    times: float = 5.0  # less than the declared one leaves
    hardly: float = 0.03  # below it the declared convention stands
    clearly: float = 10.0  # times less, below `doubted`: many parameters explain much of anything
    simpler: float = 0.8  # of what a simpler convention leaves, that a later one may
    same_size: float = 4.0  # times the declared torques: lengths are then right, inertias are off
    most_swapped: int = 8  # joints, up to which every pair is tried: 28 pairs
    late_left: float = 0.7  # of what no shift leaves, that the best shift may
    min_shift: float = 1e-3  # s: the step of the shifts
    ahead_rows: float = 0.75  # rows: a torque not held between rows looks half a row late


@dataclass(frozen=True)
class CommandCriteria:
    """What recorded commands did to the motion (`commands.py`)."""

    smooth: int = 3  # blocks over which both sides are averaged: noise of angles counts less
    alike: float = 6.0  # rows that what is left stays alike over: they are not independent
    min_blocks: int = 30  # below it nothing is said
    most_joints: int = 12  # up to which every command is tried on every joint
    trials: int = 6  # that are looked at, evenly drawn
    exchanged: float = 4.0  # times less that exchanged joints leave under the other's command
    believed: float = 0.3  # of the acceleration, that a command may leave
    cut_trials: int = 4  # in which a cut is looked for: each size is tried on all of them
    cut_row: float = 5e-3  # s: a limit is followed row by row, and acts over many
    cut_coarse: float = 2.0  # times `cut`, that a coarse look may leave
    doubted: float = 0.03  # of the acceleration, from which on a command is doubted
    cut: float = 0.3  # of that share, which a command cut on its way may leave
    # of the acceleration, that a cut command leaves at most: servos of another law than the file's
    # look as if they were cut, and leave more
    cut_left: float = 0.05
    cut_distinct: float = 0.7  # of what a limit of force leaves: both look alike
    follows: float = 0.7  # squared correlation of angle and target, to compare their sizes
    unit: float = 0.4  # in log: sizes of a unit's factor, 57 or 1000, are much farther apart
    gain_ratio: float = 1.2  # of two trials' gains: less is how friction changes
    gain_errors: float = 8.0  # standard errors of their difference
    gain_error: float = 0.1  # of a gain (standard error): a wider one says nothing
    min_trials: int = 3  # to have a middle one
    next_rows: float = 0.95  # of the rows that move, in which a target is the next row's angle
    rounding: float = 1e-7  # of the largest angle: digits that a converted set may have lost


@dataclass(frozen=True)
class TrialCriteria:
    """Whether trials are of one machine (`trials_differ.py`, `trial_words.py`).

    The `takes_` are shares of the unexplained torque's square, in pieces that were not fitted to.
    """

    takes_zero: float = 0.5  # of a difference of angles' zeros
    takes_scale: float = 0.75  # of torques: drives that saturate or play differ by themselves
    takes_offset: float = 0.5  # of a constant torque
    takes_load: float = 0.85  # of all inertias: so many numbers explain much of anything
    takes_outlier: float = 0.8  # of one outlier trial's error, to be named as its reason
    alike: float = 0.8  # of what another kind leaves: a later kind must leave less
    deviations: float = 4.0  # robust standard deviations of an outlier trial's error
    times: float = 3.0  # that its error is above the others'
    error: float = 0.02  # of its torque's square: less is no fault
    outlying: float = 0.3  # of the largest size, from which on a trial stands out
    lightest: float = -0.5  # of the torque: what takes more off the mechanism is no load
    min_trials: int = 3  # to have a middle one
    min_windows: int = 12  # of a trial, from which on it is judged
    noises: float = 3.0  # that must be left on left-out trials, for a difference to matter
    unusual: float = 2.0  # middle errors in the final model, of an outlier trial
    spoils: float = 30.0  # middle errors of a trial, and noises of all, that spoil a fit
    shown: float = 0.1  # of the widest spread, from which on a joint is listed


@dataclass(frozen=True)
class TurnCriteria:
    """Whole turns that an encoder leaves out (`turns.py`)."""

    near: float = 1.0  # rad by which a jump between rows may miss a whole turn
    share: float = 0.35  # of the period, across a gap: the motion within it is only guessed
    longest: float = 0.25  # s of a gap across which speeds on both sides foretell the motion
    gap: float = 2.5  # sampling intervals, from which on two rows are no neighbours
    jump: float = 0.25  # of the period: an encoder that wraps jumps by it, or hardly moves
    half: float = 0.5  # of the period: a larger step may be a turn the other way
    slack: float = 0.01  # of the period, by which its ends may be passed
    gain: float = 0.25  # of a target's squared distance from the angle, that turns must leave
    turn: float = 1.1  # turns: what counts anew stays within one
    other_span: float = 0.5  # rad: a smaller range shows no period
    other_jump: float = 0.8  # of the range, that a jump of another period is
    other_rare: float = 0.1  # of the steps, that may be such jumps
    other_rest: float = 0.3  # of the range, that all other steps stay within
    other_same: float = 0.05  # of a turn: a range this near to one is a turn
    other_alike: float = 0.2  # of the range, by which jumps may differ


@dataclass(frozen=True)
class RepeatCriteria:
    """Readings that stand in several rows each (`repeats.py`)."""

    min_readings: int = 20  # that are new: fewer say nothing
    even: float = 0.9  # of the readings, that stand in as many rows, or in one more
    steps: float = 4.0  # an encoder's steps that a new reading is off: less is a slow motion


@dataclass(frozen=True)
class WordCriteria:
    """Words of registers (`words.py`)."""

    leap: float = 512.0  # that readings leap by: a joint goes so far between no two rows
    left: float = 0.25  # of the largest leap, that words taken otherwise may leave
    far: float = 5.0  # usual steps, farther than which no reading lies from both beside it


@dataclass(frozen=True)
class UnbrokenCriteria:
    """Rows that follow each other (`stretch_rows.py`)."""

    gap_rows: float = 5.0  # usual rows, and
    gap: float = 0.05  # s: a longer step is a gap, over which nothing is simulated
    observed: float = 0.5  # of a stretch's angles, that must have been read


TABLE = TableCriteria()
CLOCK = ClockCriteria()
UNIT = UnitCriteria()
SIGNAL = SignalCriteria()
AGREEMENT = AgreementCriteria()
REST = RestCriteria()
JITTER = JitterCriteria()
HOLE = HoleCriteria()
BLOCK = BlockCriteria()
CONTRADICTION = ContradictionCriteria()
COMMAND = CommandCriteria()
TRIAL = TrialCriteria()
WRAP = TurnCriteria()
WORD = WordCriteria()
REPEAT = RepeatCriteria()
UNBROKEN = UnbrokenCriteria()
