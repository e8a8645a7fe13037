"""Gradient ascent on the return by E's mean, through the policy that knows E and a simulation of
the target itself.

No method for a robot, for it needs the target's own model: a row that says what slopes are worth
where they can be had. Each mean is tried in the target, which counts; where it returned less than
the best so far, the stride is halved from there.
"""

import sys

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.baselines.learned import Bout, Trip
from adaptsim_jax.baselines.steps_arena import StepsArena
from adaptsim_jax.environments.interface import make_play
from adaptsim_jax.environments.slope import make_slope
from adaptsim_jax.environments.task import Law, Tuned, environment, longest_delay, network_acting

STRIDE = 0.2  # of the range, for the field that moves most; halved where it led to less


def gradient(bout: Bout) -> Trip:
    """A visit in the target for each mean; its slope from four starts in the simulator with all of
    the target's values.
    """
    arena: StepsArena = bout.arena  # type: ignore[assignment]
    setting, T = arena.setting, len(arena.targets)
    every = [setting.targets[name].values for name in arena.names]

    def made():
        sim = environment(setting.env, setting.fields, setting.config.length)
        play = make_play(sim, setting.fields, longest_delay(setting.fields, *every))
        return make_slope(play, network_acting(setting), Tuned)

    slope, length = arena.kept("slope", made), setting.sim.length
    actor = setting.trainer.policy(arena.prepared.learned)
    starts = jax.random.split(jax.random.fold_in(jax.random.key(int(bout.seeds[0])), 300), 4)
    at, stride = np.full((T, setting.space.dim), 0.5, np.float32), np.full(T, STRIDE)
    best, base, way = np.full(T, -np.inf), at.copy(), np.zeros_like(at)
    total = bout.config.starts * (bout.config.iterations + 1)
    means, rewards, cut = [], [], set()
    for i in range(total):
        policies = Law(jnp.asarray(at))
        own = arena.visit(None, np.arange(T), policies).score
        rewards.append(arena.score(np.arange(T), policies))
        means.append(at.copy())
        for t in range(T if i + 1 < total else 0):
            if own[t] > best[t]:
                best[t], base[t] = own[t], at[t]
                found = slope(starts, base[t], every[t], actor)
                way[t] = found.gradient / max(float(np.abs(found.gradient).max()), 1e-12)
                cut |= {(arena.names[t], found.window)} if found.window < length else set()
            else:
                stride[t] *= 0.5
            at[t] = np.clip(base[t] + stride[t] * way[t], 0.0, 1.0)
        bout.report(i + 1, total)
    if cut:
        shortest = {name: min(w for n, w in cut if n == name) for name, _ in sorted(cut)}
        told = ", ".join(f"{name} {window}" for name, window in shortest.items())
        print(
            f"gradient: derivatives explode over {length} steps; truncated to windows of: {told}",
            file=sys.stderr,
        )

    def shape(x):
        return np.stack(x, 1)[:, None, None]

    return Trip(shape(rewards), shape(means), arena.one.trials * np.arange(1, total + 1))
