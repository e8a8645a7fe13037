"""Derivatives through the scooping engine against finite differences, and a modulus fitted to one trajectory with them.

python experiments/scooping_gradient.py --out gradient.json

Double precision. Part 1: the smoothed success of single trials, and of averages over errors of execution, by friction, log
modulus, height, pitch, rate and distance. Part 2: the modulus from the piece's track of one trial, from three wrong starts,
without and with noise on the track.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import compile_cache
from adaptsim_jax.files import write_json
from adaptsim_jax.models import scooping as model
from adaptsim_jax.models.scooping import ScoopOptions
from adaptsim_jax.models.scooping_fit import fit_modulus, smooth_chance, track_until
from adaptsim_jax.models.scooping_hydro import Numerics

INPUTS = ("friction", "log modulus", "height", "pitch", "rate", "distance")
SCALES = np.array(
    [0.15, 3.9, 0.01, 0.14, 0.4, 0.015]
)  # Omega's and the actions' ranges: derivatives are by shares of them
WIDTH = 3e-3  # m, of the smoothed success
NEAR = 1e-6  # of a range: the step of differences that see the same contacts
FAR = 0.03  # of a range: the step that crosses switches, as a user's change of the input does


def unpack(z, shape):
    """`z [6]` in shares of the ranges to `(params [4], action [3])`."""
    v = z * jnp.asarray(SCALES)
    return jnp.stack([v[0], jnp.exp(v[1]), shape, v[2]]), v[3:]


def packed(params: np.ndarray, action: np.ndarray) -> np.ndarray:
    return np.concatenate([[params[0], np.log(params[1]), params[3]], action]) / SCALES


def differences(go, z: np.ndarray, step: float) -> np.ndarray:
    """`[6]` central differences of `go(z [M, 6]) -> [M]`."""
    moved = np.concatenate([z + step * np.eye(6), z - step * np.eye(6)])
    value = np.asarray(go(jnp.asarray(moved)))
    return (value[:6] - value[6:]) / (2 * step)


def single_trials(samples: int, seed: int) -> dict[str, Any]:
    """Per input: the share of trials whose derivative is the near difference's within 1 %, and within 10 % of the far one's."""
    params, actions = model.draw(seed, samples)
    rows = []
    for shape in (0, 1):
        value = lambda z, s=shape: smooth_chance(*unpack(z, jnp.asarray(float(s))), jnp.zeros((1, 2)), width=WIDTH)
        go, slope = jax.jit(jax.vmap(value)), jax.jit(jax.jacfwd(value))
        for p, a in zip(params[params[:, 2] == shape], actions[params[:, 2] == shape], strict=True):
            z = packed(p, a)
            rows.append((np.asarray(slope(jnp.asarray(z))), differences(go, z, NEAR), differences(go, z, FAR)))
    exact, near, far = (np.array(v) for v in zip(*rows, strict=True))
    matters = np.abs(near) > 1e-3
    alike = lambda other, share: np.abs(exact - other) <= share * np.maximum(np.abs(other), 1e-3)
    return {
        "samples": samples,
        "matters": dict(zip(INPUTS, matters.mean(0).round(3).tolist(), strict=True)),
        "as_near_1_percent": dict(zip(INPUTS, alike(near, 0.01).mean(0).round(3).tolist(), strict=True)),
        "same_sign_as_far": float((np.sign(exact) == np.sign(far))[np.abs(far) > 0.05].mean()),
        "median_size": {"exact": float(np.median(np.abs(exact))), "near": float(np.median(np.abs(near)))},
    }


def averages(samples: int, errors: int, seed: int) -> dict[str, Any]:
    """Success averaged over errors of execution: the mean of derivatives beside the far difference of the mean."""
    params, actions = model.draw(seed, samples)
    rng = np.random.default_rng(seed)
    noise = jnp.asarray(rng.uniform(-1, 1, (errors, 2)) * np.array(ScoopOptions().noise[:2]))
    value = lambda z, s: smooth_chance(*unpack(z, s), noise, width=WIDTH)
    slope, go = jax.jit(jax.jacfwd(value)), jax.jit(jax.vmap(value, (0, None)))
    exact, far = [], []
    for p, a in zip(params, actions, strict=True):
        z, s = packed(p, a), jnp.asarray(float(p[2]))
        exact.append(np.asarray(slope(jnp.asarray(z), s)))
        far.append(differences(lambda m, s=s: go(m, s), z, FAR))
    exact, far = np.array(exact), np.array(far)
    told = np.abs(far) > 0.1
    cosine = (exact * far).sum(1) / np.maximum(np.linalg.norm(exact, axis=1) * np.linalg.norm(far, axis=1), 1e-12)
    return {
        "samples": samples,
        "errors": errors,
        "same_sign": float((np.sign(exact) == np.sign(far))[told].mean()),
        "told": int(told.sum()),
        "median_cosine": float(np.median(cosine)),
    }


def moduli(noise: float, seed: int) -> list[dict[str, Any]]:
    """Fits of WD's modulus, 50 kPa, from 10, 150 and 500 kPa; `noise` m on every row of the track."""
    truth, action = np.array([0.3, 5e4, 1.0, 0.02]), np.array([0.10, 0.0, 0.0125])
    seconds = 0.4
    track = np.asarray(
        jax.jit(track_until(seconds, ScoopOptions(), Numerics()))(jnp.asarray(truth), jnp.asarray(action))
    )
    seen = track[:, :2] + noise * np.random.default_rng(seed).normal(size=track[:, :2].shape)
    rows = []
    for start in (1e4, 1.5e5, 5e5):
        found = fit_modulus(seen, truth * np.array([1, 0, 1, 1]) + np.array([0, start, 0, 0]), action, seconds=seconds)
        rows.append(
            {"noise": noise, "start": start, "found": found.modulus, "error": found.error, "steps": found.steps}
        )
        print(f"noise {1e3 * noise:g} mm, start {start:.3g} Pa: {found.modulus:.5g} Pa (true 5e4) in {found.steps} steps, "
              f"error {1e3 * found.error:.2g} mm", flush=True)  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=48, help="random trials (48)")
    parser.add_argument("--errors", type=int, default=16, help="errors of execution in an average (16)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    compile_cache.enable()
    with jax.enable_x64(True):
        fits = [row for noise in (0.0, 1e-4, 5e-4) for row in moduli(noise, args.seed)]
        alone = single_trials(args.samples, args.seed)
        print(alone, flush=True)
        mean = averages(args.samples // 2, args.errors, args.seed)
        print(mean)
    if args.out:
        write_json(args.out, {"schema": 1, "modulus": fits, "single": alone, "average": mean})


if __name__ == "__main__":
    main()
