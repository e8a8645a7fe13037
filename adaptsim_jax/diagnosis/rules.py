"""Why an effect is refused beside all others: one list of rules for all objectives, each with
a code.

A rule asks an `Evidence` for a number and returns it where it fails. What does not apply to an
objective, a machine or an effect has no number there (None). Words are made in one place, from the
code and the number.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.testing import Test

READING, MODEL, NAME = "reading", "model", "name"
"""What a refusal is about: how rows are read, whether an effect predicts, whether it has a name.

The search takes out what fails a rule of any stage, unless its objective leaves it in the model:
`Objective.reduced` (simulated stretches leave what is how rows are read) and
`Evidence.stays_unnamed`.
"""


class Reason(NamedTuple):
    """Why a search did what it did: a code, the number that decided, and words for people."""

    code: str
    number: float
    words: str


class Evidence:
    """What is known of an effect beside all others of a model; each objective gives its own.

    Args:
        candidate: The effect.
        model: What has it, beside all others.
        less: The model without it, refitted.
        test: Of the model against that.
        level: Up to which its p holds (short trials: Holm's over all that are asked).
        price: The least of its gain.
        steadiness: Its size over its scatter.
        apart: What it takes off trials, or thirds of one, that were left out even from the choice
            of its shape, less the price of its numbers, where that is known.
        units, loss: What is left out, and of what an error is, in words.
    """

    candidate: Any
    model: Any
    less: Any
    criteria: Criteria
    test: Test
    level: float
    price: float
    steadiness: float
    apart: float | None = None
    units = "trials"
    loss = "squared error"

    @property
    def gain(self) -> float:
        """The share of the loss that it takes off, all joints that carry it together."""
        return self.test.gain

    @property
    def min_steadiness(self) -> float:
        """The least of its size over its scatter."""
        return self.criteria.steady

    @property
    def between_rows(self) -> bool:
        """Whether it is how rows are read, which stays fitted."""
        return False

    @property
    def shifts_time(self) -> bool:
        """Whether it acts by a shift in time."""
        return False

    @property
    def stays_unnamed(self) -> bool:
        """Whether it stays in the model though it fails a rule (why: `Objective.unnamed`)."""
        return False

    @property
    def at_bound(self) -> bool:
        """Whether its value lies at the end of its range."""
        raise NotImplementedError

    @property
    def unresolved_shift(self) -> float | None:
        """A shift in time, in rows of the log, that is shorter than the log resolves."""
        return None

    @property
    def declared_change(self) -> float | None:
        """By what share, at most, it changes what the file declares."""
        return None

    @property
    def scaled_change(self) -> float | None:
        """By how many of the sizes that matter, at most, it changes quantities."""
        return None

    @property
    def torque_share(self) -> tuple[float, float] | None:
        """Its share of the torque of the joint where it is most, and the least of that."""
        return None

    @property
    def bend(self) -> float | None:
        """By how many noises of the sensors bristles bend before they break away."""
        return None

    @property
    def left_without(self) -> float | None:
        """What the model without it leaves, over the noise."""
        return None

    @property
    def beyond_noise(self) -> float | None:
        """The share that it takes off the squared error beyond the noise."""
        return None

    @property
    def harmed_joints(self) -> int:
        """At how many joints simulation, where it predicts, misses angles by more."""
        return 0

    @property
    def nearer(self) -> float | None:
        """The share by which simulated angles come nearer, all joints together."""
        return None

    @property
    def best_joint(self) -> tuple[float, float] | None:
        """The share that it takes off one joint's squared error, at best, and the least of that."""
        return None


@dataclass(frozen=True)
class Rule:
    """A refusal. fails: of evidence, the number by which it fails, None where it passes."""

    code: str
    stage: str
    words: str
    fails: Callable[[Evidence], float | None]

    @property
    def meaning(self) -> str:
        """What it refuses, a sentence."""
        return " ".join((self.fails.__doc__ or "").split())


RULES: list[Rule] = []
"""All of them, in the order in which they are asked: what costs a simulation comes last."""


def rule(stage: str, words: str):
    """A function of evidence as a rule whose code is its name; words: with fields of `e` and `n`,
    the number.
    """

    def known(fails: Callable[[Evidence], float | None]):
        RULES.append(Rule(fails.__name__, stage, words, fails))
        return fails

    return known


@rule(READING, "how rows are read, not an effect")
def commands_between_rows(e: Evidence) -> float | None:
    """All commands act early or late by less than a row tells."""
    if e.between_rows and e.shifts_time:
        return 0.0
    return None


@rule(READING, "how rows are read, not an effect")
def rotors_are_steps(e: Evidence) -> float | None:
    """All rotors are what damping does that acts a part of a row earlier."""
    if e.between_rows and not e.shifts_time:
        return 0.0
    return None


@rule(MODEL, "left-out {e.units} do not confirm it")
def not_confirmed(e: Evidence) -> float | None:
    """The paired test over what was left out has a p above its level."""
    if e.test.p > e.level:
        return e.test.p
    return None


@rule(MODEL, "takes less than {e.price:.0%} off the {e.loss}")
def too_little_gain(e: Evidence) -> float | None:
    """It takes less off the left-out loss than its numbers cost."""
    if e.gain < e.price:
        return e.gain
    return None


@rule(MODEL, "trials, or thirds of one, that chose nothing of it do not bear it out")
def not_worth_apart(e: Evidence) -> float | None:
    """Trials (of fewer than three, thirds) from which nothing of it was chosen, its shape neither,
    are hardly predicted better with it.
    """
    if e.apart is not None and e.apart <= 0.0:
        return e.apart
    return None


@rule(MODEL, "the torques of all joints together are missed by more")
def others_missed_more(e: Evidence) -> float | None:
    """It helps at its own joints, and all joints together are missed by more."""
    if e.test.overall < 0.0:
        return e.test.overall
    return None


@rule(NAME, "its size differs between {e.units}: {n:.1f} times its scatter")
def unsteady(e: Evidence) -> float | None:
    """Its size is not many times its scatter between folds (jackknife)."""
    if e.steadiness < e.min_steadiness:
        return e.steadiness
    return None


@rule(MODEL, "its value is at the end of what such a machine may have")
def at_bound(e: Evidence) -> float | None:
    """Its value lies at the end of its range: it wants what no machine has."""
    if e.at_bound:
        return 1.0
    return None


@rule(NAME, "a shift in time of {n:.2g} sampling intervals: how rows are read, not an effect")
def within_row(e: Evidence) -> float | None:
    """It is a shift in time shorter than the log resolves."""
    return e.unresolved_shift


@rule(NAME, "changes what the model file declares by less than {e.criteria.min_change:.0%}")
def declared_hardly_changes(e: Evidence) -> float | None:
    """It changes what the file declares by a small share."""
    change = e.declared_change
    if change is not None and change < e.criteria.min_change:
        return change
    return None


@rule(NAME, "changes its quantities by less than what matters of them")
def less_than_matters(e: Evidence) -> float | None:
    """It changes each of its quantities by a small part of the size that matters."""
    change = e.scaled_change
    if change is not None and change < e.criteria.matters:
        return change
    return None


@rule(NAME, "it is {n:.1%} of the joint's torque")
def less_than_joint_torque(e: Evidence) -> float | None:
    """It is a small share of its joint's torque."""
    if e.torque_share is None:
        return None
    share, minimum = e.torque_share
    if share < minimum:
        return share
    return None


@rule(
    NAME,
    "its bristles break away within the sensors' noise: friction that turns smoothly, not an "
    "effect",
)
def below_noise(e: Evidence) -> float | None:
    """What it does to an angle is below the noise of its sensor."""
    if e.bend is not None and e.bend < 1.0:
        return e.bend
    return None


@rule(MODEL, "without it {n:.2f} times the noise is left, which lacks nothing")
def nothing_lacking_without(e: Evidence) -> float | None:
    """The model without it leaves no more than the noise."""
    left = e.left_without
    if left is not None and left < e.criteria.lacks_nothing:
        return left
    return None


@rule(MODEL, "takes {n:.0%} off what is beyond the noise, of which it may be a part")
def not_beyond_noise(e: Evidence) -> float | None:
    """It takes too little off the error beyond the noise to be what the model lacks."""
    share = e.beyond_noise
    if share is not None and share < e.criteria.beyond:
        return share
    return None


@rule(MODEL, "simulated stretches are missed by more with it at {n:.0f} joints")
def harms_joints(e: Evidence) -> float | None:
    """A joint at which simulation tells anything is simulated worse with it."""
    if e.harmed_joints:
        return float(e.harmed_joints)
    return None


@rule(MODEL, "the simulated angles do not come nearer to the measured ones")
def angles_not_nearer(e: Evidence) -> float | None:
    """Simulated angles come no nearer, whatever the estimator's weights see."""
    if e.nearer is not None and e.nearer < 0.0:
        return e.nearer
    return None


@rule(MODEL, "takes {n:.0%} off the squared error of the joint's angles where it is most")
def no_joint_improves(e: Evidence) -> float | None:
    """No joint's simulated angles come enough nearer."""
    if e.best_joint is None:
        return None
    share, minimum = e.best_joint
    if share < minimum:
        return share
    return None


STEPS = {
    "score_test": "{passed} of {of} candidates pass the score test, none holds out",
    "forward_gain": "takes too little off the left-out loss",
    "forward_level": "left-out trials do not confirm it",
    "forward_fit": "fitted, leaves {n:.2f} of the loss",
    "begin_from_other": "along the measured motion",
    "likely_first": "at all joints",
    "shape_artefact": "with all shapes fitted its interval includes none of it",
    "ends_at_bound": "with all shapes fitted its value is at the end of its range",
    "body_first": "a body of another mass does as well as {one}",
    "one_for_two": "{one} and {other} by one",
    "simpler_has_the_name": "{one} has fewer parameters and does as well",
    "as_logged": "loggers pair torques with angles as early or late as this",
    "of_like_joints": "like joints have it, but it could not be shown by itself in these data",
    "all_names_together": "all names together take nothing off simulated stretches",
    "better_in_its_place": "{one} predicts better in its place",
}
"""Words of what a search does besides refusals, by code."""


def refusal(evidence: Evidence, stages: Sequence[str] = (READING, MODEL, NAME)) -> Reason | None:
    """The first rule of some stages that an effect fails; None where it stays."""
    for one in (r for r in RULES if r.stage in stages):
        number = one.fails(evidence)
        if number is not None:
            words = one.words.format(e=evidence, n=number).replace("%", " %")
            return Reason(one.code, number, words)
    return None


def step_reason(code: str, number: float = 0.0, **fields: object) -> Reason:
    """Why a search took a step that is no refusal."""
    return Reason(code, number, STEPS[code].format(n=number, **fields))


def table() -> str:
    """The rules as a table in Markdown, for `docs/explanation/rules.md`."""
    rows = [f"| `{r.code}` | {r.stage} | {r.meaning} |" for r in RULES]
    return "\n".join(["| code | stage | refuses |", "| --- | --- | --- |", *rows, ""])
