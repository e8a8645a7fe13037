"""Numbers of simulations by MuJoCo that can change a finding, each with its unit and reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CandidateCriteria:
    """Sizes and ranges of what a file may lack (`catalogue.py`, `contact.py`, `fields.py`)."""

    # of all mass, from which on a body may carry a payload; a lighter one hardly could
    payload_share: float = 0.05
    # the same of a machine whose base moves, where each candidate is dear
    payload_share_moving: float = 0.1
    shift: float = 0.01  # m: of a payload's place, a step that shows in a motion
    turn: float = 2e-3  # rad: of an angle read wrong, likewise
    size: float = 10.0  # steps of a field that matter of it: one step only just shows
    prior_width: float = 100.0  # steps of a field (standard deviation): wide, so that data decide
    slope: float = 0.04  # rad: of a ground that is not level, as it is tried
    level: float = 0.02  # m: of a ground that lies higher or lower, as it is tried
    push: float = 1e-3  # of the weight: a wind that shows
    max_delay: float = 0.05  # s: a bus and a driver together delay less


@dataclass(frozen=True)
class SimulationCriteria:
    """Simulated stretches and their starts (`diagnosed.py`, `stretches.py`)."""

    horizon: float = 0.5  # s: long enough to show slow effects, short enough to follow
    horizon_moving: float = 0.24  # s where a base moves: contact makes longer stretches chaotic
    # times its noise, that an accelerometer counts with in first guesses of starts
    accelerometer_noises: float = 30.0
    # of its spread: least noise of an accelerometer where contact makes it jump
    accelerometer_spread: float = 0.1
    min_noise: float = 1e-6  # rad, m: least noise, of a log without any
    start_angle: float = 1e-2  # rad (m): scale of a start's angles
    start_speed: float = 0.1  # rad/s (m/s): the same of its speeds
    past: float = 0.1  # s of command before a stretch, for actuators that remember


@dataclass(frozen=True)
class RemarkCriteria:
    """What is remarked of a file without a fit (`step_notes`, `touching`)."""

    step_stretches: int = 8  # stretches that are simulated with half the step: they are much alike
    step_noises: float = 1.0  # noises that halving the step must change before a note says so
    pose_rows: int = 200  # rows of a log that are looked at: each costs a collision check
    # of these, above which a motion that touches does so: single ones may be noise
    touching_share: float = 0.02


@dataclass(frozen=True)
class AttitudeCriteria:
    """An orientation from gyro and accelerometer (`sensed.py`)."""

    # 1/s: by which an orientation follows gravity instead of the gyro, whose drift is slower
    follow: float = 1.0
    # of gravity: by which an acceleration may differ from it and still count as gravity
    calm: float = 0.3
    settle: float = 0.3  # s at the beginning over which gravity is averaged


CANDIDATE = CandidateCriteria()
SIMULATION = SimulationCriteria()
REMARK = RemarkCriteria()
ATTITUDE = AttitudeCriteria()
