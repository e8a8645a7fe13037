"""What the bank says of actions: chances of success, outcomes to rehearse with, and the problem
that a NAF is trained on.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from adaptsim_jax.learners.naf_goals import GoalProblem
from adaptsim_jax.tasks.scooping.bank import Bank, load_bank, points
from adaptsim_jax.tasks.scooping.config import (
    ScoopingConfig,
    ScoopingPolicy,
    checked,
    make_scooping_naf,
    scooping_space,
)
from adaptsim_jax.tasks.scooping.corrections import (
    Doubt,
    Odds,
    ScoopRecord,
    chances,
    lattice,
    outlook,
)
from adaptsim_jax.tasks.scooping.model import ScoopOptions
from adaptsim_jax.tasks.scooping.trial import (
    CONTEXT,
    draw_context,
    executed,
    make_mjx_trial,
    make_trial,
    place_input,
    success,
    test_contexts,
)


def training_problem(
    config: ScoopingConfig, draw: Callable[[Array, Any], Array], checks: int | None = None
) -> GoalProblem:
    """What a NAF is trained on: places as goals, trials of the configured source at `draw(key,
    context) -> params [4]`.

    A trial of the bank is worth its chance of success, which is what many trials with one action
    would come to.
    """
    options = checked(config)
    checks = config.checks if checks is None else checks

    def place(key):
        return draw_context(key)[:2]

    def reward(outcome, goal):
        return outcome[0]

    if not config.trains_in_bank:
        if config.simulator == "mjx":
            simulate = make_mjx_trial(options)
        else:
            simulate = make_trial(options, config.numerics)

        def real(key, context, action):
            draw_key, luck_key = jax.random.split(key)
            return success(simulate(draw(draw_key, context), action, draw_context(luck_key)))[None]

        return GoalProblem(place, place_input, real, reward)
    bank = load_bank(options, config.numerics)
    tests = jnp.asarray(test_contexts(max(checks, 1)))
    chances = jax.vmap(lambda p, a, luck: bank_chance(bank, p, executed(a, luck, options)))

    def stored(key, context, action):
        draw_key, luck_key = jax.random.split(key)
        params = jax.vmap(draw, (0, None))(jax.random.split(draw_key, config.lucks), context)
        lucks = jax.vmap(draw_context)(jax.random.split(luck_key, config.lucks))
        return chances(params, jnp.broadcast_to(action, (config.lucks, 3)), lucks).mean()[None]

    def worth(key, context, act):
        params = jax.vmap(draw, (0, None))(jax.random.split(key, checks), context)
        return chances(params, jax.vmap(act)(tests[:, :2]), tests).mean()

    return GoalProblem(place, place_input, stored, reward, worth if checks else None)


def bank_chance(bank: Bank, params: Array, action: Array) -> Array:
    """Chance of success `[]` at `params [4]` of `action [3]` as executed, by the bank."""
    return jax.nn.sigmoid(bank.logit(params, action))


def expected_odds(bank: Bank, params: Array, action: Array, options: ScoopOptions) -> Array:
    """Log odds of success `[]` at `params [4]` when `action [3]` in [-1, 1] is asked for: of the
    mean chance over its errors, by Gauss's rule of two points for each.
    """
    errors = jnp.array([(a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]) / np.sqrt(3.0)
    lucks = jnp.zeros((len(errors), CONTEXT)).at[:, 2:4].set(errors)
    logits = jax.vmap(lambda luck: bank.logit(params, executed(action, luck, options)))(lucks)
    won, lost = (jax.nn.logsumexp(jax.nn.log_sigmoid(sign * logits)) for sign in (1.0, -1.0))
    return won - lost


def bank_outcome(bank: Bank, params: Array, action: Array, won: Array) -> Array:
    """An outcome `[9, 2]` as `make_trial`'s, of a trial of the bank that ended as `won []` says.
    The last height is 0.
    """
    x = bank.places(params, action, won)
    places = jnp.stack([x, jnp.zeros_like(x)], -1)
    return jnp.concatenate([places, jnp.stack([won, jnp.zeros_like(won)])[None]])


TRIED, OTHERS = 1024, 64  # actions, and other pieces, that are looked at


def make_choice(
    config: ScoopingConfig, doubt: Doubt = Doubt()
) -> Callable[[ScoopingPolicy, Array], Array]:
    """`act(policy, contexts [..., >= 2]) -> [..., 3]` in [-1, 1]. A policy that was told of the
    target's scoops does what is likeliest to succeed by them and by the bank, the same in all
    contexts. Any other does what its network says, and probes last if it probes.
    """
    naf = make_scooping_naf(config)
    if config.correct:
        best = make_search(config, lambda *observed: chances(*observed, doubt=doubt))
    else:
        best = None

    def choose(policy, contexts):
        action = naf.greedy(policy.weights, place_input(contexts))
        if best is not None and policy.told is not None:
            return jnp.where(
                policy.told.used.any(), best(policy, action.reshape(-1, 3), policy.told), action
            )
        if policy.probe is None:
            return action
        return action.at[-1].set(policy.probe)

    return choose


def make_probe(
    config: ScoopingConfig,
    doubt: Doubt = Doubt(),
    optimism: float = 1.0,
) -> Callable[[ScoopingPolicy], ScoopingPolicy]:
    """`probe(policy) -> policy` as a visit makes its scoops: by the network, but for the last,
    which tries the action that may succeed: of the highest log odds with `optimism` standard
    deviations on top (an upper confidence bound, Srinivas et al. 2010).
    """
    naf, nothing = (
        make_scooping_naf(config),
        ScoopRecord(jnp.zeros((1, 3)), jnp.zeros(1), jnp.zeros(1, bool)),
    )

    def hoped(*observed):
        odds, variance = outlook(*observed, doubt=doubt)
        return odds + optimism * jnp.sqrt(variance)

    best = make_search(config, hoped)

    def probe(policy):
        own = naf.greedy(policy.weights, place_input(jnp.zeros((1, CONTEXT))))
        return policy._replace(told=None, probe=best(policy, own, policy.told or nothing))

    return probe


def make_search(
    config: ScoopingConfig, worth: Callable
) -> Callable[[ScoopingPolicy, Array, ScoopRecord], Array]:
    """`best(policy, own [N, 3], told) -> [3]`: of even actions, `own` and those told of, the one of
    the highest `worth(told, at_reported, tried, at_tried) -> [A]`.
    """
    space, options = scooping_space(config), checked(config)
    bank, even = load_bank(options, config.numerics), jnp.asarray(lattice(TRIED), jnp.float32)
    pieces = jnp.asarray(points(OTHERS, 0, "wide")[0], jnp.float32)
    odds = jax.vmap(lambda params, action: expected_odds(bank, params, action, options), (None, 0))
    others = jax.vmap(odds, (0, None), 1)
    known = jax.jit(others)(pieces, even)

    def best(policy, own, trials):
        own = jnp.concatenate([trials.actions, own])
        every, params = jnp.concatenate([own, even]), space.physical(policy.at)
        both = Odds(odds(params, every), jnp.concatenate([others(pieces, own), known]))
        at_reported = jax.tree.map(lambda x: x[: len(trials.actions)], both)
        return every[jnp.argmax(worth(trials, at_reported, every, both))]

    return best
