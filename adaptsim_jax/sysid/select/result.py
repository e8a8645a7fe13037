"""What a search for effects found."""

from dataclasses import dataclass, field

from adaptsim_jax.sysid.estimate.fit import Fit, Instance
from adaptsim_jax.sysid.estimate.problem import Active
from adaptsim_jax.sysid.score.table import Ranked, ScoreTable


@dataclass
class SearchResult:
    """What the search ended with, and what it saw on the way."""

    base: Fit
    final: Fit
    ranked: list[Ranked]  # about the declared model
    rivals: dict[Instance, list[Fit]] = field(default_factory=dict)  # per accepted effect: the others in its place
    classes: dict[Instance, list[Instance]] = field(default_factory=dict)
    tried: list[Fit] = field(default_factory=list)
    last: list[Ranked] = field(default_factory=list)  # about the final model
    view: ScoreTable | None = None  # of the final model
    leading: Fit | None = None  # the likeliest set of effects that still explains too little for a name

    @property
    def added(self) -> Active:
        """What the search added to the effects that the base model has already."""
        return tuple(a for a in self.final.active if a not in self.base.active)
