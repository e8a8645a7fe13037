"""All that an environment's task is made of, before anything is learned; and its digest."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput, check_counts
from adaptsim_jax.core.traced import digest_of, digest_of_arrays
from adaptsim_jax.environments.episodes import (
    Play,
    make_play,
)
from adaptsim_jax.environments.fields import ModelField, field_of, of_law, space_of
from adaptsim_jax.environments.mended import as_asked, mended
from adaptsim_jax.environments.peers import from_gymnax
from adaptsim_jax.environments.simulated import SimulatedTask, simulated
from adaptsim_jax.environments.targets import DECLARED, Target, hidden_fields, target_of
from adaptsim_jax.environments.trainer import PlannerConfig, PPOTraining, Trainer, make_ppo_trainer
from adaptsim_jax.space import Space

OF_RUN = ("phase1", "hyper", "seed", "every")
"""Tables of an env.toml that are of the run, not of the task."""


@dataclass(frozen=True)
class EnvironmentConfig:
    """Options of the task.

    env: `cartpole`, `arm`, `playground:NAME`, `brax:NAME`, `gymnax:NAME`, `module:function`,
        `file.py:function`. options: Given to it.
    model: A `model.toml` of `adaptsim diagnose`, whose findings the simulator has.
    fields: Omega, a range `[low, high]` or `[low, high, "log"]` for each number by name
        (docs/howto/environment.md).
    start: E's first mean in the first start of an adaptation, by the names of `fields`.
    wide: How far beyond Omega, as a share of each range, Phase 1 draws its targets. trials:
        Episodes of a visit, each counted.
    length: Steps of an episode, 0 for the environment's own.
    policy: `knows` E's mean, trained once; `tuned` from it at each visit for `tune` updates;
        `planned` by sampling, not trained.
    spread: Of E's samples when a policy is tuned, as a share of each range. training: PPO. planner:
        Of `planned`.
    references: Policies that a target's reward is scaled with. components: Of what is observed.
    doubt: Variance of a visit's return by luck, over that by E's mean; 0 deploys what returned most
        once.
    targets: For each by name a table of values of any field, Omega's or not, and of the engine
        (`environments/targets.py`), or a `model.toml` that it has.
    """

    env: str = "cartpole"
    model: str = ""
    options: Table = field(default_factory=dict)
    fields: Table = field(default_factory=dict)
    start: dict[str, float] = field(default_factory=dict)
    wide: float = 0.3
    trials: int = 1
    length: int = 0
    policy: Literal["knows", "tuned", "planned"] = "knows"
    tune: int = 4
    spread: float = 0.05
    training: PPOTraining = field(default_factory=PPOTraining)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    references: int = 8
    components: int = 12
    doubt: float = 0.3
    targets: Table = field(default_factory=dict)

    def __post_init__(self):
        check_counts(self, ("trials", "tune", "references", "components"))
        for name in ("wide", "length", "spread", "doubt"):
            if getattr(self, name) < 0:
                raise BadInput(f"{name} = {getattr(self, name)}: give 0 or more")


def read_env(path: str | Path) -> Table:
    """An env.toml as the table of a run: the task's options under `task`, `phase1`, `hyper`,
    `seed`, `every` beside them.

    A file of Python that `env` names is found from the folder of env.toml. BadInput names the key
    at fault.
    """
    table = configs.read(path)
    options = {key: value for key, value in table.items() if key not in OF_RUN}
    home, colon, thing = str(options.get("env", "")).rpartition(":")
    if colon and home.endswith(".py"):
        options["env"] = f"{(Path(path).parent / home).resolve()}:{thing}"
    targets = options.get("targets", {})
    for holder in (options, *(targets.values() if isinstance(targets, dict) else ())):
        model = holder.get("model") if isinstance(holder, dict) else None
        if isinstance(model, str) and model not in ("", DECLARED):
            holder["model"] = str((Path(path).parent / holder["model"]).resolve())
    configs.from_table(EnvironmentConfig, options, str(path))
    return {key: table[key] for key in OF_RUN if key in table} | {"task": options}


BLIND = 0.5
"""Of training, at its start: given E at once, a policy stops at worse ways to swing up than one that
is given nothing.
"""  # noqa: E501


FORM = 4  # of what is learned: what was learned in another is learned anew


class Setting(NamedTuple):
    """All that an environment's task is made of, before anything is learned. `declared`: as it was
    given; `env`: with the config's `model`; fields: Omega's, then those that only targets have,
    whose nominal values are `rest [R]`.
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
    declared: Any


