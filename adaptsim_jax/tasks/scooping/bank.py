"""The bank: trials of the hydroelastic engine over pieces and actions, simulated once and shared by
all policies (`experiments/scooping_bank.py` makes it).

What an action leads to depends on the piece and the action alone, so that trials may be stored. The
bank holds trials at even points (scrambled Sobol sequences) of Omega and of the wider box that
Phase 1 draws targets from, more of them near actions that looked good. Two small networks are
fitted to all. They say how likely an action as executed is to succeed, and where the piece is seen
meanwhile. Task policies are trained on it, and Phase 1 rehearses on it; targets of Phase 2 are
always simulated. A bank belongs to the options and numerics that it was made with and to no
others: a file that says otherwise is refused.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.stats import qmc

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.model import Numerics, ScoopOptions

PATH = Path(__file__).with_name("bank.npz")
BOXES = {
    "omega": (model.LOW, model.HIGH),
    "wide": ((0.15, 8e3, 0.0, 0.013), (0.5, 1.5e6, 2.0, 0.03)),
}
"""Lowest and highest parameters of each part of the bank: the paper's Omega, and the box of Phase
1's targets.
"""
REACH = np.array([0.2, 0.25, 0.05])
"""How far beyond their range actions are tried, as a share of it: execution errors leave it."""
MIN_SHARE = np.array([1e-3, -np.inf, 1e-3])  # a pitch of 0 has no edge, a distance of 0 no run-up
PLACE_UNIT = 0.1  # m: places come out of the network in units of it

Layers = Sequence[tuple[Any, Any]]


class Bank(NamedTuple):
    """chance, track: Weights and biases of the networks behind `logit` and `places`."""

    chance: Layers
    track: Layers

    def logit(self, params: Array, action: Array) -> Array:
        """Log odds of success `[]` at `params [4]` of `action [3]` as executed."""
        return forward(self.chance, features(params, action))[0]

    def places(self, params: Array, action: Array, won: Array) -> Array:
        """Where the piece is seen `[8]` m, ahead of where it lay, in a trial that ended as `won []`
        says (1 or 0).
        """
        x = jnp.concatenate([features(params, action), won[None].astype(action.dtype)])
        later = PLACE_UNIT * forward(self.track, x)
        return jnp.concatenate(
            [jnp.zeros(1, later.dtype), later]
        )  # it lies still when it is first seen


def forward(layers: Layers, x: Array) -> Array:
    """A tanh network `[n] -> [k]`."""
    for weights, bias in layers[:-1]:
        x = jnp.tanh(x @ weights + bias)
    weights, bias = layers[-1]
    return x @ weights + bias


def features(params: Array, action: Array) -> Array:
    """`[9]`: friction, log modulus, height and the action, each about [-1, 1] over Omega and the
    actions. A 1 for the shape.
    """
    low, high = np.array(model.LOW), np.array(model.HIGH)
    low[1], high[1] = np.log(low[1]), np.log(high[1])
    values = jnp.stack([params[0], jnp.log(params[1]), params[3], *action])
    lowest = np.r_[low[[0, 1, 3]], model.ACTION_LOW]
    highest = np.r_[high[[0, 1, 3]], model.ACTION_HIGH]
    middle = jnp.asarray((lowest + highest) / 2, values.dtype)
    half = jnp.asarray((highest - lowest) / 2, values.dtype)
    shape = (params[2] == jnp.arange(len(model.SHAPES))).astype(values.dtype)
    return jnp.concatenate([(values - middle) / half, shape])


def points(count: int, seed: int, box: str = "omega") -> tuple[np.ndarray, np.ndarray]:
    """Params `[count, 4]` over a box and actions `[count, 3]` a little beyond theirs, spread
    evenly. count: A power of 2.
    """
    u = qmc.Sobol(7, rng=seed).random(count)
    low, high = (np.array(b, float) for b in BOXES[box])
    low[1], high[1] = np.log(low[1]), np.log(high[1])
    shapes = high[2] + 1
    high[2] = shapes
    params = low + u[:, :4] * (high - low)
    params[:, 1] = np.exp(params[:, 1])
    params[:, 2] = np.minimum(np.floor(params[:, 2]), shapes - 1)
    low, high = np.array(model.ACTION_LOW), np.array(model.ACTION_HIGH)
    wide = REACH * (high - low)
    return params, np.maximum(low - wide + u[:, 4:] * (high - low + 2 * wide), MIN_SHARE)


def identity(options: ScoopOptions, numerics: Numerics) -> str:
    """What a bank belongs to: all of the engine's settings that change an outcome (execution errors
    are drawn later).
    """
    table = {"clearance": options.clearance, "press": options.press, "numerics": asdict(numerics)}
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()[:16]


@cache
def read_bank(path: Path = PATH) -> tuple[Table, dict[str, np.ndarray]]:
    """What the file at `path` says of itself, and its arrays."""
    if not path.exists():
        raise BadInput(
            f"{path.name}: the bank is not there; make it with `python "
            "experiments/scooping_bank.py`"
        )
    with np.load(path, allow_pickle=False) as file:
        return json.loads(str(file["about"])), {
            name: file[name] for name in file.files if name != "about"
        }


def load_bank(options: ScoopOptions, numerics: Numerics, path: Path = PATH) -> Bank:
    """The bank at `path`; BadInput where it was made with other options or numerics."""
    about, arrays = read_bank(path)
    if about["identity"] != identity(options, numerics):
        raise BadInput(
            f"scooping: the bank was made with clearance = {about['clearance']} m and the numerics "
            "of its day, not with these options; use source = rehearsal = 'simulator', correct = "
            "false, or make another bank with `python experiments/scooping_bank.py`"
        )

    def layers(name):
        count = sum(key.startswith(f"{name}_w") for key in arrays)
        return tuple(
            (jnp.asarray(arrays[f"{name}_w{i}"]), jnp.asarray(arrays[f"{name}_b{i}"]))
            for i in range(count)
        )

    return Bank(*map(layers, Bank._fields))
