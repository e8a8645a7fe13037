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
