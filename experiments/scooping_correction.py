"""How what is deployed in scooping may be corrected by the target's own scoops, tried on random
targets and seeds that no table uses.

    python experiments/scooping_correction.py --out OUT --visits own 0 1 --doubts 1,0.5,1,3 \\
        0,0.5,2,3

AdaptSim and SysID-Point adapt in ten of the pieces of `scooping_choices`, once; their visits are
kept in OUT. They are taken as they were (`own`), or the last scoop of each is replaced by a probe
with as much optimism (`tasks/scooping/deployed.py`), E going where it went. Each doubt (others,
reach, spread, most; see `tasks/scooping/corrections.py`) then says what would be deployed at the
last visits, scored in the engine in 12 test contexts. `network` is E's policy as it is, `search`
the best action when nothing was seen of the target, `start` the default doubt by the bank at the
mean that E had first, and not at its own.
"""

from __future__ import annotations

import argparse
import itertools
import pickle
import time
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import default_comparison, make_one_shot
from adaptsim_jax.baselines.adapting import adaptsim, sysid_point
from adaptsim_jax.baselines.arena import (
    Arena,
    Memory,
    MethodRun,
    Observed,
    RunLanes,
    TrialBatch,
    lanes,
)
from adaptsim_jax.core import process
from adaptsim_jax.core.config import from_table
from adaptsim_jax.core.files import output_folder, write_json
from adaptsim_jax.tasks.scooping.corrections import Doubt
from adaptsim_jax.tasks.scooping.deployed import make_choice, make_probe
from adaptsim_jax.tasks.scooping.task import ScoopingConfig, ScoopingPolicy

CONFIG = default_comparison("scooping")
OPTIONS = dict(CONFIG.train.task) | {"tests": 12, "correct": True}
PIECES = {"slippery": [0, 2, 3, 5], "cylinders": [6, 7], "boxes": [10, 11], "ellipsoids": [14, 15]}
METHODS = {
    "adaptsim": (adaptsim, 2, 1),
    "sysid_point": (sysid_point, 1, 3),
}  # how, starts, label of its lanes
LATE = 4  # visits that are scored, the last


class Recorder(Arena):
    """An arena that keeps what each visit was and showed, and scores nothing."""

    def __init__(self, *given):
        super().__init__(*given)
        self.kept: list[tuple] = []

    def visit(self, keys, where, policies) -> Observed:
        seen = super().visit(keys, where, policies)
        self.kept.append(
            (jax.tree.map(np.asarray, policies._replace(told=None, probe=None)), seen.trials)
        )
        return seen

    def score(self, where, policies) -> np.ndarray:
        return np.zeros(len(where))


def targets() -> np.ndarray:
    """`[17, 4]`: friction, modulus, shape, height of pieces drawn at random: six slippery
    cylinders, four of Omega, four boxes, three ellipsoids.
    """
    rng = np.random.default_rng(777)

    def between(low, high):
        return rng.uniform(low, high)

    def softness(low, high):
        return float(np.exp(between(np.log(low), np.log(high))))

    def draw(mu, e, g, h):
        return [between(*mu), softness(*e), g, between(*h)]

    first = [draw((0.15, 0.25), (2e4, 2e5), 1, (0.016, 0.027)) for _ in range(7)]
    first.pop(4)  # the best action there wins but 0.83
    ellipsoid, box = (
        draw((0.36, 0.5), (8e3, 3e4), 0, (0.013, 0.018)),
        draw((0.3, 0.48), (5e4, 3e5), 2, (0.016, 0.024)),
    )
    cylinder = draw((0.26, 0.38), (2e4, 1e5), 1, (0.016, 0.024))
    rng = np.random.default_rng(778)
    for _ in range(12):
        draw((0.15, 0.25), (2e4, 2e5), 1, (0.016, 0.027))
    cylinders = [draw((0.25, 0.4), (1.5e4, 2e5), 1, (0.015, 0.025)) for _ in range(6)]
    boxes = [draw((0.3, 0.48), (5e4, 3e5), 2, (0.016, 0.024)) for _ in range(6)]
    ellipsoids = [draw((0.36, 0.5), (8e3, 3e4), 0, (0.013, 0.018)) for _ in range(3)]
    return np.array([*first, cylinder, *cylinders[:3], box, *boxes[:3], ellipsoid, *ellipsoids[:2]])


def visits_of(method: str, out: Path, seeds: np.ndarray, pieces: np.ndarray) -> list[tuple]:
    """The visits of `method` with scoops of its own alone, from the file where it made them
    before.
    """
    path = out / f"visits-{method}.pkl"
    if not path.exists():
        one = replace(make_one_shot("scooping", OPTIONS), probe=None)
        arena, begin = Recorder(one, one.world(one.engine), pieces), time.process_time()
        METHODS[method][0](MethodRun(replace(CONFIG, iterations=8), arena, seeds))
        path.write_bytes(pickle.dumps(arena.kept))
        print(
            f"{method}: {len(arena.kept)} visits, {time.process_time() - begin:.0f} s of CPU time",
            flush=True,
        )
    # without what policies did not hold yet when the file was made
    return [
        (ScoopingPolicy(p.weights, p.at), TrialBatch(*t))
        for p, t in pickle.loads(path.read_bytes())
    ]


