"""The methods that adapt E, for tasks whose policies are learned: each visits distributions in
every target, for every seed.

`adaptsim`, the two SysID baselines and BayesOpt (`bayesopt.py`) train the same task policies in the
same simulator and differ in how they choose where. All seeds, targets and starts advance together,
a visit at a time.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.adaptation.phase1 import DistributionArchive, Phase1, Phase1Hyper, make_phase1
from adaptsim_jax.adaptation.phase2 import TrainedMany, stack, starts_of, train_many, train_one
from adaptsim_jax.baselines import sysid
from adaptsim_jax.baselines.arena import (
    Arena,
    Memory,
    MethodRun,
    RunLanes,
    Visits,
    lane_keys,
    lanes,
    two_keys,
)
from adaptsim_jax.core.progress import silent
from adaptsim_jax.space import gaussian, step


def adaptsim(run: MethodRun) -> Visits:
    """Phase 1 from scratch for every seed, Phase 2 in every target."""
    phase1 = make_phase1(run.arena.one.task, run.config.train.phase1)
    hypers = stack([run.config.train.hyper] * len(run.seeds))
    program = run.arena.program(
        "phase1", lambda task, *of: train_one(make_phase1(task, run.config.train.phase1), *of)
    )
    trained = train_many(phase1, hypers, run.seeds, progress=run.report, program=program)
    return phase2(run, phase1, trained, run.config.starts, run.config.iterations)


def phase2(
    run: MethodRun, phase1: Any, trained: TrainedMany, starts: int, iterations: int
) -> Visits:
    """Greedy steps from `starts` members of each run's own S_E (paper, Algorithm 2), in the arena's
    targets.
    """
    arena = run.arena
    batch = lanes(len(arena.targets), run.seeds, starts, label=1)
    first = starts_of(phase1, trained, run.seeds, starts)

    # lanes run over targets, seeds, starts; the same starts serve all targets
    def pick(x):
        rows = x.reshape(-1, *x.shape[2:])
        return jnp.tile(rows, (len(arena.targets), *(1,) * (rows.ndim - 1)))

    hyper = jax.tree.map(lambda x: jnp.asarray(x)[batch.seed], trained.hyper)
    policies = LanePolicies(phase1, trained.weights[batch.seed], hyper)
    begun = jax.tree.map(pick, first)
    found = adaptation_trace(arena, batch, policies, begun, iterations, run.report)
    spent = starts * arena.one.trials * np.arange(1, iterations + 2)
    return Visits(batch.grid(found.means), spent, batch.grid(found.rewards))


def identify(run: MethodRun, estimator: Callable, label: int) -> Visits:
    """A SysID baseline from the centre of Omega: the loop of `sysid.py`, with a target of any
    engine.
    """
    arena, task = run.arena, run.arena.one.task
    config = replace(run.config.sysid, iterations=run.config.iterations)
    network = estimator(task.space.dim, config)
    batch = lanes(len(arena.targets), run.seeds, 1, label)

    def begin(task, *keys):
        return jax.vmap(lambda a, b: sysid.untrained(a, b, task, network, config))(*keys)

    def infers(fit_config, name):
        def one(task, key, state, obs):
            keys = jax.random.split(key, 3)
            return sysid.infer(keys, state, obs, task, network, config, fit_config)

        return arena.program(
            (label, name), lambda task, *work: jax.lax.map(lambda w: one(task, *w), work)
        )

    state = arena.program((label, "begin"), begin)(*two_keys(batch.keys))
    infer = infers(config.first_fit, "first")
    state = state._replace(policy=first_policies(run, batch, state.policy))
    means, rewards, memory = [], [], Memory(arena, batch, config.iterations + 1)
    for i in range(config.iterations + 1):
        train_keys, visit_keys, infer_keys = lane_keys(batch.at(i), 3)
        state = state._replace(policy=arena.train(train_keys, state.dist, state.policy))
        means.append(np.asarray(state.dist.mean))
        rewards.append(arena.score(batch.where, memory.deployed(state.policy)))
        run.report(i + 1, config.iterations + 1)
        if i < config.iterations:
            tried = memory.visiting(state.policy)
            observed = arena.visit(visit_keys, batch.where, tried)
            memory.add(observed.trials)
            inferred = infer(infer_keys, state._replace(policy=tried), jnp.asarray(observed.obs))
            state = inferred._replace(policy=state.policy)
            if i == 0 and config.next_fit != config.first_fit:
                infer = infers(config.next_fit, "next")
    spent = arena.one.trials * np.arange(1, config.iterations + 2)
    return Visits(batch.grid(np.stack(means, 1)), spent, batch.grid(np.stack(rewards, -1)))


def first_policies(run: MethodRun, batch: RunLanes, blank: Any) -> Any:
    """What a method's first training in each lane goes on from: `blank [B, ...]`, or the seed's own
    policy for all of Omega where the task makes one, the same for all methods but AdaptSim, whose
    Phase 1 makes its own in the same way.
    """
    pretrain = run.arena.one.task.pretrain
    if pretrain is None:
        return blank
    if "first policies" not in run.shared:
        one = jax.jit(pretrain)
        parts = [one(jax.random.fold_in(jax.random.key(seed), 8)) for seed in run.seeds]
        run.shared["first policies"] = jax.tree.map(lambda *x: jnp.stack(x), *parts)
    return jax.tree.map(lambda x: x[batch.seed], run.shared["first policies"])


def sysid_bayes(run: MethodRun) -> Visits:
    """Mixture-density posterior within Omega; the policy is trained on its mean and spread."""
    return identify(run, sysid.mixture_estimator, label=2)


def sysid_point(run: MethodRun) -> Visits:
    """One point regressed from the newest trials."""
    return identify(run, sysid.point_estimator, label=3)


class LanePolicies(NamedTuple):
    """The adaptation policies `weights [B, n]` of `B` lanes, all of `phase1`; `hyper`: leaves
    `[B]`.
    """

    phase1: Phase1
    weights: jax.Array
    hyper: Phase1Hyper


class AdaptationTrace(NamedTuple):
    """Of `B` lanes and `I + 1` visits, `[B, I + 1, ...]`.

    * means `[..., D]` in unit coordinates; obs `[..., D + obs_dim]` as the adaptation policy has
      them; actions `[..., D]` that it took then, the last of which is not done
    * scores: Raw returns of the visits; rewards of what is deployed
    * policies as trained, a `[B, ...]` a visit. memory: Of all trials
    """

    means: np.ndarray
    obs: np.ndarray
    actions: np.ndarray
    scores: np.ndarray
    rewards: np.ndarray
    policies: list[Any]
    memory: Memory


def adaptation_trace(
    arena: Arena,
    batch: RunLanes,
    adapting: LanePolicies,
    first: DistributionArchive,
    iterations: int,
    report: Callable = silent,
) -> AdaptationTrace:
    """Greedy steps (paper, Algorithm 2) from `first [B, ...]`."""
    phase1, hyper = adapting.phase1, adapting.hyper
    space, memory = phase1.task.space, Memory(arena, batch, iterations + 1)

    def moved(mean, action, size):
        return step(space, gaussian(space, mean), action, size).mean

    @jax.jit
    def advance(mean, obs, number):
        whole = jnp.concatenate([2.0 * mean - 1.0, obs], -1)
        action = jax.vmap(phase1.bdq.greedy)(adapting.weights, whole)
        size = hyper.delta * hyper.shrink**number
        return jax.vmap(moved)(mean, action, size), whole, action

    dists_at = jax.vmap(lambda mean: gaussian(space, mean))
    mean, policies, trained, rows = np.asarray(first.mean), first.policy, [], []
    for i in range(iterations + 1):
        train_keys, visit_keys = two_keys(batch.at(i))
        policies = arena.train(train_keys, dists_at(mean), policies)
        observed = arena.visit(visit_keys, batch.where, memory.visiting(policies))
        reward = arena.score(batch.where, memory.deployed(policies))
        memory.add(observed.trials)
        after, *acted = advance(jnp.asarray(mean), jnp.asarray(observed.obs), i)
        rows.append((mean, *map(np.asarray, acted), observed.score, reward))
        trained.append(policies)
        mean = np.asarray(after)
        report(i + 1, iterations + 1, "Phase 2")
    columns = (np.stack(column, 1) for column in zip(*rows, strict=True))
    return AdaptationTrace(*columns, policies=trained, memory=memory)
