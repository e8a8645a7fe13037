"""The methods that adapt E, for tasks whose policies are learned: each visits distributions in
every target, for every seed.

`adaptsim`, the two SysID baselines and BayesOpt (`bayesopt.py`) train the same task policies in the
same simulator and differ in how they choose where. All seeds, targets and starts advance together,
a visit at a time.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.phase1 import make_phase1
from adaptsim_jax.adaptation.sweep import TrainedMany, stack, starts_of, train_many, train_one
from adaptsim_jax.baselines import sysid
from adaptsim_jax.baselines.arena import Arena, Lanes, Progress, lanes
from adaptsim_jax.baselines.memory import Memory
from adaptsim_jax.baselines.sysid_bayes import mixture_estimator
from adaptsim_jax.baselines.sysid_point import point_estimator
from adaptsim_jax.baselines.tour import tour
from adaptsim_jax.core.progress import silent


class Trip(NamedTuple):
    """What a method did: `rewards [T, S, N, I + 1]` of its policies over the test contexts, `means
    [T, S, N, I + 1, D]` (unit coordinates; None where it adapts no E), target trials spent by each
    visit `spent [I + 1]`, cumulated; `fresh [T, S, N, I + 1]`: rewards over the task's fresh
    contexts, None where it has none.
    """

    rewards: np.ndarray
    means: np.ndarray | None
    spent: np.ndarray
    fresh: np.ndarray | None = None


@dataclass
class Bout:
    """What a method is given: the comparison's config, the arena, seeds `[S]`, and a report."""

    config: Any
    arena: Arena
    seeds: np.ndarray
    report: Progress = silent
    cache: dict[str, Any] = field(
        default_factory=dict
    )  # what several methods start from, such as UDR's policies


def adaptsim(bout: Bout) -> Trip:
    """Phase 1 from scratch for every seed, Phase 2 in every target."""
    phase1 = make_phase1(bout.arena.one.task, bout.config.train.phase1)
    hypers = stack([bout.config.train.hyper] * len(bout.seeds))
    program = bout.arena.program(
        "phase1", lambda task, *of: train_one(make_phase1(task, bout.config.train.phase1), *of)
    )
    trained = train_many(phase1, hypers, bout.seeds, progress=bout.report, program=program)
    return phase2(bout, phase1, trained, bout.config.starts, bout.config.iterations)


def phase2(bout: Bout, phase1: Any, trained: TrainedMany, starts: int, iterations: int) -> Trip:
    """Greedy steps from `starts` members of each run's own S_E (paper, Algorithm 2), in the arena's
    targets.
    """
    arena = bout.arena
    batch = lanes(len(arena.targets), bout.seeds, starts, label=1)
    first = starts_of(phase1, trained, bout.seeds, starts)

    # lanes run over targets, seeds, starts; the same starts serve all targets
    def pick(x):
        return jnp.tile(x.reshape(-1, *x.shape[2:]), (len(arena.targets), *(1,) * (x.ndim - 2)))

    hyper = jax.tree.map(lambda x: jnp.asarray(x)[batch.seed], trained.hyper)
    found = tour(
        arena,
        batch,
        phase1,
        trained.weights[batch.seed],
        hyper,
        jax.tree.map(pick, first),
        iterations,
        bout.report,
    )
    spent = starts * arena.one.trials * np.arange(1, iterations + 2)
    return Trip(batch.grid(found.rewards), batch.grid(found.means), spent)


def identify(bout: Bout, estimator: Callable, label: int) -> Trip:
    """A SysID baseline from the centre of Omega: the loop of `sysid.py`, with a target of any
    engine.
    """
    arena, task = bout.arena, bout.arena.one.task
    config = replace(bout.config.sysid, iterations=bout.config.iterations)
    network = estimator(task.space.dim, config)
    batch = lanes(len(arena.targets), bout.seeds, 1, label)

    def begin(task, *keys):
        return jax.vmap(lambda a, b: sysid.untrained(a, b, task, network, config))(*keys)

    def infers(fit_config, name):
        def one(task, key, state, obs):
            return sysid.infer(
                jax.random.split(key, 3), state, obs, task, network, config, fit_config
            )[0]

        return arena.program(
            (label, name), lambda task, *work: jax.lax.map(lambda w: one(task, *w), work)
        )

    state = arena.program((label, "begin"), begin)(*two_keys(batch.keys))
    infer = infers(config.first_fit, "first")
    state = state._replace(policy=first_policies(bout, batch, state.policy))
    means, rewards, memory = [], [], Memory(arena, batch, config.iterations + 1)
    for i in range(config.iterations + 1):
        train_keys, visit_keys, infer_keys = (
            jax.vmap(jax.random.fold_in, (0, None))(batch.at(i), j) for j in range(3)
        )
        state = state._replace(policy=arena.train(train_keys, state.dist, state.policy))
        means.append(np.asarray(state.dist.mean))
        rewards.append(arena.score(batch.where, memory.deployed(state.policy)))
        bout.report(i + 1, config.iterations + 1)
        if i < config.iterations:
            tried = memory.visiting(state.policy)
            seen = arena.visit(visit_keys, batch.where, tried)
            memory.add(seen.trials)
            own = state.policy
            state = infer(infer_keys, state._replace(policy=tried), jnp.asarray(seen.obs))._replace(
                policy=own
            )
            if i == 0 and config.next_fit != config.first_fit:
                infer = infers(config.next_fit, "next")
    spent = arena.one.trials * np.arange(1, config.iterations + 2)
    return Trip(batch.grid(np.stack(rewards, -1)), batch.grid(np.stack(means, 1)), spent)


def first_policies(bout: Bout, batch: Lanes, blank: Any) -> Any:
    """What a method's first training in each lane goes on from: `blank [B, ...]`, or the seed's own
    policy for all of Omega where the task makes one, the same for all methods but AdaptSim, whose
    Phase 1 makes its own in the same way.
    """
    pretrain = bout.arena.one.task.pretrain
    if pretrain is None:
        return blank
    if "shared" not in bout.cache:
        one = jax.jit(pretrain)
        parts = [one(jax.random.fold_in(jax.random.key(seed), 8)) for seed in bout.seeds]
        bout.cache["shared"] = jax.tree.map(lambda *x: jnp.stack(x), *parts)
    return jax.tree.map(lambda x: x[batch.seed], bout.cache["shared"])


def sysid_bayes(bout: Bout) -> Trip:
    """Mixture-density posterior within Omega; the policy is trained on its mean and spread."""
    return identify(bout, mixture_estimator, label=2)


def sysid_point(bout: Bout) -> Trip:
    """One point regressed from the newest trials."""
    return identify(bout, point_estimator, label=3)


def two_keys(keys: jax.Array) -> tuple[jax.Array, jax.Array]:
    parts = jax.vmap(jax.random.split)(keys)
    return parts[:, 0], parts[:, 1]