def probed(arena: Arena, batch: RunLanes, visits: list[tuple], optimism: float) -> list[tuple]:
    """The same visits with their last scoops replaced by probes; E goes where it went."""
    probe = make_probe(from_table(ScoopingConfig, OPTIONS, "correction"), Doubt(), optimism)
    memory, found, act = (
        Memory(replace_one(arena, probe), batch, len(visits)),
        [],
        jax.jit(jax.vmap(arena.one.act)),
    )
    for policies, trials in visits:
        tried = memory.visiting(jax.tree.map(jnp.asarray, policies))
        actions = np.asarray(act(tried, jnp.asarray(trials.contexts)))
        last = arena.run(batch.where, trials.contexts[:, -1:], actions[:, -1:])

        def both(old, new):
            return np.concatenate([old[:, :-1], new], 1)

        now = TrialBatch(
            trials.contexts,
            both(trials.actions, actions[:, -1:]),
            jax.tree.map(both, trials.outcomes, last),
        )
        memory.add(now)
        found.append((policies, now))
    return found


def replace_one(arena: Arena, probe) -> Arena:
    return Arena(replace(arena.one, probe=probe), arena.world, arena.targets)


def deployed(arena: Arena, batch: RunLanes, visits: list[tuple], name: str) -> np.ndarray:
    """Actions `[LATE, B, G, d]` in the test contexts at the last visits, by the doubt `name`."""
    doubt = (
        None
        if name == "network"
        else Doubt()
        if name in ("search", "start")
        else Doubt(*map(float, name.split(",")))
    )
    memory, found = Memory(arena, batch, len(visits)), []
    act = make_choice(from_table(ScoopingConfig, OPTIONS, "correction"), doubt or Doubt())
    act = jax.jit(jax.vmap(act, (0, None)))
    for i, (policies, trials) in enumerate(visits):
        if i >= len(visits) - LATE:
            told = (
                jax.tree.map(jnp.asarray, policies) if doubt is None else memory.deployed(policies)
            )
            if name == "search":
                told = told._replace(told=told.told._replace(used=jnp.zeros_like(told.told.used)))
            if name == "start":
                told = told._replace(at=jnp.asarray(visits[0][0].at))
            found.append(np.asarray(act(told, jnp.asarray(arena.one.tests))))
        memory.add(trials)
    return np.stack(found)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", required=True)
    parser.add_argument("--seeds", type=int, default=3, help="from 100 on")
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=METHODS)
    parser.add_argument("--visits", nargs="+", default=["own", "1"])
    parser.add_argument("--doubts", nargs="+", default=["network", "search", "1,0.5,1,3"])
    args = parser.parse_args()
    process.enable_cache()
    out, seeds = output_folder(Path(args.out)), np.arange(100, 100 + args.seeds)
    pieces = targets()[[i for rows in PIECES.values() for i in rows]]
    one = make_one_shot("scooping", OPTIONS)
    arena = Arena(one, one.world(one.engine), pieces)
    for method, way in itertools.product(args.methods, args.visits):
        visits, (_, starts, label) = visits_of(method, out, seeds, pieces), METHODS[method]
        batch = lanes(len(pieces), seeds, starts, label)
        visits = visits if way == "own" else probed(arena, batch, visits, float(way))
        for name in args.doubts:
            begin = time.process_time()
            actions = deployed(arena, batch, visits, name)
            rewards = np.stack([arena.score_actions(batch.where, a) for a in actions], -1)
            told = by_group(batch.grid(rewards))
            write_json(out / f"{method}-{way}-{name}.json", told)
            row = "  ".join(f"{n} {v['late']:.3f} {v['best']:.3f}" for n, v in told.items())
            print(
                f"{method:12} {way:4} {name:12} late, best: {row}  "
                f"{time.process_time() - begin:.0f} s",
                flush=True,
            )


def by_group(rewards: np.ndarray) -> dict[str, dict[str, float]]:
    """Of `rewards [T, S, N, LATE]`, by group of pieces: the mean, the mean over seeds of the best,
    and each piece's mean.
    """
    found, at = {}, 0
    for name, rows in PIECES.items():
        some = rewards[at : at + len(rows)]
        found[name] = {"late": float(some.mean()), "best": float(some.max((2, 3)).mean())}
        found[name]["each"] = some.mean((1, 2, 3)).round(3).tolist()
        at += len(rows)
    found["all"] = {
        key: float(np.mean([g[key] for g in found.values()])) for key in ("late", "best")
    }
    return found


if __name__ == "__main__":
    main()
