"""Environments of gymnax: their parameters are arguments already, named `params.g`, `params.m`,
...; there is no MuJoCo model.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.fields import Field
from adaptsim_jax.environments.simulated import Simulated


class Moment(NamedTuple):
    """gymnax's own state, and what its last step gave."""

    state: Any
    key: jax.Array
    obs: jax.Array
    reward: jax.Array
    done: jax.Array


def from_gymnax(env: Any, params: Any, length: int = 0) -> Simulated:
    """`env` with `params` as its model; actions in [-1, 1] are laid over its own. BadInput where
    its actions are not a continuum.

    Episodes end where gymnax ends them, time limits included, which `length` then should not
    exceed.
    """
    space = env.action_space(params)
    if not hasattr(space, "low"):
        raise BadInput(
            f"env: {env.name} chooses among {getattr(space, 'n', 'some')} actions; one with "
            f"actions on a continuum is wanted"
        )
    size = int(np.prod(space.shape, dtype=int))
    low, high = (
        jnp.broadcast_to(jnp.asarray(x, jnp.float32), (size,)) for x in (space.low, space.high)
    )

    def moment(state, key, obs, reward, done):
        obs = jnp.asarray(obs, jnp.float32).reshape(-1)
        return Moment(
            state, key, obs, jnp.asarray(reward, jnp.float32), jnp.asarray(done, jnp.float32)
        )

    def reset(params, key):
        reset_key, key = jax.random.split(key)
        obs, state = env.reset_env(reset_key, params)
        state = jax.tree.map(lambda x: jnp.asarray(x), state)
        return moment(state, key, obs, 0.0, 0.0)

    def step(params, now, action, physics=None):
        step_key, key = jax.random.split(now.key)
        own = low + 0.5 * (action + 1.0) * (high - low)
        obs, state, reward, done, _ = env.step_env(
            step_key, now.state, own.reshape(space.shape), params
        )
        # types as at the reset: gymnax's own are of Python's numbers in places
        state = jax.tree.map(
            lambda new, old: jnp.asarray(new, jnp.asarray(old).dtype), state, now.state
        )
        return moment(state, key, obs, reward, done)

    def edit(params, fields: tuple[Field, ...], values):
        changed = {e.array: e.factor * values[i] for i, f in enumerate(fields) for e in f.edits}
        return params.replace(**changed)

    return Simulated(
        name=env.name,
        native=None,
        model=params,
        action_dim=size,
        length=length or int(params.max_steps_in_episode),
        dt=float(getattr(params, "dt", 1.0)),
        reset=reset,
        step=step,
        seen=lambda now: (now.obs, now.reward, now.done),
        data=lambda now: None,
        edit=edit,
    )
