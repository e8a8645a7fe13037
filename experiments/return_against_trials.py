"""Return in the target against target trials, for each way of adapting a simulator: one figure and
one table.

    # all tasks, 10 seeds: hours
    python experiments/return_against_trials.py --out runs/trials
    python experiments/return_against_trials.py --out runs/trials --tasks cartpole --seeds 3 --small
    # figure and table of what is there
    python experiments/return_against_trials.py --out runs/trials --show

Resumable: each task, seed and method is a part of its own in `OUT/TASK/seed-N.json`. Five targets a
task: one within Omega, four that Omega cannot say; they run in MuJoCo C. Returns are normalised in
each target: 0 UDR, 1 the oracle or the best in Omega. Tasks of Playground and the pendulum of
gymnax need the extra `[environments]`, row sbi the extra `[sbi]`.
"""

import argparse
import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core import config as configs
from adaptsim_jax.core.files import output_folder, write_bytes, write_json
from adaptsim_jax.core.progress import progress

BUDGETS = (0, 2, 5, 10, 20, 40)
METHODS = (
    "udr",
    "oracle",
    "adaptsim",
    "sysid_point",
    "sysid_bayes",
    "bayesopt",
    "cma_es",
    "gradient",
    "sbi",
    "fine_tune",
    "nominal",
    "best_in_omega",
)
EXTRA = {"sbi": "sbi", "cma_es": "cma"}
SWING = {"body:cart.mass": [0.6, 1.6], "actuator:slide.gear": [6.0, 14.0]}
TASKS: dict[str, dict[str, Any]] = {
    "cartpole": {
        "env": "cartpole",
        "fields": {
            "body:pole.mass": [0.1, 0.5],
            "body:cart.mass": [0.6, 1.6],
            "actuator:motor.gear": [6.0, 14.0],
        },
        "targets": {
            "within": {"body:pole.mass": 0.35, "body:cart.mass": 0.8, "actuator:motor.gear": 8.0},
            "weak": {"actuator:motor.gear": 4.5},
            "dry": {"joint:slide.frictionloss": 1.5},
            "late": {"delay": 0.03, "body:pole.mass": 0.4},
            "drag": {"joint:slide.damping": 3.0, "action_scale": 0.8},
        },
    },
    "pendulum": {
        "env": "gymnax:Pendulum-v1",
        "fields": {"params.m": [0.5, 2.0], "params.l": [0.7, 1.4]},
        "targets": {
            "within": {"params.m": 1.6, "params.l": 0.8},
            "heavy": {"params.m": 2.6},
            "late": {"delay": 0.1},
            "weak": {"action_scale": 0.6, "params.m": 1.2},
            "moon": {"params.g": 3.0},
        },
    },
    "arm": {
        "env": "arm",
        "fields": {
            "body:payload.mass": [0.05, 1.0],
            "joint:shoulder.damping": [0.05, 0.8],
            "joint:elbow.damping": [0.05, 0.6],
            "actuator:shoulder.gear": [2.5, 6.0],
        },
        "targets": {
            "within": {"body:payload.mass": 0.7, "joint:elbow.damping": 0.4},
            "payload": {"body:payload.mass": 1.6},
            "dry": {"joint:shoulder.frictionloss": 0.6, "joint:elbow.frictionloss": 0.3},
            "late": {"delay": 0.04},
            "weak": {"action_scale": 0.6, "joint:elbow.armature": 0.05},
        },
    },
    "cartpole_swingup": {
        "env": "playground:CartpoleSwingup",
        "fields": SWING | {"body:pole_1.mass": [0.05, 0.3]},
        "targets": {
            "within": {"body:pole_1.mass": 0.2, "actuator:slide.gear": 8.0},
            "weak": {"actuator:slide.gear": 4.5},
            "dry": {"joint:slider.frictionloss": 1.0},
            "late": {"delay": 0.03},
            "drag": {"joint:hinge_1.damping": 0.02, "action_scale": 0.8},
        },
    },
    "acrobot_swingup": {
        "env": "playground:AcrobotSwingup",
        "fields": {
            "body:lower_arm.mass": [0.5, 2.0],
            "joint:elbow.damping": [0.01, 0.2],
            "actuator:elbow.gear": [1.4, 3.0],
        },
        "targets": {
            "within": {"body:lower_arm.mass": 1.4, "actuator:elbow.gear": 2.4},
            "weak": {"actuator:elbow.gear": 1.1},
            "dry": {"joint:elbow.frictionloss": 0.2},
            "late": {"delay": 0.02},
            "upper": {"body:upper_arm.mass": 1.6, "joint:shoulder.damping": 0.15},
        },
    },
    "pendulum_swingup": {
        "env": "playground:PendulumSwingup",
        "fields": {
            "body:pole.mass": [0.5, 2.0],
            "joint:hinge.damping": [0.02, 0.3],
            "actuator:torque.gear": [0.6, 1.6],
        },
        "targets": {
            "within": {"body:pole.mass": 0.8, "actuator:torque.gear": 0.8},
            "heavy": {"body:pole.mass": 2.6},
            "dry": {"joint:hinge.frictionloss": 0.15},
            "late": {"delay": 0.05},
            "weak": {"action_scale": 0.5},
        },
    },
}
STEPS = {
    "cartpole": 6_000_000,
    "pendulum": 3_000_000,
    "arm": 6_000_000,
}  # of PPO; Playground's tasks 20 million
LEAST = -2.0  # of the figure's axis: what is worse than UDR by more is in the table alone
# Steps of PPO in the small form: of a quarter of LITTLE a policy for the own cart-pole earns half.
SMALL = {"pendulum_swingup": 16_384_000, "acrobot_swingup": 16_384_000}
LITTLE = 4_096_000
LEAST_SEEDS = 3  # for an interval over them


