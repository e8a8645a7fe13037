"""What a policy of scooping does once it was told of the target's own scoops: what it deploys, and
what its visits probe.

Both look at the same even actions, what the network says, and what was done before, by the chances
of `corrections`: deployed is the one that is likeliest to succeed, the same in all contexts.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from adaptsim_jax.tasks.scooping.bank import load_bank, points
from adaptsim_jax.tasks.scooping.chance import expected_odds
from adaptsim_jax.tasks.scooping.config import (
    ScoopingConfig,
    ScoopingPolicy,
    checked,
    make_scooping_naf,
    scooping_space,
)
from adaptsim_jax.tasks.scooping.corrections import Doubt, Odds, Told, chances, lattice, outlook
from adaptsim_jax.tasks.scooping.trial import CONTEXT, seen_place

TRIED, OTHERS = 1024, 64  # actions, and other pieces, that are looked at


def make_choice(
    config: ScoopingConfig, doubt: Doubt = Doubt()
) -> Callable[[ScoopingPolicy, jax.Array], jax.Array]:
    """`act(policy, contexts [..., >= 2]) -> [..., 3]` in [-1, 1]. A policy that was told of the
    target's scoops does what is likeliest to succeed by them and by the bank, the same in all
    contexts; any other does what its network says, and probes last if it probes.
    """
    naf = make_scooping_naf(config)
    if config.correct:
        best = make_search(config, lambda *seen: chances(*seen, doubt=doubt))
    else:
        best = None

    def choose(policy, contexts):
        action = naf.greedy(policy.weights, seen_place(contexts))
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
        Told(jnp.zeros((1, 3)), jnp.zeros(1), jnp.zeros(1, bool)),
    )

    def hoped(*seen):
        odds, variance = outlook(*seen, doubt=doubt)
        return odds + optimism * jnp.sqrt(variance)

    best = make_search(config, hoped)

    def probe(policy):
        own = naf.greedy(policy.weights, seen_place(jnp.zeros((1, CONTEXT))))
        return policy._replace(told=None, probe=best(policy, own, policy.told or nothing))

    return probe


def make_search(
    config: ScoopingConfig, worth: Callable
) -> Callable[[ScoopingPolicy, jax.Array, Told], jax.Array]:
    """`best(policy, own [N, 3], told) -> [3]`: of even actions, `own` and those told of, the one of
    the highest `worth(told, at_told, tried, at_tried) -> [A]`.
    """
    space, options = scooping_space(config), checked(config)
    bank, even = load_bank(options, config.numerics), jnp.asarray(lattice(TRIED), jnp.float32)
    pieces = jnp.asarray(points(OTHERS, 0, "wide")[0], jnp.float32)
    odds = jax.vmap(lambda params, action: expected_odds(bank, params, action, options), (None, 0))
    others = jax.vmap(odds, (0, None), 1)
    known = jax.jit(others)(pieces, even)

    def best(policy, own, told):
        own = jnp.concatenate([told.actions, own])
        every, params = jnp.concatenate([own, even]), space.physical(policy.at)
        both = Odds(odds(params, every), jnp.concatenate([others(pieces, own), known]))
        at_told = jax.tree.map(lambda x: x[: len(told.actions)], both)
        return every[jnp.argmax(worth(told, at_told, every, both))]

    return best
