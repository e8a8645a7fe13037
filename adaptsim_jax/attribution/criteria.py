"""Numbers of `attribution` that can change a name, a note or a verdict, each with its unit and
reason.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ChoiceCriteria:
    """Which simulator follows a recording (`choice.py`, `replay.py`)."""

    # rad (m): MuJoCo's median error over some stretches, below which a recording is the file's
    # own simulation
    own_error: float = 1e-6
    stretches: int = 6  # stretches that are simulated for it: each costs a simulation
    horizon: float = 0.5  # s of stretches, where nothing is asked for
    # m, or of a quaternion's entries: range from which on a base is taken to move
    base_range: float = 1e-3
    ran_away: float = 1.0  # rad (m): a stretch of which any joint errs more has run away


@dataclass(frozen=True)
class StretchCriteria:
    """Simulated rows and stretches of a log (`stretches.py`, `weights.py`, `diagnose.py`)."""

    row: float = 4e-3  # s, of a row: a faster log is merged to about this
    past: float = 0.25  # s of command before a stretch, for effects that filter or delay it
    future: float = 0.06  # s of command after a stretch, for effects that advance it
    min_rows: int = 8  # rows of a stretch: fewer show no motion
    # s, from a stretch's start: what a late sensor shows there is not compared
    look_back: float = 0.012
    max_count: int = 192  # stretches of a fit: more cost time and tell little more
    outlying: float = 3.0  # times the median error of a stretch, from which on it counts less


@dataclass(frozen=True)
class RangeCriteria:
    """Joints that move, and that feel the ends of their range (`problem.py`, `machine.py`)."""

    # rad (m): from its range, within which a joint's motion may feel its end
    near_stop: float = 0.05
    # rad (m): beyond its range, where a joint that stops there is not found
    beyond_stop: float = 0.1
    moving_noises: float = 10.0  # times its noise, by which a joint that moves does


@dataclass(frozen=True)
class PriorCriteria:
    """What is assumed before data (`diagnose.py`, `parameters.py`)."""

    # standard deviation of a drive's gain, as a share, about the one that weight and inertia gave
    estimated_gain: float = 0.1
    inertia: float = 0.3  # standard deviation of a coordinate of a body's inertial parameters (1)
    # times, within which a body's mass and moments are taken to be those of the file
    body_factor: float = 3.0


@dataclass(frozen=True)
class FrictionCriteria:
    """Directions and bristles of dry friction (`columns.py`, `acting.py`)."""

    # s of motion before a stretch, by which bristles are taken to be bent at its start
    bent: float = 0.05
    # of its level, that dry friction takes over a row in which the joint slides
    sliding: float = 0.99
    # of the largest dry friction: below it, the direction is taken from the motion
    still: float = 1e-3


@dataclass(frozen=True)
class ConventionCriteria:
    """Units and frames that a recording contradicts (`conventions.py`)."""

    # times that all torques are those of the declared masses, from which on a recording is
    # refused
    refused_scale: float = 30.0
    # times the share of the torque's square that angles in another unit may leave, to be reported
    same_share: float = 1.5
    same_added: float = 0.01  # share of the torque's square that they may leave beyond that
    # cosine of two hinges' axes, from which on they count as parallel (8 degrees)
    parallel: float = 0.99


@dataclass(frozen=True)
class PaceCriteria:
    """Clocks and efforts of another scale (`pace.py`)."""

    # share of the torque's square that another clock, or efforts of another scale, may leave to
    # be reported
    explained: float = 0.03
    # times less that a clock must leave than a rotor's inertia at every joint does
    better_than_rotors: float = 10.0
    clock_factor: float = 1.2  # times that a clock is off, from which on it is reported
    # times that a declared friction is what moves a joint, from which on it is doubted
    friction_factor: float = 4.0
    even: float = 1e-4  # of an interval: steps this even are counted, not measured


@dataclass(frozen=True)
class WindowCriteria:
    """Windows of a balance of forces (`equation`: `windows.py`, `limits.py`, `solve.py`)."""

    span: float = 0.16  # s, of a window: half of its weight lies in the middle third
    min_rows: int = 12  # rows of a window: fewer do not average noise
    grid: float = 4e-3  # s: faster logs are read at about this
    hop: float = 0.25  # of a window, from one to the next
    # windows of a recording: of longer ones they lie farther from each other
    max_windows: int = 3000
    # of a joint's usual speed, below which the direction of dry friction cannot be distinguished
    # from zero
    creep: float = 0.02
    # of the usual speed, below which a joint may be held by friction, which is then anything up
    # to its level
    clear: float = 0.1
    speed_noises: float = 3.0  # times the noise of a speed, likewise
    memory: float = 1.0  # s, over which what is left of neighbours is taken to be alike at most


@dataclass(frozen=True)
class BalanceCriteria:
    """Rows of a balance and their weights (`balance.py`, `searched.py`)."""

    # of the reported torque, that an actuator's torque is at least taken to be
    min_scale: float = 0.02
    # rad (m): from the end of a range, within which it may push, since an encoder's zero may be
    # off; at most
    at_end: float = 0.05
    at_end_share: float = 0.02  # of a range's width, the same
    still_weight: float = 0.03  # weight (1) of a window in which a joint does not move
    # of a window: share of rows in which forces are uncertain, from which on it does not count
    pushed: float = 0.01
    no_weight: float = 1e-9  # weight (1) of such a window: next to none
    friction_off: float = 0.03  # of the usual torque, by which friction may be off
    # of a joint's torque: a joint that is missed by less does not outweigh the others for that
    min_of_torque: float = 0.03
    min_of_missing: float = 0.15  # of what the file misses of a joint's torque, the same


@dataclass(frozen=True)
class ServoCriteria:
    """Drives and joints that do not follow (`equation/commands.py`, `sentences.py`)."""

    drive_significant: float = 6.0  # standard errors of a drive's gain, on which all else depends
    stuck: float = 0.1  # of its command's motion, below which a joint does not follow it


@dataclass(frozen=True)
class ConfirmationCriteria:
    """Names that another search confirms (`equation/confirmed.py`, `examine.py`, `measures.py`)."""

    # of the squared error of a joint's angles, that may be left more with a name than without:
    # over 27 reports right names left 1.5 % of the error more at most, wrong ones 20 % at least
    harm: float = 0.1
    # times the torque's missing part, which what simulation names must not exceed
    contradicted: float = 1.05
    # of what all folds say of a parameter: less, without one fold, is nothing
    only_fold: float = 1e-3
    # times the amplitude at which an effect that does not act linearly is scored, up to which the
    # score holds
    score_reach: float = 1.5


@dataclass(frozen=True)
class InertiaCriteria:
    """Inertial parameters that data fix (`physical_inertias.py`, `torque_report.py`)."""

    # of the prior's spread, that may be left of a quantity that counts as fixed: a hundredth of
    # its variance is the prior's
    narrow: float = 0.1
    # of its value in the model file, by which a quantity that the data fix differs from it; of
    # what is near zero there, of the largest one of its unit
    different: float = 0.05


@dataclass(frozen=True)
class TextCriteria:
    """What reports list (`report.py`, `sentences.py`, `command_checks.py`, `torque_report.py`)."""

    curve_rows: int = 1500  # rows of a curve of the page: more do not show
    candidates: int = 40  # candidates of the report's table
    # share of recordings like this one, in which the size that is reported would be found
    power: float = 0.8
    trials: int = 8  # trials that are named one by one
    # times the noise floor, that the Coulomb friction of a simulator that lets a stuck joint
    # creep may leave
    soft_friction: float = 5.0


CHOICE = ChoiceCriteria()
STRETCH = StretchCriteria()
RANGE = RangeCriteria()
PRIOR_WIDTH = PriorCriteria()
FRICTION = FrictionCriteria()
CONVENTION = ConventionCriteria()
PACE = PaceCriteria()
WINDOW = WindowCriteria()
BALANCE = BalanceCriteria()
SERVO = ServoCriteria()
CONFIRMATION = ConfirmationCriteria()
INERTIAL = InertiaCriteria()
TEXT = TextCriteria()