def options_of(task: str, small: bool) -> dict[str, Any]:
    steps = SMALL.get(task, LITTLE) if small else STEPS.get(task, 20_000_000)
    return TASKS[task] | {"training": {"steps": steps}}


def comparison(options: dict[str, Any], small: bool) -> Any:
    from adaptsim_jax.baselines.config import default_comparison

    base = default_comparison("environment")
    train = replace(base.train, task=options)
    if small:
        sysid = replace(base.sysid, simulations=100)
        return replace(
            base,
            train=train,
            sysid=sysid,
            starts=1,
            iterations=10,
            steps=replace(base.steps, tests=12, points=16),
        )
    return replace(base, train=train, starts=2, iterations=19)


def here(methods: list[str]) -> list[str]:
    """Methods without those whose extra is not installed, which is told: hours are not to end
    there.
    """
    lacking = {m for m in methods if m in EXTRA and find_spec(EXTRA[m]) is None}
    for m in sorted(lacking):
        print(f"left out: {m}, which needs {EXTRA[m]} (not installed here)", flush=True)
    return [m for m in methods if m not in lacking]


def run(out: Path, task: str, seeds: range, methods: list[str], small: bool) -> None:
    """The methods of one task that are not there yet, seed by seed."""
    output_folder(out / task)
    paths = {seed: out / task / f"seed-{seed}.json" for seed in seeds}
    there = {
        seed: json.loads(path.read_text()) if path.exists() else {} for seed, path in paths.items()
    }
    if all(set(methods) <= set(found) for found in there.values()):
        return
    from adaptsim_jax.adaptation.training import learned
    from adaptsim_jax.baselines.arena import MethodRun
    from adaptsim_jax.baselines.compare_steps import StepsComparison, deployed_by
    from adaptsim_jax.environments.setting import EnvironmentConfig
    from adaptsim_jax.environments.task import environment_setting, task_of

    options, sizes = options_of(task, small), comparison(options_of(task, small), small)
    setting = environment_setting(configs.from_table(EnvironmentConfig, options, task))
    made = task_of(setting)
    steps = StepsComparison(setting, list(TASKS[task]["targets"]), sizes)
    assert made.preparation is not None
    for seed, found in there.items():
        if not (left := [m for m in methods if m not in found]):
            continue
        with progress(f"{task}, seed {seed}") as report:
            ready = learned(made, made.preparation, seed, out / task / f"policy-{seed}", report)
            arena, shared = steps.arena(ready, seed), {}
            for method in left:
                asked = MethodRun(sizes, arena, np.array([seed]), report, shared)
                deployed = deployed_by(method, asked)
                found[method] = {
                    "trials": deployed.trials.tolist(),
                    "returns": deployed.returns.tolist(),
                }
                write_json(paths[seed], found)


def rows(out: Path) -> list[dict[str, Any]]:
    """For each task, target, method and budget: normalised returns by seed."""
    table = []
    for task in TASKS:
        seeds = [json.loads(p.read_text()) for p in sorted((out / task).glob("seed-*.json"))]
        seeds = [s for s in seeds if {"udr", "oracle"} <= set(s)]
        if not seeds:
            continue

        def last(m, seeds=seeds):
            return np.mean([np.array(s[m]["returns"])[:, -1] for s in seeds if m in s], 0)

        lower, upper = (
            last("udr"),
            np.max([last(m) for m in ("oracle", "best_in_omega") if all(m in s for s in seeds)], 0),
        )
        spent = max(
            run["trials"][-1] for s in seeds for run in s.values()
        )  # beyond it nothing was measured
        for method in METHODS:
            own = [s[method] for s in seeds if method in s]
            for t, target in enumerate(TASKS[task]["targets"]):
                for budget in (b for b in BUDGETS if b <= spent):
                    values = [_at(o, t, budget) for o in own]
                    if values and None not in values and upper[t] - lower[t] > 0.02 * abs(upper[t]):
                        norm = (np.array(values, float) - lower[t]) / (upper[t] - lower[t])
                        row = {"task": task, "target": target, "method": method, "budget": budget}
                        table.append(row | {"per_seed": norm.tolist(), "mean": float(norm.mean())})
    return table


def _at(run: dict[str, Any], t: int, budget: int) -> Any:
    there = [i for i, n in enumerate(run["trials"]) if n <= budget]
    return run["returns"][t][there[-1]] if there else None


