"""Derivatives through the scooping engine against differences, a modulus fitted with them, and a
smoothed chance's gradient.

    python experiments/scooping_gradient.py --out gradient.json

1. The modulus from the piece's track of one trial, of WD's cylinder (0.15 s) and of an ellipsoid (1
   s), from three wrong starts, without and with noise.
2. For how long derivatives of the piece's place by the modulus are the differences', by shape
  (double precision, random trials).
3. The gradient of the chance of success, smoothed over a tenth of the inputs' ranges, by the
   score-function estimator, beside differences of that chance; and the bank's.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core import process
from adaptsim_jax.core.files import write_json
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.bank import load_bank
from adaptsim_jax.tasks.scooping.hydro import rollout, steps_of
from adaptsim_jax.tasks.scooping.model import Numerics, ScoopOptions
from adaptsim_jax.tasks.scooping.trial import RANGES, scaled, smoothed, unscaled

WD, ACTION = np.array([0.3, 5e4, 1.0, 0.02]), np.array([0.10, 0.0, 0.0125])
CASES = {
    "cylinder": (WD, ACTION, 0.15),
    "ellipsoid": (np.array([0.3, 5e4, 0.0, 0.02]), np.array([0.05, -0.1, 0.018]), 1.0),
}
TIMES = (0.15, 0.2, 0.25, 0.3, 0.4, 0.6, 1.0)  # s
POINTS = ((WD, ACTION), (np.array([0.3, 1e5, 0.0, 0.02]), np.array([0.07, -0.05, 0.014])))
SPREAD = 0.1
SHORTEST = 2.0**-10  # share of a Gauss-Newton step below which the search along it is given up


class ModulusFit(NamedTuple):
    """modulus Pa; error: root of the mean squared distance of the tracks m; steps: of Gauss-Newton;
    moduli: visited `[steps + 1]`.
    """

    modulus: float
    error: float
    steps: int
    moduli: list[float]


def track_until(
    seconds: float, options: ScoopOptions, numerics: Numerics
) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """`track(params [4], action [3]) -> [T, 3]`: the piece's x, z m and angle rad, a row a step,
    for the first `seconds`.
    """
    rows = round(seconds / numerics.dt) + 1
    return lambda params, action: rollout(params, action, options, numerics).piece[:rows]


def make_modulus_fit(
    seconds: float = 0.15,
    options: ScoopOptions = ScoopOptions(),  # noqa: B008
    numerics: Numerics = Numerics(),  # noqa: B008
    steps: int = 30,
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], ModulusFit]:
    """`fit(seen [T, 2], params [4], action [3])`: the modulus with which the engine's track comes
    nearest to `seen` (x, z m) in a trial whose other numbers are known.

    Gauss-Newton on the logarithm of the modulus from `params[1]`, with the derivative of the
    engine; a step is halved until the error falls. `seconds`: how much of the track is used; with a
    flat bottom it must end soon after the blade met the piece. Runs in the precision that JAX is
    told to use; float64 is worth its time here.
    """
    track = track_until(seconds, options, numerics)
    low, high = np.log(model.PHYSICAL_LOW[1]), np.log(model.PHYSICAL_HIGH[1])

    def apart(log_modulus, seen, params, action):
        return (track(params.at[1].set(jnp.exp(log_modulus)), action)[:, :2] - seen).ravel()

    @jax.jit
    def both(z, *known):
        return jax.jvp(lambda q: apart(q, *known), (z,), (jnp.ones_like(z),))

    def fit(seen, params, action):
        known = tuple(jnp.asarray(v, jnp.result_type(float)) for v in (seen, params, action))

        def at(z):
            return tuple(np.asarray(v, float) for v in both(jnp.asarray(z), *known))

        z = float(np.log(params[1]))
        (wrong, slope), visited = at(z), [float(np.exp(z))]
        for _ in range(steps):
            move = -float(slope @ wrong) / max(float(slope @ slope), 1e-30)
            move, share = float(np.clip(move, -1.5, 1.5)), 1.0
            while share > SHORTEST:
                new = float(np.clip(z + share * move, low, high))
                now = at(new)
                if now[0] @ now[0] < wrong @ wrong:
                    break
                share /= 2
            else:
                break
            z, (wrong, slope) = new, now
            visited.append(float(np.exp(z)))
        return ModulusFit(visited[-1], float(np.sqrt(np.mean(wrong**2))), len(visited) - 1, visited)

    return fit


def moduli(case: str, seed: int) -> list[dict[str, Any]]:
    """Fits of a modulus of 50 kPa, from 10, 150 and 500 kPa, without and with noise m on every row
    of the track.
    """
    truth, action, seconds = CASES[case]
    fit, rows = make_modulus_fit(seconds), []
    track = np.asarray(
        jax.jit(track_until(seconds, ScoopOptions(), Numerics()))(
            jnp.asarray(truth), jnp.asarray(action)
        )
    )
    for noise, start in ((n, s) for n in (0.0, 1e-4, 5e-4) for s in (1e4, 1.5e5, 5e5)):
        seen = track[:, :2] + noise * np.random.default_rng(seed).normal(size=track[:, :2].shape)
        found = fit(seen, np.array([truth[0], start, *truth[2:]]), action)
        row = {
            "case": case,
            "noise": noise,
            "start": start,
            "found": found.modulus,
            "error": found.error,
        }
        rows.append(row | {"steps": found.steps})
        print(rows[-1], flush=True)
    return rows


def horizon(samples: int, seed: int) -> list[dict[str, Any]]:
    """By shape and time: share of trials whose derivative of x by log modulus is the difference's
    within 2 %, and median sizes m.
    """
    params, actions = model.draw(seed, samples)

    def x(log_modulus, p, a):
        return rollout(p.at[1].set(jnp.exp(log_modulus)), a, ScoopOptions(), Numerics()).piece[:, 0]

    slope = jax.jit(jax.vmap(lambda z, p, a: jax.jvp(lambda q: x(q, p, a), (z,), (jnp.ones(()),))))
    z, p, a = jnp.log(jnp.asarray(params[:, 1])), jnp.asarray(params), jnp.asarray(actions)
    exact = np.asarray(slope(z, p, a)[1])

    def value(d):
        return np.asarray(slope(z + d, p, a)[0])

    near, far = (value(1e-7) - value(-1e-7)) / 2e-7, (value(0.1) - value(-0.1)) / 0.2
    rows = []
    for shape, time in ((g, t) for g in (0, 1) for t in TIMES):
        k, some = round(time * steps_of(Numerics()) / model.SECONDS), params[:, 2] == shape
        alike = np.abs(exact[some, k] - near[some, k]) <= 0.02 * np.abs(near[some, k]) + 1e-6
        sizes = {
            name: float(np.median(np.abs(v[some, k])))
            for name, v in (("exact", exact), ("near", near), ("far", far))
        }
        rows.append(
            {
                "shape": model.SHAPES[shape],
                "time": time,
                "trials": int(some.sum()),
                "alike": float(alike.mean()),
            }
            | sizes
        )
        print(rows[-1], flush=True)
    return rows


def gradients(pairs: int, seed: int) -> list[dict[str, Any]]:
    """At two points: the smoothed chance, its gradient, central differences of the chance, and the
    bank's gradient.
    """
    go = jax.jit(lambda k, p, a: smoothed(k, p, a, spread=SPREAD, pairs=pairs))
    bank, rows = load_bank(ScoopOptions(), Numerics()), []
    n = jax.random.normal(jax.random.key(9), (256, len(RANGES)))

    def chance(z, s):
        return jax.vmap(lambda e: jax.nn.sigmoid(bank.logit(*unscaled(z + SPREAD * e, s))))(
            n
        ).mean()

    for p, a in POINTS:
        p, a = jnp.asarray(p, jnp.float32), jnp.asarray(a, jnp.float32)
        key = jax.random.key(seed)
        found, z, step = go(key, p, a), scaled(p, a), 0.1
        moved = [
            [
                go(key, *unscaled(z + d * step * jnp.eye(len(RANGES))[i], p[2])).chance
                for d in (1, -1)
            ]
            for i in range(6)
        ]
        plain = np.array([(up - down) / (2 * step) for up, down in np.array(moved)])
        guess = np.asarray(jax.grad(chance)(z, p[2]))

        def cosine(u, v):
            return float(u @ v / np.linalg.norm(u) / np.linalg.norm(v))

        gradient = np.asarray(found.gradient)
        numbers = {
            "gradient": gradient,
            "error": np.asarray(found.error),
            "differences": plain,
            "bank": guess,
        }
        row = {"params": p.tolist(), "action": a.tolist(), "chance": float(found.chance)}
        row |= {key: np.round(value.astype(float), 3).tolist() for key, value in numbers.items()}
        rows.append(
            row | {"cosine": cosine(gradient, plain), "cosine_bank": cosine(gradient, guess)}
        )
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=32, help="random trials of part 2 (32)")
    parser.add_argument(
        "--pairs", type=int, default=256, help="pairs of trials of part 3 (256); 0 leaves it out"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    process.enable_cache()
    with jax.enable_x64(True):
        fits = [row for case in CASES for row in moduli(case, args.seed)]
        times = horizon(args.samples, args.seed)
    smooth = gradients(args.pairs, args.seed) if args.pairs else []
    if args.out:
        write_json(args.out, {"schema": 1, "modulus": fits, "horizon": times, "smoothed": smooth})


if __name__ == "__main__":
    main()
