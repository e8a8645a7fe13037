"""From the evidence to what may be said: a verdict, with its reason in a sentence.

`decide` is pure. What was found, or that nothing was, gives a verdict; objections may take a name back, or hold a declared value
responsible in its place. Each has a name, and those that spoke stand in the report.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.fitted import force_ratio, rough_gain
from adaptsim_jax.sysid.evaluate.crossval import CrossValidation, confirms
from adaptsim_jax.sysid.evaluate.residual import ResidualDiagnosis
from adaptsim_jax.sysid.rivals.kinematics import FARTHEST, Remeasured
from adaptsim_jax.sysid.rivals.known_parameters import Freed
from adaptsim_jax.sysid.select.trace import Trace


@dataclass(frozen=True)
class Verdict:
    """A verdict of the report's schema, its message, whether the effects found may be named, and the rules that led to it."""

    name: str
    message: str
    named: bool
    rules: tuple[str, ...] = ()


@dataclass(frozen=True)
class Evidence:
    """All that a verdict rests on.

    before, after: the generic dictionary about the declared and the final model. force `[n]`: what the declared model leaves
    unexplained at each joint, as a share of the torque. error_before, error_after: held-out errors of the declared and of the mended
    model, the latter None where it was not asked for. floor: of the sensors' noise [rad]. flexible: the held-out error of a model
    with smooth forces of any shape over the declared model's. powered: whether most effects that matter would have been seen.
    known: declared values that were held; freed: the declared model without them. length: the declared `l1` [m]; remeasured: the
    likeliest one. Both None where nobody looked.
    """

    found: Trace
    before: ResidualDiagnosis
    after: ResidualDiagnosis
    force: np.ndarray
    error_before: CrossValidation
    floor: float
    powered: bool
    flexible: float = 1.0
    error_after: CrossValidation | None = None
    known: dict[str, float] = field(default_factory=dict)
    freed: Freed | None = None
    length: float | None = None
    remeasured: Remeasured | None = None

    @property
    def beyond(self) -> float:
        """The declared model's held-out error over the sensors' noise."""
        return self.error_before.rmse() / self.floor


def decide(evidence: Evidence, criteria: Criteria) -> Verdict:
    """The verdict on the evidence at hand. Objections that want evidence which is not there are silent."""
    verdict, spoke = (
        (_found(evidence, criteria), "found")
        if evidence.found.added
        else (_nothing(evidence, criteria), "nothing found")
    )
    rules = [spoke]
    for name, objection in OBJECTIONS:
        said = objection(evidence, verdict, criteria)
        if said is not None:
            verdict = said
            rules.append(name)
    return replace(verdict, rules=tuple(rules))


def _nothing(e: Evidence, criteria: Criteria) -> Verdict:
    """No effect earned its place: structure, too large a force, or chance."""
    well = e.flexible < criteria.well_predicted and e.beyond > criteria.beyond_floor
    if well or _structured(e.found, e.before, criteria, e.flexible):
        return Verdict("structured_unattributed", _unattributed(e.before), False)
    if np.max(e.force) > criteria.large:
        return Verdict("structured_unattributed", _large(e.force), False)
    if e.powered:
        return Verdict("within_noise", _chance(e.beyond, e.before, criteria), False)
    return Verdict("underpowered", _weak(e.beyond, criteria), False)


def _found(e: Evidence, criteria: Criteria) -> Verdict:
    """Effects were found: they are named, with what cannot be told from them, if they explain enough."""
    left = force_ratio(e.found.final, e.found.base)
    if left > criteria.explained and e.after.p_value < criteria.alpha and e.after.share > criteria.left_share:
        return Verdict("structured_unattributed", _partly(e.found, e.after, left), False)
    names = " and ".join(f"{_words(n)} at {_words(w)}" for n, w in e.found.added)
    others = [f"{_words(n)} at {_words(w)}" for rivals in e.found.classes.values() for n, w in rivals]
    if others:
        message = f"The residual is explained by {names}; these data cannot tell it from {', '.join(others)}."
        return Verdict("explained_class", message, True)
    return Verdict("explained", f"The residual is explained by {names}.", True)


