"""Policies over many steps that are trained otherwise than by adapting E, and the bounds.

Every method trains the same networks with the same learner in the same simulator. Target trials are
episodes, counted alike.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from adaptsim_jax.baselines.arena import MethodRun, Visits, lanes
from adaptsim_jax.baselines.steps_arena import StepsArena
from adaptsim_jax.core.parallel import largest_divisor
from adaptsim_jax.environments.course import TrainingPlan, trained_in
from adaptsim_jax.environments.policies import Law, Tuned, everywhere
from adaptsim_jax.environments.setting import compiled
from adaptsim_jax.environments.trainer import Worlds, make_ppo_trainer


def udr(run: MethodRun) -> Visits:
    """One policy for all of Omega, told nothing; no target data."""
    return _untried(run, "udr", lambda setting: everywhere(setting, known=False))


def udr_wide(run: MethodRun) -> Visits:
    """The same over the wider box that Phase 1 draws its targets from."""

    def worlds(setting):
        box = run.arena.one.task.targets.parameters
        low, high = (
            setting.space.unit(jnp.asarray([getattr(p, end) for p in box]))
            for end in ("low", "high")
        )
        return Worlds(low, high, jnp.zeros(()), jnp.zeros(0))

    return _untried(run, "udr_wide", worlds)


def nominal(run: MethodRun) -> Visits:
    """The policy trained at the file's own values."""

    def worlds(setting):
        fields = setting.fields[: setting.space.dim]
        u = setting.space.unit(jnp.asarray([f.nominal for f in fields], jnp.float32))
        return Worlds(u, u, jnp.zeros(()), jnp.zeros(0))

    return _untried(run, "nominal", worlds)


def _untried(run: MethodRun, name: str, worlds_of: Callable[[Any], Worlds]) -> Visits:
    """A policy of its own, of one seed, scored in every target."""
    arena: StepsArena = run.arena
    batch = lanes(len(arena.targets), run.seeds, 1, label=11)
    policy = _network(run, name, worlds_of)
    many = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(batch.where), *x.shape)), policy)
    return Visits(None, np.zeros(1, int), batch.grid(arena.score(batch.where, many))[..., None])


def _network(run: MethodRun, name: str, worlds_of: Callable[[Any], Worlds]) -> Tuned:
    if name not in run.shared:
        setting, seed = run.arena.setting, int(run.seeds[0])  # type: ignore[attr-defined]
        key, init_key, _ = jax.random.split(
            jax.random.key(seed), 3
        )  # as `prepared_of`: luck in training is shared
        learned = trained_in(
            setting.trainer,
            key,
            setting.trainer.init(init_key),
            worlds_of(setting),
            TrainingPlan(setting.config.training.rounds),
            run.report,
        )
        run.shared[name] = Tuned(jnp.full(setting.space.dim, 0.5), setting.trainer.policy(learned))
    return run.shared[name]


def fine_tune(run: MethodRun) -> Visits:
    """The policy at the middle of Omega, trained on by its own episodes in the target: an update
    after every `together` of them.
    """
    arena: StepsArena = run.arena
    setting, config = arena.setting, run.config.steps
    total = max(config.together, run.config.starts * (run.config.iterations + 1))
    updates = total // config.together
    length, base = setting.sim.length, setting.config.training
    hyper = replace(base.hyper, learning_rate=config.rate)
    training = replace(
        base,
        parallel=config.together,
        unroll=length,
        epochs=config.epochs,
        decay=1.0,
        stagger=False,
        minibatches=largest_divisor(base.minibatches, config.together * length),
        hyper=hyper,
    )
    middle = jnp.full(setting.space.dim, 0.5)
    rows = []
    for t in range(len(arena.targets)):
        play, values = arena.plays[arena.names[t]]

        def make(play=play):
            return compiled(make_ppo_trainer(play, setting.space, training, arena.obs_dim))

        trainer = arena.shared(("fine_tune", arena.names[t]), make)
        u = setting.space.unit(values[: setting.space.dim])
        worlds = Worlds(u, u, jnp.zeros(()), values[setting.space.dim :])
        key = jax.random.fold_in(jax.random.key(int(run.seeds[0])), 100 + t)
        state = trainer.begin(key, arena.prepared.learned)
        actors = [trainer.policy(arena.prepared.learned)]
        for _ in range(updates):
            state, _ = trainer.train(key, state, worlds, 1)
            actors.append(trainer.policy(trainer.learned(state)))
        many = jax.tree.map(lambda *x: jnp.stack(x), *[Tuned(middle, a) for a in actors])
        rows.append(arena.score(np.full(len(actors), t), many))
        run.report(t + 1, len(arena.targets))
    spent = config.together * np.arange(updates + 1)
    return Visits(None, spent, np.stack(rows)[:, None, None])


def best_in_omega(run: MethodRun) -> Visits:
    """The best mean of E by the tests themselves: a spread of points, then two rounds about the
    best. A bound, not a method.
    """
    arena: StepsArena = run.arena
    D, count, rows = arena.setting.space.dim, run.config.steps.points, []
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
                best, value = near[k], scores[k]
        rows.append(value)
        run.report(t + 1, len(arena.targets))
    return Visits(None, np.zeros(1, int), np.array(rows)[:, None, None, None])


def oracle(run: MethodRun) -> Visits:
    """The policy that knows E, trained on in the target's own world, fields that Omega lacks
    included. A bound, not a method.
    """
    arena: StepsArena = run.arena
    setting = arena.setting
    training, D = setting.config.training, setting.space.dim

    def made():
        play = arena.whole_play()
        return compiled(make_ppo_trainer(play, setting.space, training, arena.obs_dim))

    trainer = arena.shared("oracle", made)
    rounds = max(1, round(run.config.steps.share * training.rounds))
    rows = []
    for t, values in enumerate(arena.all_values):
        u = setting.space.unit(jnp.asarray(values[:D], jnp.float32))
        worlds = Worlds(u, u, jnp.ones(()), jnp.asarray(values[D:], jnp.float32))
        key = jax.random.fold_in(jax.random.key(int(run.seeds[0])), 200 + t)
        plan = TrainingPlan(rounds)
        learned = trained_in(trainer, key, arena.prepared.learned, worlds, plan, run.report)
        tuned = Tuned(u, trainer.policy(learned))
        law = arena.score(np.full(1, t), Law(jnp.clip(u, 0.0, 1.0)[None]))
        own = arena.score(np.full(1, t), jax.tree.map(lambda x: x[None], tuned))
        rows.append(max(float(own[0]), float(law[0])))
    return Visits(None, np.zeros(1, int), np.array(rows)[:, None, None, None])
