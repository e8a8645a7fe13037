"""d(return)/d(E's mean), through the policy that knows E and the simulator's steps: forward mode,
for environments without contact.

Over many steps such derivatives grow without bound where the motion is unstable. They are then
truncated: a window of so many steps counts how an action moves the states after it, and what went
before the window counts for nothing.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.environments.episodes import ActingPolicy, Play

EXPLODES = 10.0  # a return that would change by more than so many times itself over Omega
SHORTEST = 5  # steps of a window


class ReturnSlope(NamedTuple):
    """The mean return `score []` over the starts, its derivative by E's mean `gradient [D]` (unit
    coordinates), and the window [steps] that it was taken over; 0 where none is short enough, and
    the gradient 0.
    """

    score: float
    gradient: np.ndarray
    window: int


def make_slope(play: Play, acting: ActingPolicy, policy_of: Callable[..., Any]) -> Callable:
    """`slope(keys [N], mean [D], values [F], *more) -> ReturnSlope`: over N starts, with the
    longest window whose derivatives do not explode.

    Args:
        play: a simulation, not MuJoCo C. acting, policy_of: of the task's policies,
            `policy_of(mean, *more) -> policy`.
    """

    def score(mean, key, values, window, *more):
        world, policy = play.world(values), policy_of(mean, *more)
        reset_key, act_key = jax.random.split(key)

        def step(carry, row):
            live, memory, on = carry
            key, number = row

            def held(x):
                return jnp.where(number % window == 0, jax.lax.stop_gradient(x), x)

            live = jax.tree.map(held, live)
            action, memory = acting.act(key, policy, memory, live)
            after = play.step(world, live, action)
            return (after, memory, on * (1.0 - after.done)), on * after.reward

        T = play.sim.length
        rows = (jax.random.split(act_key, T), jnp.arange(T))
        start = (play.reset(world, reset_key), acting.start(policy), jnp.ones(()))
        total = jax.lax.scan(step, start, rows)[1].sum()
        return total, total

    @jax.jit
    def every(keys, *rest):
        def one(key):
            return jax.jacfwd(lambda mean, *more: score(mean, key, *more), has_aux=True)(*rest)

        return jax.vmap(one)(keys)

    def slope(keys: jax.Array, mean: Any, values: Any, *more: Any) -> ReturnSlope:
        window = play.sim.length
        mean, values = (jnp.asarray(x, jnp.float32) for x in (mean, values))
        while True:
            gradients, scores = (np.asarray(x) for x in every(keys, mean, values, window, *more))
            steep = np.abs(gradients).max()  # not a number, where one of them is
            if steep <= EXPLODES * (np.abs(scores).mean() + 1e-6):
                return ReturnSlope(float(scores.mean()), gradients.mean(0), window)
            if window <= SHORTEST:
                return ReturnSlope(float(scores.mean()), np.zeros(gradients.shape[1]), 0)
            window = max(window // 2, SHORTEST)

    return slope
