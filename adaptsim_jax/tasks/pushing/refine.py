"""A push for a goal, corrected by trying it in the simulator at the mean of E before it is made.

A NAF network is a few centimetres off where the patch begins. The simulator is at hand, so a push
can be tried there first and mended by where its bottle ends: no push of the target is spent, and
nothing is learned of the target.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from adaptsim_jax.tasks.pushing import model

_LEAP = 0.4  # of the action's range [-1, 1]: the farthest that one correction goes
_GRID = (17, 13)  # speeds and angles
_WITHIN = 6  # pushes of the guide for one of the simulator
_DAMPING = (
    1e-3,
    0.3,
    8.0,
)  # of the steps, m^2: at first, and its factors after a success and a failure

Push = Callable[[jax.Array], jax.Array]


def refine(
    push: Push, goal: jax.Array, action: jax.Array, trials: int, guide: Push | None = None
) -> jax.Array:
    """The best of `trials` simulated pushes for `goal [2]` m, the first of them `action [2]` in
    [-1, 1].

    `push(action [2] in [-1, 1]) -> [2]` m, where the bottle ends. Damped steps of Gauss and Newton
    with a slope that is not computed: a guess, mended by what each trial shows (Broyden 1965).
    `guide`: a cheaper simulator, alike, to take the steps in instead (`_guided`).
    """
    if guide is not None:
        return _guided(push, goal, action, trials, guide)

    def one(carry, _):
        tried, best, miss, slope, damping = carry
        new = push(tried) - goal
        away = tried - best
        slope = slope + jnp.outer(new - miss - slope @ away, away) / jnp.maximum(away @ away, 1e-6)
        better = new @ new < miss @ miss
        best, miss = jnp.where(better, tried, best), jnp.where(better, new, miss)
        damping = damping * jnp.where(better, _DAMPING[1], _DAMPING[2])
        return (_ahead(best, miss, slope, damping), best, miss, slope, damping), None

    miss = push(action) - goal
    slope, damping = _guess(miss + goal, action), jnp.asarray(_DAMPING[0], miss.dtype)
    begin = (_ahead(action, miss, slope, damping), action, miss, slope, damping)
    return jax.lax.scan(one, begin, length=trials - 1)[0][1]


def search(
    push: Push,
    goals: jax.Array,
    actions: jax.Array,
    trials: int,
    wide: jax.Array | bool = True,
    guide: Push | None = None,
) -> jax.Array:
    """For each of `goals [N, 2]` m the better of two refined actions `[N, 2]`: the one given, and
    the best of a grid for all goals; where `wide []` is false, the one given. The grid's pushes are
    simulated by `guide` where there is one.

    For what is deployed: a bottle may reach a goal across the patch or beside it, and no step leads
    from one to the other.
    """
    grid = jnp.stack(
        jnp.meshgrid(*(jnp.linspace(-1.0, 1.0, n) for n in _GRID), indexing="ij"), -1
    ).reshape(-1, 2)
    ends = jax.vmap(guide or push)(grid)
    nearest = grid[jnp.argmin(jnp.sum((ends[None] - goals[:, None]) ** 2, -1), 1)]
    found = jnp.stack(
        [
            jax.vmap(lambda g, a: refine(push, g, a, trials, guide))(goals, a)
            for a in (actions, nearest)
        ]
    )
    apart = jnp.sum((jax.vmap(jax.vmap(push))(found) - goals[None]) ** 2, -1)
    return jnp.where(((apart[1] < apart[0]) & wide)[:, None], found[1], found[0])


def _guided(push: Push, goal: jax.Array, action: jax.Array, trials: int, guide: Push) -> jax.Array:
    """The best of `trials` pushes, each solved for in `guide` as shifted by what the last one was
    off it by (space mapping, Bandler et al. 1994). The last is not simulated unless it has to be
    compared: one trial is the guide's own solution.
    """

    def solve(shift, begin):
        return refine(lambda a: guide(a) + shift, goal, begin, _WITHIN)

    first = solve(jnp.zeros_like(goal), action)
    if trials == 1:
        return first

    def one(carry, _):
        tried, best, least = carry
        end = push(tried)
        off = jnp.sum((end - goal) ** 2)
        better = off < least
        after = solve(jnp.where(jnp.isfinite(end), end - guide(tried), 0.0), tried)
        return (after, jnp.where(better, tried, best), jnp.where(better, off, least)), None

    return jax.lax.scan(one, (first, first, jnp.asarray(jnp.inf, goal.dtype)), length=trials)[0][1]


def _ahead(action, miss, slope, damping) -> jax.Array:
    """The next action to try."""
    (a, b), (_, c) = slope.T @ slope + damping * jnp.eye(2)
    x, y = slope.T @ miss
    step = -jnp.stack([c * x - b * y, a * y - b * x]) / (a * c - b * b)
    return jnp.clip(action + jnp.clip(step, -_LEAP, _LEAP), -1.0, 1.0)


def _guess(final: jax.Array, action: jax.Array) -> jax.Array:
    """`[2, 2]`: what a change of `action` does to `final`, for a bottle that slides along the push
    as far as its speed squared.
    """
    low, high = jnp.asarray(model.ACTION_LOW), jnp.asarray(model.ACTION_HIGH)
    half = ((high - low) / 2).astype(final.dtype)
    speed = (low + high)[0] / 2 + action[0] * half[0]
    went = final - jnp.asarray(model.START, final.dtype)
    aside = jnp.stack([-went[1], went[0]])
    return jnp.stack([2.0 * went / speed * half[0], aside * half[1]], 1)
