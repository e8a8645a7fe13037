"""From what was found to what may be said: one of seven verdicts, with its reason in a sentence."""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fit import force_ratio
from adaptsim_jax.sysid.evaluate.crossval import CrossValidation
from adaptsim_jax.sysid.evaluate.residual import ResidualDiagnosis
from adaptsim_jax.sysid.select.backward import confirms
from adaptsim_jax.sysid.select.result import SearchResult


@dataclass(frozen=True)
class Verdict:
    """A verdict of the report's schema, its message, and whether the effects found may be named."""

    name: str
    message: str
    named: bool


def decide(
    found: SearchResult,
    before: ResidualDiagnosis,
    after: ResidualDiagnosis,
    settings: Criteria,
    powered: bool,
    flexible: float,
    force: np.ndarray,
    beyond: float = 1.0,
) -> Verdict:
    """The verdict. `before`, `after`: the generic dictionary about the declared and the final model; `flexible`: the
    held-out error of a model with smooth forces of any shape, over the declared model's; `force` `[n]`: the force that the
    declared model leaves unexplained at each joint, as a share of the torque; `beyond`: the declared model's held-out error
    over the sensors' noise."""
    active = found.added
    if not active:
        well = flexible < settings.well_predicted and beyond > settings.beyond_floor
        if well or _structured(found, before, settings, flexible):
            return Verdict("structured_unattributed", _unattributed(before), False)
        if np.max(force) > settings.large:
            return Verdict("structured_unattributed", _large(force), False)
        if powered:
            return Verdict("within_noise", _chance(beyond, before, settings), False)
        return Verdict("underpowered", _weak(beyond, settings), False)
    left = force_ratio(found.final, found.base)
    if left > settings.explained and after.p_value < settings.alpha and after.share > settings.left_share:
        return Verdict("structured_unattributed", _partly(found, after, left), False)
    names = " and ".join(f"{_words(e)} at {_words(w)}" for e, w in active)
    others = [f"{_words(e)} at {_words(w)}" for rivals in found.classes.values() for e, w in rivals]
    if others:
        message = f"The residual is explained by {names}; these data cannot tell it from {', '.join(others)}."
        return Verdict("explained_class", message, True)
    return Verdict("explained", f"The residual is explained by {names}.", True)


def _chance(beyond: float, left: ResidualDiagnosis, settings: Criteria) -> str:
    if beyond < settings.beyond_floor:
        return "The declared model explains the data to within their noise."
    what = "nothing that would predict it in other trials."
    if left.answered and left.p_value < settings.alpha:
        much = f" ({100 * left.share:.0f} % of it)" if left.share >= 0.005 else ""
        what = (
            f"the motion only as the commands of a controller answer to such torques{much}; commands that do not depend on the "
            "motion would tell more."
        )
    return (
        f"The declared model leaves {beyond:.0f} times the sensors' noise, as torques do that wander by chance: what is left "
        f"follows {what}"
    )


def _weak(beyond: float, settings: Criteria) -> str:
    much = (
        f", though the declared model leaves {beyond:.0f} times the sensors' noise"
        if beyond >= settings.beyond_floor
        else ""
    )
    return f"Nothing is found{much}; these data would not have shown most effects that matter."


def _large(force: np.ndarray) -> str:
    joint = int(np.argmax(force))
    return (
        f"The declared model leaves forces of {100 * force[joint]:.0f} % of the torque at joint {joint + 1} that no candidate "
        "explains: too much for a chance disturbance."
    )


def confirmed(
    verdict: Verdict,
    found: SearchResult,
    before: CrossValidation,
    after: CrossValidation,
    left: ResidualDiagnosis,
    settings: Criteria,
) -> Verdict:
    """The verdict, unless the mended model simulates held-out trials no better: then no name is given.

    left: the generic dictionary about the mended model. Beside a torque that wanders by chance, which no model takes away, a smaller
    fall of the error will do, if the likelihood rises in every trial and what is left is chance.
    """
    if not verdict.named or after.rmse() < settings.least_confirmed * before.rmse():
        return verdict
    if not _predicted(left, settings) and confirms(after, before, settings) and _everywhere(found, before, settings):
        return verdict
    message = (
        "A candidate fits, but it does not simulate held-out trials better than the declared model; no name is given."
    )
    return Verdict("structured_unattributed", message, False)


