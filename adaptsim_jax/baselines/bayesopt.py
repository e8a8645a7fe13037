"""BayesOpt: the mean of E chosen by what its policy earned in the target (Muratore et al. 2021;
paper, section 6.2).
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import linalg, optimize, stats
from scipy.stats import qmc

from adaptsim_jax.baselines.adapting import first_policies
from adaptsim_jax.baselines.arena import Memory, MethodRun, Visits, lanes, two_keys
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.space import gaussian

# ---------------------------------------------------------------- Gaussian process
#
# A small Gaussian process with expected improvement, for maximising a noisy function on the unit
# box from few values.
#
# Rasmussen and Williams, "Gaussian processes for machine learning" (2006), chapters 2 and 5; Jones
# et al., "Efficient global optimization" (1998). Matern 5/2 with a length for each coordinate,
# double precision, NumPy and SciPy: tens of values.

JITTER = 1e-8
LENGTHS, NOISES = (
    (0.05, 4.0),
    (1e-3, 1.0),
)  # bounds, in the box's unit and in standard deviations of the values


class GP(NamedTuple):
    """Fitted to `x [n, D]` and values that were standardised with `mean`, `scale`; `lengths [D]`,
    `noise`: standard deviation.
    """

    x: np.ndarray
    weights: np.ndarray  # inverse(K) y
    chol: np.ndarray
    lengths: np.ndarray
    signal: float
    noise: float
    mean: float
    scale: float


def fit(x: np.ndarray, y: np.ndarray, rng: np.random.Generator, restarts: int = 3) -> GP:
    """Lengths, signal and noise by the largest posterior density from `restarts` starts (log-normal
    priors: few values).
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    mean, scale = y.mean(), max(y.std(), 1e-6)
    z, D = (y - mean) / scale, x.shape[1]
    ranges = [LENGTHS] * D + [(0.05, 20.0), NOISES]
    bounds = [tuple(np.log(ends)) for ends in ranges]
    starts = [np.log([0.5] * D + [1.0, 0.2])]
    starts += [rng.uniform(*np.array(bounds).T) for _ in range(restarts - 1)]
    ends = [
        optimize.minimize(_cost, s, (x, z), jac=True, method="L-BFGS-B", bounds=bounds)
        for s in starts
    ]
    best = np.exp(min(ends, key=lambda end: end.fun).x)
    lengths, signal, noise = best[:D], float(best[D]), float(best[D + 1])
    chol = linalg.cholesky(
        _covariance(x, x, lengths, signal) + (noise**2 + JITTER) * np.eye(len(x)), lower=True
    )
    return GP(x, linalg.cho_solve((chol, True), z), chol, lengths, signal, noise, mean, scale)


