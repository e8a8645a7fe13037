"""What a search found: records that every search hands on, from which a report is made."""

from dataclasses import dataclass
from typing import Any, NamedTuple

from adaptsim_jax.diagnosis.rules import Reason
from adaptsim_jax.diagnosis.testing import Test


class Step(NamedTuple):
    """What a search did. action: added, tried, refused, dropped, read (fitted, and not named),
    replaced or ended; candidate and its test, where there are any; reason, where there is one.
    """

    action: str
    candidate: Any
    test: Test | None
    reason: Reason | None

    @property
    def why(self) -> str:
        """Words."""
        if self.reason:
            return self.reason.words
        return ""

    @property
    def shown(self) -> str:
        """Its test, in words."""
        if self.test:
            return f"held-out gain {100 * self.test.gain:.1f} %, p {self.test.p:.2g}"
        return ""


@dataclass(frozen=True)
class Named:
    """An effect that holds out. test: beside all others; steady: size over scatter; alternatives:
    effects that do as well in its place; models: with these, where they were kept.
    """

    candidate: Any
    test: Test
    steady: float
    alternatives: tuple[Any, ...] = ()
    models: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Finding:
    """null: the declared model, fitted; final: with what was found; named: effects that hold out;
    trace: all that the search did; scores: of candidates at the declared model, likeliest first;
    stages: models on the way forward; unnamed: effects in the final model without a name, and why.
    """

    null: Any
    final: Any
    named: tuple[Named, ...]
    trace: tuple[Step, ...]
    scores: tuple[Any, ...]
    stages: tuple[Any, ...] = ()
    unnamed: tuple[tuple[Any, Reason], ...] = ()

    def refused(self) -> list[tuple[Any, str]]:
        """What was fitted and did not stay, and why, in the order of the search."""
        return [
            (s.candidate, f"{s.action}: {s.why} ({s.shown})")
            for s in self.trace
            if s.test is not None and s.action in ("refused", "dropped", "replaced")
        ]
