"""The rows of `adaptsim compare` for policies over many steps, beside those of `learned.py` and
`bayesopt.py`, which serve them too.

Every method trains the same networks with the same learner in the same simulator. Target trials are
episodes, counted alike.
"""

import importlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from adaptsim_jax.baselines.arena import lanes
from adaptsim_jax.baselines.learned import Bout, Trip
from adaptsim_jax.baselines.steps_arena import StepsArena
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.environments.interface import make_play
from adaptsim_jax.environments.task import (
    Law,
    Tuned,
    compiled,
    environment,
    everywhere,
    longest_delay,
    trained_in,
)
from adaptsim_jax.environments.trainer import Worlds, make_ppo_trainer


def udr(bout: Bout) -> Trip:
    """One policy for all of Omega, told nothing; no target data."""
    return _untried(bout, "udr", lambda setting: everywhere(setting, known=False))


def udr_wide(bout: Bout) -> Trip:
    """The same over the wider box that Phase 1 draws its targets from."""

    def worlds(setting):
        box = bout.arena.one.task.targets.parameters
        low, high = (
            setting.space.unit(jnp.asarray([getattr(p, end) for p in box]))
            for end in ("low", "high")
        )
        return Worlds(low, high, jnp.zeros(()), jnp.zeros(0))

    return _untried(bout, "udr_wide", worlds)


def nominal(bout: Bout) -> Trip:
    """The policy trained at the file's own values."""

    def worlds(setting):
        fields = setting.fields[: setting.space.dim]
        u = setting.space.unit(jnp.asarray([f.nominal for f in fields], jnp.float32))
        return Worlds(u, u, jnp.zeros(()), jnp.zeros(0))

    return _untried(bout, "nominal", worlds)


def _untried(bout: Bout, name: str, worlds_of: Callable[[Any], Worlds]) -> Trip:
    """A policy of its own, of one seed, scored in every target."""
    arena: StepsArena = bout.arena  # type: ignore[assignment]
    batch = lanes(len(arena.targets), bout.seeds, 1, label=11)
    policy = _network(bout, name, worlds_of)
    many = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(batch.where), *x.shape)), policy)
    return Trip(batch.grid(arena.score(batch.where, many))[..., None], None, np.zeros(1, int))


def _network(bout: Bout, name: str, worlds_of: Callable[[Any], Worlds]) -> Tuned:
    if name not in bout.cache:
        setting, seed = bout.arena.setting, int(bout.seeds[0])  # type: ignore[attr-defined]
        key, init_key, _ = jax.random.split(
            jax.random.key(seed), 3
        )  # as `prepared_of`: luck in training is shared
        rounds = setting.config.training.rounds
        learned = trained_in(
            setting.trainer,
            key,
            setting.trainer.init(init_key),
            worlds_of(setting),
            rounds,
            bout.report,
        )
        bout.cache[name] = Tuned(jnp.full(setting.space.dim, 0.5), setting.trainer.policy(learned))
    return bout.cache[name]


def fine_tune(bout: Bout) -> Trip:
    """The policy at the middle of Omega, trained on by its own episodes in the target: an update
    after every `together` of them.
    """
    arena: StepsArena = bout.arena  # type: ignore[assignment]
    setting, config = arena.setting, bout.config.steps
    total = max(config.together, bout.config.starts * (bout.config.iterations + 1))
    updates = total // config.together
    length, minibatches = setting.sim.length, setting.config.training.minibatches
    training = replace(
        setting.config.training,
        parallel=config.together,
        unroll=length,
        epochs=config.epochs,
        decay=1.0,
        stagger=False,
        minibatches=max(n for n in range(1, minibatches + 1) if config.together * length % n == 0),
        hyper=replace(setting.config.training.hyper, learning_rate=config.rate),
    )
    middle = jnp.full(setting.space.dim, 0.5)
    rows = []
    for t in range(len(arena.targets)):
        play, values = arena.plays[arena.names[t]]

        def make(play=play):
            return compiled(make_ppo_trainer(play, setting.space, training, _obs_dim(arena)))

        trainer = arena.kept(("fine_tune", arena.names[t]), make)
        u = setting.space.unit(values[: setting.space.dim])
        worlds = Worlds(u, u, jnp.zeros(()), values[setting.space.dim :])
        key = jax.random.fold_in(jax.random.key(int(bout.seeds[0])), 100 + t)
        state, actors = (
            trainer.begin(key, arena.prepared.learned),
            [trainer.policy(arena.prepared.learned)],
        )
        for _ in range(updates):
            state, _ = trainer.train(key, state, worlds, 1)
            actors.append(trainer.policy(trainer.learned(state)))
        many = jax.tree.map(lambda *x: jnp.stack(x), *[Tuned(middle, a) for a in actors])
        rows.append(arena.score(np.full(len(actors), t), many))
        bout.report(t + 1, len(arena.targets))
    spent = config.together * np.arange(updates + 1)
    return Trip(np.stack(rows)[:, None, None], None, spent)


