"""`environment_task`: an environment, named fields as Omega, a trainer; a `Task` for Phase 1, Phase 2
and the baselines.
"""  # noqa: E501

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.stats import qmc

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import silent
from adaptsim_jax.environments.episodes import (
    ActingPolicy,
    EpisodeSteps,
    Play,
    Rollout,
    Shown,
    look,
    make_play,
    visit,
)
from adaptsim_jax.environments.fields import ModelField, of_law
from adaptsim_jax.environments.mended import mended
from adaptsim_jax.environments.peers import OWN, load
from adaptsim_jax.environments.policies import (
    Law,
    Prepared,
    Tuned,
    acting_of,
    policies_of,
    prepared_of,
    visit_shape,
)
from adaptsim_jax.environments.setting import (
    EnvironmentConfig,
    Setting,
    digest,
    environment,
    obs_dim_of,
    setting_of,
)
from adaptsim_jax.environments.targets import DECLARED, Target, native_physics
from adaptsim_jax.environments.trainer import Worlds
from adaptsim_jax.space import Space
from adaptsim_jax.tasks.base import Preparation, Task, scaled_reward


def environment_task(
    env: Any,
    fields: Mapping[str, Any] | None = None,
    config: EnvironmentConfig | None = None,
    **options: Any,
) -> Task:
    """A `Task` of anything with `reset(key)` and `step(state, action)` over an `mjx.Model`, or of
    gymnax.

    Args:
        env: Such as `mujoco_playground.registry.load(...)`, a `ModelEnvironment`, or a name as in
                env.toml.
        fields: Omega: for each name `[low, high]` or `[low, high, "log"]`. By default `env.fields`.
        config, options: `EnvironmentConfig`, and what of it differs.

    Returns:
        A task whose `preparation` trains the policy first (`adaptsim train` does so).
    """
    config = replace(config or EnvironmentConfig(), **options)
    if isinstance(env, str):
        config, env = replace(config, env=env), load(env, config.options)
    return task_of(
        setting_of(env, config if fields is None else replace(config, fields=dict(fields)))
    )


def task_of(setting: Setting) -> Task:
    """The task as it is before its policy was trained, with the `preparation` that does so."""
    trained = setting.config.policy != "planned"

    def blank(key):
        k = visit_shape(setting)
        shown = Shown(jnp.zeros(k), jnp.zeros((setting.config.components, k)))
        return Prepared(setting.trainer.init(key) if trained else None, shown, jnp.zeros(3))

    zeros = jax.tree.map(
        lambda x: np.zeros(x.shape, x.dtype), jax.eval_shape(blank, jax.random.key(0))
    )

    def make(key, report=silent, kept=None):
        return prepared_of(setting, key, report, kept)

    whole = cache(lambda: digest(setting))
    return replace(
        ready(setting, zeros), preparation=Preparation(blank, make, partial(ready, setting), whole)
    )


def ready(setting: Setting, prepared: Prepared) -> Task:
    """The task with its policy trained."""
    config, space = setting.config, setting.space
    acting = acting_of(setting, prepared.learned, prepared.starts)
    policy_of = policies_of(setting, prepared.learned)

    def rollout(key, policy, params):
        return visit(key, setting.play, acting, policy, params, config.trials)

    def act(policy, obs):
        return _acts(setting, prepared, policy, obs)

    def world(target):
        if isinstance(target, Path):
            return in_file(setting, prepared, target)
        return in_target(setting, prepared, target)

    return Task(
        name="environment",
        space=space,
        targets=_wider(space, setting.fields, config.wide),
        obs_dim=config.components,
        first=_first(setting),
        settings={name: _of_omega(space, target) for name, target in setting.targets.items()},
        init_policy=lambda key: policy_of(jnp.full(space.dim, 0.5)),
        train=_training(setting, prepared.learned),
        rollout=rollout,
        rehearse=_rehearsal(rollout),
        doubt=config.doubt,
        observe=lambda trajectory: prepared.shown(trajectory.features),
        score=lambda trajectory: trajectory.score - trajectory.luck,
        reference=_reference(setting, rollout, policy_of),
        reward=lambda trajectory, bounds: scaled_reward(trajectory.score, bounds),
        world=world,
        act=None if config.policy == "planned" else act,
        read=lambda obs, action, reward: measured(setting, obs, action, reward, acting),
    )


