"""Scooping a piece of food (paper, section 5.2 and appendix A4): a NAF network chooses how to move
the spatula.

The policy maps where the piece lies to pitch, pitch rate and distance. It is trained at parameters
drawn from E, on trials of the hydroelastic engine itself or of the bank (`bank`). The bank is a
smoothed store of such trials that all policies share. Phase 1 may rehearse on it, too. At each
adaptation iteration it is tried twice. The piece's tracks in these trials, as a camera sees them,
are all that the adaptation policy is shown. Trials execute their actions with an error. In a
simulated target the reward is the mean over a fixed set of places and errors: the share of pieces
that lie on the spatula at the end.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from adaptsim_jax import space as spaces
from adaptsim_jax.learners.naf import NAF
from adaptsim_jax.learners.naf_goals import make_goal_learner
from adaptsim_jax.tasks.base import Task
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.bank import load_bank
from adaptsim_jax.tasks.scooping.config import (
    SETTINGS,
    ScoopingConfig,
    ScoopingPolicy,
    checked,
    make_scooping_naf,
    naf_rates,
    scooping_space,
    wide_space,
)
from adaptsim_jax.tasks.scooping.deployed import (
    bank_chance,
    bank_outcome,
    make_choice,
    training_problem,
)
from adaptsim_jax.tasks.scooping.trial import (
    POINTS,
    draw_context,
    executed,
    make_mjx_trial,
    make_trial,
    measured,
    observed,
    place_input,
    success,
    test_contexts,
)


def make_policy(
    config: ScoopingConfig = ScoopingConfig(),
) -> Callable[[ScoopingPolicy, jax.Array], jax.Array]:
    """`act(policy, places [..., 2] m) -> [..., 3]`: pitch rad, rate rad/s, distance m. Pure."""
    choose = make_choice(config)
    return lambda policy, places: model.physical_action(choose(policy, places))


def make_scooping(config: ScoopingConfig = ScoopingConfig()) -> Task:
    """Scooping as a `Task`, simulated with the hydroelastic engine, or in MJX."""
    space, naf = scooping_space(config), make_scooping_naf(config)
    if config.correct:
        load_bank(
            checked(config), config.numerics
        )  # one of other options is refused now, and not when it comes to deploying

    def draw(key, dist):
        return space.physical(spaces.sample(key, dist))

    learner = make_goal_learner(
        naf, training_problem(config, draw), config.training, naf_rates(config)
    )
    block = config.training.block

    def at_mean(weights, mean):
        return ScoopingPolicy(weights, mean if config.correct else None)

    def train_many(keys, dists, policies, trials):
        rounds = (trials + block - 1) // block
        return at_mean(
            learner.train(keys, policies.weights, dists, rounds, jnp.max(rounds)), dists.mean
        )

    def train(key, dist, policy):
        one = jax.tree.map(lambda x: x[None], (dist, policy.weights))
        rounds = -(-config.trials // block)
        return at_mean(
            learner.train(key[None], one[1], one[0], jnp.full(1, rounds), rounds)[0], dist.mean
        )

    rollout, rehearse = make_rollouts(config, naf)

    return Task(
        name="scooping",
        space=space,
        targets=space if config.targets == "omega" else wide_space(),
        obs_dim=config.trajectories * POINTS * 2,
        settings=SETTINGS,
        init_policy=lambda key: at_mean(naf.init(key).online, jnp.full(space.dim, 0.5)),
        train=train,
        rollout=rollout,
        observe=observed,
        score=lambda trajectory: trajectory.success.mean(),
        reference=lambda params: jnp.zeros(()),
        reward=lambda trajectory, reference: trajectory.tested,
        train_many=train_many,
        rehearse=rehearse,
    )


def make_rollouts(config: ScoopingConfig, naf: NAF) -> tuple[Callable, Callable | None]:
    """`rollout` of the task in the engine, and `rehearse` in the bank; None where Phase 1 is to run
    in the engine, too.
    """
    options, N = checked(config), config.trajectories
    tests = jnp.asarray(test_contexts(config.tests))
    if config.simulator == "mjx":
        trial = make_mjx_trial(options)
    else:
        trial = make_trial(options, config.numerics)

    def run(key, policy, params, outcome_of):
        contexts = jax.vmap(draw_context)(jax.random.split(key, N))
        every = jnp.concatenate([contexts, tests])
        actions = naf.greedy(policy.weights, place_input(every))
        if policy.probe is not None:
            actions = actions.at[N - 1].set(policy.probe)
        return contexts, jax.vmap(outcome_of, (None, 0, 0))(params, actions, every)

    def rollout(key, policy, params):
        contexts, outcomes = run(key, policy, params, trial)
        return measured(contexts, outcomes[:N], config.camera, success(outcomes[N:]).mean())

    if not config.rehearses_in_bank:
        return rollout, None
    bank = load_bank(options, config.numerics)

    def likely(params, action, context):
        done = executed(action, context, options)
        return bank_chance(bank, params, done), done

    def rehearse(key, policy, params):
        run_key, coin_key = jax.random.split(key)
        contexts, (chance, done) = run(run_key, policy, params, likely)
        won = (jax.random.uniform(coin_key, (N,)) < chance[:N]).astype(done.dtype)
        outcomes = jax.vmap(lambda a, w: bank_outcome(bank, params, a, w))(done[:N], won)
        return measured(contexts, outcomes, config.camera, chance[N:].mean())

    return rollout, rehearse
