"""Phase 1: meta-learn the adaptation policy in simulation (paper, Algorithm 1), as one pure
function.

A *round* runs `parallel` adaptation trajectories of `horizon` steps side by side, writes them to
the replay and to the set S_E, and then trains. Everything that a sweep varies is a traced leaf of
`Phase1Hyper`; sizes are `Phase1Config`. The round number is an argument and not part of the state,
so that it stays unbatched under `vmap` (see `replay`). Each round draws its randomness from
`(state.key, round)` alone. However a run is cut into calls, it gives the same bits.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.adaptation import reuse
from adaptsim_jax.adaptation.episode import AdaptationEpisode, Guide, StepPlan, run_episode
from adaptsim_jax.adaptation.phase1_config import Phase1Config, Phase1Hyper, check
from adaptsim_jax.adaptation.reuse import BegunTrajectories, Pool, run_reusing
from adaptsim_jax.learners import replay as ring
from adaptsim_jax.learners.bdq import BDQ, BDQConfig, BDQState, make_bdq
from adaptsim_jax.learners.replay import Transition
from adaptsim_jax.space import gaussian
from adaptsim_jax.tasks.base import Task

_LOST_ALL = 1e4
"""gain (1 - r) at which the logarithm reaches 0: with a gain of 10 and 10, a hundredfold cost."""


class DistributionArchive(NamedTuple):
    """S_E: simulation parameter distributions used, and their task policies; rings of `[archive,
    ...]`.
    """

    mean: Array
    policy: Any


class Phase1State(NamedTuple):
    """All that the next round needs, apart from its number. `pool` is None where no task policies
    are reused.
    """

    key: Array
    learner: BDQState
    replay: Transition
    archive: DistributionArchive
    pool: Pool | None = None


class Phase1Info(NamedTuple):
    """Of one round, each `[]`: means of the task reward over all steps and at the last step, of the
    shaped reward, and the learner's loss, Q and gradient norm averaged over the updates (0 during
    warm-up). Where task policies are reused (else None): simulated trials a visit that they were
    trained with, and the share of visits that reused one.
    """

    reward: Array
    final_reward: Array
    shaped: Array
    epsilon: Array
    loss: Array
    q: Array
    grad_norm: Array
    trials: Array | None = None
    reused: Array | None = None


class Phase1(NamedTuple):
    """Phase 1 of one task as pure functions; see `make_phase1`."""

    task: Task
    config: Phase1Config
    bdq: BDQ
    init: Callable[[Array], Phase1State]
    begin: Callable[..., BegunTrajectories]
    exploring: Callable[..., tuple[Callable, StepPlan, Array]]
    learn: Callable[..., tuple[Phase1State, Phase1Info]]
    round: Callable[..., tuple[Phase1State, Phase1Info]]
    run: Callable[..., tuple[Phase1State, Phase1Info]]


def make_phase1(task: Task, config: Phase1Config, over: Callable = jax.vmap) -> Phase1:
    """Check the sizes and return Phase 1 as functions that the caller jits and vmaps. over: Maps
    the function of one of the parallel trajectories over all of them, where no policies are reused
    (`sweep_plan.spread` shares them out among devices).

    * `init(key) -> Phase1State`
    * `begin(key, hyper) -> BegunTrajectories [P]`: fresh targets and fresh starts
    * `exploring(state, hyper, number []) -> (act, plan, epsilon)`: how its trajectories go
    * `learn(key, state, hyper, number [], episodes [P, ...], epsilon) -> (state, info)`: from them,
      whoever ran them
    * `round(state, hyper, number []) -> (state, info)`: these together
    * `run(state, hyper, numbers [R]) -> (state, info [R])`: a scan; leave `numbers` unbatched when
      vmapping
    """
    check(config, task)
    stage = replace(task, rollout=task.rehearse) if task.rehearse else task
    bdq = make_bdq(
        BDQConfig(
            obs_dim=task.space.dim + task.obs_dim,
            branches=task.space.dim,
            hidden=config.hidden,
            activation=config.activation,
            layer_norm=config.layer_norm,
        )
    )

    def init(key):
        key, net = jax.random.split(key)
        rings = _empty_replay(bdq, config), _empty_archive(task, config)
        return Phase1State(key, bdq.init(net), *rings, _first_pool(net, task, config))

    def begin(key, hyper):
        keys = jax.random.split(key, config.parallel)
        return jax.vmap(lambda k: _begun(k, stage, hyper))(keys)

    def exploring(state, hyper, number):
        return _exploring(bdq, config, stage, hyper, state, number)

    def learn(key, state, hyper, number, episodes, epsilon, reused=()):
        batch, shaped = _transitions(episodes, hyper)
        state = state._replace(
            replay=ring.write(state.replay, batch, number),
            archive=_remember(state.archive, episodes, number),
        )
        learner, stats = _learn(key, bdq, config, hyper, state, number)
        rewards = episodes.reward.mean(), episodes.reward[:, -1].mean(), shaped.mean()
        info = Phase1Info(*rewards, epsilon, *stats, *reused)
        return state._replace(learner=learner), info

    def one_round(state, hyper, number):
        act_key, learn_key = jax.random.split(jax.random.fold_in(state.key, number))
        *how, epsilon = exploring(state, hyper, number)
        episodes, pool, reused = _collect(act_key, stage, config, hyper, state.pool, how, over)
        state = state._replace(pool=pool)
        return learn(learn_key, state, hyper, number, episodes, epsilon, reused)

    def run(state, hyper, numbers):
        return jax.lax.scan(lambda s, n: one_round(s, hyper, n), state, numbers)

    return Phase1(task, config, bdq, init, begin, exploring, learn, one_round, run)


def archive_size(phase1: Phase1, rounds: int) -> int:
    """How many members S_E has after `rounds` rounds."""
    return min(phase1.config.archive, rounds * phase1.config.parallel * phase1.config.horizon)


def shape_reward(reward: Array, hyper: Phase1Hyper) -> Array:
    """The reward that is learned from (paper, eq. A1, with an optional gain): at least 0, and 0
    below the threshold.
    """
    line = jnp.maximum(1.0 - hyper.gain * (1.0 - reward), 0.0)
    lost = hyper.gain * jnp.maximum(1.0 - reward, 0.0)
    slow = jnp.maximum(1.0 - jnp.log1p(lost) / np.log1p(_LOST_ALL), 0.0)
    curve = (1.0 - hyper.far) / (1.0 + lost) + hyper.far * slow
    shaped = jnp.where(hyper.soft > 0, curve, line)
    return jnp.where(jnp.isfinite(reward) & (reward >= hyper.threshold), shaped, 0.0)


def _begun(key, task, hyper) -> BegunTrajectories:
    """One trajectory, from a fresh start to a fresh target."""
    target_key, start_key, run_key = jax.random.split(key, 3)
    target = draw_target(target_key, task, hyper.inside)
    start = gaussian(task.space, task.space.sample(start_key))
    return BegunTrajectories(run_key, start, task.init_policy(run_key), target)


def _exploring(bdq, config, task, hyper, state: Phase1State, number):
    """`act(key, obs)`, epsilon-greedy, the plan of a round's trajectories, and epsilon."""
    epsilon = _epsilon(config, hyper, number)

    def act(key, obs):
        return bdq.act(key, state.learner.online, obs, epsilon, hyper.independent)

    guide = Guide(config.guided, task.space) if config.guided else None
    plan = StepPlan(config.horizon, hyper.delta, hyper.shrink, hyper.obs_noise, guide)
    return act, plan, epsilon


