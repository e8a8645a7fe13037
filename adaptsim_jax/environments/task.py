"""`environment_task`: an environment, named fields as Omega, a trainer; a `Task` for Phase 1, Phase
2 and the baselines.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, is_dataclass, replace
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import silent
from adaptsim_jax.core.traced import digest_of, digest_of_arrays
from adaptsim_jax.environments.checks import check_fields, check_pure
from adaptsim_jax.environments.config import EnvironmentConfig
from adaptsim_jax.environments.fields import Field, space_of
from adaptsim_jax.environments.gymnax import from_gymnax
from adaptsim_jax.environments.interface import Play, make_play
from adaptsim_jax.environments.planner import make_planner
from adaptsim_jax.environments.rollout import Acting, Rollout, Shown, Steps, look, visit, whitened
from adaptsim_jax.environments.simulated import OWN, Simulated, load, simulated
from adaptsim_jax.environments.targets import Target, hidden_fields, native_physics, target_of
from adaptsim_jax.environments.trainer import Trainer, Worlds, make_ppo_trainer
from adaptsim_jax.space import Space
from adaptsim_jax.tasks.base import Preparation, Task

PAIRS, CHUNK = 512, 10
# of training, at its start: told E at once, a policy stops at worse ways to swing up than one that
# is told nothing
BLIND = 0.5
FORM = 3  # of what is learned: what was learned in another is learned anew
LEAST_SPREAD = (
    0.02  # of a target's best return: policies that differ by less are told apart by luck alone
)


class Law(NamedTuple):
    """A policy that is one network for all of Omega, and E's mean `[D]` (unit coordinates) that it
    is told.
    """

    mean: jax.Array


class Tuned(NamedTuple):
    """A policy of its own: E's mean `[D]`, and its network."""

    mean: jax.Array
    actor: Any


class Prepared(NamedTuple):
    """What is made once: what the trainer learned (None where nothing is), how what is seen is
    shown to the adaptation, and what starts are worth `[3]`: mean and standard deviation of the
    policy's value of them, and the return that a unit of it is worth.
    """

    learned: Any
    shown: Shown
    starts: jax.Array


class Setting(NamedTuple):
    """All that an environment's task is made of, before anything is learned. `env`: as it was
    given; fields: Omega's, then those that only targets have, whose nominal values are `rest [R]`.
    """

    config: EnvironmentConfig
    env: Any
    sim: Simulated
    space: Space
    fields: tuple[Field, ...]
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
    made = trainer(play, space, config.training, _obs_dim(play, omega, where))
    return Setting(config, env, sim, space, fields, play, compiled(made), targets, rest)


def environment_setting(config: EnvironmentConfig) -> Setting:
    """All that the task of `config` is made of, before anything is learned."""
    where = config.env if config.env in OWN else "env.toml"
    return setting_of(load(config.env, config.options, where), config, where=where)


def compiled(trainer: Trainer) -> Trainer:
    """The same with one compiled program for all that it trains."""
    return trainer._replace(
        begin=jax.jit(trainer.begin), train=jax.jit(trainer.train, static_argnums=3)
    )


def environment(
    env: Any, fields: tuple[Field, ...] = (), length: int = 0, where: str = "env"
) -> Simulated:
    """`env`, over an `mjx.Model` or of gymnax, as pure functions of its model; BadInput as
    `simulated`.
    """
    if hasattr(env, "default_params") and hasattr(env, "step_env"):
        return from_gymnax(env, env.default_params, length)
    return simulated(env, fields, length, where)


def _obs_dim(play: Play, fields: tuple[Field, ...], where: str) -> int:
    nominal = jnp.asarray([f.nominal for f in fields], jnp.float32)
    live = jax.eval_shape(lambda key: play.reset(play.world(nominal), key), jax.random.key(0))
    if live.obs.ndim != 1:
        raise BadInput(f"{where}: observations have the shape {live.obs.shape}; a vector is wanted")
    return live.obs.shape[0]


