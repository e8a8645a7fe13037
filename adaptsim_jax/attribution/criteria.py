"""Every number that can change what is named, in one place."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Criteria:
    """Each with its unit and reason; `docs/attribution.md` shows what they do.

    alpha: family-wise level of the score test over all candidates that lets one be tried. confidence: of the paired test over left-out
    trials by which an effect stays (Holm over those named). size: least share of the held-out loss (sum of squares) that an effect must
    take off, beside all others: below it nothing is worth naming. gap: share of the loss by which an alternative may be worse and
    still be told as doing as well. steady: an effect's size over its scatter between folds. most_effects: at which the search ends.
    tried: candidates that are fitted for `glance` rounds each time; fitted: those of them that are fitted whole and held out. rounds: of
    a refit.
    explained: held-out error over the noise floor up to which nothing is left to explain.
    """

    alpha: float = 0.01
    confidence: float = 0.05
    size: float = 0.01
    gap: float = 0.02
    steady: float = 3.0
    most_effects: int = 8
    tried: int = 4
    fitted: int = 2
    glance: int = 2
    rounds: int = 5
    explained: float = 1.5
