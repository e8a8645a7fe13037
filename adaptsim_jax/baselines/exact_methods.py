"""The methods on tasks whose policy is solved exactly.

Each returns the means of E that it visited in every target, for every seed.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.adaptation.analytic import Analytic, AnalyticConfig
from adaptsim_jax.adaptation.phase1 import Phase1, Phase1Hyper, make_phase1
from adaptsim_jax.adaptation.phase2 import adapt_many, stack, starts_of, train_many
from adaptsim_jax.baselines.arena import MethodRun, Visits
from adaptsim_jax.baselines.sysid import make_sysid, mixture_estimator, point_estimator
from adaptsim_jax.core.progress import silent
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.registry import make_task

# ---------------------------------------------------------------- gradient descent
#
# Gradient descent on the mean of E through the policy's training and its rollout in the target.
#
# For one target this descends the outer problem of the paper (eq. 1) itself. It needs the
# derivative of the target's cost, so the target must be differentiable: a simulated one, or a model
# of the real one. It is no method for a robot, but it says what the parameterization allows with as
# many target evaluations as the others use. See `docs/howto/differentiable.md`.

Slope = Callable[[Array, Array], tuple[Array, Array]]
LONGEST_MOVE = 0.25  # of the range, for any parameter in one step


class DescentState(NamedTuple):
    """What the next step needs: `u [D]` in unit coordinates, the gradient there `[D]`, and the
    stride `[]`.
    """

    u: Array
    gradient: Array
    stride: Array


class DescentInfo(NamedTuple):
    """What was seen at the mean that a step arrived at: `u [D]`, and the cost there `[]`."""

    u: Array
    cost: Array


def init(slope: Slope, u: Array, target: Array) -> tuple[DescentState, DescentInfo]:
    """Evaluate the first mean `u [D]` in `target [D]` (physical). `slope(u, target) -> (cost [],
    gradient [D])`.
    """
    cost, gradient = _log_slope(slope, u, target)
    stride = 0.1 / jnp.maximum(jnp.max(jnp.abs(gradient)), 1e-12)
    return DescentState(u, gradient, stride), DescentInfo(u, cost)


def step(slope: Slope, state: DescentState, target: Array) -> tuple[DescentState, DescentInfo]:
    """One projected gradient step on the logarithm of the cost, which makes strides free of its
    unit.

    The stride is Barzilai and Borwein's (1988): one evaluation a step, no line search, not
    monotone.
    """
    longest = LONGEST_MOVE / jnp.maximum(jnp.max(jnp.abs(state.gradient)), 1e-12)
    u = jnp.clip(state.u - jnp.minimum(state.stride, longest) * state.gradient, 0.0, 1.0)
    cost, gradient = _log_slope(slope, u, target)
    moved, turned = u - state.u, gradient - state.gradient
    curvature = jnp.sum(moved * turned)
    stride = jnp.where(
        curvature > 1e-12, jnp.sum(moved**2) / jnp.maximum(curvature, 1e-12), 2.0 * state.stride
    )
    return DescentState(u, gradient, stride), DescentInfo(u, cost)


def descend(slope: Slope, u: Array, target: Array, iterations: int = 10) -> DescentInfo:
    """`init` and `iterations` steps: `DescentInfo` with a leading axis `[iterations + 1]`. Pure;
    vmap over starts and targets.
    """
    state, first = init(slope, u, target)
    _, rest = jax.lax.scan(lambda s, _: step(slope, s, target), state, None, length=iterations)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest)


def _log_slope(slope: Slope, u: Array, target: Array) -> tuple[Array, Array]:
    cost, gradient = slope(u, target)
    gradient = gradient / cost
    return cost, jnp.where(jnp.isfinite(gradient), gradient, 0.0)


def task_of(run: MethodRun, late: bool) -> Task:
    """The task as AdaptSim sees it; `late`: 12 points in the last 0.5 s only (the paper's State
    variants).
    """
    late_only = {"observation": "late"} if late else {}
    return make_task(run.arena.task_name, {**run.arena.task_options, **late_only})


def adaptsim_means(
    phase1: Phase1,
    hypers: Sequence[Phase1Hyper],
    seeds: np.ndarray,
    targets: np.ndarray,
    *,
    starts: int = 2,
    iterations: int = 10,
    report: Callable = silent,
) -> np.ndarray:
    """Means visited `[H, T, S, N, iterations + 1, D]` for each of `hypers` (H), `targets [T, D]`
    and `seeds [S]`.

    One compiled Phase 1 serves all `H x S` runs, and one Phase 2 all targets. The N starts are
    drawn from a run's own S_E, with its own seed.
    """
    every = np.tile(np.asarray(seeds), len(hypers))
    many = stack([hyper for hyper in hypers for _ in seeds])
    trained = train_many(phase1, many, every, progress=report)
    first = starts_of(phase1, trained, every, starts)
    means = np.asarray(adapt_many(phase1, trained, first, targets, iterations=iterations).mean)
    return means.reshape(len(hypers), len(seeds), *means.shape[1:]).swapaxes(1, 2)


def adaptsim(run: MethodRun, late: bool = False) -> Visits:
    """Phase 1 from scratch for every seed, Phase 2 in every target."""
    config = run.config
    means = adaptsim_means(
        make_phase1(task_of(run, late), config.train.phase1),
        [config.train.hyper],
        run.seeds,
        run.targets,
        starts=config.starts,
        iterations=config.iterations,
        report=run.report,
    )
    return Visits(means[0], config.starts * (config.iterations + 1))


def adaptsim_analytic(run: MethodRun) -> Visits:
    """AdaptSim with steps of any size, whose policy is trained by the gradient of the logarithm of
    the cost through simulated adaptation. As many trajectories of it as Phase 1 has, as many target
    trials. Starts are drawn from Omega, as those in S_E are.
    """
    config, made = run.config, task_of(run, late=False)
    N, I, sizes = config.starts, config.iterations, config.train.phase1
    analytic = Analytic(
        made,
        lambda trajectory: jnp.log(trajectory.cost),
        AnalyticConfig(
            *(sizes.trajectories, sizes.parallel, sizes.horizon, sizes.hidden),
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


def sysid(run: MethodRun, estimator: Callable, late: bool = False) -> Visits:
    """One SysID baseline; the observation is the plain one of the paper, standardised by the
    baseline itself.
    """
    options = {k: v for k, v in run.arena.task_options.items() if k in run.problem.space.names}
    plain = {"scaling": "paper", "reference": "optimum", "observation": "late" if late else "full"}
    task = make_task(run.arena.task_name, options | plain)
    config = replace(run.config.sysid, iterations=run.config.iterations)
    adapt = jax.jit(jax.vmap(make_sysid(task, estimator, config), in_axes=(0, None)))
    out = []
    for i, target in enumerate(run.targets):
        keys = jax.vmap(lambda s, i=i: jax.random.fold_in(jax.random.key(s), i))(run.seeds)
        out.append(np.asarray(adapt(keys, jnp.asarray(target, jnp.float32))))
        run.report(i + 1, len(run.targets))
    return Visits(np.stack(out)[:, :, None], config.iterations + 1)


def gradient(run: MethodRun) -> Visits:
    """Gradient descent from as many random starts as AdaptSim has. Its trials are gradients of the
    target's cost.
    """
    N, D = run.config.starts, run.problem.space.dim
    with jax.enable_x64(True):
        starts = jax.vmap(lambda s: jax.random.uniform(jax.random.key(s), (N, D), jnp.float64))(
            run.seeds
        )

        def one(u, target):
            return descend(run.problem.slope, u, target, run.config.iterations).u

        over = jax.jit(jax.vmap(jax.vmap(jax.vmap(one, (0, None)), (0, None)), (None, 0)))
        means = np.asarray(over(starts, jnp.asarray(run.targets, jnp.float64)))
    return Visits(means, N * (run.config.iterations + 1))


def adaptsim_state(run: MethodRun) -> Visits:
    return adaptsim(run, late=True)


def sysid_bayes(run: MethodRun) -> Visits:
    return sysid(run, mixture_estimator)


def sysid_bayes_state(run: MethodRun) -> Visits:
    return sysid(run, mixture_estimator, late=True)


def sysid_point(run: MethodRun) -> Visits:
    return sysid(run, point_estimator)


def sysid_point_state(run: MethodRun) -> Visits:
    return sysid(run, point_estimator, late=True)
