"""The bank: trials of the hydroelastic engine over Omega and all actions, simulated once and shared by all policies.

What an action leads to depends on the piece and the action alone, so that trials may be stored. The bank holds `count` of them
at even points of Omega and the actions (a scrambled Sobol sequence), and a small network fitted to their outcomes, which says
how likely an action as executed is to succeed. Task policies are trained on draws from it; targets are always simulated.
A bank belongs to the options and numerics that it was made with and to no others: a file that says otherwise is refused.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from scipy.stats import qmc

from adaptsim_jax.errors import BadInput
from adaptsim_jax.models import scooping as model
from adaptsim_jax.models import scooping_hydro as hydro
from adaptsim_jax.models.scooping import ScoopOptions
from adaptsim_jax.models.scooping_hydro import Numerics
from adaptsim_jax.progress import Report, silent

PATH = Path(__file__).with_name("scooping_bank.npz")
HIDDEN = (64, 64)
BATCH = 64
REACH = np.array([0.2, 0.25, 0.05])
"""How far beyond their range actions are tried, as a share of it: execution errors leave it."""


class Bank(NamedTuple):
    """layers: weights and biases of the network; see `logit`."""

    layers: tuple[tuple[jax.Array, jax.Array], ...]

    def logit(self, params: jax.Array, action: jax.Array) -> jax.Array:
        """Log odds of success `[]` at `params [4]` of `action [3]` as executed."""
        x = features(params, action)
        for weights, bias in self.layers[:-1]:
            x = jnp.tanh(x @ weights + bias)
        weights, bias = self.layers[-1]
        return (x @ weights + bias)[0]


class Fit(NamedTuple):
    """A bank and how good it is: accuracy and mean log loss on held-out trials, and the share of them that succeeded."""

    bank: Bank
    accuracy: float
    log_loss: float
    succeeded: float


def features(params: jax.Array, action: jax.Array) -> jax.Array:
    """`[7]`, each about [-1, 1] over Omega and the actions."""
    low, high = np.array(model.LOW), np.array(model.HIGH)
    low[1], high[1] = np.log(low[1]), np.log(high[1])
    values = jnp.stack([params[0], jnp.log(params[1]), params[2], params[3], *action])
    ends = np.concatenate([low, model.ACTION_LOW]), np.concatenate([high, model.ACTION_HIGH])
    middle, half = ((jnp.asarray(v, values.dtype)) for v in ((ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 2))
    return (values - middle) / half


def points(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Params `[count, 4]` over Omega and actions `[count, 3]` a little beyond theirs, spread evenly; count: a power of 2."""
    u = qmc.Sobol(7, rng=seed).random(count)
    low, high = np.array(model.LOW), np.array(model.HIGH)
    low[1], high[1] = np.log(low[1]), np.log(high[1])
    params = low + u[:, :4] * (high - low)
    params[:, 1], params[:, 2] = np.exp(params[:, 1]), u[:, 2] > 0.5
    low, high = np.array(model.ACTION_LOW), np.array(model.ACTION_HIGH)
    wide = REACH * (high - low)
    return params, np.maximum(low - wide + u[:, 4:] * (high - low + 2 * wide), 1e-3)


def simulate(
    params: np.ndarray, actions: np.ndarray, options: ScoopOptions, numerics: Numerics, report: Report = silent
):
    """`(success [N], code [N])` of trials in the engine, in batches."""
    run = jax.jit(jax.vmap(lambda p, a: hydro.rollout(p, a, options, numerics)[-2:]))
    wins, codes = np.zeros(len(params), bool), np.zeros(len(params), int)
    for at in range(0, len(params), BATCH):
        room = np.minimum(np.arange(at, at + BATCH), len(params) - 1)
        won, code = run(*(jnp.asarray(v[room], jnp.float32) for v in (params, actions)))
        count = min(BATCH, len(params) - at)
        wins[at : at + count], codes[at : at + count] = np.asarray(won)[:count] > 0.5, np.asarray(code)[:count]
        report(at + count, len(params), "trials")
    return wins, codes


