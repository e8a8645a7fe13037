"""What lies between a policy and a model: actions that come late or scaled, observations with
noise; and the episode's clock.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.environments.fields import INTERFACE, Field
from adaptsim_jax.environments.simulated import Physics, Simulated


class Live(NamedTuple):
    """An environment at work: its own `state`, actions so far `[L, A]` (the newest first), `key` of
    what is drawn, `obs [O]` as the policy sees it, `reward []`, `done []`, and steps so far `time
    []`.
    """

    state: Any
    actions: jax.Array
    key: jax.Array
    obs: jax.Array
    reward: jax.Array
    done: jax.Array
    time: jax.Array


class World(NamedTuple):
    """A model with its fields in place, and its interface: what steps need, computed once an
    episode.
    """

    model: Any
    delay: jax.Array  # in steps
    scale: jax.Array
    noise: jax.Array


class Play(NamedTuple):
    """`world(values [F]) -> World`, `reset(world, key) -> Live`, `step(world, live, action [A]) ->
    Live`; pure, of one sample.
    """

    sim: Simulated
    fields: tuple[Field, ...]
    world: Callable[[jax.Array], World]
    reset: Callable[[World, jax.Array], Live]
    step: Callable[[World, Live, jax.Array], Live]


def make_play(
    sim: Simulated, fields: tuple[Field, ...], longest: float = 0.0, physics: Physics | None = None
) -> Play:
    """`sim` with `fields`, those of the interface among them, as arguments. longest: s, the
    greatest delay that may come.

    A delay between two steps is a mean of both actions, weighted by how near they are; before the
    first action there is 0.
    """
    names = [field.name for field in fields]
    longest = max(longest, 0.0 if "delay" in names else sim.interface.get("delay", 0.0))
    held = int(-(-longest // sim.dt)) + 2 if longest > 0 else 1

    def own(values, name):
        nominal = sim.interface.get(name, INTERFACE[name][2])
        if name in names:
            return values[names.index(name)]
        return jnp.asarray(nominal, jnp.float32)

    def world(values):
        model = sim.edit(sim.model, fields, values)
        return World(
            model,
            own(values, "delay") / sim.dt,
            own(values, "action_scale"),
            own(values, "observation_noise"),
        )

    def view(world, state, actions, key, time):
        obs, reward, done = sim.seen(state)
        if "observation_noise" in {*names, *sim.interface}:
            key, noise_key = jax.random.split(key)
            obs = obs + world.noise * jax.random.normal(noise_key, obs.shape)
        return Live(state, actions, key, obs, reward, done, time)

    def reset(world, key):
        state_key, key = jax.random.split(key)
        state = sim.reset(world.model, state_key)
        return view(world, state, jnp.zeros((held, sim.action_dim)), key, jnp.zeros((), jnp.int32))

    def step(world, live, action):
        actions = jnp.concatenate([jnp.clip(action, -1.0, 1.0)[None], live.actions[:-1]])
        sent = actions[0]
        if held > 1:
            near = jnp.clip(
                1.0 - jnp.abs(jnp.arange(held) - jnp.clip(world.delay, 0.0, held - 1.0)), 0.0, 1.0
            )
            sent = near @ actions
        state = sim.step(world.model, live.state, world.scale * sent, physics=physics)
        return view(world, state, actions, live.key, live.time + 1)

    return Play(sim, fields, world, reset, step)
