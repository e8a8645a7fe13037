"""What a mended push is worth to the task: diagnosed from its tracks, trained on again, adapted in
the target that lacks something.

    python -m experiments.pushing_worth --out OUT --seeds 10 --trajectories 1250
    python -m experiments.pushing_worth --out OUT --seeds 3 --trajectories 1250 --engine drake \\
        --effects tilt

For each effect: 18 pushes of `experiments/pushing_worlds.py` at WD's parameters and `adaptsim
diagnose` of them; Phase 1 of AdaptSim with the declared and with the mended model (`model.toml`),
each from scratch for every seed; Phase 2 of both in the same target, the slide in steps of 1 ms
with the true effect (`nothing`: with none, and the declared model alone). With `--engine drake`
target and diagnosed pushes are made in Drake, gravity turned by the tilt, and the models are
Drake's planar twin. Rewards are printed by pushes made in the target; `planned`: what the best
actions of each model as fitted to the tracks earn there, without any adaptation. What is in OUT is
not computed again.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from adaptsim_jax import default_comparison, make_one_shot
from adaptsim_jax.adaptation.phase1 import make_phase1
from adaptsim_jax.adaptation.phase2 import stack, train_many
from adaptsim_jax.baselines.adapting import phase2
from adaptsim_jax.baselines.arena import Arena, MethodRun
from adaptsim_jax.baselines.results import bootstrap_interval
from adaptsim_jax.core import config as configs
from adaptsim_jax.core import process
from adaptsim_jax.core.files import atomic_file
from adaptsim_jax.tasks.one_shot import best_actions
from adaptsim_jax.tasks.pushing.config import SETTINGS
from adaptsim_jax.tasks.pushing.diagnosis.diagnose import diagnose
from adaptsim_jax.tasks.pushing.kind import of_model
from experiments import pushing_worlds, pushing_worlds_3d

# what acts in the target: as the slide has it, and as the generator of tracks has it
EFFECTS = {
    "tilt": ({"tilt_y": 0.03}, {"tilt_y": 0.03}),
    "speed_scale": ({"speed_scale": -0.1}, {"speed_scale": -0.1}),
    "grain": ({"grain_a": 0.3}, {"grain": 0.3, "grain_angle": np.pi / 2}),
    "nothing": ({"tilt_y": 1e-12}, {}),
}
WD = np.array([SETTINGS["wd"][name] for name in ("mu", "e", "mu_p", "y_p")])


def diagnosed(out: Path, name: str, seed: int, engine: str) -> dict:
    """The report on pushes in the target; `model.toml` lies beside them."""
    if not (out / "report.json").exists():
        own, truth = pushing_worlds.world("null", seed)
        for key, value in (SETTINGS["wd"] | EFFECTS[name][1]).items():
            own[key] = np.full(len(own["speed"]), value)
        folder = out / "measured"
        tracks = (
            pushing_worlds.simulate(own)
            if engine == "planar"
            else pushing_worlds_3d.simulate(engine, own)
        )
        meta = "" if engine == "planar" else f'coefficients = "{engine}"\n'
        pushing_worlds.write_world(
            folder, own, truth, tracks, np.random.default_rng([seed, 7]), meta=meta
        )
        report = diagnose(folder, out=out)
        (out / "report.json").write_text(json.dumps(report, default=float))
    return json.loads((out / "report.json").read_text())


def made_target(one, engine: str, name: str):
    """The world in which an effect acts."""
    lacking = EFFECTS[name][0]
    if engine == "planar":
        return one.world("planar", lacking=lacking)
    if set(lacking) - {"tilt_y"}:
        raise SystemExit(f"--effects {name}: {engine} can be tilted and no more; use tilt, nothing")
    return one.world(engine, gravity=pushing_worlds_3d.gravity(0.0, lacking["tilt_y"]))


def planned(one, world, fitted: np.ndarray, target_world) -> float:
    """What the best actions of a model at `fitted [4]` earn in the target."""
    _, actions = best_actions(world, fitted, one.tests, one.reward, (161, 31), shared=True)
    places, _ = target_world.run(np.tile(WD, (len(actions), 1)), one.tests, actions)
    return float(np.mean([one.reward(p, g) for p, g in zip(places, one.tests, strict=True)]))


def trained(config, one, seeds: np.ndarray):
    phase1 = make_phase1(one.task, config.train.phase1)
    return phase1, train_many(phase1, stack([config.train.hyper] * len(seeds)), seeds)


def told(name: str, model: str, rewards: np.ndarray, spent: np.ndarray) -> str:
    """Mean over seeds (and both starts) by pushes made before, and of each seed's best; rewards
    `[S, N, I + 1]`.
    """
    made = np.concatenate([[0], spent[:-1]])
    cells = []
    for k in [int(np.flatnonzero(made == n)[0]) for n in (0, 4, 8, 16, 32) if n in made]:
        cells.append(f"{made[k]}: {cell(rewards[..., k].mean(1))}")
    return f"{name:12s} {model:9s} pushes made {'  '.join(cells)}  best {cell(rewards.max((1, 2)))}"


def cell(values: np.ndarray) -> str:
    low, high = bootstrap_interval(values)
    return f"{values.mean():.3f} ({low:.3f}-{high:.3f})"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--effects", nargs="+", default=list(EFFECTS), choices=EFFECTS)
    parser.add_argument("--trajectories", type=int, default=5000, help="of Phase 1")
    parser.add_argument(
        "--planned",
        action="store_true",
        help="no more than what is planned in each model as fitted",
    )
    parser.add_argument("--iterations", type=int, default=8)
    parser.add_argument(
        "--engine", choices=("planar", "drake"), default="planar", help="of the target"
    )
    parser.add_argument(
        "--tracks-seed", type=int, default=9203, help="of the pushes that are diagnosed"
    )
    args = parser.parse_args()
    process.enable_cache()
    config = replace(default_comparison("pushing"), seeds=args.seeds, iterations=args.iterations)
    phase1 = replace(config.train.phase1, trajectories=args.trajectories)
    config = replace(config, train=replace(config.train, phase1=phase1))
    seeds, options, kept = np.arange(args.seeds), dict(config.train.task), {}
    if args.engine == "drake":
        options["coefficients"] = "drake"
    for name in args.effects:
        out = args.out / name
        out.mkdir(parents=True, exist_ok=True)
        report = diagnosed(out, name, args.tracks_seed, args.engine)
        mended = of_model(configs.read(out / "model.toml"), "model.toml")
        mended.pop("left_out")
        print(
            f"{name:12s} named: "
            f"{', '.join('/'.join([e['name'], *e['alternatives']]) for e in report['effects'])}"
        )
        before = report["declared"]["before"]
        fitted = {
            "declared": [before[key]["value"] for key in before],
            "mended": mended["fitted"],
        }
        # in Drake both models are slides in converged steps, so that nothing but the effect tells
        # them apart
        plain = {} if args.engine == "planar" else {"mended": EFFECTS["nothing"][0]}
        for model, extra in (("declared", plain), ("mended", mended))[
            : 1 if name == "nothing" else 2
        ]:
            one = make_one_shot("pushing", options | extra)
            target = made_target(one, args.engine, name)
            plan = planned(one, one.world("planar"), np.array(fitted[model]), target)
            print(f"{name:12s} {model:9s} planned {plan:.3f}", flush=True)
            if model == "declared":  # what the target allows, whatever the model
                print(f"{name:12s} oracle    {np.mean(one.oracle(target, WD)):.3f}", flush=True)
            if args.planned:
                continue
            path = out / f"{model}-{args.trajectories}-{args.seeds}.npz"
            if not path.exists():
                began = time.process_time()
                if model == "mended" or model not in kept:
                    kept[model] = trained(config, one, seeds)
                learned = time.process_time() - began
                trip = phase2(
                    MethodRun(config, Arena(one, target, WD[None]), seeds),
                    *kept[model],
                    config.starts,
                    args.iterations,
                )
                cpu = time.process_time() - began
                with atomic_file(path) as file:
                    np.savez(
                        file,
                        rewards=trip.rewards[0],
                        spent=trip.spent,
                        cpu=[learned, cpu],
                    )
            found = np.load(path)
            print(told(name, model, found["rewards"], found["spent"]), flush=True)
            print(
                f"{'':22s} CPU s of Phase 1 and of both phases: {found['cpu'].round()}", flush=True
            )


if __name__ == "__main__":
    main()
