"""Numbers of the closed loop that can change a name or a value, each with its unit and reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ClosedLoopCriteria:
    """How servos are simulated, fitted and compared."""

    step: float = 1e-3  # s: a stiff servo's loop answers within a few milliseconds
    near_end: float = 0.02  # rad (m): from the end of its range, within which a joint may touch it
    longest: float = 4.0  # s, of a piece: a closed loop forgets its start long before
    # s, of stretches where joints run away from pieces: at a limit no loop is closed, and what is
    # wrong of a force grows with the square of time
    stretch: float = 1.0
    runaway: float = 20.0  # times the noise, that a fitted joint leaves which may run away
    calmer: float = 0.4  # log of what stretches must leave less at least, joints' mean
    pieces: int = 28  # at most, those that move most: more cost time and tell little more
    start_pieces: int = 10  # the same where fits begin
    unscored: float = 0.15  # s after a piece's start, whose speed is only smoothed
    rest: float = 0.01  # rad (m): a trial whose first rows differ by less begins at rest
    history: float = 0.3  # s of targets before a piece, and the longest delay
    smooth: float = 0.12  # s, over which imposed motion is smoothed
    moving: float = 20.0  # times its noise, by which a joint moves that is fitted
    # rad (m): no encoder counts as better, since how trials are stepped leaves a part of this
    min_noise: float = 1e-4
    batch: int = 16  # parameter sets of a call
    # rows' worth of a pull to the file's scale: only ratios show where damping is heavy
    pull: float = 30.0
    gain: float = 0.03  # of the squared error, that a number of one joint must take off left out
    shared_gain: float = 0.06  # the same of a number that all joints share
    level: float = 0.003  # of the paired test over left-out pieces
    lacks_nothing: float = 1.5  # times the noise, that a joint which lacks nothing leaves at most
    shown: float = 1.15  # times the noise, that a model without a number must leave at its joints
    min_change: float = 0.05  # of kp, damping or a limit of the file, that is worth a name
    # by which the change of another number, in its usual size, counts: a hundredth is worth a name
    units: float = 5.0
    # times the noise, that one number which explains all leaves at most after three rounds
    hopeful: float = 10.0
    brief: float = 8.0  # s of each trial, over which one number that explains all is tried first
    hopeless: float = 1.0  # log of what is left over the noise, joints' sum: so much worse is lost
    enough: float = 2.0  # times the noise, that a joint with nothing more to find leaves at most
    far: float = 4.0  # times the noise, beyond which a piece lacks something
    helped: int = 2  # pieces that come from there to `enough`: they show a number by themselves
    harm: float = 0.1  # of a joint's squared error (log), by which a shared number may harm it
    # of a joint's error over whole trials by the file, that its own numbers must take off together
    better: float = 0.2
    rounds: int = 12  # of a fit
    # times the noise, or what is left beyond it, by which half as long a step moves a joint that it
    # was short enough for
    stepped: float = 0.3
    halvings: int = 1  # of the step, at most: each doubles the time of a round
    settled: float = 1e-3  # of the loss: a round over whole trials that takes off less is the last
    shared: int = 4  # numbers that all joints share, at most
    own: int = 2  # numbers of one joint beside its law, at most
    # spread of the logarithm of kp, the rotor free, up to which kp is known and not only ratios:
    # steps and rounding that repeats move it by up to four times as much, a seventh
    scale_known: float = 0.03
    # times kp, or the whole scale: a joint that is simulated alike by that does not show it
    other_gain: float = 1.3
    clearly: float = 0.1  # of the squared error (log), that such a law must leave more at least
    # logarithms of factors of a servo's whole law, from which a fit over whole trials begins again
    scales: tuple[float, ...] = (-2.0, -1.0, 1.0, 2.0)
    near: float = 0.01  # m: a centre of mass that is nearer to its joint shows no way outward
    tool: float = 0.1  # m, of the same, where fits begin: most tools are that long
    reach: float = 0.5  # m, at most, from a body's centre of mass to that of what it carries
    late: float = 1e-3  # s: a delay below is none
    usual_delay: float = 0.02  # s, of a bus or a filter, from which fits over whole trials begin
    damping_delay: float = 2e-3  # s, at most: a step of MuJoCo's, unless a file says another


CLOSED_LOOP = ClosedLoopCriteria()
