"""What an objective gives to the search for effects: models of a recording, scored, fitted and
compared on what was left out.

Short trials, simulated stretches and the balance of torques are objectives. `search` asks each the
same questions. Where an objective needs more than these, the method says why.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from adaptsim_jax.diagnosis.finding import Step
from adaptsim_jax.diagnosis.rules import Evidence, Reason
from adaptsim_jax.diagnosis.testing import Test

Model = Any
"""Effects that were `added` to the declared model, and its fit; each objective has its own."""
Refused = Sequence[tuple[Evidence, Reason]]


class FittedCandidate(NamedTuple):
    """A model that has a candidate more, or has it in the place of another, and its test.

    test: against the model without it; of a look-alike, of the name's model against this one, where
    little gain passes. passed: whether it may be taken; reason: why not, or what it leaves.
    """

    candidate: Any
    model: Model
    test: Test
    passed: bool
    reason: Reason | None = None


class Round(NamedTuple):
    """Attempts that compete. ended: said in the trace where none of them passes."""

    attempts: Iterable[FittedCandidate]
    ended: Reason | None = None


class Objective:
    """A recording against a declared model that may lack effects.

    most_effects: at which the search ends.
    """

    most_effects: int

    def declared(self) -> Model:
        """The declared model, fitted."""
        raise NotImplementedError

    def begun(self, null: Model) -> tuple[Model, Sequence[Step]]:
        """The model from which the search goes on, and how it came about: the declared one."""
        return null, ()

    def scores(self, model: Model) -> Sequence[Any]:
        """Of every candidate that is not in the model, likeliest first."""
        raise NotImplementedError

    def within_noise(self, model: Model) -> bool:
        """Whether a model leaves no more than the noise, so that it lacks nothing."""
        return False

    def rounds(self, base: Model) -> Iterator[Round]:
        """Candidates beside a model's effects, fitted; a round is asked if none before gained."""
        raise NotImplementedError

    def better(self, one: FittedCandidate, other: FittedCandidate) -> bool:
        """Whether one that passed is to be taken instead of another."""
        raise NotImplementedError

    def taken(self, attempt: FittedCandidate) -> Model:
        """The model of an attempt that the search takes."""
        return attempt.model

    def updated(self, null: Model) -> Model:
        """The declared model after another was taken."""
        return null

    def members(self, model: Model) -> tuple[Model, Sequence[Step]]:
        """The model with effects at many joints as effects that are tested joint by joint."""
        return model, ()

    def evidence(self, model: Model, candidates: Sequence[Any]) -> list[Evidence]:
        """What was left out shows of some of a model's effects, each beside all others."""
        raise NotImplementedError

    def tested_last(self, e: Evidence) -> bool:
        """Whether an effect is so far from going that it is tested again only in the end."""
        return False

    def reduced(self, model: Model, refused: Refused) -> tuple[Model, Sequence[Step]]:
        """The model without the weakest that is refused, whatever the stage, and with it those that
        are not adjacent: each takes a fit.
        """
        gone: list[tuple[Evidence, Reason]] = []
        for e, reason in sorted(refused, key=lambda r: r[0].test.gain):
            if not any(self.adjacent(e.candidate, other.candidate) for other, _ in gone):
                gone.append((e, reason))
        steps = [Step("dropped", e.candidate, e.test, reason) for e, reason in gone]
        return self.without(model, [e for e, _ in gone]), steps

    def adjacent(self, candidate: Any, other: Any) -> bool:
        """Whether one may take up what another does, so that both do not go at once."""
        return True

    def without(self, model: Model, gone: Sequence[Evidence]) -> Model:
        """The model without some effects, the first of which is the weakest."""
        return gone[0].less

    def simpler(self, model: Model, rows: Sequence[Evidence]) -> tuple[Model, Sequence[Step]]:
        """A model that does as well by fewer numbers, and what was replaced; itself if none is."""
        return model, ()

    def in_place_of(self, e: Evidence) -> Iterable[FittedCandidate]:
        """Other effects in the place of one; those that pass do as well as it does."""
        raise NotImplementedError

    def unnamed(self, e: Evidence) -> Reason | None:
        """Why an effect stays in the model without a name; None where it has one."""
        return None

    def closed(self, null: Model, model: Model, rows: Sequence[Evidence]) -> tuple[Model, Model]:
        """The declared and the final model as they are reported."""
        return null, model
