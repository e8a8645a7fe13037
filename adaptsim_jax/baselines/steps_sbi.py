"""The posterior by package `sbi` (Tejero-Cantero et al. 2020): neural posterior estimation with a
flow, on our batched simulator.

One estimator serves all visits of a seed: it is told the observation and the mean that the policy
was told, so nothing is trained anew between visits. Simulations whose observation is not finite are
masked.
"""

import contextlib
import importlib
import io
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.learned import Bout, Trip
from adaptsim_jax.baselines.steps_arena import StepsArena
from adaptsim_jax.baselines.sysid import within_omega
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.task import Law

EPOCHS = 200  # at most; it ends where 20 of them bring nothing on held-out simulations


def npe(
    u: np.ndarray, x: np.ndarray, seed: int, epochs: int = EPOCHS
) -> Callable[[np.ndarray, int], np.ndarray]:
    """A posterior fitted to parameters and what they showed.

    Args:
        u: `[N, D]`, drawn uniformly from the unit box. x: `[N, K]`; rows that are not finite are
            masked.

    Returns:
        `sample(observation [K], n) -> [n, D]`, not truncated to the box. BadInput where the package
        is missing.
    """
    try:
        torch: Any = importlib.import_module("torch")
        inference: Any = importlib.import_module("sbi.inference")
        utils: Any = importlib.import_module("sbi.utils")
    except ModuleNotFoundError as error:
        raise BadInput(
            f"compare: method 'sbi' needs {error.name}; pip install 'adaptsim_jax[sbi]'"
        ) from None
    sound = np.isfinite(x).all(1)
    if sound.sum() < 20:
        raise BadInput(
            f"sbi: {sound.sum()} of {len(x)} simulations are finite; at least 20 are wanted"
        )
    torch.manual_seed(seed)
    prior = utils.BoxUniform(torch.zeros(u.shape[1]), torch.ones(u.shape[1]))
    trainer = inference.NPE(prior=prior, show_progress_bars=False)

    def tensor(rows):
        return torch.as_tensor(np.asarray(rows, np.float32))

    trainer.append_simulations(tensor(u[sound]), tensor(x[sound]))
    with contextlib.redirect_stdout(io.StringIO()):  # it says that it converged
        flow = trainer.train(max_num_epochs=epochs, show_train_summary=False)

    def sample(observation: np.ndarray, count: int) -> np.ndarray:
        with torch.no_grad():
            return flow.sample((count,), condition=tensor(observation)[None])[:, 0].numpy()

    return sample


def sbi(bout: Bout) -> Trip:
    """The loop of SysID-Bayes with that posterior: the policy is told its mean within Omega."""
    arena: StepsArena = bout.arena  # type: ignore[assignment]
    T, D, seed = len(arena.targets), arena.setting.space.dim, int(bout.seeds[0])
    config, sample = bout.config.sysid, _posterior(bout, seed)
    mean, means, rewards = np.full((T, D), 0.5, np.float32), [], []
    for i in range(bout.config.iterations + 1):
        policies = Law(jnp.asarray(mean))
        means.append(mean)
        rewards.append(arena.score(np.arange(T), policies))
        if i < bout.config.iterations:
            obs = arena.visit(None, np.arange(T), policies).obs
            draws = [
                sample(np.concatenate([o, m]), config.draws) for o, m in zip(obs, mean, strict=True)
            ]

            def one(d):
                return within_omega(jnp.asarray(d)[None], jnp.ones(1, bool), config.least_std)[
                    0
                ].mean

            mean = np.stack([np.asarray(one(d)) for d in draws])
        bout.report(i + 1, bout.config.iterations + 1)

    def shape(x):
        return np.stack(x, 1)[:, None, None]

    return Trip(
        shape(rewards), shape(means), arena.one.trials * np.arange(bout.config.iterations + 1)
    )


def _posterior(bout: Bout, seed: int) -> Callable[[np.ndarray, int], np.ndarray]:
    """Fitted to visits at points of Omega, each by the policy of another mean."""
    arena: StepsArena = bout.arena  # type: ignore[assignment]
    D, count = arena.setting.space.dim, bout.config.sysid.simulations
    u, mean = np.split(np.random.default_rng(seed).random((count, 2 * D), np.float32), 2, 1)

    def show(task, *rows):
        return jax.vmap(
            lambda k, m, p: task.observe(task.rollout(k, Law(m), task.space.physical(p)))
        )(*rows)

    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 400), count)
    seen = arena.program("sbi", show)(keys, jnp.asarray(mean), jnp.asarray(u))
    return npe(u, np.concatenate([np.asarray(seen), mean], 1), seed)
