"""What a search did, step by step. A trace is only ever added to, by a new one: who holds one holds what was known then."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from adaptsim_jax.sysid.estimate.fitted import Fit, Instance
from adaptsim_jax.sysid.estimate.problem import Active
from adaptsim_jax.sysid.score.table import Ranked, ScoreTable


@dataclass(frozen=True)
class Step:
    """One thing that the search did; what it says nothing of stays as it was.

    action: in words. final: the model held from here on, `view` the scores about it. tried: models that were fitted; instead_of:
    earlier ones whose place they take. rivals: the others that were tried in an effect's place; settled: effects whose rivals are no
    more asked for. classes: of the effects of the final model. leading: the likeliest set that still explains too little for a name.
    """

    action: str
    final: Fit | None = None
    view: ScoreTable | None = None
    tried: tuple[Fit, ...] = ()
    instead_of: tuple[Fit, ...] = ()
    rivals: Mapping[Instance, tuple[Fit, ...]] = field(default_factory=dict)
    settled: tuple[Instance, ...] = ()
    classes: Mapping[Instance, tuple[Instance, ...]] | None = None
    leading: Fit | None = None


@dataclass(frozen=True)
class Trace:
    """The declared model `base` with the scores `first` about it, all candidates as they rank there, and the steps since.
    What the search found is asked of its steps."""

    base: Fit
    first: ScoreTable
    ranked: tuple[Ranked, ...]
    steps: tuple[Step, ...] = ()

    def then(self, action: str, **did) -> "Trace":
        """The trace with one more `Step`."""
        return replace(self, steps=(*self.steps, Step(action, **did)))

    @cached_property
    def final(self) -> Fit:
        """The model that the search holds."""
        return next((s.final for s in reversed(self.steps) if s.final is not None), self.base)

    @cached_property
    def view(self) -> ScoreTable:
        """The scores about it."""
        return next((s.view for s in reversed(self.steps) if s.view is not None), self.first)

    @cached_property
    def tried(self) -> tuple[Fit, ...]:
        """Every model that was fitted, in order, the last fit of each."""
        out: tuple[Fit, ...] = ()
        for step in self.steps:
            out = (*(t for t in out if not any(t is old for old in step.instead_of)), *step.tried)
        return out

    @cached_property
    def rivals(self) -> dict[Instance, tuple[Fit, ...]]:
        """For effects that were accepted, the others in their place."""
        out: dict[Instance, tuple[Fit, ...]] = {}
        for step in self.steps:
            out = {e: r for e, r in out.items() if e not in step.settled} | dict(step.rivals)
        return out

    @cached_property
    def classes(self) -> dict[Instance, tuple[Instance, ...]]:
        """For effects of the final model, the others that the data cannot tell from them."""
        return dict(next((s.classes for s in reversed(self.steps) if s.classes is not None), {}))

    @cached_property
    def leading(self) -> Fit | None:
        """The likeliest set of effects that still explains too little for a name."""
        return next((s.leading for s in reversed(self.steps) if s.leading is not None), None)

    @property
    def added(self) -> Active:
        """What the search added to the effects that the base model has already."""
        return tuple(a for a in self.final.active if a not in self.base.active)