def against(out: Path, budget: int = 10) -> list[str]:
    """Lines of a table for each task: AdaptSim's return after `budget` target trials less each
    method's, `+` and `-` where the 95 % interval of its mean over seeds is without 0; in how many
    targets outside of Omega it is above, and as good (not `-`).
    """
    from adaptsim_jax.baselines.results import bootstrap_interval
    from adaptsim_jax.report import figures as look

    text = []
    for task in TASKS:
        seeds = [json.loads(p.read_text()) for p in sorted((out / task).glob("seed-*.json"))]
        seeds = [s for s in seeds if "adaptsim" in s]
        names = list(TASKS[task]["targets"])
        lines = []
        for method in METHODS:
            both = [s for s in seeds if method in s]
            if method == "adaptsim" or not both:
                continue

            def less(s, t, m=method):
                return _at(s["adaptsim"], t, budget) - _at(s[m], t, budget)

            apart = np.array([[less(s, t) for s in both] for t in range(len(names))])
            ends = np.array([bootstrap_interval(row) for row in apart])
            mark = np.where(ends[:, 0] > 0, " +", np.where(ends[:, 1] < 0, " -", ""))
            above, good = np.sum(apart[1:].mean(1) > 0), np.sum(mark[1:] != " -")
            if len(both) < LEAST_SEEDS:
                mark, good = np.full(len(names), ""), ""
            cells = [f"{row.mean():.3g}{m}" for row, m in zip(apart, mark, strict=True)]
            lines.append(
                f"| {look.label(method)} | {len(both)} | {' | '.join(cells)} | {above} | {good} |"
            )
        if lines:
            text += [f"\n{task}: AdaptSim after {budget} target trials less each method\n"]
            text += [
                f"| method | seeds | {' | '.join(names)} | above | as good |",
                "| --- |" + " --- |" * (len(names) + 3),
            ]
            text += lines
    return text


def show(out: Path) -> list[Path]:
    """figure.png, table.md and results.json of what is there."""
    from adaptsim_jax.report import figures as look

    table = rows(out)
    write_json(out / "results.json", {"budgets": BUDGETS, "rows": table})
    tasks = list(dict.fromkeys(r["task"] for r in table))
    wide, high = min(max(len(tasks), 1), 3), -(-max(len(tasks), 1) // 3)
    figure, axes = look.new_figure(
        max(3.0 * wide + 1.2, 5.4), 2.6 * high + 1.0, high, wide, sharey=True
    )
    for ax in axes[len(tasks) :]:
        ax.set_visible(False)
    text, lowest = [], 0.0
    for ax, task in zip(axes, tasks, strict=False):
        text += [
            f"\n{task}\n\n| method | {' | '.join(map(str, BUDGETS))} |",
            f"| --- |{' --- |' * len(BUDGETS)}",
        ]
        for method in METHODS:
            cells = [
                [
                    r["mean"]
                    for r in table
                    if (r["task"], r["method"], r["budget"]) == (task, method, b)
                ]
                for b in BUDGETS
            ]
            means = [
                float(np.median(c)) if c else None for c in cells
            ]  # a target with little room counts no more
            if any(m is not None for m in means):
                text.append(
                    f"| {look.label(method)} | "
                    f"{' | '.join('' if m is None else f'{round(m, 2) + 0.0:.2f}' for m in means)} "
                    "|"
                )
                drawn = [(b, m) for b, m in zip(BUDGETS, means, strict=True) if m is not None]
                lowest = min([lowest, *[m for _, m in drawn]])
                ax.plot(
                    *zip(*drawn, strict=True),
                    marker="o",
                    markersize=3,
                    label=look.label(method),
                    **look.style(method),
                )
        look.style_axes(ax)
        ax.set_title(task, fontsize=9)
        ax.set_xlabel("target trials")
    axes[0].set_ylim(max(lowest - 0.1, LEAST), 1.1)
    for ax in axes[::wide]:
        ax.set_ylabel("return (0 UDR, 1 oracle)")
    handles, labels = axes[0].get_legend_handles_labels()
    columns = 3 if len(tasks) < 2 else 4
    figure.legend(
        handles, labels, loc="outside lower center", ncols=columns, frameon=False, fontsize=7
    )
    text = ["Medians over targets of the means over seeds.", *text, *against(out)]
    write_bytes(out / "table.md", ("\n".join(text) + "\n").encode())
    return [look.save(figure, out / "figure.png"), out / "table.md", out / "results.json"]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--tasks", default=",".join(TASKS))
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="the first of the seeds")
    parser.add_argument(
        "--small",
        action="store_true",
        help="fewer steps and one start: a seed of a task in minutes",
    )
    parser.add_argument(
        "--show", action="store_true", help="figure and table of what is there; nothing is run"
    )
    args = parser.parse_args()
    if not args.show:
        methods, seeds = here(args.methods.split(",")), range(args.first, args.first + args.seeds)
        for task in args.tasks.split(","):
            run(args.out, configs.pick("task", task, TASKS), seeds, methods, args.small)
    for path in show(args.out):
        print(f"written: {path}")


if __name__ == "__main__":
    main()
