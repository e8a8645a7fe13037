"""What counts as an effect, declared beforehand: the thresholds of the search and of the decision."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Criteria:
    """Declared beforehand: what counts as an effect.

    "Gain" is of log-likelihood, "force" the RMS of the unexplained one, "error" the held-out RMS error; "share" and "p-value" are of
    what the generic dictionary predicts of a residual.
    """

    alpha: float = 0.01  # family-wise level of a test over all candidates
    sure_p: float = 1e-8  # p-value of what was looked for and is no chance: a line, what an effect or much error leaves
    no_chance: float = 1e-12  # p-value below which it is structure, however unevenly it spreads over the trials
    follows: float = 0.01  # share from which `alpha` is enough, and a line or one more variable worth it

    # of the search: what is tried, and what it must earn
    shortlist: int = 8  # leaders refitted whole
    most_effects: int = 3
    price: float = 4.0  # gain that each further parameter, or phase of a trial, must earn
    class_gap: float = 6.0  # a rival stays in the class unless its gain is less by more than this
    class_z: float = 2.5  # and by more than so many standard errors over windows
    least_fall: float = 0.1  # of the force, that is worth a name
    least_share: float = 0.004  # of the torque, likewise
    surely: float = 100.0  # gain of an effect that is small beside the torque, and yet no chance
    explained: float = 0.35  # of the force: with no more left, the search ends at the first effect that earns nothing
    large: float = 0.3  # of the torque: a force beyond it is no disturbance, whatever its shape
    still_far: float = 0.05  # of the torque: with more force left than torques wander by, what was found is not all
    next_to_none: float = 0.01  # of the torque: with more force left, steps are made short and short lists whole
    nothing_left: float = 1e-3  # of the torque: with less force left there is nothing to refine
    idle: float = 0.95  # of the force left: above this an effect or a pair explains nothing, and no refit will
    slight: float = 300.0  # gain: an idle effect that gains less is no place to go on from
    hopeless: float = 1000.0  # gain behind a trial that explains nearly everything: no refit makes up for it
    round_gain: float = 1.0  # gain that is worth another round of refining, or a finer shape

    # of two effects at once, where no single one earns a name
    pairs: int = 3  # that are refitted until they settle
    clear: float = 0.1  # of the force: a pair that leaves less ends the making of pairs
    promising: float = 0.6  # of the force: of a pair that leaves no more, look-alikes of its members are tried too

    # of the proof by left-out trials
    least_gain: float = 0.97  # error with an effect over without it: above this it is not shown
    far: float = 4.0  # times the squared error without an effect: beyond this it is shown without leaving trials out
    very_far: float = 25.0  # the same by a fit of the search, which may lack the finer shapes of the final model
    least_confirmed: float = 0.6  # error after over before: with less of a gain a name would be a guess
    least_trials: int = 5  # that all gain by chance once in 32 times

    # of the decision: what may be named
    left_share: float = 0.02  # share left by a set that explains too little, from which it is no name
    remains: float = 0.02  # error after over before: a model that leaves less may be named
    much_remains: float = 0.15  # beyond this, however little of what is left is predicted counts, if it is no chance
    clear_share: float = 0.04  # share of what is left that is no chance at `clear_p`, however much error remains
    clear_p: float = 1e-10  # p-value
    beyond_floor: float = 4.0  # error over the noise floor up to which what remains is no concern
    beyond_floor_still: float = 2.0  # the same where much of the error remains
    as_well: float = 1.1  # error with a known value freed over the mended model's: below this they explain alike

    # of the decision: what is structure
    predicted: float = 0.8  # error of a flexible model over the declared model's: below this its forces are no chance
    well_predicted: float = 0.4  # below this they are structure whatever linear scores say, if error is beyond noise
    flexible_groups: int = 4  # variables that the flexible model may use, picked one after the other
    rival_gain: float = 20.0  # gain of a refitted rival from which the residual is structure
    answered: float = 0.5  # of a command's variance, made by feedback: balancing 0.7 to 0.93, tracking 0 to 0.35
    answered_share: float = 0.05  # share where commands answer to the motion: up to 0.03 follows it by chance
    matters: float = 0.03  # of the torque: an effect of this size changes what a controller does
    joints_alike: float = 1.5  # ratio of forces (shares of the torque) at two joints that do not say which it is
    line_stretches: int = 3  # of a recording: fewer tell a line from the shape of one motion badly
    stretch_p: float = 1e-3  # p-value that one short stretch may bring to a hum that wanders: a single jolt is no hum
    stretch_p_of_band: float = 1e-6  # the same of a resonance, which is looked for in few long stretches
    resonance_height: float = 2.0  # over the octaves beside it: chance torques have broad spectra, not flat ones

    # what is no effect: filters, steps, starts
    filter_p: float = 1e-6  # p-value of a smoothing: one is rare, and taking one off that is not there costs little
    filter_worth: float = 9.0  # fall of the sum of squares by another extent that is worth another fit
    filter_widest: float = 20.0  # steps squared: more than a moving average of 21 samples is no filter against noise
    step_share: float = 1 / 3  # of the sensors' noise (RMS) that halving the steps may move a simulation by
    suspicious: float = 0.1  # of the torque: with more force left the declared fit is made from another start too

    # of a first link that was measured wrong
    length_faint: float = 0.15  # times the best candidate's gain: wrong lengths had 0.4 to 1.9, effects up to 0.09
    length_doubt: float = 2.0  # times `explained`, foretold of the best length: beyond it no more lengths are tried