def _obs_dim(arena: StepsArena) -> int:
    return int(arena.setting.trainer.policy(arena.prepared.learned).mean.shape[0])


def cma_es(bout: Bout) -> Trip:
    """E's mean by the covariance matrix adaptation of Hansen (2016), a visit for each candidate
    (package `cma`).
    """
    try:
        cma: Any = importlib.import_module("cma")
    except ModuleNotFoundError:
        raise BadInput("compare: method 'cma_es' needs the package cma; pip install cma") from None
    arena: StepsArena = bout.arena  # type: ignore[assignment]
    space, total = arena.one.task.space, bout.config.starts * (bout.config.iterations + 1)
    T = len(arena.targets)
    options = {"bounds": [0.0, 1.0], "verbose": -9, "seed": int(bout.seeds[0]) + 1}
    searches = [
        cma.CMAEvolutionStrategy(space.dim * [0.5], bout.config.steps.sigma, options)
        for _ in range(T)
    ]
    means, rewards, own = [], [], []
    while len(means) < total:
        asked = [search.ask() for search in searches]
        for j in range(min(len(asked[0]), total - len(means))):
            at = np.array([a[j] for a in asked], np.float32)
            seen = arena.visit(None, np.arange(T), Law(jnp.asarray(at)))
            rewards.append(arena.score(np.arange(T), Law(jnp.asarray(at))))
            means.append(at)
            own.append(seen.score)
        told = len(asked[0])
        if len(means) % told == 0:
            for t, search in enumerate(searches):
                search.tell(asked[t], [-float(s[t]) for s in own[-told:]])
        bout.report(len(means), total)

    def shape(x):
        return np.stack(x, 1)[:, None, None]

    return Trip(shape(rewards), shape(means), arena.one.trials * np.arange(1, total + 1))


def best_in_omega(bout: Bout) -> Trip:
    """The best mean of E by the tests themselves: a spread of points, then two rounds about the
    best. A bound, not a method.
    """
    arena: StepsArena = bout.arena  # type: ignore[assignment]
    D, count, rows = arena.setting.space.dim, bout.config.steps.points, []
    spread = qmc.Sobol(D, rng=3).random(count).astype(np.float32)
    for t in range(len(arena.targets)):
        best, value = None, -np.inf
        for reach in (None, 0.15, 0.05):
            if reach is None or best is None:
                near = spread
            else:
                near = np.clip(best + reach * (2.0 * spread - 1.0), 0.0, 1.0)
            scores = arena.score(np.full(count, t), Law(jnp.asarray(near)))
            k = int(np.nanargmax(scores))
            if scores[k] > value:
                best, value = (near[k], scores[k])
            else:
                best, value = (best, value)
        rows.append(value)
        bout.report(t + 1, len(arena.targets))
    return Trip(np.array(rows)[:, None, None, None], None, np.zeros(1, int))


def oracle(bout: Bout) -> Trip:
    """The policy that knows E, trained on in the target's own world, fields that Omega lacks
    included. A bound, not a method.
    """
    arena: StepsArena = bout.arena  # type: ignore[assignment]
    setting = arena.setting
    training, D = setting.config.training, setting.space.dim
    every = [setting.targets[name].values for name in arena.names]

    def made():
        sim = environment(setting.env, setting.fields, setting.config.length)
        play = make_play(sim, setting.fields, longest_delay(setting.fields, *every))
        return compiled(make_ppo_trainer(play, setting.space, training, _obs_dim(arena)))

    trainer = arena.kept("oracle", made)
    rounds = max(1, round(bout.config.steps.share * training.rounds))
    rows = []
    for t, values in enumerate(every):
        u = setting.space.unit(jnp.asarray(values[:D], jnp.float32))
        worlds = Worlds(u, u, jnp.ones(()), jnp.asarray(values[D:], jnp.float32))
        key = jax.random.fold_in(jax.random.key(int(bout.seeds[0])), 200 + t)
        learned = trained_in(trainer, key, arena.prepared.learned, worlds, rounds, bout.report)
        tuned = Tuned(u, trainer.policy(learned))
        law = arena.score(np.full(1, t), Law(jnp.clip(u, 0.0, 1.0)[None]))
        own = arena.score(np.full(1, t), jax.tree.map(lambda x: x[None], tuned))
        rows.append(max(float(own[0]), float(law[0])))
    return Trip(np.array(rows)[:, None, None, None], None, np.zeros(1, int))
