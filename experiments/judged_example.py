"""The example of docs/attribution.md: a log of one joint whose dry friction the model file lacks,
its diagnosis, and the figures and numbers of the page.

    python experiments/judged_example.py --out OUT --page docs/images

OUT: the log, the model file and the diagnosis. The log comes from this file's own equations.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from adaptsim_jax import diagnose
from adaptsim_jax.attribution import tree_objective
from adaptsim_jax.attribution.replay import replay_files
from adaptsim_jax.diagnosis import testing
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.objective import FittedCandidate

MASS, ARM, INERTIA, GRAVITY = 1.0, 0.2, 0.012, 9.81  # kg, m, kg m2 about the centre, m/s2
DAMPING, FRICTION = 0.02, 0.08  # N m s/rad, N m: the file has the first alone
TRIALS, SECONDS, RATE, STEP, NOISE = 6, 4.0, 100, 1e-4, 3e-4  # Hz, s, rad
FILE = f"""<mujoco model="arm">
  <worldbody>
    <body name="arm"><joint name="shoulder" type="hinge" axis="0 1 0" damping="{DAMPING}"/>
      <inertial pos="0 0 -{ARM}" mass="{MASS}" diaginertia="{INERTIA} {INERTIA} 0.001"/></body>
  </worldbody>
  <actuator><motor name="shoulder" joint="shoulder"/></actuator>
</mujoco>
"""
META = 'task = "mechanism"\nmodel = "../arm.xml"\n'
SHOWN = 8  # candidates in the figure
RED, BLUE, GREY = "tab:red", "tab:blue", "0.65"


def trial(rng: np.random.Generator) -> np.ndarray:
    """Rows [T, 3] of time, angle and torque, under a sum of three sines."""
    size, rate, phase = rng.uniform(0.25, 0.6, 3), rng.uniform(2, 8, 3), rng.uniform(0, 6.28, 3)
    q, v, rows = rng.uniform(-0.5, 0.5), 0.0, []
    inertia, every = INERTIA + MASS * ARM**2, round(1 / RATE / STEP)
    for k in range(round(SECONDS / STEP)):
        if k % every == 0:  # a torque holds from its row to the next
            torque = float((size * np.sin(rate * k * STEP + phase)).sum())
            rows.append([k * STEP, q + rng.normal(0, NOISE), torque])
        smooth = torque - MASS * GRAVITY * ARM * np.sin(q) - DAMPING * v
        free = v + STEP * smooth / inertia
        v = np.sign(free) * max(abs(free) - STEP * FRICTION / inertia, 0.0)  # friction stops at 0
        q += STEP * v
    return np.array(rows)


def write_log(folder: Path) -> None:
    rng = np.random.default_rng(3)
    (folder / "logs").mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(FILE)
    (folder / "logs" / "meta.toml").write_text(META)
    for k in range(TRIALS):
        path, head = folder / "logs" / f"trial_{k}.csv", "time,q_shoulder,tau_shoulder"
        np.savetxt(path, trial(rng), "%.6f", ",", header=head, comments="")


@dataclass
class Noted:
    """What a search did on its way: findings, look-alikes that were fitted, and the differences
    [B] of each sign test.
    """

    found: list[Finding] = field(default_factory=list)
    instead: list[FittedCandidate] = field(default_factory=list)
    tests: list[np.ndarray] = field(default_factory=list)


def diagnosed(folder: Path) -> tuple[dict, Noted]:
    """The report, and what was noted while the package made it."""
    noted, objective = Noted(), tree_objective.TreeObjective
    search, instead, test = tree_objective.search, objective.in_place_of, testing.sign_flip

    def noted_search(*arguments, **options) -> Finding:
        noted.found.append(search(*arguments, **options))
        return noted.found[-1]

    def noted_instead(self, evidence) -> list[FittedCandidate]:
        noted.instead = instead(self, evidence)
        return noted.instead

    def noted_test(differences: np.ndarray) -> float:
        noted.tests.append(np.array(differences))
        return test(differences)

    tree_objective.search, testing.sign_flip = noted_search, noted_test
    objective.in_place_of = noted_instead
    try:
        report = diagnose(folder / "logs", out=folder / "out")
    finally:
        tree_objective.search, testing.sign_flip = search, test
        objective.in_place_of = instead
    return report, noted


def differences_of(report: dict, asked: list[np.ndarray]) -> np.ndarray:
    """Those of the first named effect's last test: of its p and, of such, the largest sum."""
    p = report["effects"][0]["p_value"]
    same = [d for d in asked if np.isclose(testing.sign_flip(d), p, rtol=1e-6)]
    return max(same, key=lambda d: d.sum())


