"""The policies of an environment's task: how they act, and how the one that knows E is trained.

Before that it is checked what only shows when an environment runs: functions that are not pure,
fields that do nothing.
"""

import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.stats import qmc

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.progress import silent
from adaptsim_jax.core.store import Kept
from adaptsim_jax.core.traced import digest_of
from adaptsim_jax.environments.course import TrainingPlan, trained_in
from adaptsim_jax.environments.episodes import ActingPolicy, Play, Rollout, Shown, visit, whitened
from adaptsim_jax.environments.setting import BLIND, Setting, obs_dim_of
from adaptsim_jax.environments.trainer import Worlds, make_planner
from adaptsim_jax.space import Space

PAIRS = 512


class Law(NamedTuple):
    """A policy that is one network for all of Omega, and E's mean `[D]` (unit coordinates) that it
    is told.
    """

    mean: Array


class Tuned(NamedTuple):
    """A policy of its own: E's mean `[D]`, and its network."""

    mean: Array
    actor: Any


class Prepared(NamedTuple):
    """What is made once.

    learned: What the trainer learned, None where nothing is. shown: How features become the
    observation of the adaptation. starts: What starts are worth. These are the mean and the
    standard deviation of the policy's value of them, and the return that a unit of it is worth.
    """

    learned: Any
    shown: Shown
    starts: Array


def visit_shape(setting: Setting) -> int:
    """How many features a visit has."""
    obs, act = obs_dim_of(setting.play, setting.play.fields, "env"), setting.sim.action_dim
    return 3 * min(4, setting.sim.length) * (obs + act) + 12 * obs + 2


def acting_of(setting: Setting, learned: Any, starts: Any = (0.0, 0.0, 0.0)) -> ActingPolicy:
    """How the task's policies act, given what the trainer learned, and what `starts` are worth
    (`Prepared`).
    """
    if setting.config.policy == "planned":
        return make_planner(setting.play, setting.space, setting.config.planner)
    critic = setting.trainer.policy(learned)
    own = setting.config.policy == "tuned"
    mean, spread, worth = jnp.asarray(starts)

    def luck(obs):
        value = setting.trainer.value(critic, obs, jnp.zeros(setting.space.dim))
        return worth * jnp.clip(value - mean, -3.0 * spread, 3.0 * spread)

    def act(key, policy, memory, live):
        actor = policy.actor if own else critic
        return setting.trainer.act(actor, live.obs, 2.0 * policy.mean - 1.0), memory

    return ActingPolicy(lambda policy: (), act, luck)


def policies_of(setting: Setting, learned: Any) -> Callable[[Array], Any]:
    """`(mean [D]) -> policy`, as it is before any tuning."""
    if setting.config.policy != "tuned":
        return Law
    return lambda mean: Tuned(mean, setting.trainer.policy(learned))


def network_acting(setting: Setting) -> ActingPolicy:
    """The same for policies that bring their own network, `Tuned`."""

    def act(key, policy, memory, live):
        return setting.trainer.act(policy.actor, live.obs, 2.0 * policy.mean - 1.0), memory

    return ActingPolicy(lambda policy: (), act)


def everywhere(setting: Setting, known: bool = True) -> Worlds:
    """All of Omega, told to the policy or not (UDR)."""
    D = setting.space.dim
    return Worlds(jnp.zeros(D), jnp.ones(D), jnp.asarray(known, jnp.float32), jnp.zeros(0))


def prepared_of(
    setting: Setting, key: Array, report: Callable = silent, kept: Kept | None = None
) -> Prepared:
    """Train the policy that knows E's mean, then look at what visits within Omega show. BadInput
    names a field that does nothing. kept: Holds the training while it lasts.
    """
    train_key, init_key, look_key = jax.random.split(key, 3)
    check_pure(setting.play, np.array([f.nominal for f in setting.play.fields]))
    check_fields(setting.space, shaken(setting))
    learned = None
    if setting.config.policy != "planned":
        learned = setting.trainer.init(init_key)
        plan = TrainingPlan(setting.config.training.rounds, BLIND, kept)
        learned = trained_in(setting.trainer, train_key, learned, everywhere(setting), plan, report)
    acting = acting_of(setting, learned, (0.0, 1e9, 1.0))  # a start's luck is its value
    policy_of = policies_of(setting, learned)

    @jax.jit
    @jax.vmap
    def visits(key, mean, u):
        return visit(key, setting.play, acting, policy_of(mean), setting.space.physical(u), 1)

    count = PAIRS if setting.config.policy != "planned" else 64
    points = jnp.asarray(qmc.Sobol(2 * setting.space.dim, rng=0).random(count), jnp.float32)
    found = visits(jax.random.split(look_key, count), *jnp.split(points, 2, 1))
    features = np.asarray(found.features)
    if not np.isfinite(features).any(1).all():
        raise BadInput(
            "env: what policies show is not finite; mend the reward, or narrow the fields' ranges"
        )
    return Prepared(learned, whitened(features, setting.config.components), starts_of(found))


