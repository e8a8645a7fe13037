"""What of the stretches enters the sums of a fit, and with which weights: each channel by the size
of its own residuals.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from adaptsim_jax.attribution.criteria import STRETCH
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.paths import residuals
from adaptsim_jax.attribution.problem import Group, TreeProblem
from adaptsim_jax.attribution.simulate import Path

MAX_SAMPLES = 48  # rows of a stretch that enter the sums, evenly spread: neighbours say the same


@dataclass(frozen=True)
class Weights:
    """channel [2n]: 1 / size of a residual of each channel (0: not measured); stretch [W]."""

    channel: np.ndarray
    stretch: np.ndarray


@dataclass(frozen=True)
class TreeFit:
    """A model fitted: its vector, starts by group [2n, W] (see `simulate`), weights, loss by
    stretch [W], and how it ended.
    """

    vector: Vector
    starts: tuple[np.ndarray, ...]
    weights: Weights
    loss: np.ndarray
    code: str
    rounds: int

    @property
    def total(self) -> float:
        return float(self.loss.sum())


def _own(weights: Weights, group: Group, joints: int) -> np.ndarray:
    """Channel weights [2 n_g] of a group."""
    j = np.array(group.joints)
    return np.concatenate([weights.channel[j], weights.channel[joints + j]])


class Counted(NamedTuple):
    """Of a group's stretches what enters the sums: rows [T], channels [C] of its 2n (those measured
    at all), weight [W, T, C].
    """

    rows: np.ndarray
    channels: np.ndarray
    weight: np.ndarray

    def pick(self, z: np.ndarray) -> np.ndarray:
        """Of what is logged [W, L+1, 2n, ...] what counts [W, T, C, ...]."""
        return z[:, self.rows[:, None], self.channels]

    def weigh(self, z: np.ndarray) -> np.ndarray:
        """What counts [W, T, C, ...], weighted in place, as [W, T C, ...]."""
        z *= self.weight.reshape(*self.weight.shape, *[1] * (z.ndim - 3))
        return z.reshape(len(z), -1, *z.shape[3:])

    def flat(self, z: np.ndarray) -> np.ndarray:
        """What is logged [W, L+1, 2n, ...], weighted, as [W, T C, ...]."""
        return self.weigh(self.pick(z))


def counted(problem: TreeProblem, group: Group, weights: Weights) -> Counted:
    s, at = group.stretches, picked(problem)
    mask = np.concatenate([s.seen, s.seen_v], 1).transpose(2, 0, 1)[:, at]
    weight = _own(weights, group, problem.joints) * np.sqrt(weights.stretch)[:, None, None] * mask
    channels = np.flatnonzero(np.any(weight != 0.0, axis=(0, 1)))
    return Counted(at, channels, weight[..., channels])


def losses(problem: TreeProblem, paths: Sequence[Path], weights: Weights) -> np.ndarray:
    """Half the weighted sum of squares of each stretch [W], over the samples that count."""
    return np.sum(group_losses(problem, paths, weights), 0)


def group_losses(problem: TreeProblem, paths: Sequence[Path], weights: Weights) -> list[np.ndarray]:
    """The same of each group of joints by itself, [W] each."""
    out = []
    for group, path in zip(problem.groups, paths, strict=True):
        r = residuals(group, path)[:, picked(problem)] * _own(weights, group, problem.joints)
        out.append(0.5 * np.square(r).sum((1, 2)) * weights.stretch)
    return out


def picked(problem: TreeProblem) -> np.ndarray:
    """Rows of a stretch that enter the sums."""
    rows = problem.groups[0].stretches.rows
    return np.unique(np.linspace(0, rows, min(MAX_SAMPLES, rows + 1)).round().astype(int))


def weigh(problem: TreeProblem, paths: Sequence[Path]) -> Weights:
    """Weights from the residuals themselves, by medians over stretches, so that none that ran away
    decides.
    """
    n, width = problem.joints, problem.groups[0].stretches.count
    channel, share, over = np.zeros(2 * n), np.zeros((width, 2 * n)), []
    for group, path in zip(problem.groups, paths, strict=True):
        r = residuals(group, path)
        mask = np.concatenate([group.stretches.seen, group.stretches.seen_v], 1).transpose(2, 0, 1)
        count = mask.sum(1)
        rms = np.sqrt(np.square(r).sum(1) / np.maximum(count, 1))
        j = np.array(group.joints)
        for k, at in enumerate([*j, *(n + j)]):
            have = count[:, k] > 0
            if have.any():
                size = np.median(rms[have, k])
                channel[at] = 1.0 / max(size, problem.floor[at], 1e-9)
                over.append(size / max(problem.floor[at], 1e-9))
                share[:, at] = rms[:, k] * channel[at]
    used = channel > 0
    size = np.sqrt(np.square(share[:, used]).mean(1))
    if np.any(size > 0):
        usual = max(float(np.median(size[size > 0])), 1e-12)
    else:
        usual = 1.0
    # what a model lacks moves a stretch's residuals together: beside the prior, they count as one
    # where it is most of them
    alike = np.clip(np.median(over), 1.0, np.sqrt(MAX_SAMPLES)) if over else 1.0
    return Weights(
        channel / alike, 1.0 / np.square(np.maximum(1.0, size / (STRETCH.outlying * usual)))
    )
