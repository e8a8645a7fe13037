"""What the bank says of actions: chances of success, outcomes to rehearse with, and the problem
that a NAF is trained on.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.learners.naf_goals import GoalProblem
from adaptsim_jax.tasks.scooping.bank import Bank, load_bank
from adaptsim_jax.tasks.scooping.config import ScoopingConfig, checked
from adaptsim_jax.tasks.scooping.model import ScoopOptions
from adaptsim_jax.tasks.scooping.trial import (
    CONTEXT,
    draw_context,
    executed,
    make_mjx_trial,
    make_trial,
    seen_place,
    success,
    test_contexts,
)


def training_problem(
    config: ScoopingConfig, draw: Callable[[jax.Array, Any], jax.Array], checks: int | None = None
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

        return GoalProblem(place, seen_place, real, reward)
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

    return GoalProblem(place, seen_place, stored, reward, worth if checks else None)


def bank_chance(bank: Bank, params: jax.Array, action: jax.Array) -> jax.Array:
    """Chance of success `[]` at `params [4]` of `action [3]` as executed, by the bank."""
    return jax.nn.sigmoid(bank.logit(params, action))


def expected_odds(
    bank: Bank, params: jax.Array, action: jax.Array, options: ScoopOptions
) -> jax.Array:
    """Log odds of success `[]` at `params [4]` when `action [3]` in [-1, 1] is asked for: of the
    mean chance over its errors, by Gauss's rule of two points for each.
    """
    errors = jnp.array([(a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]) / np.sqrt(3.0)
    lucks = jnp.zeros((len(errors), CONTEXT)).at[:, 2:4].set(errors)
    logits = jax.vmap(lambda luck: bank.logit(params, executed(action, luck, options)))(lucks)
    won, lost = (jax.nn.logsumexp(jax.nn.log_sigmoid(sign * logits)) for sign in (1.0, -1.0))
    return won - lost


def bank_outcome(bank: Bank, params: jax.Array, action: jax.Array, won: jax.Array) -> jax.Array:
    """An outcome `[9, 2]` as `make_trial`'s, of a trial of the bank that ended as `won []` says;
    the last height is 0.
    """
    x = bank.places(params, action, won)
    places = jnp.stack([x, jnp.zeros_like(x)], -1)
    return jnp.concatenate([places, jnp.stack([won, jnp.zeros_like(won)])[None]])
