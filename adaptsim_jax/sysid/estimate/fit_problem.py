"""What a fit holds fixed, and where it stands."""

from typing import Any, NamedTuple

from adaptsim_jax.logs.segments import Windows

Array = Any  # of JAX in a trace, of NumPy outside


class FitProblem(NamedTuple):
    """What a fit holds fixed. free `[P]` marks fitted theta; active `[A]` indexes eff (-1: unused slot)."""

    windows: Windows
    mask: Array
    free: Array
    active: Array
    low: Array  # [P + A]
    high: Array
    trial_weight: Array  # [N]
    prior_mean: Array  # [P + A]
    prior_precision: Array


class FitPoint(NamedTuple):
    """Where a fit stands, and the linearisation there: `jac [C-1, L+1, Y, W]` and the Gram matrices `[W, C, C]` of
    `[J_theta | J_active | J_x0 | r]`, all in standard deviations."""

    theta: Array
    eff: Array
    x0: Array  # [S, W]
    residual: Array  # [L+1, Y, W]
    jac: Array
    gram: Array
    window_cost: Array  # [W]
    cost: Array
