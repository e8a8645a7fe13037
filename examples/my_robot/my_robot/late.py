"""The pendulum with commands that arrive late."""

from typing import NamedTuple

import numpy as np

from adaptsim_jax import EngineKind, make_backend


class Settings(NamedTuple):
    """rows: by how many rows a command is late."""

    rows: int = 1


def make_late(dt: float, rows: int):
    """`simulate(params [B, 10], commands [B, T, 2] N m, initial [B, 4]) -> Trajectory` in rows of
    `dt` s.
    """
    simulate = make_backend("pendulum", "native", dt).simulate

    def late(params, commands, initial):
        waiting = np.zeros_like(commands[:, :rows])
        return simulate(
            params, np.concatenate([waiting, commands], 1)[:, : commands.shape[1]], initial
        )

    return late


ENGINE = EngineKind(Settings, make_late)