def _first(setting: Setting) -> np.ndarray | None:
    """E's first mean [D] (unit coordinates); what the config does not name is in the middle."""
    given, space = setting.config.start, setting.space
    if not given:
        return None
    for name in given:
        configs.pick("start", name, space.names)
    with jax.ensure_compile_time_eval():  # a task is made within traced programs, too
        middle = np.asarray(space.physical(jnp.full(space.dim, 0.5)))
        values = [given.get(n, float(m)) for n, m in zip(space.names, middle, strict=True)]
        return np.clip(np.asarray(space.unit(jnp.asarray(values, jnp.float32))), 0.0, 1.0)


def _training(setting: Setting, learned: Any) -> Callable:
    """`(key, dist, policy) -> policy` for E: the one that knows its mean, tuned where that is
    asked for.
    """
    config, trainer = setting.config, setting.trainer

    def train(key, dist, policy):
        if config.policy != "tuned":
            return Law(dist.mean)
        low, high = (jnp.clip(dist.mean + way * config.spread, 0.0, 1.0) for way in (-1.0, 1.0))
        worlds = Worlds(low, high, jnp.ones(()), jnp.zeros(0))
        state, _ = trainer.train(key, trainer.begin(key, learned), worlds, config.tune)
        return Tuned(dist.mean, trainer.policy(trainer.learned(state)))

    return train


def _own_key(params: Any) -> Array:
    """Of a target's own starts, which Phase 1 rates every policy from: luck with a start is no
    merit.
    """
    bits = jax.lax.bitcast_convert_type(jnp.sum(jnp.asarray(params, jnp.float32)), jnp.uint32)
    return jax.random.fold_in(jax.random.key(0), bits)


def _rehearsal(rollout: Callable) -> Callable:
    """`(key, policy, params)`: what `rollout` shows, with the return from the target's own
    starts.
    """

    def rehearse(key, policy, params):
        keys = jnp.stack([key, _own_key(params)])
        both = jax.vmap(lambda k: rollout(k, policy, params))(keys)
        shown, rated = (jax.tree.map(lambda x, i=i: x[i], both) for i in (0, 1))
        return shown._replace(score=rated.score)

    return rehearse


def _reference(setting: Setting, rollout: Callable, policy_of: Callable) -> Callable:
    """`(params) -> [2]`: best and mean return in the target of policies at means spread over Omega,
    and at the target's own place in it.
    """
    means = reference_means(setting)

    def reference(params):
        own = jnp.clip(setting.space.unit(jnp.asarray(params, jnp.float32)), 0.0, 1.0)[None]
        every, key = jnp.concatenate([means, own]), _own_key(params)
        score = jax.vmap(lambda m: rollout(key, policy_of(m), params).score)(every)
        return jnp.stack([score.max(), score[:-1].mean()])

    return reference


def reference_means(setting: Setting) -> Array:
    """Means of E `[references, D]` spread over Omega, whose policies scale a target's reward."""
    sobol = qmc.Sobol(setting.space.dim, rng=1)
    return jnp.asarray(sobol.random(setting.config.references), jnp.float32)


def _acts(setting: Setting, prepared: Prepared, policy: Any, obs: Array) -> Array:
    own = isinstance(policy, Tuned)
    actor = policy.actor if own else setting.trainer.policy(prepared.learned)
    return setting.trainer.act(actor, obs, 2.0 * policy.mean - 1.0)


def measured(setting: Setting, obs: Any, action: Any, reward: Any, acting: ActingPolicy) -> Rollout:
    """An episode that was measured, `obs [t, O]`, `action [t, A]`, `reward [t]`, as one that was
    simulated: where it ended early, it is over from there. BadInput names a shape that does not
    fit.
    """
    T, A = setting.sim.length, setting.sim.action_dim
    O = obs_dim_of(setting.play, setting.play.fields, "env")
    rows = [np.asarray(x, np.float32) for x in (obs, action, reward)]
    t = len(rows[2])
    for name, x, shape in zip(
        ("obs", "action", "reward"), rows, ((t, O), (t, A), (t,)), strict=True
    ):
        if x.shape != shape or not 1 <= t <= T or not np.isfinite(x).all():
            raise BadInput(
                f"{name}: the shape is {x.shape}; {shape} of finite numbers is wanted, of 1 to {T} "
                "steps"
            )
    full = [np.concatenate([x, np.zeros((T - t, *x.shape[1:]), np.float32)]) for x in rows]
    on = jnp.asarray(np.arange(T) < t, jnp.float32)
    return look(
        EpisodeSteps(jnp.asarray(full[0]), jnp.asarray(full[1]), jnp.asarray(full[2]), on), acting
    )


