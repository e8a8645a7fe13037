"""Derivatives through the scooping engine put to use: a smoothed chance of success, and a modulus fitted to a trajectory.

Success is a step in the piece's height over the blade, so its derivative is nothing almost everywhere. Here the step is a
logistic curve `width` m wide, averaged over errors of execution. The derivatives are those of the engine between switches (a
point that enters contact, the blade that is held over the table); a trial that balances on a switch has none worth using, and
an average of derivatives is then not the derivative of the average. `experiments/scooping_gradient.py` measures how much.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.models import scooping as model
from adaptsim_jax.models import scooping_hydro as hydro
from adaptsim_jax.models.scooping import ScoopOptions
from adaptsim_jax.models.scooping_hydro import Numerics, Scoop

Array = Any
SHORTEST = 2.0**-10  # share of a Gauss-Newton step below which the search along it is given up


class ModulusFit(NamedTuple):
    """modulus Pa; error: root of the mean squared distance of the tracks m; steps: of Gauss-Newton; moduli: visited `[steps + 1]`."""

    modulus: float
    error: float
    steps: int
    moduli: list[float]


def smooth_success(out: Scoop, width: float = 1e-3) -> Array:
    """`[]` in (0, 1): how far the piece's centre is over the blade's face and over the spatula, by logistic curves of `width` m."""
    step = lambda room: jax.nn.sigmoid(room / width)
    back = -(model.BLADE_HALF[0] * 2 + model.NECK_HALF[0] * 2 + model.RADIUS)
    return step(out.above - model.RISEN) * step(out.ahead - back) * step(model.RADIUS - out.ahead)


def smooth_chance(
    params: Array,
    action: Array,
    errors: Array,
    options: ScoopOptions = ScoopOptions(),  # noqa: B008
    numerics: Numerics = Numerics(),  # noqa: B008
    width: float = 1e-3,
) -> Array:
    """`[]`: smoothed success of `action [3]` (rad, rad/s, m) at `params [4]`, averaged over `errors [N, 2]` of pitch and rate.

    Pure; differentiable by all of params but the shape, and by the action.
    """

    def one(error):
        done = action + jnp.concatenate([error, jnp.zeros(1, error.dtype)])
        return smooth_success(hydro.rollout(params, done, options, numerics), width)

    return jax.vmap(one)(errors).mean()


def track_until(seconds: float, options: ScoopOptions, numerics: Numerics) -> Callable[[Array, Array], Array]:
    """`track(params [4], action [3]) -> [T, 3]`: the piece's x, z m and angle rad, a row a step, for the first `seconds`."""
    rows = round(seconds / numerics.dt) + 1
    return lambda params, action: hydro.rollout(params, action, options, numerics).piece[:rows]


def fit_modulus(
    seen: np.ndarray,
    params: np.ndarray,
    action: np.ndarray,
    *,
    seconds: float = 0.4,
    options: ScoopOptions = ScoopOptions(),  # noqa: B008
    numerics: Numerics = Numerics(),  # noqa: B008
    steps: int = 30,
) -> ModulusFit:
    """The modulus with which the engine's track comes nearest to `seen [T, 2]` (x, z m), in a trial whose other numbers are known.

    Gauss-Newton on the logarithm of the modulus from `params[1]`, with the derivative of the engine; a step is halved until the
    error falls. Runs in the precision that JAX is told to use; float64 is worth its time here.
    """
    track = track_until(seconds, options, numerics)
    kind = jnp.result_type(float)
    seen, known, done = (jnp.asarray(v, kind) for v in (seen, params, action))

    def apart(log_modulus):
        here = track(known.at[1].set(jnp.exp(log_modulus)), done)[:, :2]
        return (here - seen).ravel()

    both = jax.jit(lambda z: (apart(z), jax.jacfwd(apart)(z)))
    error = jax.jit(lambda z: jnp.mean(jnp.square(apart(z))))
    low, high = np.log(model.PHYSICAL_LOW[1]), np.log(model.PHYSICAL_HIGH[1])
    z = float(np.log(params[1]))
    least, visited = float(error(z)), [float(np.exp(z))]
    for _ in range(steps):
        wrong, slope = (np.asarray(v, float) for v in both(z))
        step = -float(slope @ wrong) / max(float(slope @ slope), 1e-30)
        step, share = float(np.clip(step, -1.5, 1.5)), 1.0
        while share > SHORTEST:
            new = float(np.clip(z + share * step, low, high))
            if (now := float(error(new))) < least:
                break
            share /= 2
        else:
            break
        z, least = new, now
        visited.append(float(np.exp(z)))
    return ModulusFit(visited[-1], float(np.sqrt(least)), len(visited) - 1, visited)
