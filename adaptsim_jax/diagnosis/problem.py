"""What a task gives to be diagnosed: parameters, candidates, and the residuals of its trials as a
function of the parameters.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from adaptsim_jax.effects.base import Effect, Quantity


@dataclass(frozen=True)
class Problem:
    """A recording of T trials against a model of P quantities.

    residuals: `values [T, P]` (each trial with its own) -> `[T, R]`, measured minus simulated over
    the sensor's noise, zero where nothing was measured. columns: `values [P]`, `basis [K, P]` ->
    derivatives `[T, R, K]` of what is simulated over the noise. counts: measured numbers of each
    trial `[T]`. channels: coordinates of a row, of which `R` is a multiple. starts: points `[S, P]`
    from which the declared fit may begin; begun: from how many of them, the best, it does; again:
    declared quantities beside whose values a fit is begun again where it leaves structure, for
    there are minima close by. What each trial has of its own (where it started) is the task's: it
    fits it
    inside of `residuals`, and takes out of `columns` what it would take up. fold `[T]`: trials that
    are left out together (each by itself where None); block `[T]`: trials that stand together in a
    paired test (likewise). anew: told of values `[P]` that a search takes, so that starts which
    were found by other values are found anew. weight `[T]`: what `residuals` and `columns` are
    multiplied by (1 where None).
    """

    quantities: tuple[Quantity, ...]
    declared: tuple[str, ...]
    effects: tuple[Effect, ...]
    residuals: Callable[[np.ndarray], np.ndarray]
    columns: Callable[[np.ndarray, np.ndarray], np.ndarray]
    counts: np.ndarray
    trials: tuple[str, ...]
    starts: np.ndarray
    scan: Callable[[np.ndarray], np.ndarray] | None = (
        None  # values [S, P] -> loss [S], roughly; where a cheaper way exists
    )
    index: Mapping[str, int] = field(default_factory=dict)
    channels: int = 2
    begun: int = 4
    again: tuple[str, ...] = ()
    fold: np.ndarray | None = None
    block: np.ndarray | None = None
    anew: Callable[[np.ndarray], None] | None = None
    weight: np.ndarray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "index", {q.name: i for i, q in enumerate(self.quantities)})

    @property
    def neutral(self) -> np.ndarray:
        return np.array([q.default for q in self.quantities])

    def at(self, names) -> np.ndarray:
        """Places of quantities by name."""
        return np.array([self.index[n] for n in names], int)

    def by_channel(self, residual: np.ndarray) -> np.ndarray:
        """Residuals `[T, R]` as rows of channels `[T, rows, C]`."""
        return residual.reshape(len(residual), -1, self.channels)

    def effect(self, name: str) -> Effect:
        return next(e for e in self.effects if e.name == name)