def _of_omega(space: Space, target: Target) -> dict[str, float]:
    return dict(zip(space.names, map(float, target.values), strict=False))


def _wider(space: Space, fields: tuple[ModelField, ...], share: float) -> Space:
    """Omega with each range wider by `share` of it at both ends, where the field can be there."""

    def one(p, field):
        if p.scale == "log":
            factor = (p.high / p.low) ** share
            return replace(p, low=p.low / factor, high=p.high * factor)
        more = share * (p.high - p.low)
        # what must be positive stays so, and above a third of the least in Omega
        if field.minimum < 0:
            low = p.low - more
        else:
            low = max(p.low - more, p.low / 3.0, field.minimum)
        return replace(p, low=low, high=p.high + more)

    return Space(tuple(one(p, f) for p, f in zip(space.parameters, fields, strict=False)))


def play_in(setting: Setting, target: Target) -> tuple[Play, Array]:
    """The environment as the target steps it, and its values `[F]`. It steps in MuJoCo C or, where
    the target says so, in the simulator. Of the fields that Omega lacks, those that the target
    changes have a value.
    """
    D = setting.space.dim
    declared = target.model == DECLARED  # which has no numbers of laws that were found
    held = [
        i
        for i, f in enumerate(setting.fields)
        if (i < D or target.values[i] != f.nominal) and not (declared and of_law(f))
    ]
    fields, values = tuple(setting.fields[i] for i in held), target.values[held]
    longest, given = longest_delay(fields, values), jnp.asarray(values, jnp.float32)
    env = setting.declared if declared else setting.env
    if target.model and not declared:
        env = mended(env, target.model)
    sim = environment(env, fields, setting.config.length)
    if target.engine == "simulator":
        return make_play(sim, fields, longest), given
    assert sim.native is not None
    physics = native_physics(sim.native, fields, target._replace(values=values))
    return make_play(sim, fields, longest, physics), given


def longest_delay(fields: Sequence[ModelField], *values: np.ndarray) -> float:
    """The greatest delay [s] among several `values [F]` of `fields`; 0 where none of them is
    one.
    """
    return max(
        (float(v[i]) for v in values for i, f in enumerate(fields) if f.name == "delay"),
        default=0.0,
    )


def in_target(setting: Setting, prepared: Prepared, name: str) -> Task:
    """The task with its rollouts in the target called `name`, whatever the parameters say; rewards
    are scaled in it.
    """
    target = setting.targets[name]
    task, (play, values) = ready(setting, prepared), play_in(setting, target)
    acting = acting_of(setting, prepared.learned, prepared.starts)
    policy_of = policies_of(setting, prepared.learned)

    def rollout(key, policy, params):
        return visit(key, play, acting, policy, values, setting.config.trials)

    score = jax.jit(jax.vmap(lambda m: rollout(jax.random.key(0), policy_of(m), None).score))
    every = score(reference_means(setting))
    ends = jnp.stack([jnp.nanmax(every), jnp.nanmean(every)])
    return replace(task, rollout=rollout, reference=lambda params: ends)


def in_file(setting: Setting, prepared: Prepared, path: Path) -> Task:
    """The task with its rollouts in the target that a TOML file says, called by its name: a table
    of fields as [targets.NAME] has it, or a `model.toml` of `adaptsim diagnose`.
    """
    table = configs.read(path)
    if "schema" in table:
        table = {"model": str(path)}
    config = replace(setting.config, model="", targets={path.stem: table.get("params", table)})
    try:
        return in_target(setting_of(setting.env, config), prepared, path.stem)
    except BadInput as error:
        raise BadInput(f"{path}: {str(error).removeprefix(f'targets.{path.stem}: ')}") from None


def environment_setting(config: EnvironmentConfig) -> Setting:
    """All that the task of `config` is made of, before anything is learned."""
    where = config.env if config.env in OWN else "env.toml"
    return setting_of(load(config.env, config.options, where), config, where=where)
