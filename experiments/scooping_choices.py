"""How Phase 1 of scooping may be trained, tried on random targets and seeds that no table uses: which choice adapts best.

    python experiments/scooping_choices.py --out OUT base led-wide more more-led-wide more-short

For each seed task policies are made once, by a Phase 1 as the preset has it, and lent to all choices: what differs is the adaptation
policy. Phase 2 takes the nearest of these policies at each visit; its trials run in the engine, its reward is the bank's chance of
success over 12 test contexts. Pieces: slippery cylinders (all but one easy for some action), cylinders of Omega, boxes, ellipsoids.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import default_comparison, gaussian, make_one_shot, make_phase1
from adaptsim_jax.adaptation.phase1 import Phase1, Phase1Config, Phase1Hyper, Phase1State
from adaptsim_jax.adaptation.sweep import TrainedMany, stack, starts_of
from adaptsim_jax.baselines.arena import Arena, lanes
from adaptsim_jax.baselines.learned import two_keys
from adaptsim_jax.core import compile_cache
from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.space import step
from adaptsim_jax.tasks.one_shot import OneShot

TRAIN = default_comparison("scooping").train
MORE = {"trajectories": 5000, "parallel": 250, "updates": 2400, "capacity": 40_000}
SHORT = replace(TRAIN.hyper.learner, discount=0.7)
CHOICES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "base": ({}, {}),
    "led": ({"guided": 0.5}, {}),
    "wide": ({}, {"inside": 0.2}),
    "led-wide": ({"guided": 0.5}, {"inside": 0.2}),
    "short": ({}, {"learner": SHORT}),
    "more": (MORE, {}),
    "more-led-wide": (MORE | {"guided": 0.5}, {"inside": 0.2}),
    "more-short": (MORE, {"learner": SHORT}),
}
STARTS, STEPS = 2, 8
GROUPS = {"slippery": slice(0, 6), "cylinders": slice(6, 10), "boxes": slice(10, 14), "ellipsoids": slice(14, 17)}


def targets() -> np.ndarray:
    """`[17, 4]`: friction, modulus, shape, height of pieces drawn at random, by `GROUPS`."""
    rng = np.random.default_rng(777)
    between = lambda low, high: rng.uniform(low, high)
    softness = lambda low, high: float(np.exp(between(np.log(low), np.log(high))))
    draw = lambda mu, e, g, h: [between(*mu), softness(*e), g, between(*h)]
    first = [draw((0.15, 0.25), (2e4, 2e5), 1, (0.016, 0.027)) for _ in range(7)]
    first.pop(4)  # the best action there wins but 0.83
    ellipsoid, box = draw((0.36, 0.5), (8e3, 3e4), 0, (0.013, 0.018)), draw((0.3, 0.48), (5e4, 3e5), 2, (0.016, 0.024))
    cylinder = draw((0.26, 0.38), (2e4, 1e5), 1, (0.016, 0.024))
    rng = np.random.default_rng(778)
    for _ in range(12):
        draw((0.15, 0.25), (2e4, 2e5), 1, (0.016, 0.027))
    cylinders = [draw((0.25, 0.4), (1.5e4, 2e5), 1, (0.015, 0.025)) for _ in range(6)]
    boxes = [draw((0.3, 0.48), (5e4, 3e5), 2, (0.016, 0.024)) for _ in range(6)]
    ellipsoids = [draw((0.36, 0.5), (8e3, 3e4), 0, (0.013, 0.018)) for _ in range(3)]
    return np.array([*first, cylinder, *cylinders[:3], box, *boxes[:3], ellipsoid, *ellipsoids[:2]])


def trained(one: OneShot, sizes: Phase1Config, hyper: Phase1Hyper, seeds: np.ndarray, pools: list[Any]):
    """Phase 1, each seed's runs, and their states; with the task policies of `pools`, or from nothing where there are none."""
    phase1 = make_phase1(one.task, sizes)
    run = jax.jit(lambda state: phase1.run(state, hyper, jnp.arange(sizes.rounds)))
    init, done = jax.jit(phase1.init), []
    for i, seed in enumerate(seeds):
        state = init(jax.random.key(int(seed)))
        done.append(run(state._replace(pool=pools[i]) if pools else state))
    states, infos = zip(*done, strict=True)
    together = lambda *x: jnp.stack(x)
    weights, archive = (
        jnp.stack([s.learner.target for s in states]),
        jax.tree.map(together, *[s.archive for s in states]),
    )
    many = TrainedMany(stack([hyper] * len(seeds)), weights, archive, jax.tree.map(together, *infos))
    return phase1, many, states


