"""The pendulum with Omega moved by a traced offset, so that ranges are swept in one compiled
program (paper, figure A7).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.episode import StepPlan
from adaptsim_jax.adaptation.phase1 import make_phase1
from adaptsim_jax.adaptation.phase2 import adapt, draw_starts
from adaptsim_jax.adaptation.training import TrainConfig, traced
from adaptsim_jax.baselines.sysid import SysIdConfig, make_sysid
from adaptsim_jax.core import config as configs
from adaptsim_jax.core.progress import silent
from adaptsim_jax.mechanisms.double_pendulum import linear as model
from adaptsim_jax.space import Space
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.pendulum.task import (
    PendulumConfig,
    PendulumPolicy,
    best_in_space,
    make_pendulum,
)


@dataclass(frozen=True)
class ShiftedSpace:
    """`base` with physical values moved by `offset [D]`, which may be traced; unit coordinates stay
    what they are.
    """

    base: Space
    offset: jax.Array

    def __getattr__(self, name: str) -> Any:
        return getattr(self.base, name)

    def physical(self, u: jax.Array) -> jax.Array:
        x = self.base.physical(u)
        return x + jnp.broadcast_to(self.offset, x.shape)

    def unit(self, x: jax.Array) -> jax.Array:
        return self.base.unit(x - jnp.broadcast_to(self.offset, x.shape))


def shiftable_pendulum(options: Mapping[str, Any]) -> Callable[[jax.Array], Task]:
    """`shifted(offset [D]) -> Task`: `make_task("pendulum", options)` with Omega moved, and targets
    within Omega with it.

    The scaling of observations is that of the unmoved Omega: it is a change of coordinates, the
    same for all.
    """
    config = configs.from_table(PendulumConfig, dict(options), "config, [task]")
    base = make_pendulum(config)  # here, since it computes with numbers, not with tracers

    def shifted(offset: jax.Array) -> Task:
        space: Any = ShiftedSpace(base.space, offset)

        def train(key, dist, policy):
            del key, policy
            return PendulumPolicy(*model.optimal_gain(space.physical(dist.mean)))

        search = best_in_space(space) if config.reference == "omega" else None
        return replace(
            base,
            space=space,
            targets=space if config.targets == "omega" else base.targets,
            train=train,
            reference=base.reference if search is None else lambda params: search(params)[1],
        )

    return shifted


def adaptsim_run(
    config: TrainConfig, target: np.ndarray, *, starts: int = 2, iterations: int = 10
) -> Callable:
    """`run(offset [D], seed []) -> means [N, iterations + 1, D]`: Phase 1 and Phase 2 on Omega
    moved by `offset`; pure.
    """
    hyper, sizes = traced(config.hyper), config.phase1
    used = min(sizes.archive, sizes.trajectories * sizes.horizon)
    shifted = shiftable_pendulum(config.task)

    def run(offset, seed):
        phase1 = make_phase1(shifted(offset), sizes)
        key = jax.random.key(seed)
        state, _ = phase1.run(phase1.init(key), hyper, jnp.arange(sizes.rounds))
        first = draw_starts(jax.random.fold_in(key, 1), state.archive, used, starts)
        weights, aim = state.learner.target, jnp.asarray(target, jnp.float32)
        found = adapt(
            key,
            phase1.task,
            phase1.bdq,
            weights,
            first,
            aim,
            StepPlan(iterations, hyper.delta),
        )
        return found.history.mean

    return run


def adaptsim_over_ranges(
    config: TrainConfig,
    offsets: np.ndarray,
    seeds: np.ndarray,
    target: np.ndarray,
    *,
    report: Callable = silent,
) -> np.ndarray:
    """Means visited `[R, S, N, I + 1, D]` (unit coordinates) for `offsets [R, D]` and `seeds [S]`,
    one program.
    """
    return _each(jax.jit(adaptsim_run(config, target)), offsets, seeds, report)


def sysid_over_ranges(
    estimator: Callable,
    config: SysIdConfig,
    offsets: np.ndarray,
    seeds: np.ndarray,
    target: np.ndarray,
    *,
    report: Callable = silent,
) -> np.ndarray:
    """The same for SysID with `mixture_estimator` or `point_estimator`, with the paper's plain
    observation: `[R, S, 1, iterations + 1, D]`.
    """

    shifted = shiftable_pendulum({"scaling": "paper", "reference": "optimum"})

    @jax.jit
    def run(offset, seed):
        return make_sysid(shifted(offset), estimator, config)(
            jax.random.key(seed), jnp.asarray(target, jnp.float32)
        )[None]

    return _each(run, offsets, seeds, report)


def _each(run: Callable, offsets: np.ndarray, seeds: np.ndarray, report: Callable) -> np.ndarray:
    out = []
    for i, offset in enumerate(np.asarray(offsets, np.float32)):
        for j, seed in enumerate(seeds):
            out.append(np.asarray(run(jnp.asarray(offset), jnp.asarray(seed))))
            report(i * len(seeds) + j + 1, len(offsets) * len(seeds))
    return np.stack(out).reshape(len(offsets), len(seeds), *out[0].shape)