def _not_confirmed(e: Evidence, verdict: Verdict, criteria: Criteria) -> Verdict | None:
    """The mended model simulates held-out trials no better: then no name is given.

    Beside a torque that wanders by chance, which no model takes away, a smaller fall of the error will do, if the likelihood rises in
    every trial and what is left is chance.
    """
    before, after = e.error_before, e.error_after
    if not verdict.named or after is None or after.rmse() < criteria.least_confirmed * before.rmse():
        return None
    if (
        not _predicted(e.after, criteria)
        and confirms(after, before, criteria)
        and _everywhere(e.found, before, criteria)
    ):
        return None
    message = (
        "A candidate fits, but it does not simulate held-out trials better than the declared model; no name is given."
    )
    return Verdict("structured_unattributed", message, False)


def _stand_in(e: Evidence, verdict: Verdict, criteria: Criteria) -> Verdict | None:
    """Much error remains that is no chance: effects that stand in for one that the catalogue lacks (a lag for a delay, friction and
    drag for Stribeck's curve) explain most of it and leave the shape of what they miss. A wandering torque may leave as much error,
    but nothing that follows the motion in left-out trials."""
    if not verdict.named or e.error_after is None:
        return None
    left, error = e.after, e.error_after.rmse()
    remains = error / e.error_before.rmse()
    much = remains > criteria.much_remains and left.p_value < (
        criteria.no_chance if left.share < criteria.follows else criteria.sure_p
    )
    clear = much or (left.share > criteria.clear_share and left.p_value < criteria.clear_p)
    beyond = error > (criteria.beyond_floor_still if much else criteria.beyond_floor) * e.floor
    if not (clear and remains > criteria.remains and beyond):
        return None
    best = " and ".join(f"{_words(n)} at {_words(w)}" for n, w in e.found.added)
    message = (
        f"The likeliest set, {best}, leaves an error {error / e.floor:.0f} times the noise, and what is left sits at "
        f"{left.where()}: too much for a name."
    )
    return Verdict("structured_unattributed", message, False)


def _known_value(e: Evidence, verdict: Verdict, criteria: Criteria) -> Verdict | None:
    """Freeing what is declared as known explains as much as the effects that are named, or what none explains."""
    if e.freed is None or not open_to_rivals(verdict):
        return None
    mended = e.error_before if e.error_after is None else e.error_after
    pairs = [f"{n} is not {e.known[n]:.4g} but {v:.4g}" for n, v in e.freed.values.items()]
    other = " and ".join(pairs) or "what stands under [known] is wrong"
    if verdict.named:
        if e.freed.error.rmse() > criteria.as_well * mended.rmse():
            return None
        cause = verdict.message.rstrip(".").replace("The residual is explained by ", "").split(";")[0]
        message = f"Either the model lacks {cause}, or {other}: these data cannot tell which."
    else:
        if e.freed.error.rmse() > criteria.least_confirmed * e.error_before.rmse():
            return None
        message = (
            f"The declared model explains the data much better if {other}; an effect that does the same is possible."
        )
    return Verdict("confounded_with_declared", message, False)


def _wrong_length(e: Evidence, verdict: Verdict, criteria: Criteria) -> Verdict | None:
    """Another `l1` explains what nothing else does, or is likelier than the effects that are named."""
    rival = e.remeasured
    if rival is None or e.length is None or not open_to_rivals(verdict):
        return None
    if rival.left > criteria.explained or abs(rival.l1 / e.length - 1.0) >= FARTHEST:
        return None
    if verdict.named and rough_gain(rival.model, e.found.final) <= 0.0:
        return None
    beside = "which is likelier than any effect" if verdict.named else "and no effect does so"
    message = (
        f"The declared model explains the data if l1 is not {e.length:.4g} but {rival.l1:.4g} m "
        f"(that leaves {100 * rival.left:.0f} % of the unexplained torque, {beside}): measure it again."
    )
    return Verdict("confounded_with_declared", message, False)