def starts_of(found: Rollout) -> Array:
    """`Prepared.starts` of visits `found [N]` whose luck is the value of their start, by least
    squares.
    """
    score, value = (np.asarray(x, float) for x in (found.score, found.luck))
    sound = np.isfinite(score) & np.isfinite(value)
    score, value = score[sound], value[sound]
    slope = np.cov(score, value)[0, 1] / (value.var() + 1e-12)
    return jnp.asarray([value.mean(), value.std(), max(slope, 0.0)], jnp.float32)


def shaken(setting: Setting) -> Callable[[Array], np.ndarray]:
    """`(u [N, D]) -> [N, K]` features of an episode under the same random actions. BadInput where
    its rewards are not finite.
    """
    dim = setting.sim.action_dim
    random = ActingPolicy(
        lambda policy: (),
        lambda key, policy, memory, live: (jax.random.uniform(key, (dim,), minval=-1.0), memory),
    )

    @jax.jit
    @jax.vmap
    def run(u):
        return visit(jax.random.key(0), setting.play, random, (), setting.space.physical(u), 1)

    def features(u):
        found = run(u)
        finite = np.isfinite(np.asarray(found.score))
        if not finite.all():
            values = np.asarray(setting.space.physical(u[finite.argmin()])).round(4).tolist()
            at = dict(zip(setting.space.names, values, strict=True))
            raise BadInput(
                f"env: the return is not finite under random actions at {at}; mend the reward, or "
                "narrow that range"
            )
        return np.asarray(found.features)

    return features


NOTHING = 1e-5  # of what is seen, in its own spread: single precision alone moves it by less


def check_pure(play: Play, values: np.ndarray) -> None:
    """BadInput where two traces of a reset and a step differ: the environment keeps a state of its
    own, or draws without a key.
    """

    def run(key, values):
        world = play.world(values)
        live = play.step(world, play.reset(world, key), jnp.zeros(play.sim.action_dim))
        return live.obs, live.reward, live.done

    given = (jax.random.key(0), jnp.asarray(values, jnp.float32))
    if digest_of(run, *given) != digest_of(run, *given):
        raise BadInput(
            f"env: {play.sim.name} is not pure: called twice alike, reset and step do not do the "
            "same; draw from the key alone, and keep what changes in the state"
        )


LEVELS = 5  # of a field's range, at which it is tried


def check_fields(space: Space, features: Callable[[Array], np.ndarray]) -> None:
    """BadInput names a field that nothing follows from; a line of one from which nothing does in a
    part of its range.

    Args:
        features: `(u [N, D]) -> [N, K]` of the same episode at points of Omega.
    """
    D, levels = space.dim, np.linspace(0.0, 1.0, LEVELS)
    points = np.tile(np.random.default_rng(0).uniform(size=(4, 1, 1, D)), (1, D, LEVELS, 1))
    for i in range(D):
        points[:, i, :, i] = levels
    every = jnp.asarray(points.reshape(-1, D), jnp.float32)
    found = np.asarray(features(every)).reshape(4, D, LEVELS, -1)
    scale = np.nanstd(found.reshape(-1, found.shape[-1]), 0) + 1e-3
    moved = np.nanmax(np.abs(np.diff(found, axis=2)) / scale, axis=(0, 3)) > NOTHING
    ends = np.asarray(space.physical(jnp.tile(levels[:, None], (1, D)).astype(jnp.float32)))
    for i, name in enumerate(space.names):
        if not moved[i].any():
            raise BadInput(
                f"fields: nothing that is seen follows from '{name}' anywhere in its range; leave "
                "it out, or widen it"
            )
        if not moved[i].all():
            still = [f"{ends[k, i]:.4g} to {ends[k + 1, i]:.4g}" for k in np.flatnonzero(~moved[i])]
            print(
                f"fields: nothing follows from '{name}' from {', '.join(still)} (of two geoms that "
                "touch the greater friction acts); a value in there is the one at its edge",
                file=sys.stderr,
            )
