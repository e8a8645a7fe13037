"""The methods that learn the task policy itself from target trials: UDR, UDR+Target, LearnInTarget
(paper, section 6).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax

from adaptsim_jax.baselines.arena import MethodRun, TrialBatch, Visits, lane_keys, lanes
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.one_shot import OneShot, action_grid


@dataclass(frozen=True)
class DirectConfig:
    """budgets: target trials in all after which a policy is scored. LearnInTarget: hidden: Width of
    its one layer; updates with AdamW (rate, decay) on all trials so far. grid: Actions a side that
    its policy chooses among.
    """

    budgets: tuple[int, ...] = (0, 4, 8, 16, 24, 32, 40, 48)
    hidden: int = 64
    updates: int = 1000
    rate: float = 1e-2
    decay: float = 1e-4
    grid: int = 50

    def __post_init__(self):
        if not self.budgets or self.budgets[0] < 0 or any(np.diff(self.budgets) <= 0):
            raise BadInput(
                f"budgets {self.budgets} must rise from 0 or more; give such as 0, 4, 8, 16"
            )
        if min(self.hidden, self.updates, self.grid) < 1:
            raise BadInput(f"LearnInTarget sizes must be positive, got {self}")


def udr(run: MethodRun) -> Visits:
    """One policy for all of Omega; no target data."""
    arena = run.arena
    batch = lanes(len(arena.targets), run.seeds, 1, label=4)
    policies = jax.tree.map(lambda x: x[batch.seed], udr_policies(run))
    return Visits(None, np.zeros(1, int), batch.grid(arena.score(batch.where, policies))[..., None])


def udr_policies(run: MethodRun) -> Any:
    """A UDR policy for each seed `[S, ...]`; trained once for all methods that start from it."""
    if "udr" not in run.shared:
        keys = jax.vmap(lambda s: jax.random.fold_in(jax.random.key(s), 4))(
            jnp.asarray(run.seeds, jnp.uint32)
        )
        train = jax.jit(run.arena.one.train_uniform)
        parts = []
        for i, key in enumerate(keys):
            parts.append(train(key))
            run.report(i + 1, len(keys), "UDR")
        run.shared["udr"] = jax.tree.map(lambda *x: jnp.stack(x), *parts)
    return run.shared["udr"]


def udr_target(run: MethodRun) -> Visits:
    """UDR's policy, tuned on its own trials in the target, all of them so far, at each of the
    budgets.
    """
    arena, budgets = run.arena, run.config.direct.budgets
    batch = lanes(len(arena.targets), run.seeds, 1, label=5)
    policies = jax.tree.map(lambda x: x[batch.seed], udr_policies(run))
    tune = jax.jit(lambda *work: jax.lax.map(lambda w: arena.one.tune(*w), work))
    stored, rewards = _room(arena.one, len(batch.where), budgets[-1]), []
    for i, (before, budget) in enumerate(zip((0, *budgets), budgets, strict=False)):
        explore_keys, tune_keys = lane_keys(batch.at(i), 2)
        if budget > before:
            stored = _keep(
                stored, arena.explored(explore_keys, batch.where, policies, budget - before), before
            )
            used = jnp.full(len(batch.where), budget)
            policies = tune(tune_keys, policies, *map(_device, stored), used)
        rewards.append(arena.score(batch.where, policies))
        run.report(i + 1, len(budgets))
    return Visits(None, np.array(budgets), batch.grid(np.stack(rewards, -1)))


def learn_in_target(run: MethodRun) -> Visits:
    """Random actions in the target, a small network from action to outcome, and the action that it
    thinks best.
    """
    arena, config = run.arena, run.config.direct
    batch = lanes(len(arena.targets), run.seeds, 1, label=6)
    most = config.budgets[-1]
    split = jax.vmap(jax.random.split)(batch.keys)
    contexts = arena.contexts(split[:, 0], max(most, 1))
    shape = (max(most, 1), arena.one.action_dim)
    actions = np.asarray(jax.vmap(lambda k: jax.random.uniform(k, shape, minval=-1.0))(split[:, 1]))
    stored = TrialBatch(contexts, actions, arena.run(batch.where, contexts, actions))
    choose = jax.jit(
        lambda *work: jax.lax.map(lambda w: predicted_best(arena.one, config)(*w), work)
    )
    rewards = []
    for i, budget in enumerate(config.budgets):
        chosen = choose(batch.at(i), *map(_device, stored), jnp.full(len(batch.where), budget))
        rewards.append(arena.score_actions(batch.where, np.asarray(chosen)))
        run.report(i + 1, len(config.budgets))
    return Visits(None, np.array(config.budgets), batch.grid(np.stack(rewards, -1)))


class Predictor(nn.Module):
    """`[p] -> [k]`: one hidden layer."""

    hidden: int
    outputs: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        return nn.Dense(self.outputs)(nn.relu(nn.Dense(self.hidden)(x)))


def predicted_best(one: OneShot, config: DirectConfig) -> Callable:
    """`choose(key, contexts [N, g], actions [N, d], outcomes [N, ...], used []) -> [G + F, d]`:
    actions for the `scored` contexts.

    Trials that failed are left out of the fit. Ties and a network without data fall to the
    first action.
    """
    grid, tests = jnp.asarray(action_grid((config.grid,) * one.action_dim)), jnp.asarray(one.scored)

    def choose(key, contexts, actions, outcomes, used):
        x, y = jax.vmap(one.inputs)(contexts, actions), jax.vmap(one.outputs)(outcomes)
        present = (jnp.arange(len(x)) < used) & jnp.isfinite(y).all(-1)
        y = jnp.where(present[:, None], y, 0.0)
        network: Any = Predictor(config.hidden, y.shape[-1])
        rates = optax.adamw(
            optax.cosine_decay_schedule(config.rate, config.updates), weight_decay=config.decay
        )
        weights = network.init(key, x[0])

        def loss(w):
            wrong = jnp.square(jax.vmap(lambda r: network.apply(w, r))(x) - y).sum(-1)
            return jnp.sum(wrong * present) / jnp.maximum(jnp.sum(present), 1)

        def one_update(_, carry):
            w, opt = carry
            moves, opt = rates.update(jax.grad(loss)(w), opt, w)
            return optax.apply_updates(w, moves), opt

        weights, _ = jax.lax.fori_loop(
            0, config.updates, one_update, (weights, rates.init(weights))
        )

        def best(context):
            outputs = jax.vmap(lambda a: network.apply(weights, one.inputs(context, a)))(grid)
            return grid[jnp.argmax(jax.vmap(one.worth, (0, None))(outputs, context))]

        return jax.lax.map(best, tests)

    return choose


def _room(one: OneShot, B: int, most: int) -> TrialBatch:
    """Empty places for `most` trials of each of `B`; of one, at least, so that shapes exist."""
    most = max(most, 1)
    context = jax.eval_shape(one.draw, jax.random.key(0))
    return TrialBatch(
        np.zeros((B, most, *context.shape), np.float32),
        np.zeros((B, most, one.action_dim), np.float32),
        None,
    )


def _keep(stored: TrialBatch, new: TrialBatch, at: int) -> TrialBatch:
    def put(rows, more):
        rows[:, at : at + more.shape[1]] = more
        return rows

    if stored.outcomes is None:
        most = stored.actions.shape[1]
        outcomes = jax.tree.map(
            lambda x: np.zeros((x.shape[0], most, *x.shape[2:]), x.dtype), new.outcomes
        )
        stored = stored._replace(outcomes=outcomes)
    return jax.tree.map(put, stored, new)


def _device(tree: Any) -> Any:
    return jax.tree.map(jnp.asarray, tree)
