"""What counts as an effect, declared beforehand: the thresholds of the search and of the decision."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Criteria:
    """Declared beforehand: what counts as an effect. alpha: family-wise level of a test over all candidates.

    shortlist: leaders refitted whole. price: log-likelihood that each further parameter must earn. class_gap and
    class_z: a rival stays in the class unless it loses by more than `class_gap` nats *and* `class_z` standard errors over
    windows. least_fall: least relative fall of the unexplained force that is worth a name. explained: with no more than
    this share of the unexplained force left over, the search ends at the first effect that earns nothing. pairs: of two effects
    that are refitted until they settle, where no single one earns a name. clear: a pair that leaves less than this share ends
    the making of pairs; promising: of one that leaves no more, look-alikes of its members are tried in their place. large: an
    unexplained force beyond this share of the torque is no disturbance, whatever its shape.

    Of the decision: "error" is the held-out RMS error; "share" and "p-value" are of what the generic dictionary predicts of a
    residual.
    """

    alpha: float = 0.01
    shortlist: int = 8
    price: float = 4.0
    class_gap: float = 6.0
    class_z: float = 2.5
    least_fall: float = 0.1
    least_share: float = 0.004
    least_beside: float = 0.1
    explained: float = 0.35
    most_effects: int = 3
    pairs: int = 3
    clear: float = 0.1
    promising: float = 0.6
    large: float = 0.3
    surely: float = 100.0  # log-likelihood that an effect gains which is small beside the torque, and yet no chance
    least_gain: float = 0.97  # error with an effect over without it: above this it is not shown by left-out trials
    far: float = 4.0  # times the squared error without an effect: beyond this it is shown without leaving trials out
    very_far: float = 25.0  # the same by a fit of the search, which may lack the finer shapes of the final model
    predicted: float = 0.8  # error of a flexible model over the declared model's: below this its forces are no chance
    well_predicted: float = (
        0.4  # below this they are structure whatever the linear scores say, where the error is beyond noise
    )
    no_chance: float = 1e-12  # p-value below which it is structure, however unevenly it spreads over the trials
    follows: float = 0.01  # share from which `alpha` is enough
    answered_share: float = 0.05  # where commands answer to the motion, up to 0.03 follows it by chance
    left_share: float = 0.02  # share left by a set that explains too little, from which it is no name
    rival_gain: float = 20.0  # log-likelihood of a refitted rival from which the residual is structure
    remains: float = 0.02  # error after over before: a model that leaves less than this may be named
    much_remains: float = 0.15  # beyond this, however little of what is left is predicted counts, if it is no chance
    much_p: float = 1e-8  # p-value of that; `no_chance` where the share is below `follows`
    clear_share: float = 0.04  # share of what is left that is no chance at `clear_p`, however much error remains
    clear_p: float = 1e-10  # p-value
    beyond_floor: float = 4.0  # error over the noise floor up to which what remains is no concern
    beyond_floor_still: float = 2.0  # the same where much of the error remains
    least_trials: int = 5  # that all gain by chance once in 32 times
    least_confirmed: float = 0.6  # error after over before: with less of a gain than this a name would be a guess
    as_well: float = 1.1  # error with a known value freed over the mended model's: below this they explain alike

    # what is left, beside the generic dictionary
    line_p: float = 1e-8  # p-value below which a sharp tone in the unexplained force is a line
    line_share: float = 0.01  # of the residual, from which a line is worth telling
    line_stretches: int = 3  # of a recording: fewer tell a line from the shape of one motion badly
    stretch_p: float = 1e-3  # p-value that one short stretch may bring to a hum that wanders: a single jolt is no hum
    stretch_p_of_band: float = 1e-6  # the same of a resonance, which is looked for in few long stretches
    resonance_height: float = 2.0  # over the octaves beside it: chance torques have broad spectra, not flat ones
    joints_alike: float = (
        1.5  # ratio of unexplained shares of the torque at two joints, below which they do not say which it is
    )
    answered: float = (
        0.5  # of a command's variance that feedback makes: balancing has 0.7 to 0.93, tracking and open loop 0 to 0.35
    )
    matters: float = 0.03  # of the torque's RMS: an effect of this size changes what a controller does
    flexible_groups: int = 4  # variables that the flexible model may use, picked one after the other
    flexible_fall: float = 0.01  # of the held-out sum of squares, for one more

    # what is no effect: clocks, filters, steps, starts
    phase_price: float = 8.0  # fall of the whitened sum of squares that each further phase of a trial must earn
    filter_p: float = 1e-6  # p-value of a smoothing: one is rare, and taking one off that is not there costs little
    filter_worth: float = 9.0  # gain of a correction to a smoothing that is worth another fit
    filter_widest: float = 20.0  # steps squared: more than a moving average of 21 samples is no filter against noise
    step_share: float = 1 / 3  # of the sensors' noise (RMS) that halving the steps may move a simulation by
    suspicious: float = (
        0.1  # of the RMS torque: more unexplained force, and the declared fit is made from another start too
    )
    next_to_none: float = 0.01  # of the RMS torque: with more force left, steps are made short once its effect is found

    # of the search
    hopeless: float = (
        1000.0  # of log-likelihood behind a trial that explains nearly everything: no refit makes up for it
    )
    left_follows: float = 1e-8  # p-value of what a found effect leaves, below which the whole list is tried
    idle: float = 0.95  # of the force left: above this an effect or a pair explains nothing, and no refit will
    slight: float = 300.0  # of log-likelihood: an idle effect that gains less is no place to go on from
    slack: float = 1.2  # times the force left before: what leaves more is no step forward
    still_far: float = (
        0.05  # of the torque: with more left than torques wander by, what was found one by one is not all
    )
    blatant: float = 0.01  # of the torque: with less force left over the short list will do
    errors_alike: float = 1.05  # sums of squares within this are alike: then fewer parameters count
    wider_gain: float = 1.0  # of log-likelihood, at first, of a wider effect: less would not come to pay
    nothing_left: float = 1e-3  # of the torque: with less force left unexplained there is nothing to refine
    round_gain: float = 1.0  # of log-likelihood, for another round of refining

    # of a first link that was measured wrong
    length_faint: float = (
        0.15  # times the best candidate's gain: wrong lengths had 0.4 to 1.9 of it (once 0.02), effects up to 0.09
    )
    length_doubt: float = (
        2.0  # times what may be left, foretold of the best length: beyond it no more lengths are tried
    )
