"""One NAF for many contexts: the network folded for a context is the wide one, and it learns what
the context changes.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.learners.naf import NAFConfig, NAFHyper, make_naf
from adaptsim_jax.learners.naf_goals import GoalProblem
from adaptsim_jax.learners.naf_shared import SharedConfig, SharedLearner, fold, move

WIDE = make_naf(NAFConfig(obs_dim=3, action_dim=1, hidden=(24, 16)))
PLAIN = make_naf(NAFConfig(obs_dim=1, action_dim=1, hidden=(24, 16)))


def test_a_folded_network_moved_to_a_context_is_the_wide_network_there():
    weights = jax.jit(WIDE.init)(jax.random.key(0)).online
    plain, tilt = fold(weights, 1, 2, 24)
    assert plain.shape == jax.eval_shape(
        PLAIN.init, jax.random.key(0)
    ).online.shape and tilt.shape == (2, 24)
    goals = jnp.linspace(-1.0, 1.0, 5)[:, None]
    for shown in ([0.0, 0.0], [0.7, -0.4]):
        there = move(plain, tilt, jnp.array(shown))
        obs = jnp.concatenate([goals, jnp.broadcast_to(jnp.array(shown), (5, 2))], -1)
        for ours, wide in zip(
            PLAIN.quadratic(there, goals), WIDE.quadratic(weights, obs), strict=True
        ):
            np.testing.assert_allclose(ours, wide, atol=1e-5)


def test_it_learns_an_action_that_depends_on_goal_and_context():
    """A trial lands at `action + 0.5 context`, so that the best action is `goal - 0.5 context`."""
    problem = GoalProblem(
        draw=lambda key: jax.random.uniform(key, (1,), minval=-0.4, maxval=0.4),
        see=lambda goal: goal,
        trial=lambda key, context, action: action + 0.5 * context[:1],
        reward=lambda outcome, goal: 1.0 - jnp.abs(outcome - goal)[0],
    )
    config = SharedConfig(contexts=200, trials=32, updates=1500, batch=64, candidates=16)

    def draw(key):
        return jax.random.uniform(key, (2,), minval=-1.0)

    learn = SharedLearner(
        WIDE, problem, draw, lambda c: c, config, NAFHyper(learning_rate=3e-3, max_grad_norm=10.0)
    ).train
    plain, tilt = fold(jax.jit(learn)(jax.random.key(1)), 1, 2, 24)
    goals = jnp.linspace(-0.4, 0.4, 9)[:, None]
    for context in ([-0.8, 0.3], [0.0, 0.0], [0.9, -0.9]):
        action = PLAIN.greedy(move(plain, tilt, jnp.array(context)), goals)
        np.testing.assert_allclose(action, goals - 0.5 * context[0], atol=0.1)


def test_more_candidates_than_trials_are_refused():
    with pytest.raises(BadInput, match="candidates"):
        SharedConfig(trials=8, candidates=16)
