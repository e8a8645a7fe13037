"""Environments by name: ours, those of MuJoCo Playground, Brax and gymnax, and anybody's function.

Parameters of gymnax's environments are arguments already, named `params.g`, `params.m`, ...; there is
no MuJoCo model.
"""  # noqa: E501

import importlib
import importlib.util
import inspect
import subprocess
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.core.config import Table, suggest
from adaptsim_jax.core.errors import BadInput, one_line
from adaptsim_jax.core.registry import function_named
from adaptsim_jax.environments.fields import ModelField
from adaptsim_jax.environments.simulated import SimulatedTask

OWN = {
    "cartpole": "adaptsim_jax.environments.own:cartpole",
    "arm": "adaptsim_jax.environments.own:arm",
}


def load(name: str, options: Table | None = None, where: str = "env") -> Any:
    """The environment called `name`: `cartpole` or `arm` of ours, `playground:NAME`, `brax:NAME`,
    `gymnax:NAME`, `module:function` or `file.py:function`. options: Given to it. BadInput says what
    is missing, and how to get it.
    """
    home, colon, thing = OWN.get(name, name).rpartition(":")
    options = dict(options or {})
    if not colon:
        known = [
            *OWN,
            "playground:NAME",
            "brax:NAME",
            "gymnax:NAME",
            "module:function",
            "file.py:function",
        ]
        raise BadInput(f"{where}: environment '{name}' is unknown; {suggest(name, known)}")
    if home in _PEERS:
        return _PEERS[home](thing, options, where)
    made = function_named(f"{home}:{thing}", where)
    try:
        inspect.signature(made).bind(**options)
    except TypeError as error:
        raise BadInput(f"{where}: {name}: {error}; mend [options]") from None
    return made(**options)


def _playground(name: str, options: Table, where: str) -> Any:
    registry = _peer("mujoco_playground", "playground", where).registry
    if name not in registry.ALL_ENVS:
        raise BadInput(f"{where}: Playground has no '{name}'; {suggest(name, registry.ALL_ENVS)}")
    known = registry.get_default_config(name)
    for key in options:
        if key not in known:
            raise BadInput(
                f"{where}: options.{key}: '{name}' has no such option; {suggest(key, known)}"
            )
    if "impl" in known:
        options = {
            "impl": "jax"
        } | options  # Playground's own default is for GPUs, and twenty times slower on a CPU
    if options.get("impl") == "warp":
        _peer("warp", "warp-lang", f'{where}: impl = "warp"')
        if jax.default_backend() == "cpu":
            print(
                f'{where}: impl = "warp" is slow on a CPU; set impl = "jax" in [options]',
                file=sys.stderr,
            )
    try:
        return registry.load(name, config_overrides=options)
    except (subprocess.CalledProcessError, FileNotFoundError) as error:
        env = sys.modules.get("mujoco_playground._src.mjx_env")
        folder = getattr(env, "MENAGERIE_PATH", "its external_deps/mujoco_menagerie")
        raise BadInput(
            f"{where}: '{name}' needs MuJoCo Menagerie, which Playground fetches by git when it is "
            f"first loaded, and could not ({one_line(str(error))}); load it once with a network, "
            f"or copy a checkout of Menagerie to {folder}"
        ) from None


def _brax(name: str, options: Table, where: str) -> Any:
    envs = _peer("brax.envs", "brax", where)
    return envs.get_environment(name, **({"backend": "mjx"} | options))


def _gymnax(name: str, options: Table, where: str) -> Any:
    gymnax = _peer("gymnax", "gymnax", where)
    if name not in gymnax.registered_envs:
        raise BadInput(f"{where}: gymnax has no '{name}'; {suggest(name, gymnax.registered_envs)}")
    return gymnax.make(name, **options)[0]


def _peer(module: str, package: str, where: str) -> Any:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise BadInput(
            f"{where}: needs {package} ({error.name} is missing); pip install {package}"
        ) from None


_PEERS: dict[str, Callable[[str, Table, str], Any]] = {
    "playground": _playground,
    "brax": _brax,
    "gymnax": _gymnax,
}


class GymnaxMoment(NamedTuple):
    """gymnax's own state, and what its last step gave."""

    state: Any
    key: Array
    obs: Array
    reward: Array
    done: Array


def from_gymnax(env: Any, params: Any, length: int = 0) -> SimulatedTask:
    """`env` with `params` as its model; actions in [-1, 1] are laid over its own. BadInput where
    its actions are not a continuum.

    Episodes end where gymnax ends them, time limits included, which `length` then should not
    exceed.
    """
    space = env.action_space(params)
    if not hasattr(space, "low"):
        raise BadInput(
            f"env: {env.name} chooses among {getattr(space, 'n', 'some')} actions; one with "
            "actions on a continuum is wanted"
        )
    size = int(np.prod(space.shape, dtype=int))
    low, high = (
        jnp.broadcast_to(jnp.asarray(x, jnp.float32), (size,)) for x in (space.low, space.high)
    )

    def moment(state, key, obs, reward, done):
        obs = jnp.asarray(obs, jnp.float32).reshape(-1)
        return GymnaxMoment(
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

    def edit(params, fields: tuple[ModelField, ...], values):
        changed = {e.array: e.factor * values[i] for i, f in enumerate(fields) for e in f.edits}
        return params.replace(**changed)

    return SimulatedTask(
        name=env.name,
        native=None,
        model=params,
        action_dim=size,
        length=length or int(params.max_steps_in_episode),
        dt=float(getattr(params, "dt", 1.0)),
        reset=reset,
        step=step,
        observed=lambda now: (now.obs, now.reward, now.done),
        data=lambda now: None,
        edit=edit,
    )
