"""UDR: one policy for all of Omega, by minimising the mean cost (paper, section 6); Table 1's lower
normaliser.

Which cost matters. Eight free gains and a single start state overfit: minimising the mean cost from
the task's own start drives gains into the thousands on a coordinate that this start hardly excites,
beats the best LQR policy of the target itself over 2.5 s, does not converge, and is unstable just
outside Omega. The LQR policies that everything else here uses are optimal from *every* start, so
UDR minimises the mean over starts too: then UDR over a single point is the LQR policy there, and
over Omega all restarts end in one optimum. `experiments/udr_bound.py` shows both.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize
from scipy.stats import qmc

from adaptsim_jax.baselines.problem import Problem
from adaptsim_jax.core.errors import BadInput


class Udr(NamedTuple):
    """`policy`, and the mean cost over Omega (and over starts) that each restart ended with
    `[R]`.
    """

    policy: np.ndarray
    restarts: np.ndarray


def udr(problem: Problem, *, samples_log2: int = 9, restarts: int = 3, seed: int = 0) -> Udr:
    """Minimise the mean cost over `2^samples_log2` scrambled Sobol points of Omega, in double
    precision.

    BFGS with the exact gradient through the rollout, from the mean of the optimal policies and from
    scattered ones, in units of their spread; each run goes on until the gradient of the logarithm
    of the cost is nil.
    """
    if samples_log2 < 4 or restarts < 1:
        raise BadInput(
            f"UDR with 2^{samples_log2} samples and {restarts} restarts: give at least 4 and 1"
        )
    with jax.enable_x64(True):
        sobol = qmc.Sobol(problem.space.dim, rng=seed).random_base2(samples_log2)
        params = problem.space.physical(jnp.asarray(sobol))
        optimal = np.asarray(jax.jit(jax.vmap(problem.policy))(params))
        centre, spread = optimal.mean(0), optimal.std(0)

        @jax.jit
        @jax.value_and_grad
        def objective(z):
            policy = centre + spread * z.reshape(centre.shape)
            return jnp.log(jnp.mean(jax.vmap(lambda p: problem.mean_cost(p, policy))(params)))

        rng = np.random.default_rng(seed)
        starts = [np.zeros(centre.size), *rng.normal(size=(restarts - 1, centre.size))]
        ends = [_minimise(objective, start) for start in starts]
    best = min(ends, key=lambda end: end.fun)
    return Udr(centre + spread * best.x.reshape(centre.shape), np.exp([end.fun for end in ends]))


def _minimise(value_and_grad, start: np.ndarray) -> optimize.OptimizeResult:
    def both(x):
        value, gradient = value_and_grad(x)
        return float(value), np.asarray(gradient, np.float64)

    return optimize.minimize(
        both, start, jac=True, method="BFGS", options={"gtol": 1e-6, "maxiter": 300}
    )
