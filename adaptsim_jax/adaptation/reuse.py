"""Reuse of task policies across nearby parameter distributions (paper, appendix A1), as arrays of
fixed size.

A pool holds task policies, each *anchored* at the mean of the distribution that it was trained for
first. A distribution within `threshold` of an anchor borrows that policy and trains it further with
a shrinking budget, or not at all once the policy has had enough. Others train one of their own and
become anchors. A borrower is never an anchor, so a policy does not spread from one borrower to the
next. Distances are Euclidean between means in unit coordinates.

All of it is for `P` distributions visited at the same time: each of them sees the pool as it was
before. So trajectories that share a pool take their steps together.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from adaptsim_jax import space as spaces
from adaptsim_jax.adaptation.episode import AdaptationEpisode, PolicyTrial, StepPlan, look
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners import replay as ring
from adaptsim_jax.space import Gaussian, Space
from adaptsim_jax.tasks.base import Task


@dataclass(frozen=True)
class ReuseConfig:
    """threshold: D, 0 to reuse nothing and keep no pool. Budgets in trials: first: M; most: M_max,
    a policy that has had as many is not trained again; least: M_min. decay: Alpha, so that a
    policy's j-th training has
    `max(least, decay^(j - 1) first)`. capacity: Anchors that stay, the oldest go. together: Policies
    trained at once.
    """  # noqa: E501

    threshold: float = 0.0
    first: int = 10_000
    most: int = 30_000
    least: int = 2_000
    decay: float = 0.9
    capacity: int = 1000
    together: int = 10


class Pool(NamedTuple):
    """Anchors `mean [C, D]` and their `policy [C, ...]`. taught `[C]` int32: J, distributions that
    the policy was trained with. spent `[C]` int32: Trials that it has had in all. count `[]` int32:
    Anchors ever made.
    """

    mean: Array
    policy: Any
    taught: Array
    spent: Array
    count: Array


class Loan(NamedTuple):
    """policy `[P, ...]` to go on from; place `[P]` int32 of its anchor in the pool, -1 for one of
    its own. budget `[P]` int32: Trials to train it with now.
    """

    policy: Any
    place: Array
    budget: Array


def empty_pool(config: ReuseConfig, dim: int, policy: Any) -> Pool:
    """No anchors yet, for policies shaped like `policy` (arrays or shapes)."""
    none = jnp.zeros(config.capacity, jnp.int32)
    return Pool(
        jnp.zeros((config.capacity, dim)),
        ring.empty(policy, config.capacity),
        none,
        none,
        jnp.zeros((), jnp.int32),
    )


def shared_pool(config: ReuseConfig, mean: Array, policy: Any) -> Pool:
    """One anchor at `mean [D]`, whose `policy` has had all the training that it gets here: lent to
    whatever is near.
    """
    pool = empty_pool(config, mean.shape[0], policy)

    def put(old, value):
        return old.at[0].set(value)

    return Pool(
        put(pool.mean, mean),
        jax.tree.map(put, pool.policy, policy),
        put(pool.taught, 1),
        put(pool.spent, config.most),
        jnp.ones((), jnp.int32),
    )


def lend(pool: Pool, config: ReuseConfig, means: Array, own: Any) -> Loan:
    """What each of `means [P, D]` goes on from: the nearest anchor's policy if it is near enough,
    else `own [P, ...]`.
    """
    there = jnp.arange(config.capacity) < pool.count
    distance = jnp.linalg.norm(means[:, None] - pool.mean[None], axis=-1)
    distance = jnp.where(there[None], distance, jnp.inf)
    nearest = jnp.argmin(distance, -1).astype(jnp.int32)
    near = jnp.min(distance, -1) < config.threshold
    again = jnp.maximum(
        config.least, config.first * config.decay ** pool.taught[nearest].astype(means.dtype)
    )
    again = jnp.where(pool.spent[nearest] >= config.most, 0, jnp.round(again).astype(jnp.int32))
    budget = jnp.where(near, again, config.first).astype(jnp.int32)
    policy = jax.tree.map(lambda old, new: _where(near, old[nearest], new), pool.policy, own)
    return Loan(policy, jnp.where(near, nearest, -1), budget)


def settle(pool: Pool, config: ReuseConfig, means: Array, policies: Any, loan: Loan) -> Pool:
    """The pool after `policies [P, ...]` came out of the training that `loan` asked for at `means
    [P, D]`.

    Where several borrowed from one anchor at once, all their trainings count, and the first one's
    policy stays.
    """
    P, C = means.shape[0], config.capacity
    order = jnp.arange(P, dtype=jnp.int32)
    trained = (loan.place >= 0) & (loan.budget > 0)
    place = jnp.where(trained, loan.place, C)  # C is past the end: dropped
    first = jnp.full(C + 1, P, jnp.int32).at[place].min(order)
    keeps = jnp.where(first[place] == order, place, C)
    policy = jax.tree.map(
        lambda old, new: old.at[keeps].set(new, mode="drop"), pool.policy, policies
    )
    pool = pool._replace(
        policy=policy,
        taught=pool.taught.at[place].add(1, mode="drop"),
        spent=pool.spent.at[place].add(loan.budget, mode="drop"),
    )
    new = loan.place < 0
    row = jnp.where(new, (pool.count + jnp.cumsum(new) - 1) % C, C)

    def put(old, value):
        return old.at[row].set(value, mode="drop")

    return Pool(
        put(pool.mean, means),
        jax.tree.map(put, pool.policy, policies),
        put(pool.taught, jnp.ones(P, jnp.int32)),
        put(pool.spent, loan.budget),
        pool.count + jnp.sum(new, dtype=jnp.int32),
    )


def train_loans(keys: Array, train_many, dists: Any, loan: Loan, together: int) -> Any:
    """Policies `[P, ...]` after their budgets: `together` at a time, those with like budgets side
    by side.

    `train_many(keys, dists, policies, budgets)` takes as long as its largest budget, so that
    sorting makes a budget of nothing cost next to nothing inside one compiled program.
    """
    P = loan.budget.shape[0]
    order = jnp.argsort(-loan.budget)

    def groups(x):
        return x[order].reshape(P // together, together, *x.shape[1:])

    work = jax.tree.map(groups, (keys, dists, loan.policy, loan.budget))
    done = jax.lax.map(lambda w: train_many(*w), work)
    back = jnp.argsort(order)
    return jax.tree.map(lambda x: x.reshape(P, *x.shape[2:])[back], done)


def check(config: ReuseConfig, parallel: int) -> None:
    """BadInput where the budgets or sizes make no sense for `parallel` distributions visited at
    once.
    """
    if config.threshold < 0 or not 0 < config.decay <= 1:
        raise BadInput(f"reuse: threshold must be at least 0 and decay in (0, 1], got {config}")
    if not 0 <= config.least <= config.first <= config.most:
        raise BadInput(
            f"reuse: budgets least {config.least}, first {config.first}, most {config.most} must "
            "not decrease; reorder them"
        )
    if config.capacity < parallel:
        raise BadInput(
            f"reuse: capacity {config.capacity} is below the {parallel} visited at once; use at "
            f"least {parallel}"
        )
    if config.together < 1 or parallel % config.together:
        raise BadInput(
            f"reuse: together = {config.together} must divide the {parallel} visited at once"
        )


def _where(mask: Array, x: Array, y: Array) -> Array:
    return jnp.where(mask.reshape(-1, *(1,) * (x.ndim - 1)), x, y)


class Reusing(NamedTuple):
    """episodes `[P, ...]`. pool: After all of them. budgets `[P, I + 1]` int32: Trials that each
    visit's policy was trained with; reused `[P, I + 1]` bool: whether it was lent.
    """

    episodes: AdaptationEpisode
    pool: Pool
    budgets: Array
    reused: Array


class BegunTrajectories(NamedTuple):
    """`P` trajectories before their first visit: keys, E, policies `[P, ...]` that are untrained
    (what a visit far from every anchor starts from), and targets `[P, D]` (physical).
    """

    keys: Array
    dists: Gaussian
    policies: Any
    targets: Array


def run_reusing(
    begun: BegunTrajectories, task: Task, act: Any, pool: Pool, config: ReuseConfig, plan: StepPlan
) -> Reusing:
    """Adapt all trajectories to their targets with `act(key, obs) -> action [D]`, step by step."""
    references = jax.vmap(task.reference)(begun.targets)

    def look_at(run, noise, *attempt):
        return look(run, noise, task, PolicyTrial(*attempt), plan.noise)

    def one(carry, number):
        dists, pool = carry
        parts = visit_keys(begun, number)
        loan = lend(pool, config, dists.mean, begun.policies)
        trained = train_loans(parts[:, 0], task.train_many, dists, loan, config.together)
        pool = settle(pool, config, dists.mean, trained, loan)
        attempts = (dists, trained, begun.targets, references)
        now = jax.vmap(look_at)(parts[:, 1], parts[:, 2], *attempts)
        action, after = move(begun, task.space, act, plan, dists, now.obs, number)
        return (after, pool), (now, action, loan.budget, loan.place >= 0)

    (_, pool), found = jax.lax.scan(one, (begun.dists, pool), jnp.arange(plan.steps + 1))
    visits, actions, budgets, reused = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), found)
    return Reusing(AdaptationEpisode(*visits, action=actions[:, :-1]), pool, budgets, reused)


def visit_keys(begun: BegunTrajectories, number: Array | int) -> Array:
    """`[P, 4]` for visit `number`: to train, to run, of the observation's noise, to act."""
    return jax.vmap(lambda k: jax.random.split(jax.random.fold_in(k, number), 4))(begun.keys)


def move(
    begun: BegunTrajectories,
    space: Space,
    act: Any,
    plan: StepPlan,
    dists: Gaussian,
    obs: Array,
    number: Array | int,
) -> tuple[Array, Gaussian]:
    """The actions `[P, D]` after visit `number` of `obs [P, D + obs_dim]`, and E after them."""
    keys, size = visit_keys(begun, number)[:, 3], plan.size(number)
    action = jax.vmap(act)(keys, obs)
    if plan.guide is not None:
        lead = jax.vmap(plan.guide, (0, 0, 0, 0, 0, None))
        action = lead(begun.keys, keys, action, dists.mean, begun.targets, size)
    return action, jax.vmap(lambda d, a: spaces.step(space, d, a, size))(dists, action)
