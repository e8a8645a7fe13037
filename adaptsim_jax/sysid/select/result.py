"""What a search for effects found."""

from dataclasses import dataclass, field

from adaptsim_jax.sysid.estimate.fit import Fitted, Instance
from adaptsim_jax.sysid.estimate.problem import Active
from adaptsim_jax.sysid.score.table import Ranked, View


@dataclass
class Found:
    """What the search ended with, and what it saw on the way."""

    base: Fitted
    final: Fitted
    ranked: list[Ranked]  # about the declared model
    rivals: dict[Instance, list[Fitted]] = field(default_factory=dict)  # per accepted effect: the others in its place
    classes: dict[Instance, list[Instance]] = field(default_factory=dict)
    tried: list[Fitted] = field(default_factory=list)
    last: list[Ranked] = field(default_factory=list)  # about the final model
    view: View | None = None  # of the final model
    leading: Fitted | None = None  # the likeliest set of effects that still explains too little for a name

    @property
    def added(self) -> Active:
        """What the search added to the effects that the base model has already."""
        return tuple(a for a in self.final.active if a not in self.base.active)
