"""Every number by which logs are read and checked, each with its unit and reason."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TableCriteria:
    """Rows, cells and times of a table (`table_checks.py`, `table_clocks.py`)."""

    min_rows: int = 20  # of a trial: fewer tell no motion
    min_clock_time: float = (
        1e6  # s: beyond are clock times, counted from the first row to lose no digit
    )
    max_value: float = 1e5  # SI: a larger value is damage, not data
    max_interval: float = 0.25  # s from row to row: beyond it no motion is sampled at all
    min_interval: float = 2e-5  # s from row to row: below it a declared unit of time is doubted
    max_missing_share: float = (
        0.05  # of the rows that may lack a number: more is no reading lost now and then
    )
    min_incomplete_share: float = (
        0.3  # of the rows that lack something: the table is joined of topics
    )
    min_column_share: float = 0.05  # of the rows that a column of states has at least
    min_kind_share: float = 0.1  # of the rows of which one kind of row is listed
    restart_steps: float = 2.0  # steps from its first value, within which a clock starts again
    min_pause: float = 5.0  # s from row to row: what follows is a trial of its own
    max_float32_time: float = 1e4  # s: float32 holds smaller times to a millisecond
    min_repeated_share: float = 0.2  # of the steps that are none: digits are lost
    min_motion: float = 1e-3  # rad (m) of range, from which on a joint is taken to move
    max_norm_error: float = 0.05  # by which its length may be off


@dataclass(frozen=True)
class ClockCriteria:
    """Messages with stamps of their own (`clock.py`, `ros.py`)."""

    n_neighbours: int = 10  # messages on each side by which a stamp is judged
    min_stamps: int = 5  # below it no stamp is judged
    max_offset: int = 10**9  # ns by which delays of neighbours may differ: no network is slower
    min_messages: int = 5  # messages below which a joint tells no motion: it stays where it was
    max_gap_rows: float = 10.0  # rows of its own, after which a series has a gap
    min_density: float = 1.5  # times the usual rows of a stretch: two parts lie over each other
    min_set_back: float = 2.0  # usual rows that a clock steps back: less is order
    min_overlap: int = 4  # rows that lie there: fewer may be out of order
    n_first_messages: int = 20  # messages of a topic that are looked at to know its joints
    decisive_ratio: float = 0.5  # of what the other reading of a trajectory leaves, that decides
    usual_quantile: float = 0.9  # of the steps between messages: those at rest say little
    min_contradiction_steps: float = 3.0  # such steps that another sender's angles may be off
    min_leap_share: float = 0.2  # of an angle's range between two messages: no joint goes so far
    min_leaping_share: float = (
        0.02  # of the messages that do, and the next one back: no joint, nor a wrap
    )
    max_sender_share: float = 0.34  # of the messages, that another sender has at most


@dataclass(frozen=True)
class UnitCriteria:
    """Units that a log betrays (`scales.py`, `unit_guess.py`, `headings.py`)."""

    max_angle: float = 4.0 * np.pi  # rad beyond which degrees are suspected where no speeds tell
    max_speed: float = 20.0  # rad/s beyond which such angles may be degrees though speeds agree
    min_outlier_ratio: float = 15.0  # times that one trial's angles may reach as far as the others'
    max_ranges: float = 20.0  # declared ranges that a joint may move before its unit is refused
    hint_ranges: float = 3.0  # the same before a hint is given
    max_ranges_in_unit: float = (
        1.2  # declared ranges that it may move in the unit suspected instead
    )
    max_slide_length: float = (
        10.0  # m that a slide without a range may move before mm are hinted at
    )
    log_tolerance: float = 0.1  # in log: two factors of units this near are one
    ratio_tolerance: float = 0.02  # the same of ratios that are known so well
    log_ratio_tolerance: float = (
        0.05  # of a small ratio's logarithm, by which trials may differ in it
    )
    min_rows: int = 20  # with angle and speed, to compare both
    min_r2: float = 0.9  # R2 of speeds and slopes, to take their ratio for a unit's
    max_ratio: float = 1.2  # largest over smallest ratio of a log's joints
    min_degree_speed: float = (
        60.0  # a second and more: of a joint within a turn if these are degrees
    )
    min_samples: int = 20  # values that show a scale
    end_tolerance: float = 1e-4  # of 100, what single precision and text leave of it
    min_cut_rows: int = 3  # rows at exactly 1, from which on an angle is taken to be cut there
    max_degrees: float = 400.0  # whole numbers up to here may be degrees
    scale_tolerance: float = 1e-6  # share by which two scales of one unit may differ
    max_bench_angle: float = 10.0  # rad that no pendulum on a bench reaches at such speeds
    max_swing_speed_ratio: float = 15.0  # speeds over sqrt(g / l) of these
    min_other_angle: float = 5.0  # rad that its other joint reaches too, or one alone is in degrees
    gravity_tolerance: float = 0.3  # of the earth's, by which a declared g may differ unasked
    follower_tolerance: float = 0.05  # of its motion, by which a follower's readings may be off


@dataclass(frozen=True)
class SignalCriteria:
    """Of one joint of one trial (`quality/signals.py`, `quality/audit.py`)."""

    min_rows: int = 20  # rows with an angle: fewer say nothing of a joint
    min_motion: float = 0.2  # rad, or rad/s: range from which on a joint is taken to move
    max_still_range: float = 0.02  # rad, or m: range below which a trial teaches nothing
    min_gap_intervals: float = 5.0  # sampling intervals: longer ones are gaps, not jitter
    max_jitter: float = 0.05  # of an interval (std): a loop without a real-time clock has less
    min_rate: float = 45.0  # Hz: 50 Hz with its own jitter still passes
    frozen_rows: int = 5  # equal readings in a row: fewer are the encoder's steps
    frozen_sides: int = 4  # rows before and after a run, for the speed there
    frozen_steps: float = 10.0  # noises that the angle should have moved in the meantime
    min_spike_ratio: float = 30.0  # usual misses of the cubic through the neighbours
    spike_sides: float = 0.5  # of that miss, by which it sticks out from both neighbours
    spike_gap: float = 2.0  # sampling intervals: across longer ones no cubic is drawn
    max_end_share: float = 0.9  # of the rows at the ends: a relay rests there and is not cut
    cut_rows: int = 5  # rows at an end: fewer are the top of a curve
    cut_runs: int = 2  # runs at an end: a single one may be chance
    cut_share: float = 0.01  # of the rows: less changes nothing
    cut_steps: float = 20.0  # of its resolution, that the signal would have gone on
    min_gain: float = 0.5  # speed over slope: below it is another unit, sign or gear
    max_gain: float = 2.0  # the same above
    gain_error: float = 0.03  # scale of a speed that filters and windows leave
    gain_errors: float = 5.0  # standard errors of that scale
    lag_rows: float = 0.5  # sampling intervals: less is how differences are taken
    min_lag: float = 1e-3  # s: less changes no fit
    derived_miss: float = 0.005  # of the speed (std): a difference of angles misses less
    derived_corr: float = 0.999  # correlation of both: measured speeds have noise of their own
    min_command_lag_rows: float = -4.0  # sampling intervals: what comes earlier is no answer
    command_min_gain: float = 0.7  # measured over commanded torque, below which a warning says so
    command_max_gain: float = 1.4  # the same above
    max_command_lag: float = 0.02  # s: slower than current loops are
    stale_steps: float = 6.0  # resolutions over two rows: the joint surely turns
    stale_rows: int = 50  # such rows: fewer give no share
    stale_share: float = 0.05  # of these that repeat a reading: chance alone makes fewer
    value_tolerance: float = 1e-6  # of the range: nearer values are one, but for a table's digits
    min_rows_per_value: float = 4.0  # of an encoder, at least: its values are few
    slow_share: float = 0.02  # of the top speed: slower rows are not counted as turning round


@dataclass(frozen=True)
class AgreementCriteria:
    """When two records are related (`consistency.py`)."""

    span: float = 0.1  # s, over which slopes are taken: the noise of the angle averages out
    min_span: int = 8  # rows of it, where rows are few
    min_r2: float = 0.5  # R2 of speed and slope: below it they are unrelated
    min_signal_ratio: float = 6.0  # noises of the slope, that the motion must be
    trim_deviations: float = 6.0  # robust standard deviations: a wrap or a lost row is beyond
    min_command_r2: float = 0.3  # R2 of command and measured torque
    max_early_rows: int = 5  # rows by which a command may look early
    max_late_rows: int = 40  # rows by which it may be late: 40 ms at 1 kHz, 0.8 s at 50 Hz
    lattice_off: float = 0.15  # of a step: a value is on the lattice within it
    lattice_outliers: float = 0.02  # of the values, that may be off it
    lattice_same: float = 0.05  # of the steps that round to none: a finer lattice has more


@dataclass(frozen=True)
class RestCriteria:
    """Where a pendulum rests without torque (`quality/pendulum_design.py`)."""

    n_rows: int = 20  # at the beginning of a trial
    max_range: float = 0.003  # rad of range: an encoder's steps
    max_torque: float = 1e-3  # N m: what a drive that is off shows
    min_range: float = 0.02  # rad of range in the whole trial, or it is stuck
    max_tilt: float = 0.6  # rad from hanging and from upright: friction holds less


@dataclass(frozen=True)
class JitterCriteria:
    """When rows count as evenly sampled, whatever their stamps say (`consistency.py`)."""

    max_uneven_share: float = 1e-3  # of an interval: a clock this even is even
    min_share: float = 0.7  # of the stamps' unevenness, that the angles must not follow
    min_standard_errors: float = 10.0  # standard errors of that share
    min_rows: int = 10  # of a trial
    min_count: int = 50  # rows of all trials
    max_offset_rows: float = 2.0  # sampling intervals: stamps farther from even are no jitter


@dataclass(frozen=True)
class HoleCriteria:
    """Rows that are missing though stamps are even (`holes.py`)."""

    min_rows: int = 20  # of a trial
    min_residual_ratio: float = 30.0  # usual squares that a cubic over a hole leaves
    min_gain: float = 30.0  # times less that it leaves with the rows put in
    max_rows: int = 8  # rows of a hole: over longer ones no cubic holds
    min_count: int = 3  # holes of all trials: fewer may be a slip of the machine
    min_noise_share: float = 1e-9  # of an angle's range: what rounding leaves
    min_leap_ratio: float = 1.4  # times the way of a row beside it, that a joint goes over a hole
    speed_tolerance: float = 3.0  # usual misses a row, by which the speed over a hole may be off


@dataclass(frozen=True)
class BlockCriteria:
    """Averages in which motion and torque are compared (`hypotheses.py`)."""

    length: float = 0.03  # s: noise of 1 kHz encoders averages out, motion stays
    min_rows: float = 3.0  # sampling intervals of a block
    sharp_length: float = 0.01  # s of a sharp block, which is no shorter than a row
    edge: float = 0.05  # s at each end of a trial, where differences are one-sided
    max_gap_rows: float = 4.0  # sampling intervals: blocks beside longer gaps are left out
    min_count: int = 12  # rows of a trial in which nothing is missing
    max_blocks: int = 1200  # blocks that are looked at, evenly drawn: a second of work
    min_blocks: int = 60  # blocks: below, so many parameters explain anything
    slow_share: float = 0.02  # of the top speed, within which dry friction turns
    min_motion: float = 1e-3  # rad (std): of less motion nothing is said


@dataclass(frozen=True)
class ContradictionCriteria:
    """When another convention is named instead of the declared one (`contradictions.py`)."""

    min_doubted_share: float = (
        0.15  # of the torque's square, left as declared: friction alone leaves less
    )
    max_share_otherwise: float = 0.1  # the same, that another convention may leave
    min_ratio: float = 5.0  # less than the declared one leaves
    max_share_as_declared: float = 0.03  # below it the declared convention stands
    min_clear_ratio: float = (
        10.0  # times less, below `min_doubted_share`: many parameters explain much of anything
    )
    max_ratio_to_simpler: float = 0.8  # of what a simpler convention leaves, that a later one may
    max_torque_ratio: float = (
        4.0  # times the declared torques: lengths are then right, inertias are off
    )
    max_swapped_joints: int = 8  # joints, up to which every pair is tried: 28 pairs
    max_shifted_ratio: float = 0.7  # of what no shift leaves, that the best shift may
    min_shift: float = 1e-3  # s: the step of the shifts
    min_ahead_rows: float = 0.75  # rows: a torque not held between rows looks half a row late


@dataclass(frozen=True)
class CommandCriteria:
    """What recorded commands did to the motion (`commands.py`)."""

    n_smoothed_blocks: int = (
        3  # blocks over which both sides are averaged: noise of angles counts less
    )
    n_correlated_rows: float = (
        6.0  # rows that what is left stays alike over: they are not independent
    )
    min_blocks: int = 30  # below it nothing is said
    max_joints: int = 12  # up to which every command is tried on every joint
    max_trials: int = 6  # that are looked at, evenly drawn
    min_exchange_ratio: float = (
        4.0  # times less that exchanged joints leave under the other's command
    )
    max_believed_share: float = 0.3  # of the acceleration, that a command may leave
    max_limit_trials: int = 4  # in which a cut is looked for: each size is tried on all of them
    limit_row_time: float = 5e-3  # s: a limit is followed row by row, and acts over many
    coarse_ratio: float = 2.0  # times `max_limited_ratio`, that a coarse look may leave
    min_doubted_share: float = 0.03  # of the acceleration, from which on a command is doubted
    max_limited_ratio: float = 0.3  # of that share, which a command cut on its way may leave
    # of the acceleration, that a cut command leaves at most: servos of another law than the file's
    # look as if they were cut, and leave more
    max_limited_share: float = 0.05
    max_force_limit_ratio: float = 0.7  # of what a limit of force leaves: both look alike
    min_squared_correlation: float = (
        0.7  # squared correlation of angle and target, to compare their sizes
    )
    log_unit_tolerance: float = (
        0.4  # in log: sizes of a unit's factor, 57 or 1000, are much farther apart
    )
    min_gain_ratio: float = 1.2  # of two trials' gains: less is how friction changes
    min_gain_errors: float = 8.0  # standard errors of their difference
    max_gain_error: float = 0.1  # of a gain (standard error): a wider one says nothing
    min_trials: int = 3  # to have a middle one
    min_next_row_share: float = (
        0.95  # of the rows that move, in which a target is the next row's angle
    )
    rounding: float = 1e-7  # of the largest angle: digits that a converted set may have lost


@dataclass(frozen=True)
class TrialCriteria:
    """Whether trials are of one machine (`trials_differ.py`, `trial_words.py`).

    The `min_share_...` are shares of the unexplained torque's square, in pieces that were not
    fitted to.
    """

    min_share_zero: float = 0.5  # of a difference of angles' zeros
    min_share_scale: float = 0.75  # of torques: drives that saturate or play differ by themselves
    min_share_offset: float = 0.5  # of a constant torque
    min_share_load: float = 0.85  # of all inertias: so many numbers explain much of anything
    min_share_outlier: float = 0.8  # of one outlier trial's error, to be named as its reason
    max_ratio_to_other_kind: float = (
        0.8  # of what another kind leaves: a later kind must leave less
    )
    min_deviations: float = 4.0  # robust standard deviations of an outlier trial's error
    min_error_ratio: float = 3.0  # that its error is above the others'
    min_error_share: float = 0.02  # of its torque's square: less is no fault
    min_outlying_ratio: float = 0.3  # of the largest size, from which on a trial stands out
    min_load: float = -0.5  # of the torque: what takes more off the mechanism is no load
    min_trials: int = 3  # to have a middle one
    min_windows: int = 12  # of a trial, from which on it is judged
    min_noise_ratio: float = 3.0  # that must be left on left-out trials, for a difference to matter
    min_unusual_ratio: float = 2.0  # middle errors in the final model, of an outlier trial
    min_spoiling_ratio: float = (
        30.0  # middle errors of a trial, and noises of all, that spoil a fit
    )
    min_shown_ratio: float = 0.1  # of the widest spread, from which on a joint is listed


@dataclass(frozen=True)
class TurnCriteria:
    """Whole turns that an encoder leaves out (`turns.py`)."""

    turn_tolerance: float = 1.0  # rad by which a jump between rows may miss a whole turn
    gap_tolerance_share: float = (
        0.35  # of the period, across a gap: the motion within it is only guessed
    )
    max_gap: float = 0.25  # s of a gap across which speeds on both sides foretell the motion
    min_gap_rows: float = 2.5  # sampling intervals, from which on two rows are no neighbours
    min_jump_share: float = (
        0.25  # of the period: an encoder that wraps jumps by it, or hardly moves
    )
    half: float = 0.5  # of the period: a larger step may be a turn the other way
    slack: float = 0.01  # of the period, by which its ends may be passed
    min_gain: float = 0.25  # of a target's squared distance from the angle, that turns must leave
    max_turns: float = 1.1  # turns: what counts anew stays within one
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
    min_even_share: float = 0.9  # of the readings, that stand in as many rows, or in one more
    min_steps: float = 4.0  # an encoder's steps that a new reading is off: less is a slow motion


@dataclass(frozen=True)
class WordCriteria:
    """Words of registers (`words.py`)."""

    min_leap: float = 512.0  # that readings leap by: a joint goes so far between no two rows
    max_leap_ratio: float = 0.25  # of the largest leap, that words taken otherwise may leave
    max_usual_steps: float = (
        5.0  # usual steps, farther than which no reading lies from both beside it
    )


@dataclass(frozen=True)
class UnbrokenCriteria:
    """Rows that follow each other (`stretch_rows.py`)."""

    min_gap_rows: float = 5.0  # usual rows, and
    min_gap: float = 0.05  # s: a longer step is a gap, over which nothing is simulated
    min_read_share: float = 0.5  # of a stretch's angles, that must have been read


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
