"""What the target's own pushes tell beside the choice of E: how far the simulator at E's mean is
off, over parameters and actions.

No E makes the simulator right where the target is of another kind, nor where E is not found yet.
The pushes that adaptation makes anyway show by how much: each is simulated again at the E in
question. What near parameters within Omega explain of the gaps is taken for granted (`nearer`).
What they leave is smoothed over the actions by a Gaussian process (Rasmussen and Williams 2006,
chapter 2; `with_gaps`). Far from all pushes the simulator is believed as it is.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from adaptsim_jax.tasks.pushing import model

_REACH = 0.5  # of the action's range [-1, 1]: how far what a push showed holds
# noise's share of the gaps' spread: a gap is one of a simulator with edges, not of a smooth
# function
_DOUBT = 0.1
_NEAR = 0.15  # of Omega's range: how far from E's mean parameters are looked for
_BLUR, _LARGE = (
    0.01,
    3.0,
)  # m: what counts as a gap; and gaps so many times larger count less than their square
_STEPS, _AHEAD, _LEAP = (
    6,
    0.04,
    0.2,
)  # steps; of Omega's range: of a slope by differences, and the farthest of one step
_DAMPING = (0.1, 0.3, 5.0)  # of the steps: at first, and its factors after a success and a failure


class PushRecord(NamedTuple):
    """Pushes made in the target: actions `[K, 2]` in [-1, 1], places `[K, 2]` m where their bottles
    ended, used `[K]` bool: whether a row counts.
    """

    actions: Array
    places: Array
    used: Array


def nearer(
    end: Callable[[Array, Array], Array],
    mean: Array,
    given: PushRecord,
    guide: Callable[[Array, Array], Array] | None = None,
) -> Array:
    """E's `mean [D]` (unit coordinates) moved within Omega to where `end(u [D], action [2]) -> [2]`
    m puts the target's pushes best.

    A few damped steps of Gauss and Newton (Levenberg, Marquardt) under a Gaussian prior of width
    `_NEAR` around `mean`. Slopes are central differences, for a push that touches the patch's edge
    has none. Without pushes it is `mean` itself. `guide`: a cheaper simulator, alike, that slopes
    are taken from.
    """
    used = given.used & jnp.isfinite(given.places).all(-1)
    places = jnp.where(used[:, None], given.places, 0.0)
    step = _AHEAD * jnp.eye(mean.shape[0], dtype=mean.dtype)

    def miss(u, end=end):
        gap = (
            jnp.where(used[:, None], jax.vmap(lambda a: end(u, a))(given.actions) - places, 0.0)
            / _BLUR
        )
        return (gap / (1.0 + jnp.sum(gap**2, -1, keepdims=True) / _LARGE**2) ** 0.25).reshape(-1)

    about = miss if guide is None else lambda u: miss(u, guide)

    def cost(u, missed):
        return missed @ missed + jnp.sum(((u - mean) / _NEAR) ** 2)

    def one(carry, _):
        u, missed, damping = carry
        slope = jax.vmap(lambda s: (about(u + s) - about(u - s)) / (2 * _AHEAD))(step).T
        curve = slope.T @ slope + jnp.eye(len(mean)) / _NEAR**2
        down = slope.T @ missed + (u - mean) / _NEAR**2
        away = jnp.linalg.solve(curve + damping * jnp.diag(jnp.diag(curve)), down)
        tried = jnp.clip(u - jnp.clip(away, -_LEAP, _LEAP), 0.0, 1.0)
        now = miss(tried)
        better = cost(tried, now) < cost(u, missed)
        damping = damping * jnp.where(better, _DAMPING[1], _DAMPING[2])
        return (jnp.where(better, tried, u), jnp.where(better, now, missed), damping), None

    begin = (mean, miss(mean), jnp.asarray(_DAMPING[0], mean.dtype))
    return jax.lax.scan(one, begin, length=_STEPS)[0][0]


def with_gaps(push: Callable[[Array], Array], given: PushRecord) -> Callable[[Array], Array]:
    """`push(action [2] in [-1, 1]) -> [2]` m, mended by what the target's pushes differ from it by.
    Rows that are not used, or not finite, count for nothing; without any it is `push` itself.
    """
    used = given.used & jnp.isfinite(given.places).all(-1)
    gaps = jnp.where(used[:, None], given.places - jax.vmap(push)(given.actions), 0.0)
    alike = _alike(given.actions, given.actions) * used[:, None] * used[None]
    spread = alike + jnp.diag(jnp.where(used, _DOUBT**2, 1.0))
    weights = jax.scipy.linalg.solve(spread, gaps, assume_a="pos")
    return lambda action: push(action) + (_alike(action[None], given.actions) @ weights)[0]


def _alike(a: Array, b: Array) -> Array:
    """`[A, 2], [B, 2] -> [A, B]`: 1 for the same action, 0 for far ones."""
    return jnp.exp(-0.5 * jnp.sum(((a[:, None] - b[None]) / _REACH) ** 2, -1))


_FARTHEST = 0.4  # of the action's range [-1, 1]: the farthest that one correction goes
_GRID = (17, 13)  # speeds and angles
_WITHIN = 6  # pushes of the guide for one of the simulator
_GUIDED_DAMPING = (
    1e-3,
    0.3,
    8.0,
)  # of the steps, m^2: at first, and its factors after a success and a failure

Push = Callable[[Array], Array]


def refine(push: Push, goal: Array, action: Array, trials: int, guide: Push | None = None) -> Array:
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
        damping = damping * jnp.where(better, _GUIDED_DAMPING[1], _GUIDED_DAMPING[2])
        return (_ahead(best, miss, slope, damping), best, miss, slope, damping), None

    miss = push(action) - goal
    slope, damping = _guess(miss + goal, action), jnp.asarray(_GUIDED_DAMPING[0], miss.dtype)
    begin = (_ahead(action, miss, slope, damping), action, miss, slope, damping)
    return jax.lax.scan(one, begin, length=trials - 1)[0][1]


def search(
    push: Push,
    goals: Array,
    actions: Array,
    trials: int,
    wide: Array | bool = True,
    guide: Push | None = None,
) -> Array:
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
    distance = jnp.sum((jax.vmap(jax.vmap(push))(found) - goals[None]) ** 2, -1)
    return jnp.where(((distance[1] < distance[0]) & wide)[:, None], found[1], found[0])


def _guided(push: Push, goal: Array, action: Array, trials: int, guide: Push) -> Array:
    """The best of `trials` pushes, each solved for in `guide` as shifted by what the last one was
    off it by (space mapping, Bandler et al. 1994). The last is not simulated unless it has to be
    compared: One trial is the guide's own solution.
    """

    def solve(shift, begin):
        return refine(lambda a: guide(a) + shift, goal, begin, _WITHIN)

    first = solve(jnp.zeros_like(goal), action)
    if trials == 1:
        return first

    def one(carry, _):
        tried, best, minimum = carry
        end = push(tried)
        off = jnp.sum((end - goal) ** 2)
        better = off < minimum
        after = solve(jnp.where(jnp.isfinite(end), end - guide(tried), 0.0), tried)
        return (after, jnp.where(better, tried, best), jnp.where(better, off, minimum)), None

    return jax.lax.scan(one, (first, first, jnp.asarray(jnp.inf, goal.dtype)), length=trials)[0][1]


def _ahead(action, miss, slope, damping) -> Array:
    """The next action to try."""
    (a, b), (_, c) = slope.T @ slope + damping * jnp.eye(2)
    x, y = slope.T @ miss
    adjugate = jnp.stack([c * x - b * y, a * y - b * x])
    step = -adjugate / (a * c - b * b)
    return jnp.clip(action + jnp.clip(step, -_FARTHEST, _FARTHEST), -1.0, 1.0)


def _guess(final: Array, action: Array) -> Array:
    """`[2, 2]`: what a change of `action` does to `final`, for a bottle that slides along the push
    as far as its speed squared.
    """
    low, high = jnp.asarray(model.ACTION_LOW), jnp.asarray(model.ACTION_HIGH)
    half = ((high - low) / 2).astype(final.dtype)
    speed = (low + high)[0] / 2 + action[0] * half[0]
    went = final - jnp.asarray(model.START, final.dtype)
    aside = jnp.stack([-went[1], went[0]])
    return jnp.stack([2.0 * went / speed * half[0], aside * half[1]], 1)