def adapted(one: OneShot, phase1: Phase1, many: TrainedMany, seeds: np.ndarray, states: tuple[Phase1State, ...]):
    """Rewards and means `[T, S, N, I + 1, ...]` of Phase 2 with the nearest policies of each seed's pool."""
    arena, space = Arena(one, one.world(one.engine), targets()), one.task.space
    batch = lanes(len(arena.targets), seeds, STARTS, 1)
    first = starts_of(phase1, many, seeds, STARTS)
    mean = np.tile(np.asarray(first.mean).reshape(-1, space.dim), (len(arena.targets), 1))
    weights, where = many.weights[batch.seed], jnp.asarray(arena.targets[batch.where], jnp.float32)
    pools = jax.tree.map(lambda *x: jnp.stack(x), *[s.pool for s in states])
    size = (many.hyper.delta[0], many.hyper.shrink[0])

    def nearest(mean, seed):
        apart = jnp.linalg.norm(pools.mean[seed] - mean, axis=-1)
        there = jnp.arange(apart.shape[0]) < pools.count[seed]
        place = jnp.argmin(jnp.where(there, apart, jnp.inf))
        return jax.tree.map(lambda x: x[seed, place], pools.policy)

    def moved(weights, mean, obs, number):
        action = phase1.bdq.greedy(weights, jnp.concatenate([2.0 * mean - 1.0, obs]))
        return step(space, gaussian(space, mean), action, size[0] * size[1] ** number).mean

    near, move = jax.jit(jax.vmap(nearest)), jax.jit(jax.vmap(moved, (0, 0, 0, None)))
    chance = jax.jit(jax.vmap(lambda key, policy, target: one.task.rollout(key, policy, target).tested))
    rewards, means = [], []
    for i in range(STEPS + 1):
        policies, (_, keys) = near(jnp.asarray(mean), jnp.asarray(batch.seed)), two_keys(batch.at(i))
        seen = arena.visit(keys, batch.where, policies)
        rewards.append(np.asarray(chance(keys, policies, where)))
        means.append(mean)
        mean = np.asarray(move(weights, jnp.asarray(mean), jnp.asarray(seen.obs), i))
    return batch.grid(np.stack(rewards, -1)), batch.grid(np.stack(means, 1))


def told(rewards: np.ndarray, means: np.ndarray) -> dict[str, dict[str, float]]:
    """By group: mean of the best visits, of all visits, of the last four, and the share of these at cylinders."""
    best, late = rewards.max((2, 3)), rewards[..., -4:]
    at_cylinders = means[..., -4:, 2]
    return {
        name: {
            "best": float(best[rows].mean()),
            "all": float(rewards[rows].mean()),
            "late": float(late[rows].mean()),
            "at_cylinders": float(at_cylinders[rows].mean()),
        }
        for name, rows in GROUPS.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("choices", nargs="+", choices=CHOICES, metavar="CHOICE", help=", ".join(CHOICES))
    parser.add_argument("--seeds", type=int, default=3, help="from 100 on")
    parser.add_argument("--out", required=True)
    args = parser.parse_args()
    compile_cache.enable()
    out, seeds, found = output_folder(Path(args.out)), np.arange(100, 100 + args.seeds), {}
    one = make_one_shot("scooping", dict(TRAIN.task) | {"tests": 12})
    pools = [state.pool for state in trained(one, TRAIN.phase1, TRAIN.hyper, seeds, [])[2]]
    for choice in args.choices:
        begin, (sizes, hyper) = time.process_time(), CHOICES[choice]
        some = replace(TRAIN.phase1, **sizes), replace(TRAIN.hyper, **hyper)
        phase1, many, states = trained(one, *some, seeds, pools)
        rewards, means = adapted(one, phase1, many, seeds, states)
        found[choice] = told(rewards, means) | {"cpu_s": time.process_time() - begin}
        print(choice, found[choice], flush=True)
        write_json(out / "choices.json", found)


if __name__ == "__main__":
    main()
