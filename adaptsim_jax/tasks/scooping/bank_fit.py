"""The bank's networks fitted to its trials: chance of success, and the piece's places, with errors on held-out trials."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from adaptsim_jax.tasks.scooping.bank import PLACE_UNIT, Bank, Layers, Trials, features, forward

CHANCE, TRACK = (128, 128, 128), (96, 96)  # hidden layers of the networks
SIZE, PASSES, RATE, DECAY = 256, 60, 3e-3, 1e-2


many = jax.vmap(forward, (None, 0))


class Fit(NamedTuple):
    """A bank, and on held-out trials: accuracy and mean log loss of its chance, with a number for each box, and the root of the
    mean squared error of its places m."""

    bank: Bank
    accuracy: dict[str, float]
    log_loss: dict[str, float]
    track_error: float


def fit(parts: dict[str, Trials], *, seed: int = 0, held_out: float = 0.1, passes: int = PASSES) -> Fit:
    """The networks for the trials of all boxes; the last share of each box is only for testing."""
    split = {box: len(t.wins) - round(held_out * len(t.wins)) for box, t in parts.items()}
    gather = lambda keep: Trials(
        *(np.concatenate(c) for c in zip(*(keep(b, t) for b, t in parts.items()), strict=True))
    )
    train = gather(lambda b, t: tuple(v[: split[b]] for v in t))
    one, two = jax.random.split(jax.random.key(seed))
    chance = network(one, CHANCE, *_chance_data(train), _chance_loss, passes)
    track = network(two, TRACK, *_track_data(train), _track_loss, passes)
    accuracy, losses, errors = {}, {}, []
    for box, trials in parts.items():
        test = Trials(*(v[split[box] :] for v in trials))
        x, y = _chance_data(test)
        out = many(chance, x)
        accuracy[box] = float(jnp.mean((out > 0) == (y > 0.5)))
        losses[box] = float(_chance_loss(out, y))
        x, y = _track_data(test)
        errors.append(float(jnp.mean(jnp.square(many(track, x) - y))))
    return Fit(Bank(chance, track), accuracy, losses, PLACE_UNIT * float(np.sqrt(np.mean(errors))))


def network(key: jax.Array, hidden: tuple[int, ...], x: jax.Array, y: jax.Array, loss, passes: int) -> Layers:
    """Layers from `x [N, n]` to `y [N, k]`: AdamW with a cosine rate, `passes` over the data in batches of 256."""
    key, *keys = jax.random.split(key, len(hidden) + 2)
    sizes = (x.shape[1], *hidden, y.shape[1])
    layers = tuple(
        (float(np.sqrt(1 / a)) * jax.random.normal(k, (a, b)), jnp.zeros(b))
        for k, a, b in zip(keys, sizes, sizes[1:], strict=False)
    )
    updates = passes * max(1, len(x) // SIZE)
    rates = optax.adamw(optax.cosine_decay_schedule(RATE, updates), weight_decay=DECAY)

    def update(carry, key):
        layers, opt = carry
        rows = jax.random.randint(key, (SIZE,), 0, len(x))
        slopes = jax.grad(lambda w: loss(many(w, x[rows]), y[rows]))(layers)
        moves, opt = rates.update(slopes, opt, layers)
        return (optax.apply_updates(layers, moves), opt), None

    run = jax.jit(lambda c, k: jax.lax.scan(update, c, k)[0])
    return run((layers, rates.init(layers)), jax.random.split(key, updates))[0]


def _features(t: Trials) -> jax.Array:
    return jax.vmap(features)(jnp.asarray(t.params, jnp.float32), jnp.asarray(t.actions, jnp.float32))


def _chance_data(t: Trials) -> tuple[jax.Array, jax.Array]:
    return _features(t), jnp.asarray(t.wins, jnp.float32)[:, None]


def _track_data(t: Trials) -> tuple[jax.Array, jax.Array]:
    x = jnp.concatenate([_features(t), jnp.asarray(t.wins, jnp.float32)[:, None]], 1)
    return x, jnp.asarray(t.places[:, 1:] / PLACE_UNIT, jnp.float32)


def _chance_loss(out: jax.Array, y: jax.Array) -> jax.Array:
    return jnp.mean(optax.sigmoid_binary_cross_entropy(out, y))


def _track_loss(out: jax.Array, y: jax.Array) -> jax.Array:
    return jnp.mean(jnp.square(out - y))
