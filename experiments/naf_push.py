"""How good NAF policies of the push are, as a share of the best actions, with and without
relabelled goals.

    python experiments/naf_push.py --policies 16 --trials 1000 3000 10000

Random parameters of Omega in the planar model, the task's own training; each policy is scored on
the task's test goals, beside the best of a fine grid of actions for each goal.
"""

import argparse
import time
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import gaussian
from adaptsim_jax.tasks.pushing import model, planar
from adaptsim_jax.tasks.pushing.task import (
    PushingConfig,
    draw_goal,
    make_policy,
    make_pushing,
    push_reward,
)


def best_rewards(params: jax.Array, goals: jax.Array) -> jax.Array:
    """`[P, G]`: for each of `params [P, 4]` and `goals [G, 2]` the best reward over 161 speeds x 31
    angles.
    """
    lines = [
        jnp.linspace(low, high, n)
        for low, high, n in zip(model.ACTION_LOW, model.ACTION_HIGH, (161, 31), strict=True)
    ]
    grid = jnp.stack(jnp.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 2)

    def one(p):
        final = jax.vmap(lambda a: planar.rollout(p, a)[-1])(grid)
        return jax.vmap(lambda g: push_reward(final, g[None]).max())(goals)

    return jax.jit(lambda ps: jax.lax.map(one, ps))(params)


def trained_rewards(config: PushingConfig, params: jax.Array, goals: jax.Array, trials: list[int]):
    """For each budget: rewards `[P, G]` of policies trained at `params [P, 4]`, and CPU seconds a
    policy.
    """
    task, act = make_pushing(config), make_policy(config)
    keys = jax.random.split(jax.random.key(1), len(params))
    dists = jax.vmap(lambda p: gaussian(task.space, task.space.unit(p)))(params)

    @jax.jit
    def run(budget):
        policies = task.train_many(
            keys, dists, jax.vmap(task.init_policy)(keys), jnp.full(len(params), budget)
        )

        def final(w, p):
            return jax.vmap(lambda g: planar.rollout(p, act(w, g))[-1])(goals)

        return push_reward(
            jax.vmap(final)(policies, params), jnp.broadcast_to(goals, (len(params), *goals.shape))
        )

    jax.block_until_ready(run(jnp.int32(0)))
    for budget in trials:
        begin = time.process_time()
        rewards = np.asarray(run(jnp.int32(budget)))
        yield budget, rewards, (time.process_time() - begin) / len(params)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--policies", type=int, default=16)
    parser.add_argument("--goals", type=int, default=64)
    parser.add_argument("--trials", type=int, nargs="+", default=[1000, 3000, 10_000])
    args = parser.parse_args()
    params = jnp.asarray(model.draw(5, args.policies)[0], jnp.float32)
    goals = jax.vmap(draw_goal)(jax.random.split(jax.random.key(9), args.goals))
    best = np.asarray(best_rewards(params, goals)).mean(1)
    print(
        f"{args.policies} random parameters, {args.goals} goals: best actions earn "
        f"{best.mean():.3f} on average"
    )
    base = PushingConfig()
    plain = replace(base, training=replace(base.training, relabel=0.0))
    for name, config in {"relabelled": base, "as aimed": plain}.items():
        for budget, rewards, cpu in trained_rewards(config, params, goals, args.trials):
            share = rewards.mean(1) / best
            print(
                f"{name:11} {budget:6} trials: reward {rewards.mean():.3f}, "
                f"{rewards.mean() / best.mean():.3f} of the best, worst policy {share.min():.3f}; "
                f"{1e3 * cpu:.0f} ms of CPU a policy",
                flush=True,
            )


if __name__ == "__main__":
    main()
