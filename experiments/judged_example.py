"""The example of docs/attribution.md: a log of one joint whose dry friction the model file lacks,
its diagnosis, and the figures and numbers of the page.

    python experiments/judged_example.py --out OUT --page docs/images

OUT: the log, the model file and the diagnosis. The log comes from this file's own equations.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from adaptsim_jax import diagnose
from adaptsim_jax.attribution.replay import replay_files
from adaptsim_jax.diagnosis import testing

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
    size, rate, phase = rng.uniform(0.4, 1.0, 3), rng.uniform(2, 8, 3), rng.uniform(0, 6.28, 3)
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


def diagnosed(folder: Path) -> tuple[dict, list[np.ndarray]]:
    """The report, and the differences [B] of each sign test that was made on the way."""
    asked, test = [], testing.sign_flip

    def noted(differences: np.ndarray) -> float:
        asked.append(np.array(differences))
        return test(differences)

    testing.sign_flip = noted
    try:
        report = diagnose(folder / "logs", out=folder / "out")
    finally:
        testing.sign_flip = test
    return report, asked


def differences_of(report: dict, asked: list[np.ndarray]) -> np.ndarray:
    """Those of the first named effect's last test: of its p and, of such, the largest sum."""
    p = report["effects"][0]["p_value"]
    same = [d for d in asked if np.isclose(testing.sign_flip(d), p, rtol=1e-6)]
    return max(same, key=lambda d: d.sum())


def draw_error(folder: Path, page: Path) -> dict:
    """Stretches of the first trial by both files, and the error of every stretch, mrad."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), width_ratios=(2, 1))
    medians = {}
    files = {"declared.xml": ("declared file", RED), "model.xml": ("mended file", BLUE)}
    for file, (label, colour) in files.items():
        found = replay_files(folder / "out" / file, folder / "logs")
        for w in range(int(SECONDS / 0.5)):
            once = label if w == 0 else None
            left.plot(found.time[w], found.simulated[w, :, 0], color=colour, lw=1.2, label=once)
            if file == "declared.xml":
                thick = {"color": "0.8", "lw": 5, "zorder": 0}
                once = "measured" if w == 0 else None
                left.plot(found.time[w], found.measured[w, :, 0], label=once, **thick)
        error = 1e3 * np.sort(found.error[:, 0])
        medians[file] = float(np.median(error))
        right.semilogy(np.arange(1, len(error) + 1), error, color=colour, label=label)
    right.axhline(1e3 * NOISE, color="k", ls=":", lw=1, label="noise")
    left.set(xlabel="time, s", ylabel="angle, rad", title="stretches of one trial")
    right.set(xlabel="stretch, by its error", ylabel="error, mrad", title="all stretches")
    left.legend(frameon=False, fontsize=8)
    right.legend(frameon=False, fontsize=8)
    save(figure, page / "judged_error.png")
    return medians


def draw_scores(report: dict, page: Path) -> list[dict]:
    """The likeliest candidates by what each gains, to first order, where it was left out."""
    best = sorted(report["candidates"], key=lambda c: -c["held_out_gain"])[:SHOWN]
    colour = {"accepted": RED, "look-alike": BLUE, "rejected": GREY}
    figure, axes = plt.subplots(figsize=(7, 3))
    names = [f"{c['name'].replace('_', ' ')}, {c['where']}" for c in best]
    gains = [100 * c["held_out_gain"] for c in best]
    axes.barh(names, gains, color=[colour[c["status"]] for c in best])
    axes.invert_yaxis()
    axes.set(xlabel="left-out error that it takes off by itself, to first order, %")
    for kind in sorted({c["status"] for c in best}):
        axes.barh([names[0]], [0], color=colour[kind], label=kind)
    axes.legend(frameon=False, fontsize=8, loc="lower right")
    save(figure, page / "judged_scores.png")
    return [{k: c[k] for k in ("name", "where", "held_out_gain", "p_value", "why")} for c in best]


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
    right.legend(frameon=False, fontsize=8)
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
    report, asked = diagnosed(args.out)
    numbers = {k: report[k] for k in ("verdict", "message", "effects")}
    numbers["error"] = {k: report["error"][k] for k in ("unit", "before", "after", "noise_floor")}
    numbers["candidates"] = len(report["candidates"])
    numbers["judge"] = report["yardsticks"]["judge"]
    numbers["replay_mrad"] = draw_error(args.out, args.page)
    numbers["scores"] = draw_scores(report, args.page)
    numbers["test"] = draw_test(differences_of(report, asked), args.page)
    text = json.dumps(numbers, indent=1, default=float)
    (args.page / "judged.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
