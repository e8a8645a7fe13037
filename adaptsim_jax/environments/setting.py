"""All that an environment's task is made of, before anything is learned; and its digest."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, is_dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.traced import digest_of, digest_of_arrays
from adaptsim_jax.environments.config import EnvironmentConfig
from adaptsim_jax.environments.episodes import (
    Play,
    make_play,
)
from adaptsim_jax.environments.fields import ModelField, space_of
from adaptsim_jax.environments.peers import from_gymnax
from adaptsim_jax.environments.simulated import SimulatedTask, simulated
from adaptsim_jax.environments.targets import Target, hidden_fields, target_of
from adaptsim_jax.environments.trainer import Trainer, make_ppo_trainer
from adaptsim_jax.space import Space

BLIND = 0.5
"""Of training, at its start: given E at once, a policy stops at worse ways to swing up than one that
is given nothing.
"""  # noqa: E501


FORM = 3  # of what is learned: what was learned in another is learned anew


class Setting(NamedTuple):
    """All that an environment's task is made of, before anything is learned. `env`: as it was
    given; fields: Omega's, then those that only targets have, whose nominal values are `rest [R]`.
    """

    config: EnvironmentConfig
    env: Any
    sim: SimulatedTask
    space: Space
    fields: tuple[ModelField, ...]
    play: Play
    trainer: Trainer
    targets: Mapping[str, Target]
    rest: jax.Array


def setting_of(
    env: Any, config: EnvironmentConfig, trainer: Callable = make_ppo_trainer, where: str = "env"
) -> Setting:
    """`env` with `config`; all that a person may have got wrong is told here, before anything is
    compiled.
    """
    raw = environment(env, where=where)
    ranges = config.fields or getattr(env, "fields", {})
    space, omega = space_of(raw.names, ranges, f"{where}, fields")
    table = config.targets or {"nominal": {}}

    def own(f):
        return replace(f, nominal=raw.interface.get(f.name, f.nominal))

    fields = tuple(map(own, (*omega, *hidden_fields(raw.names, table, omega))))
    omega = fields[: space.dim]
    targets = {
        name: target_of(name, given, fields, raw.native is not None)
        for name, given in table.items()
    }
    sim = environment(env, omega, config.length, where)
    longest = [
        p.high + config.wide * (p.high - p.low) for p in space.parameters if p.name == "delay"
    ]
    play = make_play(sim, omega, max(longest, default=0.0))
    rest = jnp.asarray([f.nominal for f in fields[space.dim :]], jnp.float32)
    made = trainer(play, space, config.training, obs_dim_of(play, omega, where))
    return Setting(config, env, sim, space, fields, play, compiled(made), targets, rest)


def compiled(trainer: Trainer) -> Trainer:
    """The same with one compiled program for all that it trains."""
    return trainer._replace(
        begin=jax.jit(trainer.begin), train=jax.jit(trainer.train, static_argnums=3)
    )


def environment(
    env: Any, fields: tuple[ModelField, ...] = (), length: int = 0, where: str = "env"
) -> SimulatedTask:
    """`env`, over an `mjx.Model` or of gymnax, as pure functions of its model; BadInput as
    `simulated`.
    """
    if hasattr(env, "default_params") and hasattr(env, "step_env"):
        return from_gymnax(env, env.default_params, length)
    return simulated(env, fields, length, where)


def obs_dim_of(play: Play, fields: tuple[ModelField, ...], where: str) -> int:
    nominal = jnp.asarray([f.nominal for f in fields], jnp.float32)
    live = jax.eval_shape(lambda key: play.reset(play.world(nominal), key), jax.random.key(0))
    if live.obs.ndim != 1:
        raise BadInput(f"{where}: observations have the shape {live.obs.shape}; a vector is wanted")
    return live.obs.shape[0]


def digest(setting: Setting) -> str:
    """Of all that what is learned depends on: what the environment computes, its numbers, Omega,
    and how a policy is trained and shown. It takes one trace of a reset and a step.
    """
    config, sim, play = setting.config, setting.sim, setting.play

    def run(key, values, action):
        world = play.world(values)
        live = play.reset(world, key)
        return live, play.step(world, live, action)

    values, action = jnp.zeros(len(play.fields)), jnp.zeros(sim.action_dim)
    table = {
        "form": FORM,
        "space": [asdict(p) for p in setting.space.parameters],
        "training": asdict(config.training) if is_dataclass(config.training) else {},
        "trainer": getattr(setting.trainer.train, "__qualname__", ""),
        "planner": asdict(config.planner) if config.policy == "planned" else {},
        "shown": [config.components, BLIND],
        "steps": [sim.length, float(sim.dt)],
        "traced": digest_of(run, jax.random.key(0), values, action),
        "model": digest_of_arrays(sim.model),
    }
    return configs.digest(table)
