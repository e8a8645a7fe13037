"""What a mended model is worth for the task: policies before and after, both run in the world that made the data.

    python -m experiments.closeloop_task --out closeloop_task.md

For each hidden effect: a linear-world recording is generated, written as files and diagnosed; the task policy is
trained on the fitted declared model and on `model.toml`, and both control the generator's own simulator, which shares
no code with the package's models.
"""

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax import diagnose
from adaptsim_jax.commands.task_reward import REWARD_GAIN, Trained, trained_policy
from adaptsim_jax.mechanisms.double_pendulum.linear import SAMPLES
from adaptsim_jax.mechanisms.model_file import Value
from adaptsim_jax.sysid import ModelFile, read_model
from adaptsim_jax.tasks.pendulum.augmented_policy import DT, ROWS
from tests.generators import effects as hidden_effects
from tests.generators import forces
from tests.generators.dataset import Spec, draft, make_datasets
from tests.generators.recording import write_dataset
from tests.generators.simulate import Delay, Drive, Plant, _rk4, play
from tests.generators.worlds import lanes_of

CASES = (("spring", 2, 6.0), ("coulomb", 1, 4.0), ("torque_gain", 1, 4.0), ("delay", 1, 4.0), ("bias", 2, 6.0))


def cost_in_world(rig, hidden: list[dict], trained: Trained) -> float:
    """The task's cost of a policy in the generator's simulator: hanging start, commands held for 5 ms."""
    law = jax.jit(trained.law)
    table = hidden_effects.Table(1)
    for e in hidden:
        table.add(
            e["name"], max(int(e["where"][-1]) - 1 if e["where"] != "base" else 0, 0), slice(0, 1), e["parameters"]
        )
    times = DT * np.arange(ROWS)[:, None]
    zero = np.zeros((ROWS, 2, 1))
    drive = Drive(
        times, zero, np.zeros((2, 4, 1)), np.zeros((ROWS, 4, 1)), np.full((2, 1), np.inf), np.zeros((4, 1)),
        np.zeros((ROWS, 4, 1)), np.zeros((2, 1)), zero, np.zeros(1),
    )  # fmt: skip
    plant = Plant(lanes_of([rig], [1]), table, drive, table.step())
    y = np.zeros((5 if plant.filter is not None or plant.bristle is not None else 3, 2, 1))
    y[0, 0] = -np.pi
    slack, commands, cost = y[0].copy(), np.zeros((ROWS, 2, 1)), 0.0
    delay = Delay(table["delay"]["size"], times, commands) if "delay" in table else None
    if plant.filter is not None:
        y[4] = y[0]
    pieces = int(np.ceil(DT / table.step() - 1e-9))
    h = np.full(1, DT / pieces)
    past = np.zeros((max(trained.world.history, 2), 2), np.float32)
    for k in range(ROWS):
        seen = plant.sense(y, slack)[0][:, 0]
        commands[k, :, 0] = np.asarray(law(jnp.asarray(seen, jnp.float32), jnp.asarray(past), jnp.float32(k * DT)))
        past = np.concatenate([past[1:], commands[k, :, 0][None].astype(np.float32)])
        cost += float(np.sum(y[:2] ** 2) + np.sum(commands[k] ** 2))
        for i in range(pieces):
            t = times[k] + i * h
            u = forces.static_command(table, commands[k] if delay is None else delay(t, h))
            y = _rk4(plant, y, t, h, u, zero[0])
            if "backlash" in table:
                slack = play(y[0], slack, table["backlash"]["size"])
    return cost * SAMPLES / ROWS


def declared_only(after: ModelFile, report: dict) -> ModelFile:
    """The declared model as it was fitted before anything was added."""
    before = report["declared"]["before"]
    declared = {
        name: Value(before[name]["value"], before[name]["low"], before[name]["high"], v.unit)
        for name, v in after.declared.items()
    }
    return replace(after, declared=declared, effects=(), names=(), covariance=np.zeros((0, 0)))


def one_case(seed: int, effect: tuple[str, int, float], folder: Path) -> dict:
    """Verdict, costs and rewards of one hidden effect."""
    spec = Spec(seed, effects=(effect,), world="linearized")
    data = make_datasets([spec])[0]
    write_dataset(data, folder / "data")
    report = diagnose(folder / "data", out=folder / "out")
    after = read_model(folder / "out" / "model.toml")
    rig, hidden = draft(spec).rig, data.truth["effects"]
    costs = {
        stage: cost_in_world(rig, hidden, trained_policy(model))
        for stage, model in (("before", declared_only(after, report)), ("after", after))
    }
    best = min(costs.values())
    return {
        "hidden": f"{effect[0]} at joint {effect[1]}, {effect[2]:g} x",
        "verdict": report["verdict"],
        "found": ", ".join(f"{e['name']} at {e['where']}" for e in report["effects"]) or "nothing",
        "error": (report["error"]["before"], report["error"]["after"]),
        "costs": costs,
        "reward": {k: 1.0 - REWARD_GAIN * (c / best - 1.0) for k, c in costs.items()},
        "predicted": report.get("task_reward"),
    }


def table_of(rows: list[dict], command: str) -> str:
    """The page, in Markdown."""
    lines = [
        "# The task before and after mending the model", "",
        f"Command: `{command}`", "",
        "Linear-world recordings (6 trials of 6 s at 200 Hz) with one hidden effect; sizes are multiples of the size that",
        "just matters. Both policies control the generator's simulator from hanging for 2.5 s. Reward as the task's:",
        "1 - 10 (cost / best - 1), against the cheaper of the two. `predicted` is what `diagnose` said without the world.", "",
        "| hidden | verdict | found | held-out error, rad | cost before | cost after | change "
        "| reward before | after | predicted before |",
        "| --- | --- | --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]  # fmt: skip
    for r in rows:
        before, after = r["costs"]["before"], r["costs"]["after"]
        error = f"{r['error'][0]:.3g} -> " + ("-" if r["error"][1] is None else f"{r['error'][1]:.3g}")
        predicted = f"{r['predicted']['before']:.3f}" if r["predicted"] else "-"
        lines.append(
            f"| {r['hidden']} | {r['verdict']} | {r['found']} | {error} | {before:.4g} | {after:.4g} | "
            f"{100 * (after / before - 1):+.2f} % | {r['reward']['before']:.3f} | {r['reward']['after']:.3f} | {predicted} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("closeloop_task.md"))
    parser.add_argument("--seed", type=int, default=12)
    parser.add_argument("--cases", type=int, default=len(CASES), help="how many of the effects, from the first")
    args = parser.parse_args()
    rows = []
    for i, effect in enumerate(CASES[: args.cases]):
        began = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            rows.append(one_case(args.seed + i, effect, Path(folder)))
        print(rows[-1], f"{time.monotonic() - began:.0f} s", flush=True)
        command = f"python -m experiments.closeloop_task --seed {args.seed} --cases {args.cases}"
        args.out.write_text(table_of(rows, command))


if __name__ == "__main__":
    main()