def predict(gp: GP, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation `[m]` of the function itself at `x [m, D]`, in the values'
    unit.
    """
    across = _covariance(np.asarray(x, float), gp.x, gp.lengths, gp.signal)
    half = linalg.solve_triangular(gp.chol, across.T, lower=True)
    spread = np.sqrt(np.maximum(gp.signal - (half**2).sum(0), 1e-12))
    return gp.mean + gp.scale * (across @ gp.weights), gp.scale * spread


def expected_improvement(gp: GP, x: np.ndarray, best: float) -> np.ndarray:
    """`[m]`: by how much the function at `x [m, D]` is expected to exceed `best`."""
    mean, spread = predict(gp, x)
    z = (mean - best) / spread
    return (mean - best) * stats.norm.cdf(z) + spread * stats.norm.pdf(z)


def propose(gp: GP, rng: np.random.Generator, candidates: int = 2048) -> np.ndarray:
    """The point `[D]` of the unit box with the largest expected improvement over the best mean at a
    known point.

    Random candidates, half of them around the best known points; the best three are refined.
    """
    D = gp.x.shape[1]
    known = predict(gp, gp.x)[0]
    around = gp.x[np.argsort(-known)[:3]][rng.integers(0, min(3, len(known)), candidates // 2)]
    near = np.clip(around + 0.1 * rng.normal(size=around.shape), 0.0, 1.0)
    tried = np.concatenate([rng.uniform(size=(candidates - len(near), D)), near])

    def value(u):
        return -float(expected_improvement(gp, u[None], known.max())[0])

    first = tried[np.argsort(-expected_improvement(gp, tried, known.max()))[:3]]
    ends = [optimize.minimize(value, u, method="L-BFGS-B", bounds=[(0.0, 1.0)] * D) for u in first]
    return np.clip(min(ends, key=lambda end: end.fun).x, 0.0, 1.0)


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs(a[:, None] - b[None])


def _covariance(a: np.ndarray, b: np.ndarray, lengths: np.ndarray, signal: float) -> np.ndarray:
    r = np.sqrt(5.0 * ((_distances(a, b) / lengths) ** 2).sum(-1))
    return signal * (1.0 + r + r**2 / 3.0) * np.exp(-r)


def _cost(logs: np.ndarray, x: np.ndarray, z: np.ndarray) -> tuple[float, np.ndarray]:
    """Negative log posterior and its gradient by the logarithms of lengths, signal and noise."""
    D, n = x.shape[1], len(z)
    lengths = np.exp(logs[:D])
    signal, noise = np.exp(logs[D]), np.exp(logs[D + 1])
    squares = (_distances(x, x) / lengths) ** 2
    r = np.sqrt(5.0 * squares.sum(-1))
    kernel = signal * (1.0 + r + r**2 / 3.0) * np.exp(-r)
    chol = linalg.cholesky(kernel + (noise**2 + JITTER) * np.eye(n), lower=True)
    inverse = linalg.cho_solve((chol, True), np.eye(n))
    weights = inverse @ z
    inner = 0.5 * (inverse - np.outer(weights, weights))  # derivative of the cost by the covariance
    by_length = (
        5.0 / 3.0 * signal * (1.0 + r) * np.exp(-r)
    )  # times a coordinate's square: dK / d log length
    slopes = [np.sum(inner * by_length * squares[..., i]) for i in range(D)]
    slopes += [np.sum(inner * kernel), 2.0 * noise**2 * np.trace(inner)]
    centre = np.log([0.5] * D + [1.0, 0.2])
    width = np.array([0.75] * D + [1.0, 1.0])
    deviation = (logs - centre) / width
    cost = 0.5 * z @ weights + np.log(np.diag(chol)).sum() + 0.5 * deviation @ deviation
    return float(cost), np.array(slopes) + deviation / width


@dataclass(frozen=True)
class BayesOptConfig:
    """initial: points of a Latin hypercube before the first choice. points: In all, 0 for as many
    visits as AdaptSim makes.
    """

    initial: int = 12
    points: int = 0

    def __post_init__(self):
        if self.initial < 2 or self.points < 0:
            raise BadInput(
                f"BayesOpt: initial = {self.initial}, points = {self.points}; give at least 2 and 0"
            )


def bayesopt(run: MethodRun) -> Visits:
    """A task policy trained anew at each point; the return of a visit's trials goes to a Gaussian
    process.

    The row's iterations are points; a policy is scored as every other method's, over the test
    contexts.
    """
    arena, config = run.arena, run.config.bayesopt
    total = config.points or run.config.starts * (run.config.iterations + 1)
    batch = lanes(len(arena.targets), run.seeds, 1, label=7)
    space, D = arena.one.task.space, arena.one.task.space.dim
    rngs = [
        np.random.default_rng([7, int(run.seeds[s]), int(t)])
        for t, s in zip(batch.where, batch.seed, strict=True)
    ]
    initial = min(config.initial, total)
    points = np.zeros((len(rngs), total, D))
    points[:, :initial] = [qmc.LatinHypercube(D, rng=rng).random(initial) for rng in rngs]
    returns, rewards = np.zeros((len(rngs), total)), np.zeros((len(rngs), total))
    memory = Memory(arena, batch, total)
    for i in range(total):
        if i >= initial:
            for b, rng in enumerate(rngs):
                points[b, i] = propose(fit(points[b, :i], returns[b, :i], rng), rng)
        train_keys, visit_keys = two_keys(batch.at(i))
        dists = jax.vmap(lambda m: gaussian(space, m))(jnp.asarray(points[:, i], jnp.float32))
        policies = arena.train(
            train_keys, dists, first_policies(run, batch, arena.untrained(train_keys))
        )
        observed = arena.visit(visit_keys, batch.where, memory.visiting(policies))
        rewards[:, i] = arena.score(batch.where, memory.deployed(policies))
        memory.add(observed.trials)
        returns[:, i] = observed.score
        run.report(i + 1, total)
    spent = arena.one.trials * np.arange(1, total + 1)
    return Visits(batch.grid(points), spent, batch.grid(rewards))