def fit(params: np.ndarray, actions: np.ndarray, wins: np.ndarray, *, seed: int = 0, held_out: float = 0.1) -> Fit:
    """A network for the outcomes `wins [N]`: AdamW, batches of 256, 60 passes; the last share of trials is only for testing."""
    x = jax.vmap(features)(jnp.asarray(params, jnp.float32), jnp.asarray(actions, jnp.float32))
    y = jnp.asarray(wins, jnp.float32)
    train = len(x) - round(held_out * len(x))
    sizes = (x.shape[1], *HIDDEN, 1)
    keys = jax.random.split(jax.random.key(seed), len(sizes))
    scale = lambda a: float(np.sqrt(1.0 / a))
    layers = tuple(
        (scale(a) * jax.random.normal(k, (a, b)), jnp.zeros(b)) for k, a, b in zip(keys, sizes, sizes[1:], strict=False)
    )
    updates = 60 * max(1, train // 256)
    rates = optax.adamw(optax.cosine_decay_schedule(5e-3, updates), weight_decay=1e-3)

    def loss(layers, x, y):
        out = _forward(layers, x)
        return jnp.mean(optax.sigmoid_binary_cross_entropy(out, y))

    def update(carry, key):
        layers, opt = carry
        rows = jax.random.randint(key, (256,), 0, train)
        moves, opt = rates.update(jax.grad(loss)(layers, x[rows], y[rows]), opt, layers)
        return (optax.apply_updates(layers, moves), opt), None

    run = jax.jit(lambda c, k: jax.lax.scan(update, c, k)[0])
    layers, _ = run((layers, rates.init(layers)), jax.random.split(keys[-1], updates))
    test = slice(train, None)
    right = jnp.mean((_forward(layers, x[test]) > 0) == (y[test] > 0.5))
    return Fit(Bank(layers), float(right), float(loss(layers, x[test], y[test])), float(y[test].mean()))


def _forward(layers: Any, x: jax.Array) -> jax.Array:
    for weights, bias in layers[:-1]:
        x = jnp.tanh(x @ weights + bias)
    return (x @ layers[-1][0] + layers[-1][1])[:, 0]


def identity(options: ScoopOptions, numerics: Numerics) -> str:
    """What a bank belongs to: all of the engine's settings that change an outcome (execution errors are drawn later)."""
    table = {"clearance": options.clearance, "press": options.press, "numerics": asdict(numerics)}
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()[:16]


def save_bank(path: Path, found: Fit, wins: np.ndarray, seed: int, options: ScoopOptions, numerics: Numerics) -> None:
    """The trials' outcomes (their points follow from count and seed), the network, and what they belong to."""
    arrays: dict[str, Any] = {
        f"{n}{i}": np.asarray(v) for i, layer in enumerate(found.bank.layers) for n, v in zip("wb", layer, strict=True)
    }
    about = {
        "identity": identity(options, numerics),
        "clearance": options.clearance,
        "count": len(wins),
        "seed": seed,
        "accuracy": found.accuracy,
        "log_loss": found.log_loss,
    }
    np.savez_compressed(path, wins=np.packbits(wins), about=np.array(json.dumps(about)), **arrays)


@cache
def _read(path: Path) -> tuple[dict[str, Any], tuple[tuple[np.ndarray, np.ndarray], ...]]:
    if not path.exists():
        raise BadInput(f"{path.name}: the bank is not there; make it with `python experiments/scooping_bank.py`")
    with np.load(path, allow_pickle=False) as file:
        about = json.loads(str(file["about"]))
        layers = tuple((file[f"w{i}"], file[f"b{i}"]) for i in range(len(HIDDEN) + 1))
    return about, layers


def load_bank(options: ScoopOptions, numerics: Numerics, path: Path = PATH) -> Bank:
    """The bank at `path`; BadInput where it was made with other options or numerics."""
    about, layers = _read(path)
    if about["identity"] != identity(options, numerics):
        raise BadInput(
            f"scooping: the bank was made with clearance = {about['clearance']} m and the numerics of its day, not with these "
            "options; use source = 'simulator', or make another bank with `python experiments/scooping_bank.py`"
        )
    return Bank(tuple((jnp.asarray(w), jnp.asarray(b)) for w, b in layers))
