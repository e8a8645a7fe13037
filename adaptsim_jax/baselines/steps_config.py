"""Budgets of the methods for policies over many steps."""

from dataclasses import dataclass

from adaptsim_jax.core.errors import BadInput


@dataclass(frozen=True)
class StepsConfig:
    """tests: episodes that score a policy. together, epochs, rate: of fine-tuning in the target,
    episodes of an update, epochs over them, and the learning rate. points: of the search for the
    best in Omega. share: of the training's rounds that an oracle goes on for. sigma: of CMA-ES at
    its start, as a share of each range.
    """

    tests: int = 8
    together: int = 2
    epochs: int = 8
    rate: float = 3e-4
    points: int = 64
    share: float = 0.5
    sigma: float = 0.25

    def __post_init__(self):
        for name in ("tests", "together", "epochs", "points"):
            if getattr(self, name) < 1:
                raise BadInput(f"compare: steps.{name} = {getattr(self, name)}; give at least 1")
