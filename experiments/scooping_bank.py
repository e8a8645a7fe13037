"""Make the bank of scooping trials that task policies are trained with and Phase 1 rehearses on,
and say how good it is.

python experiments/scooping_bank.py --omega 32768 --wide 32768 --near 8192 --keep build/bank
chunks there are not made again

Trials `near` are of actions that networks fitted to the others think good: policies will ask for
such, so that is where the networks must be right. They are added in lots of 2048, each with
networks that know the lots before.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from adaptsim_jax.core import process
from adaptsim_jax.core.files import atomic_file
from adaptsim_jax.core.progress import Report, progress, silent
from adaptsim_jax.tasks.scooping import bank as scooping_bank
from adaptsim_jax.tasks.scooping import hydro, model
from adaptsim_jax.tasks.scooping.bank import (
    BOXES,
    PLACE_UNIT,
    Bank,
    Layers,
    features,
    forward,
    identity,
)
from adaptsim_jax.tasks.scooping.model import MESSAGES, Numerics, ScoopOptions

CHUNK, CANDIDATES = 2048, 256
BATCH = 64  # trials side by side
PLACES = len(model.OBSERVED_AT)
SEEDS = {"omega": 0, "wide": 1}
CHANCE, TRACK = (128, 128, 128), (96, 96)  # hidden layers of the networks
SIZE, PASSES, RATE, DECAY = 256, 60, 3e-3, 1e-2


many = jax.vmap(forward, (None, 0))


class Trials(NamedTuple):
    """`params [N, 4]`, `actions [N, 3]` as executed, `wins [N]` bool, `places [N, 8]` m along the
    table from where it lay.
    """

    params: np.ndarray
    actions: np.ndarray
    wins: np.ndarray
    places: np.ndarray


class Fit(NamedTuple):
    """A bank, and on held-out trials: accuracy and mean log loss of its chance, with a number for
    each box, and the root of the mean squared error of its places m.
    """

    bank: Bank
    accuracy: dict[str, float]
    log_loss: dict[str, float]
    track_error: float


def fit(
    parts: dict[str, Trials], *, seed: int = 0, held_out: float = 0.1, passes: int = PASSES
) -> Fit:
    """The networks for the trials of all boxes; the last share of each box is only for testing."""
    split = {box: len(t.wins) - round(held_out * len(t.wins)) for box, t in parts.items()}

    def gather(keep):
        return Trials(
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


def network(
    key: jax.Array, hidden: tuple[int, ...], x: jax.Array, y: jax.Array, loss, passes: int
) -> Layers:
    """Layers from `x [N, n]` to `y [N, k]`: AdamW with a cosine rate, `passes` over the data in
    batches of 256.
    """
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
    return jax.vmap(features)(
        jnp.asarray(t.params, jnp.float32), jnp.asarray(t.actions, jnp.float32)
    )


def _chance_data(t: Trials) -> tuple[jax.Array, jax.Array]:
    return _features(t), jnp.asarray(t.wins, jnp.float32)[:, None]


def _track_data(t: Trials) -> tuple[jax.Array, jax.Array]:
    x = jnp.concatenate([_features(t), jnp.asarray(t.wins, jnp.float32)[:, None]], 1)
    return x, jnp.asarray(t.places[:, 1:] / PLACE_UNIT, jnp.float32)


def _chance_loss(out: jax.Array, y: jax.Array) -> jax.Array:
    return jnp.mean(optax.sigmoid_binary_cross_entropy(out, y))


def _track_loss(out: jax.Array, y: jax.Array) -> jax.Array:
    return jnp.mean(jnp.square(out - y))


def simulate(
    params: np.ndarray,
    actions: np.ndarray,
    options: ScoopOptions,
    numerics: Numerics,
    report: Report = silent,
) -> tuple[Trials, np.ndarray]:
    """The trials in the engine, in batches, and their codes `[N]`."""
    rows = hydro.observed_rows(numerics)

    @jax.jit
    @jax.vmap
    def run(params, action):
        out = hydro.rollout(params, action, options, numerics)
        return out.success > 0.5, out.piece[rows, 0], out.code

    N = len(params)
    wins, places, codes = np.zeros(N, bool), np.zeros((N, PLACES)), np.zeros(N, int)
    for at in range(0, N, BATCH):
        room = np.minimum(np.arange(at, at + BATCH), N - 1)
        found = run(*(jnp.asarray(v[room], jnp.float32) for v in (params, actions)))
        count = min(BATCH, N - at)
        wins[at : at + count], places[at : at + count], codes[at : at + count] = (
            np.asarray(f)[:count] for f in found
        )
        report(at + count, N, "trials")
    return Trials(params, actions, wins, places), codes


def trials_of(
    box: str, count: int, keep: Path, options: ScoopOptions, numerics: Numerics
) -> tuple[Trials, float]:
    """`count` trials in `box`, a chunk of them a file in `keep`, and the CPU seconds that they
    took.
    """
    params, actions = scooping_bank.points(
        2 ** int(np.ceil(np.log2(max(count, 2)))), SEEDS[box], box
    )
    parts, codes, cpu = [], [], 0.0
    with progress(f"bank, {box}") as report:
        for at in range(0, count, CHUNK):
            some = slice(at, min(at + CHUNK, count))
            path = keep / f"{box}-{at:06d}.npz"
            if not path.exists():
                begin = time.process_time()
                made, code = simulate(params[some], actions[some], options, numerics)
                spent = time.process_time() - begin
                with atomic_file(path) as file:
                    np.savez(
                        file,
                        wins=made.wins,
                        places=made.places.astype(np.float32),
                        code=code,
                        cpu=spent,
                    )
            with np.load(path) as found:
                parts.append(Trials(params[some], actions[some], found["wins"], found["places"]))
                codes.append(found["code"])
                cpu += float(found["cpu"])
            report(some.stop, count, "trials")
    faults = {
        MESSAGES[c]: int((np.concatenate(codes) == c).sum())
        for c in np.unique(np.concatenate(codes))
        if c
    }
    wins = np.concatenate([p.wins for p in parts])
    print(
        f"{box}: {count} trials, {count / cpu:.0f} a CPU second; succeeded: {wins.mean():.3f}; "
        f"faults: {faults or 'none'}"
    )
    return Trials(*(np.concatenate(v) for v in zip(*parts, strict=True))), cpu


def near_points(bank: Bank, lot: int, options: ScoopOptions) -> tuple[np.ndarray, np.ndarray]:
    """Even pieces of Omega, for each of them the best of 256 random actions by the bank, executed
    with an error.
    """
    params, _ = scooping_bank.points(CHUNK, 100 + lot)
    rng = np.random.default_rng(lot)
    low, high = np.array(model.ACTION_LOW), np.array(model.ACTION_HIGH)
    actions = rng.uniform(low, high, (CHUNK, CANDIDATES, 3))
    errors = np.array([(i, j, 0.0) for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)]) * np.array(
        options.noise
    )

    def chance(p, a):
        return jax.nn.sigmoid(
            jax.vmap(lambda e: bank.logit(p, a + e))(jnp.asarray(errors, jnp.float32))
        ).mean()

    likely = jax.jit(lambda p, a: jax.lax.map(lambda w: jax.vmap(chance, (None, 0))(*w), (p, a)))
    best = np.asarray(likely(*(jnp.asarray(v, jnp.float32) for v in (params, actions)))).argmax(1)
    chosen = actions[np.arange(CHUNK), best] + 1.5 * rng.uniform(-1, 1, (CHUNK, 3)) * (
        *options.noise[:2],
        1e-3,
    )
    return params, np.maximum(chosen, scooping_bank.MIN_SHARE)


def add_near(
    parts: dict[str, Trials], lots: int, keep: Path, options: ScoopOptions, numerics: Numerics
) -> None:
    """Put trials `near` into `parts`, a file each lot."""
    for lot in range(lots):
        path = keep / f"near-{lot:03d}.npz"
        if not path.exists():
            params, actions = near_points(fit(parts, seed=lot, passes=30).bank, lot, options)
            made, _ = simulate(
                params.astype(np.float32), actions.astype(np.float32), options, numerics
            )
            with atomic_file(path) as file:
                np.savez(file, **made._asdict())
        with np.load(path) as found:
            new = Trials(*(found[name] for name in Trials._fields))
        print(f"near, lot {lot}: succeeded: {new.wins.mean():.3f}", flush=True)
        old = parts.get("near")
        parts["near"] = (
            new if old is None else Trials(*(np.concatenate(v) for v in zip(old, new, strict=True)))
        )


def save_bank(
    path: Path,
    bank: Bank,
    parts: dict[str, Trials],
    about: dict[str, Any],
    options: ScoopOptions,
    numerics: Numerics,
) -> None:
    """The outcomes of each part, the networks, and what they belong to; points, too, where they do
    not follow from a seed.
    """
    arrays: dict[str, Any] = {
        f"{name}_{n}{i}": np.asarray(v, np.float32)
        for name in Bank._fields
        for i, layer in enumerate(getattr(bank, name))
        for n, v in zip("wb", layer, strict=True)
    }
    arrays |= {f"wins_{name}": np.packbits(trials.wins) for name, trials in parts.items()}
    for name in parts.keys() - BOXES.keys():
        points = np.concatenate([parts[name].params, parts[name].actions], 1)
        arrays[f"points_{name}"] = points.astype(np.float32)
    about = {"identity": identity(options, numerics), "clearance": options.clearance} | about
    with atomic_file(path) as file:
        np.savez_compressed(file, about=np.array(json.dumps(about)), **arrays)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--omega", type=int, default=32768, help="trials within Omega, a multiple of 2048 (32768)"
    )
    parser.add_argument(
        "--wide", type=int, default=32768, help="trials within the box of Phase 1's targets (32768)"
    )
    parser.add_argument(
        "--near", type=int, default=8192, help="trials near good actions, a multiple of 2048 (8192)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the networks")
    parser.add_argument("--clearance", type=float, default=ScoopOptions().clearance, help="m")
    parser.add_argument(
        "--keep",
        type=Path,
        default=Path("build/scooping_bank"),
        help="folder of the simulated chunks",
    )
    parser.add_argument("--out", type=Path, default=scooping_bank.PATH)
    args = parser.parse_args()
    process.enable_cache()
    args.keep.mkdir(parents=True, exist_ok=True)
    options, numerics = ScoopOptions(clearance=args.clearance), Numerics()
    counts = {"omega": args.omega, "wide": args.wide}
    parts = {
        box: trials_of(box, n, args.keep, options, numerics)[0] for box, n in counts.items() if n
    }
    add_near(parts, args.near // CHUNK, args.keep, options, numerics)
    begin = time.process_time()
    found = fit(parts, seed=args.seed)
    about = {
        "counts": counts,
        "seeds": SEEDS,
        "accuracy": found.accuracy,
        "log_loss": found.log_loss,
        "track_error": found.track_error,
    }
    save_bank(args.out, found.bank, parts, about, options, numerics)
    print(
        f"networks on held-out tenths, {time.process_time() - begin:.0f} CPU seconds: "
        f"{json.dumps(about)}"
    )
    print(f"written: {args.out}, {args.out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