def _collect(key, task, config, hyper, pool, how, over):
    """`parallel` exploring trajectories; leading axis `parallel`. Also the pool after them, and
    what Info says of reuse.
    """
    act, plan = how
    keys = jax.random.split(key, config.parallel)
    if pool is None:

        def one(key):
            begun = _begun(key, task, hyper)
            return run_episode(begun.keys, task, act, *begun[1:], plan)

        return over(one)(keys), None, ()
    begun = jax.vmap(lambda k: _begun(k, task, hyper))(keys)
    found = run_reusing(begun, task, act, pool, config.reuse, plan)
    return found.episodes, found.pool, (found.budgets.mean(), found.reused.mean())


def draw_target(key, task: Task, inside) -> Array:
    """Physical values `[D]`, each from Omega with probability `inside`, else from the task's box of
    targets.
    """
    near_key, anywhere_key, coin_key = jax.random.split(key, 3)
    near = task.space.physical(task.space.sample(near_key))
    anywhere = task.targets.physical(task.targets.sample(anywhere_key))
    return jnp.where(jax.random.uniform(coin_key, anywhere.shape) < inside, near, anywhere)


def _transitions(episodes: AdaptationEpisode, hyper: Phase1Hyper) -> tuple[Transition, Array]:
    """Flatten visits `[parallel, horizon + 1]` to transitions `[parallel * horizon]`, rewarded by
    the visit after.
    """
    shaped = shape_reward(episodes.reward, hyper)

    def flat(x):
        return x.reshape(-1, *x.shape[2:])

    last = jnp.zeros_like(shaped[:, 1:]).at[:, -1].set(1.0)
    transitions = Transition(
        flat(episodes.obs[:, :-1]),
        flat(episodes.action),
        flat(shaped[:, 1:]),
        flat(episodes.obs[:, 1:]),
        flat(1.0 - hyper.terminal * last),
    )
    return transitions, shaped