def setting_of(
    env: Any, config: EnvironmentConfig, trainer: Callable = make_ppo_trainer, where: str = "env"
) -> Setting:
    """`env` with `config`; all that a person may have got wrong is told here, before anything is
    compiled.
    """
    declared = env
    if config.model:
        env = mended(env, config.model)
    raw = environment(env, where=where)
    ranges = config.fields or getattr(env, "fields", {})
    space, omega = space_of(raw.names, ranges, f"{where}, fields")
    table = config.targets or {"nominal": {}}

    def own(f):
        return replace(f, nominal=raw.interface.get(f.name, f.nominal))

    fields = tuple(map(own, (*omega, *hidden_fields(raw.names, table, omega))))
    omega = fields[: space.dim]
    both = env, declared
    targets = {name: _target(name, given, fields, both, raw) for name, given in table.items()}
    sim = environment(env, omega, config.length, where)
    longest = [
        p.high + config.wide * (p.high - p.low) for p in space.parameters if p.name == "delay"
    ]
    play = make_play(sim, omega, max(longest, default=0.0))
    rest = jnp.asarray([f.nominal for f in fields[space.dim :]], jnp.float32)
    made = trainer(play, space, config.training, obs_dim_of(play, omega, where))
    return Setting(config, env, sim, space, fields, play, compiled(made), targets, rest, declared)


def _target(
    name: str, given: Any, fields: tuple[ModelField, ...], both: tuple[Any, Any], raw: SimulatedTask
) -> Target:
    """A target; with a `model` of its own, what it does not name is as that says. Where something
    acts beside MJX, the engine is the simulator unless the target says otherwise. both: the
    environment with the config's model, and without.
    """
    env, declared = both
    if given.get("model"):
        own = declared if given["model"] == DECLARED else mended(env, given["model"])
        raw = environment(own)
        known = [f.name for f in fields if raw.laws is not None or not of_law(f)]
        found = {name: field_of(raw.names, name).nominal for name in known}
        found |= raw.interface
        fields = tuple(replace(f, nominal=found.get(f.name, f.nominal)) for f in fields)
    if raw.laws is not None:
        given = {"engine": "simulator"} | dict(given)
    return target_of(name, given, fields, raw.native is not None)


def compiled(trainer: Trainer) -> Trainer:
    """The same with one compiled program for all that it trains."""
    returns = trainer.returns and jax.jit(trainer.returns, static_argnums=4)
    train = jax.jit(trainer.train, static_argnums=3)
    return trainer._replace(begin=jax.jit(trainer.begin), train=train, returns=returns)


def environment(
    env: Any, fields: tuple[ModelField, ...] = (), length: int = 0, where: str = "env"
) -> SimulatedTask:
    """`env`, over an `mjx.Model` or of gymnax, as pure functions of its model; BadInput as
    `simulated`.
    """
    if hasattr(env, "default_params") and hasattr(env, "step_env"):
        return from_gymnax(env, env.default_params, length)
    return simulated(as_asked(env, where), fields, length, where)


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
    training = asdict(config.training) if is_dataclass(config.training) else {}
    planner = asdict(config.planner) if config.policy == "planned" else {}
    table = {
        "form": FORM,
        "space": [asdict(p) for p in setting.space.parameters],
        "training": training,
        "trainer": getattr(setting.trainer.train, "__qualname__", ""),
        "planner": planner,
        "shown": [config.components, BLIND],
        "steps": [sim.length, float(sim.dt)],
        "traced": digest_of(run, jax.random.key(0), values, action),
        "model": digest_of_arrays(sim.model),
    }
    return configs.digest(table)