Objection = Callable[[Evidence, Verdict, Criteria], Verdict | None]
OBJECTIONS: tuple[tuple[str, Objection], ...] = (
    ("not confirmed by left-out trials", _not_confirmed),
    ("stands in for another", _stand_in),
    ("known value", _known_value),
    ("wrong length", _wrong_length),
)


def open_to_rivals(verdict: Verdict) -> bool:
    """Whether a wrong declared value could be behind it: effects are named, or structure is left that none explains."""
    return verdict.named or verdict.name == "structured_unattributed"


def _everywhere(found: Trace, trials: CrossValidation, criteria: Criteria) -> bool:
    """Whether the likelihood rises in every trial, of enough of them to be no chance."""
    names = np.unique(trials.trial[trials.fold >= 0])
    gain = found.final.likelihood - found.base.likelihood
    return len(names) >= criteria.least_trials and all(gain[trials.trial == k].sum() > 0.0 for k in names)


def _structured(found: Trace, before: ResidualDiagnosis, criteria: Criteria, flexible: float) -> bool:
    """Structure that is more than chance: some smooth force, or a rival that was refitted, predicts it in left-out trials, or its
    spectrum has a line."""
    answer = before.answered and before.line is None and before.share < criteria.answered_share
    clear = not answer and _predicted(before, criteria)
    if clear or (before.p_value < criteria.alpha and flexible < criteria.predicted):
        return True
    fall = 1.0 - criteria.least_fall  # a rival that is likelier but leaves all of the force has fitted single windows
    return any(
        rough_gain(t, found.base) > criteria.rival_gain and force_ratio(t, found.base) < fall for t in found.tried
    )


def _predicted(left: ResidualDiagnosis, criteria: Criteria) -> bool:
    """Whether some smooth force predicts what is left, or its spectrum has a line."""
    sure = left.p_value < criteria.no_chance or (left.p_value < criteria.alpha and left.share > criteria.follows)
    return sure or left.line is not None


def _words(name: str) -> str:
    """An effect or a place as a person writes it."""
    return name.replace("_", " ").replace("joint", "joint ")


def _unattributed(at: ResidualDiagnosis) -> str:
    share = at.places[0][2]
    much = f" ({100 * share:.0f} % of the residual{'' if at.sharp else ', held out'})" if share >= 0.005 else ""
    return f"There is structure that no candidate explains; it sits at {at.where()}{much}{at.beside()}."


def _partly(found: Trace, at: ResidualDiagnosis, left: float) -> str:
    best = " and ".join(f"{_words(e)} at {_words(w)}" for e, w in found.final.active)
    return (
        f"The best candidate, {best}, leaves {100 * left:.0f} % of the unexplained torque, which is too much for a name; "
        f"what is left sits at {at.where()}{at.beside()}."
    )


def _large(force: np.ndarray) -> str:
    joint = int(np.argmax(force))
    return (
        f"The declared model leaves forces of {100 * force[joint]:.0f} % of the torque at joint {joint + 1} that no candidate "
        "explains: too much for a chance disturbance."
    )


def _chance(beyond: float, left: ResidualDiagnosis, criteria: Criteria) -> str:
    if beyond < criteria.beyond_floor:
        return "The declared model explains the data to within their noise."
    what = "nothing that would predict it in other trials."
    if left.answered and left.p_value < criteria.alpha:
        much = f" ({100 * left.share:.0f} % of it)" if left.share >= 0.005 else ""
        what = (
            f"the motion only as the commands of a controller answer to such torques{much}; commands that do not depend on the "
            "motion would tell more."
        )
    return (
        f"The declared model leaves {beyond:.0f} times the sensors' noise, as torques do that wander by chance: what is left "
        f"follows {what}"
    )


def _weak(beyond: float, criteria: Criteria) -> str:
    much = (
        f", though the declared model leaves {beyond:.0f} times the sensors' noise"
        if beyond >= criteria.beyond_floor
        else ""
    )
    return f"Nothing is found{much}; these data would not have shown most effects that matter."
