"""How much reward the push allows: the best parameters of Omega for each setting, and what
adaptation steps can reach.

    python experiments/pushing_ceiling.py

Task policies are perfect here: for each test goal the best of a grid of actions in the *simulator*
at the parameters tried, run in the target. So this bounds every method that chooses parameters,
however its policies are trained.
"""

import argparse
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
from reachable import reachable_values

from adaptsim_jax.tasks.one_shot import action_grid
from adaptsim_jax.tasks.pushing import planar
from adaptsim_jax.tasks.pushing import task as pushing
from adaptsim_jax.tasks.pushing.task import PushingConfig


def earned(targets: np.ndarray, points: tuple[int, int] = (81, 21), goals: int = 24):
    """`f(u [U, 4]) -> [U, T + 1]`: rewards in `targets [T, 4]` (physical) of perfect policies for
    unit coordinates `u`; last, in the simulator itself.
    """
    space = pushing.pushing_space()
    tests, actions = (
        pushing.goal_lattice(goals),
        pushing.physical_action(jnp.asarray(action_grid(points))),
    )
    aims = jnp.asarray(targets, jnp.float32)

    def one(u):
        params = space.physical(u)
        final = jax.vmap(lambda a: planar.rollout(params, a)[-1])(actions)
        rewards = jax.vmap(lambda g: pushing.push_reward(final, g[None]))(tests)
        chosen = actions[jnp.argmax(rewards, 1)]

        def there(t):
            return pushing.push_reward(
                jax.vmap(lambda a: planar.rollout(t, a)[-1])(chosen), tests
            ).mean()

        return jnp.append(jax.vmap(there)(aims), rewards.max(1).mean())

    run = jax.jit(lambda us: jax.lax.map(one, us))
    return lambda us: np.asarray(run(jnp.asarray(us, jnp.float32)))


def search(
    f, targets: int, samples: int, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Best rewards `[T]`, where `[T, 4]`, and rewards of `samples` random parameters: these, then
    two rounds around the best.
    """
    rng = np.random.default_rng(seed)
    tried = rng.uniform(size=(samples, 4))
    found = f(tried)
    plain = found.copy()
    for width in (0.1, 0.05):
        best = [tried[np.argsort(-found[:, i])[:10]].repeat(8, 0) for i in range(targets)]
        more = np.clip(np.concatenate(best) + width * rng.normal(size=(80 * targets, 4)), 0.0, 1.0)
        tried, found = np.concatenate([tried, more]), np.concatenate([found, f(more)])
    where = found[:, :targets].argmax(0)
    return found[where, range(targets)], tried[where], plain


def reached(
    f, column: int, aim: np.ndarray, delta: float, steps: int, pairs: int
) -> tuple[float, float]:
    """Mean best reward from one random start, and from the better of two, on the grid of steps: of
    each parameter the two reachable values nearest to `aim [4]`.
    """
    best = []
    for start in np.random.default_rng(1).uniform(size=(2 * pairs, 4)):
        values = [reachable_values(float(s), delta, steps) for s in start]
        near = [v[np.argsort(np.abs(v - a))[:2]] for v, a in zip(values, aim, strict=True)]
        best.append(f(np.array(list(product(*near))))[:, column].max())
    flat = np.array(best)
    return flat.mean(), np.maximum(flat[::2], flat[1::2]).mean()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=400)
    parser.add_argument("--pairs", type=int, default=3)
    args = parser.parse_args()
    space, names = pushing.pushing_space(PushingConfig()), list(pushing.SETTINGS)
    targets = np.array([space.values(pushing.SETTINGS[name]) for name in names])
    f = earned(targets)
    best, where, plain = search(f, len(names), args.samples)
    where[0], best[0] = (
        (u := np.asarray(space.unit(targets[0]))),
        f(u[None])[0, 0],
    )  # wd lies within Omega
    for i, name in enumerate(names):
        low, middle, high = np.quantile(plain[:, i], [0.1, 0.5, 0.9])
        print(
            f"{name}: best of Omega {best[i]:.3f} at {where[i].round(2)}; random parameters "
            f"{low:.2f} {middle:.2f} {high:.2f}"
        )
    for delta, steps in ((0.15, 8), (0.1, 8), (0.1, 12)):
        for i in (0, 2):
            one, two = reached(f, i, where[i], delta, steps, args.pairs)
            print(
                f"steps of {delta}, {steps} of them, {names[i]}: one start {one:.3f}, the better "
                f"of two {two:.3f}"
            )


if __name__ == "__main__":
    main()
