"""The README's picture of a diagnosis: the torque that a rigid body leaves at a joint, the friction
found in it, the error before and after.

    adaptsim diagnose DATA --out OUT
    python experiments/residual_figure.py OUT DATA --figure docs/images/residual.png

OUT: a diagnosis of a double pendulum (`model.toml`, `report.json`) that names Coulomb friction and
a rotor at joint 2. The torque left is the measured one less the fitted rigid body's
(docs/reference/measured-data.md has its equations), its viscous friction and the rotor, by inverse
dynamics with angles differentiated over 41 rows.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import savgol_filter

WINDOW = 41  # rows of 1 ms
BINS = 40


def torque_left(path: Path, report: dict, model: dict) -> tuple[np.ndarray, np.ndarray]:
    """`v2 [T]` rad/s and the unexplained torque `[T]` N m of joint 2 in one trial."""
    rows = np.genfromtxt(path, delimiter=",", names=True)
    dt = float(np.median(np.diff(rows["time"])))
    q = [np.unwrap(rows[k]) for k in ("q1", "q2")]
    (v1, v2), (a1, a2) = (
        [savgol_filter(x, WINDOW, 3, deriv=d, delta=dt) for x in q] for d in (1, 2)
    )
    value = {k: p["value"] for k, p in report["declared"]["after"].items()}
    rotor = next(e for e in model["effects"] if e["name"] == "armature" and e["where"] == "joint2")
    l1, g = model["geometry"]["l1"], model["geometry"]["g"]
    m12 = value["p3"] + l1 * value["h2"] * np.cos(q[1])
    body = (
        m12 * a1
        + value["p3"] * a2
        + l1 * value["h2"] * np.sin(q[1]) * v1**2
        + g * value["h2"] * np.sin(q[0] + q[1])
    )
    left = rows["tau2"] - body - value["b2"] * v2 - rotor["parameters"]["inertia"]["value"] * a2
    inside = slice(WINDOW, -WINDOW)
    return v2[inside], left[inside]


def draw(report: dict, model: dict, parts: list[tuple[np.ndarray, np.ndarray]], out: Path) -> None:
    v, left = (np.concatenate(x) for x in zip(*parts, strict=True))
    level = next(e for e in model["effects"] if e["name"] == "coulomb" and e["where"] == "joint2")[
        "parameters"
    ]["level"]["value"]
    figure, (torque, error) = plt.subplots(1, 2, figsize=(10, 3.6), width_ratios=(1.25, 1))
    torque.scatter(
        v[::7],
        left[::7],
        s=2,
        color="0.75",
        linewidths=0,
        rasterized=True,
        label="torque left by the rigid body",
    )
    edges = np.quantile(v, np.linspace(0, 1, BINS + 1))
    which = np.clip(np.digitize(v, edges) - 1, 0, BINS - 1)
    medians = [(np.median(v[which == k]), np.median(left[which == k])) for k in range(BINS)]
    torque.plot(
        *zip(*medians, strict=True), "o", ms=4, color="tab:blue", label="its median, by velocity"
    )
    span = np.quantile(v, [0.002, 0.998])
    torque.plot(
        [span[0], 0, 0, span[1]],
        [-level, -level, level, level],
        color="tab:red",
        lw=1.8,
        label=f"Coulomb friction found: {level:.3f} N m",
    )
    torque.set(
        xlim=span,
        ylim=(-4 * level, 4 * level),
        xlabel="velocity of joint 2 [rad/s]",
        ylabel="torque at joint 2 [N m]",
    )
    torque.legend(fontsize=8, loc="upper left", frameon=False, markerscale=1.5)

    trials = report["error"]["per_trial"]
    for k, row in enumerate(trials):
        before, after = 1e3 * row["before"], 1e3 * row["after"]
        error.plot([before, after], [k, k], color="0.7", lw=1.5, zorder=1)
        error.plot(before, k, "o", color="0.45", label="rigid body, fitted" if k == 0 else None)
        error.plot(
            after, k, "o", color="tab:red", label="with the effects found" if k == 0 else None
        )
    error.set_yticks(
        range(len(trials)), [row["trial"].removeprefix("trial_") for row in trials], fontsize=8
    )
    error.set(
        ylabel="trial, left out in turn",
        xlabel="error of simulated angles over 0.5 s [mrad]",
        xlim=(0, None),
    )
    error.invert_yaxis()
    all_of_it = [1e3 * report["error"][k] for k in ("before", "after")]
    error.set_title(f"median of all {all_of_it[0]:.1f} → {all_of_it[1]:.1f} mrad", fontsize=9)
    error.legend(fontsize=8, frameon=False, loc="lower left")
    for axis in (torque, error):
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(out, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("diagnosis", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--figure", type=Path, default=Path("residual.png"))
    a = parser.parse_args()
    model = tomllib.loads((a.diagnosis / "model.toml").read_text())
    report = json.loads((a.diagnosis / "report.json").read_text())
    parts = [torque_left(path, report, model) for path in sorted(a.data.glob("*.csv"))]
    draw(report, model, parts, a.figure)
    print(f"written: {a.figure}")


if __name__ == "__main__":
    main()