def environment_task(
    env: Any,
    fields: Mapping[str, Any] | None = None,
    config: EnvironmentConfig | None = None,
    **options: Any,
) -> Task:
    """A `Task` of anything with `reset(key)` and `step(state, action)` over an `mjx.Model`, or of
    gymnax.

    Args:
        env: such as `mujoco_playground.registry.load(...)`, a `ModelEnvironment`, or a name as in
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

    def make(key, report=silent):
        return prepared_of(setting, key, report)

    whole = cache(lambda: digest(setting))
    return replace(
        ready(setting, zeros), preparation=Preparation(blank, make, partial(ready, setting), whole)
    )


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


def visit_shape(setting: Setting) -> int:
    """How many features a visit has."""
    obs, act = _obs_dim(setting.play, setting.play.fields, "env"), setting.sim.action_dim
    return 3 * min(4, setting.sim.length) * (obs + act) + 12 * obs + 2


def acting_of(setting: Setting, learned: Any, starts: Any = (0.0, 0.0, 0.0)) -> Acting:
    """How the task's policies act, given what the trainer learned, and what `starts` are worth
    (`Prepared`).
    """
    if setting.config.policy == "planned":
        return make_planner(setting.play, setting.space, setting.config.planner)
    critic = setting.trainer.policy(learned)
    shared = None if setting.config.policy == "tuned" else critic
    mean, spread, worth = jnp.asarray(starts)

    def luck(obs):
        value = setting.trainer.value(critic, obs, jnp.zeros(setting.space.dim))
        return worth * jnp.clip(value - mean, -3.0 * spread, 3.0 * spread)

    def act(key, policy, memory, live):
        actor = policy.actor if shared is None else shared
        return setting.trainer.act(actor, live.obs, 2.0 * policy.mean - 1.0), memory

    return Acting(lambda policy: (), act, luck)


def policies_of(setting: Setting, learned: Any) -> Callable[[jax.Array], Any]:
    """`(mean [D]) -> policy`, as it is before any tuning."""
    if setting.config.policy != "tuned":
        return Law
    return lambda mean: Tuned(mean, setting.trainer.policy(learned))


def network_acting(setting: Setting) -> Acting:
    """The same for policies that bring their own network, `Tuned`."""

    def act(key, policy, memory, live):
        return setting.trainer.act(policy.actor, live.obs, 2.0 * policy.mean - 1.0), memory

    return Acting(lambda policy: (), act)


def trained_in(
    trainer: Trainer,
    key: jax.Array,
    learned: Any,
    worlds: Worlds,
    rounds: int,
    report: Callable = silent,
    blind: float = 0.0,
) -> Any:
    """What the trainer has learned after `rounds` in `worlds` from `learned`: in chunks, so that
    progress shows.

    blind: for this share of the rounds, the first, no world is told.
    """
    begin_key, key = jax.random.split(key)
    state = trainer.begin(begin_key, learned)
    size = max(
        n for n in range(1, min(CHUNK, rounds) + 1) if rounds % n == 0
    )  # one compiled program serves all of it
    last = float("nan")
    for done in range(size, rounds + 1, size):
        known = worlds.known if done > blind * rounds else jnp.zeros(())
        state, info = trainer.train(key, state, worlds._replace(known=known), size)
        episodes = np.asarray(info.episode)
        if np.isfinite(episodes).any():
            last = float(np.nanmean(episodes))
        report(done, rounds, f"training the policy, return {last:.4g}")
    return trainer.learned(state)


def everywhere(setting: Setting, known: bool = True) -> Worlds:
    """All of Omega, told to the policy or not (UDR)."""
    D = setting.space.dim
    return Worlds(jnp.zeros(D), jnp.ones(D), jnp.asarray(known, jnp.float32), jnp.zeros(0))


def prepared_of(setting: Setting, key: jax.Array, report: Callable = silent) -> Prepared:
    """Train the policy that knows E's mean, then look at what visits within Omega show. BadInput
    names a field that does nothing.
    """
    train_key, init_key, look_key = jax.random.split(key, 3)
    check_pure(setting.play, np.array([f.nominal for f in setting.play.fields]))
    check_fields(setting.space.names, shaken(setting))
    learned = None
    if setting.config.policy != "planned":
        learned = setting.trainer.init(init_key)
        rounds = setting.config.training.rounds
        learned = trained_in(
            setting.trainer, train_key, learned, everywhere(setting), rounds, report, BLIND
        )
    acting = acting_of(setting, learned, (0.0, 1e9, 1.0))  # a start's luck is its value
    policy_of = policies_of(setting, learned)

    @jax.jit
    @jax.vmap
    def seen(key, mean, u):
        return visit(key, setting.play, acting, policy_of(mean), setting.space.physical(u), 1)

    count = PAIRS if setting.config.policy != "planned" else 64
    points = jnp.asarray(qmc.Sobol(2 * setting.space.dim, rng=0).random(count), jnp.float32)
    found = seen(jax.random.split(look_key, count), *jnp.split(points, 2, 1))
    features = np.asarray(found.features)
    if not np.isfinite(features).any(1).all():
        raise BadInput(
            "env: what policies show is not finite; mend the reward, or narrow the fields' ranges"
        )
    return Prepared(learned, whitened(features, setting.config.components), starts_of(found))


def starts_of(found: Rollout) -> jax.Array:
    """`Prepared.starts` of visits `found [N]` whose luck is the value of their start, by least
    squares.
    """
    score, value = (np.asarray(x, float) for x in (found.score, found.luck))
    sound = np.isfinite(score) & np.isfinite(value)
    score, value = score[sound], value[sound]
    slope = np.cov(score, value)[0, 1] / (value.var() + 1e-12)
    return jnp.asarray([value.mean(), value.std(), max(slope, 0.0)], jnp.float32)


def shaken(setting: Setting) -> Callable[[jax.Array], np.ndarray]:
    """`(u [N, D]) -> [N, K]` features of an episode under the same random actions. BadInput where
    its rewards are not finite.
    """
    dim = setting.sim.action_dim
    random = Acting(
        lambda policy: (),
        lambda key, policy, memory, live: (jax.random.uniform(key, (dim,), minval=-1.0), memory),
    )

    @jax.jit
    @jax.vmap
    def run(u):
        return visit(jax.random.key(0), setting.play, random, (), setting.space.physical(u), 1)

    def seen(u):
        found = run(u)
        if not np.isfinite(np.asarray(found.score)).all():
            bad = int(np.flatnonzero(~np.isfinite(np.asarray(found.score)))[0])
            at = dict(
                zip(
                    setting.space.names,
                    np.asarray(setting.space.physical(u[bad])).round(4).tolist(),
                    strict=True,
                )
            )
            raise BadInput(
                f"env: the return is not finite under random actions at {at}; mend the reward, or "
                f"narrow that range"
            )
        return np.asarray(found.features)

    return seen


def ready(setting: Setting, prepared: Prepared) -> Task:
    """The task with its policy trained."""
    config, space = setting.config, setting.space
    acting = acting_of(setting, prepared.learned, prepared.starts)
    policy_of = policies_of(setting, prepared.learned)

    def init_policy(key):
        return policy_of(jnp.full(space.dim, 0.5))

    def train(key, dist, policy):
        if config.policy != "tuned":
            return Law(dist.mean)
        half = jnp.full(space.dim, config.spread)
        worlds = Worlds(dist.mean - half, dist.mean + half, jnp.ones(()), jnp.zeros(0))
        state = setting.trainer.begin(key, prepared.learned)
        state, _ = setting.trainer.train(key, state, worlds, config.tune)
        return Tuned(dist.mean, setting.trainer.policy(setting.trainer.learned(state)))

    def rollout(key, policy, params):
        return visit(key, setting.play, acting, policy, params, config.trials)

    def own_key(params):
        """Of a target's own starts, which Phase 1 judges every policy from: luck with a start is no
        merit.
        """
        bits = jax.lax.bitcast_convert_type(jnp.sum(jnp.asarray(params, jnp.float32)), jnp.uint32)
        return jax.random.fold_in(jax.random.key(0), bits)

    def rehearse(key, policy, params):
        """What `rollout` shows, with the return from the target's own starts."""
        both = jax.vmap(lambda k: rollout(k, policy, params))(jnp.stack([key, own_key(params)]))
        shown, judged = (jax.tree.map(lambda x, i=i: x[i], both) for i in (0, 1))
        return shown._replace(score=judged.score)

    means = jnp.asarray(qmc.Sobol(space.dim, rng=1).random(config.references), jnp.float32)

    def reference(params):
        """Best and mean return in the target of policies at means spread over Omega, and at the
        target's own place in it.
        """
        own = jnp.clip(space.unit(jnp.asarray(params, jnp.float32)), 0.0, 1.0)[None]
        every = jnp.concatenate([means, own])
        score = jax.vmap(lambda m: rollout(own_key(params), policy_of(m), params).score)(every)
        return jnp.stack([score.max(), score[:-1].mean()])

    def reward(trajectory, bounds):
        spread = jnp.maximum(bounds[0] - bounds[1], LEAST_SPREAD * jnp.abs(bounds[0]) + 1e-6)
        return jnp.minimum(1.0 - (bounds[0] - trajectory.score) / spread, 1.0)

    return Task(
        name="environment",
        space=space,
        targets=_wider(space, setting.fields, config.wide),
        obs_dim=config.components,
        settings={name: _of_omega(space, target) for name, target in setting.targets.items()},
        init_policy=init_policy,
        train=train,
        rollout=rollout,
        rehearse=rehearse,
        doubt=config.doubt,
        observe=lambda trajectory: prepared.shown(trajectory.features),
        score=lambda trajectory: trajectory.score - trajectory.luck,
        reference=reference,
        reward=reward,
        world=lambda name: in_target(setting, prepared, name),
        act=None
        if config.policy == "planned"
        else lambda policy, obs: _acts(setting, prepared, policy, obs),
        read=lambda obs, action, reward: measured(setting, obs, action, reward, acting),
    )


