from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import (
    Phase1Config,
    Phase1Hyper,
    compare,
    default_comparison,
    make_backend,
    make_phase1,
    make_task,
)
from adaptsim_jax.diagnosis import catalogue

print([effect.name for effect in catalogue()][-1])

puck = make_task("puck", {"goal": 0.5})
phase1 = make_phase1(
    puck, Phase1Config(trajectories=20, parallel=10, updates=4, capacity=500, archive=500)
)
state = jax.jit(phase1.init)(jax.random.key(0))
state, info = jax.jit(phase1.run)(state, Phase1Hyper(), jnp.arange(phase1.config.rounds))
print("rewards of", puck.name, np.asarray(info.final_reward).mean())

params = np.array([[1.0, 0.8, 0.4, 0.3, 0.2, 0.15, 0.02, 0.01, 0.1, 0.1]])
command, rest = np.ones((1, 50, 2)), np.zeros((1, 4))
late, prompt = (
    make_backend("pendulum", name).simulate(params, command, rest).state
    for name in ("late", "native")
)
print("late by a row:", np.abs(np.asarray(late)[0, 1:] - np.asarray(prompt)[0, :-1]).max())

small = replace(
    default_comparison("pendulum"),
    methods=("random_search",),
    settings=("wd",),
    seeds=2,
    iterations=1,
)
(row,) = compare("pendulum", small)["rows"]
print(f"random search earns {row['mean']:.3f} of 1")

small = replace(default_comparison("puck"), methods=("udr", "oracle"), settings=("slick",), seeds=2)
udr, oracle = compare("puck", small)["rows"]
print(
    f"where it is slick, a push for all of Omega earns {udr['mean']:.2f}, and the best "
    f"{oracle['mean']:.2f}"
)