def draw_error(folder: Path, page: Path) -> dict:
    """What both files leave of the first trial, and the error of every stretch, in mrad."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), width_ratios=(2, 1))
    medians = {}
    files = {"declared.xml": ("declared file", RED), "model.xml": ("mended file", BLUE)}
    for file, (label, colour) in files.items():
        found = replay_files(folder / "out" / file, folder / "logs")
        first = int(np.argmax(np.diff(found.time[:, 0]) < 0)) + 1  # stretches of the first trial
        for w in range(first):
            off = 1e3 * (found.simulated[w, :, 0] - found.measured[w, :, 0])
            left.plot(found.time[w], off, color=colour, lw=1.2, label=label if w == 0 else None)
        error = 1e3 * np.sort(found.error[:, 0])
        medians[file] = float(np.median(error))
        right.semilogy(np.arange(1, len(error) + 1), error, color=colour, label=label)
    right.axhline(1e3 * NOISE, color="k", ls=":", lw=1, label="noise")
    left.set(xlabel="time, s", ylabel="simulated - measured angle, mrad", title="one trial")
    right.set(xlabel="stretch, by its error", ylabel="error, mrad", title="all stretches")
    left.legend(frameon=False, fontsize=8)
    right.legend(frameon=False, fontsize=8)
    save(figure, page / "judged_error.png")
    return medians


def draw_scores(noted: Noted, page: Path) -> list[dict]:
    """The likeliest candidates by what each gains, to first order, where it was left out."""
    found = noted.found[-1]
    best, loss = list(found.scores)[:SHOWN], found.stages[0].fit.total
    named = {n.candidate.key for n in found.named}
    instead = {one.candidate.key for one in noted.instead}
    colours = [
        RED if key in named else BLUE if key in instead else GREY
        for key in (s.candidate.key for s in best)
    ]
    figure, axes = plt.subplots(figsize=(7, 3))
    names = [s.candidate.effect.replace("_", " ") for s in best]
    axes.barh(names, [100 * s.held_out / loss for s in best], color=colours)
    axes.invert_yaxis()
    axes.set(xlabel="left-out squared error that it takes off, to first order, %")
    for colour, label in ((RED, "named"), (BLUE, "fitted in its place"), (GREY, "scored")):
        axes.barh([names[0]], [0], color=colour, label=label)
    axes.legend(frameon=False, fontsize=8, loc="lower right")
    save(figure, page / "judged_scores.png")
    return [{"name": s.candidate.effect, "gain": s.held_out / loss, "p": s.p} for s in best]


def draw_test(differences: np.ndarray, page: Path) -> dict:
    """The sum of differences over blocks, beside sums with random signs."""
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (10_000, len(differences)))
    sums, own = signs @ differences, float(differences.sum())
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), width_ratios=(1, 1.4))
    left.bar(np.arange(1, len(differences) + 1), differences, color=BLUE)
    left.set(xlabel="block that was left out", ylabel="log(error without / with)")
    right.hist(sums, 60, color=GREY, label="with random signs")
    right.axvline(own, color=RED, label="as measured")
    right.set(xlabel="sum over blocks", ylabel="of 10,000 draws")
    right.legend(frameon=False, fontsize=8, loc="upper left")
    save(figure, page / "judged_test.png")
    return {"blocks": len(differences), "sum": own, "largest_random": float(sums.max())}


def save(figure: plt.Figure, path: Path) -> None:
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--page", type=Path, required=True)
    args = parser.parse_args()
    write_log(args.out)
    report, noted = diagnosed(args.out)
    numbers = {k: report[k] for k in ("verdict", "message", "effects")}
    numbers["error"] = {k: report["error"][k] for k in ("unit", "before", "after", "noise_floor")}
    numbers["candidates"] = len(report["candidates"])
    numbers["judge"] = report["yardsticks"]["judge"]
    numbers["replay_mrad"] = draw_error(args.out, args.page)
    numbers["scores"] = draw_scores(noted, args.page)
    numbers["instead"] = [
        {"name": one.candidate.effect, "better_is_the_name_by": one.test.gain, "p": one.test.p}
        for one in noted.instead
    ]
    numbers["trace"] = [
        [s.action, s.candidate.effect if s.candidate else "", s.why, s.shown]
        for s in noted.found[-1].trace
    ]
    numbers["test"] = draw_test(differences_of(report, noted.tests), args.page)
    text = json.dumps(numbers, indent=1, default=float)
    (args.page / "judged.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
