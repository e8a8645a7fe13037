"""Methods for policies over many steps that move E's mean with a search of their own, beside those
of `adapting.py` and `bayesopt.py`, which serve them too.

* CMA-ES of package `cma` (Hansen 2016), by the returns of its candidates.
* The posterior by package `sbi` (Tejero-Cantero et al. 2020): neural posterior estimation with a
  flow, on our batched simulator. One estimator serves all visits of a seed: it is given the
  observation and the policy's mean, so nothing is trained between visits. Simulations whose
  observation is not finite are masked.
* Gradient ascent on the return, through the policy that knows E and a simulation of the target
  itself. No method for a robot, for it needs the target's own model: a row that shows what slopes
  are worth where they can be had. Each mean is tried in the target, which counts. Where it returned
  less than the best so far, the stride is halved from there.
"""

import contextlib
import importlib
import io
import sys
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.arena import MethodRun, Observed, Visits
from adaptsim_jax.baselines.steps_arena import StepsArena
from adaptsim_jax.baselines.sysid import within_omega
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.episodes import make_slope
from adaptsim_jax.environments.policies import Law, Tuned, network_acting

STRIDE = 0.2  # of the range, for the field that moves most; halved where it led to less
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


def searched(
    run: MethodRun,
    total: int,
    first: np.ndarray,
    move: Callable[[np.ndarray, Observed], np.ndarray],
) -> Visits:
    """`total` visits in every target: at the means `first [T, D]`, then where `move(means,
    observed)` goes.
    """
    arena: StepsArena = run.arena
    every, at = np.arange(len(arena.targets)), first
    means, rewards = [], []
    for i in range(total):
        policies = Law(jnp.asarray(at))
        observed = arena.visit(None, every, policies)
        rewards.append(arena.score(every, policies))
        means.append(at)
        if i + 1 < total:
            at = move(at, observed)
        run.report(i + 1, total)

    def grid(x):
        return np.stack(x, 1)[:, None, None]

    return Visits(grid(means), arena.one.trials * np.arange(1, total + 1), grid(rewards))


def visits_of(run: MethodRun) -> int:
    """As many visits as AdaptSim makes."""
    return run.config.starts * (run.config.iterations + 1)


def cma_es(run: MethodRun) -> Visits:
    """E's mean by covariance matrix adaptation, a visit for each candidate."""
    try:
        cma: Any = importlib.import_module("cma")
    except ModuleNotFoundError:
        raise BadInput("compare: method 'cma_es' needs the package cma; pip install cma") from None
    arena: StepsArena = run.arena
    options = {"bounds": [0.0, 1.0], "verbose": -9, "seed": int(run.seeds[0]) + 1}
    start = arena.setting.space.dim * [0.5]
    searches = [
        cma.CMAEvolutionStrategy(start, run.config.steps.sigma, options) for _ in arena.names
    ]
    asked, scores = [search.ask() for search in searches], []

    def move(at, observed):
        scores.append(observed.score)
        if len(scores) == len(asked[0]):
            for t, search in enumerate(searches):
                search.tell(asked[t], [-float(s[t]) for s in scores])
                asked[t] = search.ask()
            scores.clear()
        return np.array([a[len(scores)] for a in asked], np.float32)

    first = np.array([a[0] for a in asked], np.float32)
    return searched(run, visits_of(run), first, move)


def gradient(run: MethodRun) -> Visits:
    """A visit in the target for each mean. Its slope from four starts in the simulator with all of
    the target's values.
    """
    arena: StepsArena = run.arena
    setting, T, values = arena.setting, len(arena.targets), arena.all_values
    slope = arena.shared(
        "slope", lambda: make_slope(arena.whole_play(), network_acting(setting), Tuned)
    )
    actor, length = setting.trainer.policy(arena.prepared.learned), setting.sim.length
    starts = jax.random.split(jax.random.fold_in(jax.random.key(int(run.seeds[0])), 300), 4)
    first, stride = np.full((T, setting.space.dim), 0.5, np.float32), np.full(T, STRIDE)
    best, base, way = np.full(T, -np.inf), first.copy(), np.zeros_like(first)
    cut: dict[str, int] = {}

    def climb(t, mean):
        base[t] = mean
        found = slope(starts, mean, values[t], actor)
        way[t] = found.gradient / max(float(np.abs(found.gradient).max()), 1e-12)
        if found.window < length:
            cut[arena.names[t]] = min(found.window, cut.get(arena.names[t], length))

    def move(at, observed):
        for t in range(T):
            if observed.score[t] > best[t]:
                best[t] = observed.score[t]
                climb(t, at[t])
            else:
                stride[t] *= 0.5
        return np.clip(base + stride[:, None] * way, 0.0, 1.0).astype(np.float32)

    visits = searched(run, visits_of(run), first, move)
    if cut:
        windows = ", ".join(f"{name} {window}" for name, window in sorted(cut.items()))
        print(
            f"gradient: derivatives explode over {length} steps; truncated to windows of: "
            f"{windows}",
            file=sys.stderr,
        )
    return visits


def sbi(run: MethodRun) -> Visits:
    """The loop of SysID-Bayes with that posterior: the policy is given its mean within Omega."""
    arena: StepsArena = run.arena
    config, sample = run.config.sysid, _posterior(run, int(run.seeds[0]))

    def inferred(obs, mean):
        draws = jnp.asarray(sample(np.concatenate([obs, mean]), config.draws))
        found, _ = within_omega(draws[None], jnp.ones(1, bool), config.least_std)
        return np.asarray(found.mean)

    def move(at, observed):
        return np.stack([inferred(o, m) for o, m in zip(observed.obs, at, strict=True)])

    first = np.full((len(arena.targets), arena.setting.space.dim), 0.5, np.float32)
    visits = searched(run, run.config.iterations + 1, first, move)
    return visits._replace(spent=visits.spent - arena.one.trials)  # the last mean is only scored


def _posterior(run: MethodRun, seed: int) -> Callable[[np.ndarray, int], np.ndarray]:
    """Fitted to visits at points of Omega, each by the policy of another mean."""
    arena: StepsArena = run.arena
    D, count = arena.setting.space.dim, run.config.sysid.simulations
    u, mean = np.split(np.random.default_rng(seed).random((count, 2 * D), np.float32), 2, 1)

    def show(task, *rows):
        return jax.vmap(
            lambda k, m, p: task.observe(task.rollout(k, Law(m), task.space.physical(p)))
        )(*rows)

    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), 400), count)
    obs = arena.program("sbi", show)(keys, jnp.asarray(mean), jnp.asarray(u))
    return npe(u, np.concatenate([np.asarray(obs), mean], 1), seed)