def _everywhere(found: SearchResult, trials: CrossValidation, settings: Criteria) -> bool:
    """Whether the likelihood rises in every trial, of enough of them to be no chance."""
    names = np.unique(trials.trial[trials.fold >= 0])
    gain = found.final.likelihood - found.base.likelihood
    return len(names) >= settings.least_trials and all(gain[trials.trial == k].sum() > 0.0 for k in names)


def unforced(
    verdict: Verdict,
    found: SearchResult,
    before: CrossValidation,
    after: CrossValidation,
    left: ResidualDiagnosis,
    floor: float,
    settings: Criteria,
) -> Verdict:
    """The verdict, unless much error remains that is no chance: effects that stand in for one that the catalogue lacks
    (a lag for a delay, friction and drag for Stribeck's curve) explain most of it and leave the shape of what they miss.

    left: the generic dictionary about the mended model; floor: of the noise, rad. A wandering torque may leave as much error, but
    nothing that follows the motion in left-out trials.
    """
    remains = after.rmse() / before.rmse()
    much = remains > settings.much_remains and left.p_value < (
        settings.no_chance if left.share < settings.follows else settings.much_p
    )
    clear = much or (left.share > settings.clear_share and left.p_value < settings.clear_p)
    beyond = after.rmse() > (settings.beyond_floor_still if much else settings.beyond_floor) * floor
    if not (verdict.named and clear and remains > settings.remains and beyond):
        return verdict
    best = " and ".join(f"{_words(e)} at {_words(w)}" for e, w in found.added)
    message = (
        f"The likeliest set, {best}, leaves an error {after.rmse() / floor:.0f} times the noise, and what is left sits at "
        f"{left.where()}: too much for a name."
    )
    return Verdict("structured_unattributed", message, False)


def _structured(found: SearchResult, before: ResidualDiagnosis, settings: Criteria, flexible: float) -> bool:
    """Structure that is more than chance: some smooth force, or a rival that was refitted, predicts it in left-out trials, or its
    spectrum has a line."""
    answer = before.answered and before.line is None and before.share < settings.answered_share
    clear = not answer and _predicted(before, settings)
    if clear or (before.p_value < settings.alpha and flexible < settings.predicted):
        return True
    fall = 1.0 - settings.least_fall  # a rival that is likelier but leaves all of the force has fitted single windows
    return any(
        t.total - found.base.total > settings.rival_gain and force_ratio(t, found.base) < fall for t in found.tried
    )


def _predicted(left: ResidualDiagnosis, settings: Criteria) -> bool:
    """Whether some smooth force predicts what is left, or its spectrum has a line."""
    sure = left.p_value < settings.no_chance or (left.p_value < settings.alpha and left.share > settings.follows)
    return sure or left.line is not None


def _words(name: str) -> str:
    """An effect or a place as a person writes it."""
    return name.replace("_", " ").replace("joint", "joint ")


def _unattributed(at: ResidualDiagnosis) -> str:
    share = at.places[0][2]
    much = f" ({100 * share:.0f} % of the residual{'' if at.sharp else ', held out'})" if share >= 0.005 else ""
    return f"There is structure that no candidate explains; it sits at {at.where()}{much}{at.beside()}."


def _partly(found: SearchResult, at: ResidualDiagnosis, left: float) -> str:
    best = " and ".join(f"{_words(e)} at {_words(w)}" for e, w in found.final.active)
    return (
        f"The best candidate, {best}, leaves {100 * left:.0f} % of the unexplained torque, which is too much for a name; "
        f"what is left sits at {at.where()}{at.beside()}."
    )
