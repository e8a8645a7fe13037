"""What task policies of scooping earn whose E stands at the target's own parameters: all that knowing them would give.

    python experiments/scooping_informed.py

Parameters outside of Omega are moved to its nearest place, as a mean of E must be. Random pieces, six slippery cylinders and six
of Omega, and the five settings; with several spreads of E, as fractions of Omega's ranges. Rewards are shares of 12 tests in the
engine, and beside them the chance of success that the bank, which the policies are trained on, gives them.
"""

from __future__ import annotations

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import Gaussian, default_comparison, make_one_shot
from adaptsim_jax.baselines.arena import Arena
from adaptsim_jax.core import compile_cache
from adaptsim_jax.tasks.one_shot import OneShot

SHAPE = 2  # E's spread there is left as it is


def pieces(seed: int) -> np.ndarray:
    """`[12, 4]`: slippery cylinders, then cylinders of Omega."""
    rng = np.random.default_rng(seed)
    draw = lambda mu, e: [
        rng.uniform(*mu),
        float(np.exp(rng.uniform(np.log(e[0]), np.log(e[1])))),
        1,
        rng.uniform(0.018, 0.024),
    ]
    slippery = [draw((0.18, 0.24), (3e4, 9e4)) for _ in range(6)]
    return np.array(slippery + [draw((0.25, 0.4), (2e4, 1.5e5)) for _ in range(6)])


def rewards(one: OneShot, targets: np.ndarray, spread: float, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """`[count, T]` in the engine and by the bank, of `count` policies trained for each of `targets [T, 4]`."""
    arena, space = Arena(one, one.world(one.engine), targets), one.task.space
    where = np.tile(np.arange(len(targets)), count)
    keys = jax.random.split(jax.random.key(seed), len(where))
    mean = space.snap(jnp.clip(space.unit(jnp.asarray(targets, jnp.float32)), 0.0, 1.0))[where]
    std = jnp.full(mean.shape, spread).at[:, SHAPE].set(1e-4)
    policies = arena.train(keys, Gaussian(mean, std), arena.untrained(keys))
    chance = jax.jit(jax.vmap(lambda key, policy, target: one.task.rollout(key, policy, target).tested))
    bank = np.asarray(chance(keys, policies, jnp.asarray(targets[where], jnp.float32)))
    return arena.score(where, policies).reshape(count, -1), bank.reshape(count, -1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=5, help="policies for each piece")
    parser.add_argument("--spreads", type=float, nargs="+", default=[1e-4, 0.05, 0.1])
    parser.add_argument("--seed", type=int, default=110)
    args = parser.parse_args()
    compile_cache.enable()
    one = make_one_shot("scooping", dict(default_comparison("scooping").train.task) | {"tests": 12})
    settings = np.array([one.task.space.values(one.task.settings[name], name) for name in one.task.settings])
    every = np.concatenate([pieces(args.seed), settings])
    for spread in args.spreads:
        begin = time.process_time()
        engine, bank = rewards(one, every, spread, args.count, args.seed)
        print(f"spread {spread:g}, {time.process_time() - begin:.0f} s of CPU time")
        for name, rows in {"slippery cylinders": slice(0, 6), "cylinders of Omega": slice(6, 12)}.items():
            print(f"  {name:20} engine {engine[:, rows].mean():.2f} {engine[:, rows].mean(0).round(2)}", end="")
            print(f" bank {bank[:, rows].mean():.2f} {bank[:, rows].mean(0).round(2)}")
        for i, name in enumerate(one.task.settings, 12):
            print(f"  {name:20} engine {engine[:, i].mean():.2f} {engine[:, i].round(2)} bank {bank[:, i].mean():.2f}")


if __name__ == "__main__":
    main()
