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