def _acts(setting: Setting, prepared: Prepared, policy: Any, obs: jax.Array) -> jax.Array:
    if isinstance(policy, Tuned):
        actor = policy.actor
    else:
        actor = setting.trainer.policy(prepared.learned)
    return setting.trainer.act(actor, obs, 2.0 * policy.mean - 1.0)


def measured(setting: Setting, obs: Any, action: Any, reward: Any, acting: Acting) -> Rollout:
    """An episode that was measured, `obs [t, O]`, `action [t, A]`, `reward [t]`, as one that was
    simulated: where it ended early, it is over from there. BadInput names a shape that does not
    fit.
    """
    T, A = setting.sim.length, setting.sim.action_dim
    O = _obs_dim(setting.play, setting.play.fields, "env")
    rows = [np.asarray(x, np.float32) for x in (obs, action, reward)]
    t = len(rows[2])
    for name, x, shape in zip(
        ("obs", "action", "reward"), rows, ((t, O), (t, A), (t,)), strict=True
    ):
        if x.shape != shape or not 1 <= t <= T or not np.isfinite(x).all():
            raise BadInput(
                f"{name}: the shape is {x.shape}; {shape} of finite numbers is wanted, of 1 to {T} "
                f"steps"
            )
    full = [np.concatenate([x, np.zeros((T - t, *x.shape[1:]), np.float32)]) for x in rows]
    on = jnp.asarray(np.arange(T) < t, jnp.float32)
    return look(Steps(jnp.asarray(full[0]), jnp.asarray(full[1]), jnp.asarray(full[2]), on), acting)