def _learn(key, bdq: BDQ, config, hyper, state: Phase1State, number):
    """`updates` gradient steps on batches drawn beforehand; none during warm-up."""
    block = config.parallel * config.horizon
    filled = jnp.minimum((number + 1) * block, config.capacity)
    rate = hyper.learner.learning_rate * _rate_share(config, hyper, number)
    rates = replace(hyper.learner, learning_rate=rate)

    def updated():
        batches = ring.sample(key, state.replay, filled, (config.updates, config.batch))
        learner, info = jax.lax.scan(lambda s, b: bdq.update(s, b, rates), state.learner, batches)
        return learner, (info.loss.mean(), info.q.mean(), info.grad_norm.mean())

    nothing = (jnp.zeros(()),) * 3
    return jax.lax.cond(number >= config.warmup, updated, lambda: (state.learner, nothing))


def _epsilon(config, hyper, number):
    share = jnp.clip(number / (hyper.epsilon_share * max(config.rounds - 1, 1)), 0.0, 1.0)
    return hyper.epsilon_start + (hyper.epsilon_end - hyper.epsilon_start) * share


def _rate_share(config, hyper, number):
    late = jnp.clip(2.0 * number / max(config.rounds, 1) - 1.0, 0.0, 1.0)
    return 1.0 + (hyper.rate_end - 1.0) * late


def _empty_replay(bdq: BDQ, config: Phase1Config) -> Transition:
    obs = jnp.zeros(bdq.config.obs_dim)
    action = jnp.zeros(bdq.config.branches, jnp.int32)
    return ring.empty(Transition(obs, action, jnp.zeros(()), obs, jnp.zeros(())), config.capacity)


def _empty_archive(task: Task, config: Phase1Config) -> DistributionArchive:
    policy = jax.eval_shape(task.init_policy, jax.random.key(0))
    return ring.empty(DistributionArchive(jnp.zeros(task.space.dim), policy), config.archive)


def _first_pool(key, task: Task, config: Phase1Config) -> Pool | None:
    if config.reuse.threshold == 0:
        return None
    if task.pretrain is not None:
        policy = task.pretrain(jax.random.fold_in(key, 1))
        return reuse.shared_pool(config.reuse, jnp.full(task.space.dim, 0.5), policy)
    return reuse.empty_pool(
        config.reuse, task.space.dim, jax.eval_shape(task.init_policy, jax.random.key(0))
    )


def _remember(
    archive: DistributionArchive, episodes: AdaptationEpisode, number
) -> DistributionArchive:
    """Add every distribution that an action was taken from, with its policy (Algorithm 1, line
    10).
    """
    used = DistributionArchive(episodes.mean, episodes.policy)
    rows = jax.tree.map(lambda x: x[:, :-1].reshape(-1, *x.shape[2:]), used)
    return ring.write(archive, rows, number)
