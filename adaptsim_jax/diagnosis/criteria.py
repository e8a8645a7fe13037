"""Every number that can change what is named, in one place."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TorqueCriteria:
    """Of the search along the measured motion (`attribution/equation`).

    tried: candidates of a round that are judged.
    gain: share of a joint's squared missing torque that each number of an effect must take off
        where it was left out.
    level: of the paired test over blocks.
    steady: amplitudes over their standard errors, root mean square.
    slowest: of a joint's usual speed: what sets in below is not told from what holds a joint still.
    worth: of a joint's torque, root mean square: an effect of less is not worth a name, and as much
        may be left of what is explained.
    discovery: share of false ones among what like drives have (Benjamini and Hochberg, 1995).
    paired: of the log's sampling interval. Measured torques of all joints that are late or early by
        less are how a logger pairs them with angles (of the cycle before, filtered), not an effect.
    simulated: joints up to which the search goes on by simulation where what the torque shows
        simulates to more than the noise (of more it takes minutes); of both results the one with
        more skill by both yardsticks together is taken.
    """

    tried: int = 6
    gain: float = 0.02
    level: float = 0.01
    steady: float = 1.0
    slowest: float = 0.15
    worth: float = 0.03
    discovery: float = 0.05
    paired: float = 1.5
    simulated: int = 2


@dataclass(frozen=True)
class Criteria:
    """Each with its unit and reason (`docs/attribution.md`).

    alpha: family-wise level of the score test over all candidates, which lets one be tried.
    confidence: level of the paired test over left-out blocks by which each effect stays (short
        trials, such as pushes: Holm over those that are in the model).
    size: least share of the held-out loss that an effect must take off beside all others; below it
        nothing is worth naming. Of mechanisms also what each parameter that a model has more must
        take off.
    worth: least share of the squared error of some joint's angles (at least of the noise floor's
        square) that an effect must take off.
    noise_share: of the error that the declared model leaves at a joint, the share below which what
        is left counts as noise for `worth`.
    described: the same of an effect that is no law but describes one (a torque that depends on the
        angle in any way).
    gap: share of the loss by which an alternative may be worse and still be told as doing as well;
        of mechanisms one with fewer parameters then has the name.
    alike: share of what an effect gains (in logarithms) by which an alternative may be worse all
        the same.
    steady: an effect's size over its scatter between folds, of mechanisms with all else held.
    bound: share of the end of a value's range within which it lies at it. An effect there is not
        named: it wants what no machine has.
    min_shift: of the log's sampling interval. A shift in time below it is how rows are read, not
        an effect.
    within_row: of the log's sampling interval. Commands that act this much early at most, at all
        joints, changed between two rows (of a controller faster than its log): read so, not an
        effect.
    min_change: share of a value that the model file declares (armature, dry friction) below which
        it is not worth correcting.
    most_effects: at which the search ends.
    tried, rounds: candidates that are fitted each time, and for how many rounds at most.
    glance: rounds by which candidates are sorted (of mechanisms twice as many, and on while they
        gain). The best is fitted whole.
    behind: share of the loss by which a candidate may be worse at a glance than the best one and
        still be fitted.
    matters: of the size that matters of a quantity (its scale). An effect that changes all of its
        quantities by less is no name.
    worse_share: share of the held-out loss by which a model that is only compared must be worse for
        its fit to end early.
    explained: held-out error over the noise floor up to which nothing is left to explain.
    lacks_nothing: what a model of short trials leaves over the noise, below which it lacks nothing;
        0: always goes on.
    beyond: where a fit of short trials leaves more than `lacks_nothing`, the share that an effect
        must take off of the squared error beyond the noise (0.9: it is three times what is left).
        What is smaller may name a part of that. 0: no such rule.
    near: the same, up to which simulated stretches tell all that there is.
    outlying: as `explained`, of one joint in one trial: beyond it something is left, whatever the
        others say.
    beginning: share of the stretches over which is fitted, and searched again where nothing
        was named, if more than `outlying` is left.
    few: stretches beyond `outlying` from which on they are looked at by themselves, where all
        else is explained.
    torque: of the search along the measured motion.
    left: of the error of these, at most, that an effect which acts now and then may leave.
    """

    alpha: float = 0.01
    confidence: float = 0.05
    size: float = 0.01
    worth: float = 0.1
    noise_share: float = 0.02
    described: float = 0.5
    gap: float = 0.02
    alike: float = 0.1
    steady: float = 3.0
    bound: float = 0.05
    min_shift: float = 0.25
    within_row: float = 0.6
    min_change: float = 0.1
    most_effects: int = 8
    tried: int = 4
    rounds: int = 12
    glance: int = 2
    behind: float = np.inf
    matters: float = 0.0
    worse_share: float = 0.3
    explained: float = 1.5
    lacks_nothing: float = 0.0
    beyond: float = 0.0
    near: float = 3.0
    outlying: float = 10.0
    beginning: float = 0.15
    few: int = 3
    left: float = 1 / 3
    torque: TorqueCriteria = TorqueCriteria()


@dataclass(frozen=True)
class FoldCriteria:
    """Parts of a log that are left out in turn (`folds.py`, `simulator.py`)."""

    # from which on each trial is a fold: of fewer, none could show what it lacks
    min_trials: int = 5
    pieces: int = 8  # folds, about, of fewer trials
    apart: int = 3  # trials, or parts of fewer, that a name must predict without them
    test_pieces: int = 24  # blocks, about, of a test of stretches of fewer trials
    # s, of a block of windows, which overlap: much longer than what neighbours share
    span: float = 0.5
    min_blocks: int = 16  # blocks of windows: enough for a level of 0.01
    max_blocks: int = 60  # blocks of windows: more distinguish no better
    min_windows: int = 2  # windows of a piece, where a trial has them
    min_stretches: int = 3  # stretches: of fewer none can be left out


@dataclass(frozen=True)
class PairedTestCriteria:
    """Tests of what left-out parts gain, and of residuals (`testing.py`)."""

    all_signs: int = 14  # parts up to which the sign-flip test takes all patterns of signs (16384)
    # patterns of signs that are drawn for more parts: enough for a level of 0.001
    drawn_signs: int = 10_000
    max_lag: int = 40  # rows over which residuals may be correlated: more are slow changes
    min_correlation: float = 0.05  # autocorrelation below which residuals count as independent
    # share of the median loss that is added to each: a unit that hardly moved shows little,
    # however much it gained
    added_loss: float = 0.1


@dataclass(frozen=True)
class RestartCriteria:
    """Which fits are begun again elsewhere (`fit.py`, `starts.py`)."""

    fit_noises: float = 1.5  # times the noise, beyond which a fit is begun again from another start
    stretch_noises: float = 1.3  # times the noise, beyond which a stretch's start is drawn again


@dataclass(frozen=True)
class LookAlikeCriteria:
    """Other effects in the place of a named one (`trials.py`, and objectives of `attribution`)."""

    # of the named model's loss, up to which a look-alike is fitted to the end
    max_loss: float = 1.5
    # of what a name takes off, which one step of a look-alike must take off in its place
    min_step_gain: float = 0.1
    # look-alikes, the likeliest first, that are fitted in the place of an effect: each costs a
    # fit
    fitted: int = 3
    # of what an effect gains at first order, what one that it is mistaken for must gain in its
    # place to be fitted
    near_gain: float = 0.5
    other_gain: float = 0.8  # the same of any other effect


@dataclass(frozen=True)
class ReportCriteria:
    """Errors and models in reports (`report.py`, `rows.py`, `recommended.py`, `schema.py`)."""

    # skill against what needs no model, from which on a model distinguishes effects and is worth
    # using
    useful_skill: float = 0.35
    worthless_skill: float = 0.02  # the same, below which a model is worth no more than none
    parameter_level: float = 0.90  # coverage of the intervals of parameters (effects and declared)
    error_level: float = 0.95  # coverage of the interval of the error over held-out trials
    # trials, from which on the interval of an error is over trials: of fewer over parts of them
    min_trials: int = 3
    # noises, over a whole stretch, from which on a difference of two models shows
    visible: float = 3.0
    slack: float = 1.05  # times the declared file's error, up to which a joint counts as no worse
    run_stretches: int = 24  # stretches over which a written file is run: each file takes seconds
    ran_away: float = 1.0  # rad (m): of an error, from which on its size means nothing
    # times the median error of all trials: those beyond it, where they are few, are listed
    outlying: float = 4.0
    followed: float = 1.5  # times the noise floor, up to which trials count as followed


@dataclass(frozen=True)
class NumberCriteria:
    """The table of numbers by trial and log (`numbers.py`)."""

    level: float = 0.01  # probability of one false contradiction or more, over the whole table
    blocks: int = 1000  # of a t test, which shows any p however few there are
    # of what all know, that holds a trial or a log by itself where it shows nothing: where this is
    # more than half of what is known of a number, the part does not tell of it
    held: float = 1e-3
    min_parts: int = 3  # logs, from which on their spread is a sample, and one can be told apart
    min_freedom: int = 3  # trials more than logs, from which on these tell how far a log may be off
    exchanged: float = 0.9  # correlation, from which on two numbers can be exchanged
    told: int = 3  # numbers of a contradiction in its sentence


FOLD = FoldCriteria()
PAIRED = PairedTestCriteria()
RESTART = RestartCriteria()
LOOK_ALIKE = LookAlikeCriteria()
REPORT = ReportCriteria()
NUMBERS = NumberCriteria()