def _of_omega(space: Space, target: Target) -> dict[str, float]:
    return dict(zip(space.names, map(float, target.values), strict=False))


def _wider(space: Space, fields: tuple[Field, ...], share: float) -> Space:
    """Omega with each range wider by `share` of it at both ends, where the field can be there."""

    def one(p, field):
        if p.scale == "log":
            factor = (p.high / p.low) ** share
            return replace(p, low=p.low / factor, high=p.high * factor)
        more = share * (p.high - p.low)
        # what must be positive stays so, and above a third of the least in Omega
        if field.least < 0:
            low = p.low - more
        else:
            low = max(p.low - more, p.low / 3.0, field.least)
        return replace(p, low=low, high=p.high + more)

    return Space(tuple(one(p, f) for p, f in zip(space.parameters, fields, strict=False)))


def play_in(setting: Setting, target: Target) -> tuple[Play, jax.Array]:
    """The environment as the target steps it, in MuJoCo C or, where the target says so, in the
    simulator, and its values `[F]`: of the fields that Omega lacks, those that the target changes.
    """
    D = setting.space.dim
    kept = [i for i, f in enumerate(setting.fields) if i < D or target.values[i] != f.nominal]
    fields, values = tuple(setting.fields[i] for i in kept), target.values[kept]
    longest, told = longest_delay(fields, values), jnp.asarray(values, jnp.float32)
    if target.engine == "simulator":
        return make_play(
            environment(setting.env, fields, setting.config.length), fields, longest
        ), told
    assert setting.sim.native is not None
    physics = native_physics(setting.sim.native, fields, target._replace(values=values))
    return make_play(setting.sim, fields, longest, physics), told


def longest_delay(fields: Sequence[Field], *values: np.ndarray) -> float:
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

    means = jnp.asarray(
        qmc.Sobol(setting.space.dim, rng=1).random(setting.config.references), jnp.float32
    )
    score = jax.jit(jax.vmap(lambda m: rollout(jax.random.key(0), policy_of(m), None).score))
    every = np.asarray(score(means))
    told = jnp.asarray([np.nanmax(every), np.nanmean(every)], jnp.float32)
    return replace(task, rollout=rollout, reference=lambda params: told)
