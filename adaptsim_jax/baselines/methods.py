"""The baselines of tasks whose policy is solved exactly.

Each returns the means of E that it visited in every target, for every seed.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.analytic import AnalyticConfig, make_analytic
from adaptsim_jax.baselines import gradient
from adaptsim_jax.baselines.adaptsim_row import adaptsim_means
from adaptsim_jax.baselines.config import CompareConfig
from adaptsim_jax.baselines.problem import Problem
from adaptsim_jax.baselines.sysid_bayes import make_sysid_bayes
from adaptsim_jax.baselines.sysid_point import make_sysid_point
from adaptsim_jax.core.progress import silent
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.registry import make_task


class Run(NamedTuple):
    """What a method is given: the comparison's config, the targets `[T, D]` (physical), seeds
    `[S]`, and a report.
    """

    task_name: str
    task_options: dict
    config: CompareConfig
    problem: Problem
    targets: np.ndarray
    seeds: np.ndarray
    report: Callable = silent


class Visits(NamedTuple):
    """`means [T, S, N, I + 1, D]` in unit coordinates, and target rollouts spent on one target by
    one seed.
    """

    means: np.ndarray
    target_trials: int


def task_of(run: Run, late: bool) -> Task:
    """The task as AdaptSim sees it; `late`: 12 points in the last 0.5 s only (the paper's State
    variants).
    """
    return make_task(
        run.task_name, {**run.task_options, "observation": "late"} if late else run.task_options
    )


def adaptsim(run: Run, late: bool = False) -> Visits:
    """Phase 1 from scratch for every seed, Phase 2 in every target."""
    config = run.config
    means = adaptsim_means(
        task_of(run, late),
        config.train.phase1,
        [config.train.hyper],
        run.seeds,
        run.targets,
        starts=config.starts,
        iterations=config.iterations,
        report=run.report,
    )
    return Visits(means[0], config.starts * (config.iterations + 1))


def adaptsim_analytic(run: Run) -> Visits:
    """AdaptSim with steps of any size, whose policy is trained by the gradient of the logarithm of
    the cost through simulated adaptation; as many trajectories of it as Phase 1 has, as many target
    trials. Starts are drawn from Omega, as those in S_E are.
    """
    config, made = run.config, make_task(run.task_name, run.task_options)
    N, I, sizes = config.starts, config.iterations, config.train.phase1
    analytic = make_analytic(
        made,
        lambda trajectory: jnp.log(trajectory.cost),
        AnalyticConfig(
            sizes.trajectories,
            sizes.parallel,
            sizes.horizon,
            sizes.hidden,
            inside=config.train.hyper.inside,
        ),
    )
    targets = jnp.asarray(run.targets, jnp.float32)

    @jax.jit
    def one(seed):
        key = jax.random.key(seed)
        state, _ = analytic.run(analytic.init(key), jnp.arange(analytic.config.updates))
        starts = made.space.sample(jax.random.fold_in(key, 1), (N,))
        return jax.vmap(lambda target: analytic.adapt(state.weights, starts, target, I))(targets)

    means = []
    for i, seed in enumerate(run.seeds):
        means.append(np.asarray(one(seed)))
        run.report(i + 1, len(run.seeds))
    return Visits(np.stack(means, 1), N * (I + 1))


def sysid(run: Run, make: Callable, late: bool = False) -> Visits:
    """One SysID baseline; the observation is the plain one of the paper, standardised by the
    baseline itself.
    """
    options = {k: v for k, v in run.task_options.items() if k in run.problem.space.names}
    plain = {"scaling": "paper", "reference": "optimum", "observation": "late" if late else "full"}
    task = make_task(run.task_name, options | plain)
    config = replace(run.config.sysid, iterations=run.config.iterations)
    adapt = jax.jit(jax.vmap(make(task, config), in_axes=(0, None)))
    out = []
    for i, target in enumerate(run.targets):
        keys = jax.vmap(lambda s, i=i: jax.random.fold_in(jax.random.key(s), i))(run.seeds)
        out.append(np.asarray(adapt(keys, jnp.asarray(target, jnp.float32)).means))
        run.report(i + 1, len(run.targets))
    return Visits(np.stack(out)[:, :, None], config.iterations + 1)


def descend(run: Run) -> Visits:
    """Gradient descent from as many random starts as AdaptSim has. Its trials are gradients of the
    target's cost.
    """
    N, D = run.config.starts, run.problem.space.dim
    with jax.enable_x64(True):
        starts = jax.vmap(lambda s: jax.random.uniform(jax.random.key(s), (N, D), jnp.float64))(
            run.seeds
        )

        def one(u, target):
            return gradient.descend(run.problem.slope, u, target, run.config.iterations).u

        over = jax.jit(jax.vmap(jax.vmap(jax.vmap(one, (0, None)), (0, None)), (None, 0)))
        means = np.asarray(over(starts, jnp.asarray(run.targets, jnp.float64)))
    return Visits(means, N * (run.config.iterations + 1))


def adaptsim_state(run: Run) -> Visits:
    return adaptsim(run, late=True)


def sysid_bayes(run: Run) -> Visits:
    return sysid(run, make_sysid_bayes)


def sysid_bayes_state(run: Run) -> Visits:
    return sysid(run, make_sysid_bayes, late=True)


def sysid_point(run: Run) -> Visits:
    return sysid(run, make_sysid_point)


def sysid_point_state(run: Run) -> Visits:
    return sysid(run, make_sysid_point, late=True)
