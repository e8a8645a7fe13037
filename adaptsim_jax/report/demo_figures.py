"""The figures of the tour: what learning earned, the comparison, a recording explained."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from adaptsim_jax.report import figures as look
from adaptsim_jax.report import figures_comparison as draw

SHADES = ("#0072B2", "#56B4E9", "#004d7a")
CURVES = ("adaptsim", "sysid_bayes", "sysid_point")
MEASURED, DECLARED, MENDED = "#7b8794", "#c4540a", "#1767b0"
SHOWN = 2.0  # s of a recording


def learning_curves(metrics: Sequence[Sequence[Mapping[str, Any]]]) -> Figure:
    """Mean reward that is learned from, a line for each run's `metrics.jsonl`.

    It lies in [0, 1]. The task's own reward has no lower end, and a few hopeless starts would hide
    all the rest.
    """
    figure, (ax,) = look.new_figure(4.6, 2.9)
    for i, rows in enumerate(metrics):
        steps = [row["adaptation_steps"] / 1000 for row in rows]
        ax.plot(
            steps, [row["shaped"] for row in rows], color=SHADES[i % len(SHADES)], linewidth=1.5
        )
    look.style_axes(ax)
    ax.set_ylim(0, 1)
    ax.set_xlabel("adaptation steps in simulation (thousands)", fontsize=9)
    ax.set_ylabel("mean reward while learning", fontsize=9)
    return figure


def rewards_over_iterations(results: Mapping[str, Any]) -> Figure:
    """The paper's reward over iterations for the one setting of the tour."""
    figure = draw.reward_over_iterations(results, CURVES)
    figure.set_size_inches(4.6, 3.4)
    figure.axes[0].set_title("")
    return figure


def reward_map(chart: Any, target: Sequence[float], rows: Sequence[Mapping[str, Any]]) -> Figure:
    """The paper's figure 5: the best policy's parameters of each seed on the map of what could be
    earned.
    """
    found = {
        row["method"]: np.array(row["best_params"])[:, :2]
        for row in rows
        if row["method"] in CURVES
    }
    figure = draw.parameter_map(chart, target, found)
    figure.set_size_inches(4.6, 3.9)
    return figure


def recording_explained(trial: Mapping[str, Any], channel: str) -> Figure:
    """Two seconds of one trial, measured and simulated by the declared and the mended model, and
    under it what each is off by.

    `trial`: of `held_out` of a diagnosis; each half second is simulated from its own fitted start.
    """
    time = np.asarray(trial["time"], float)
    rows = time <= time[np.isfinite(time)][0] + SHOWN
    columns = [("declared", DECLARED, trial["before"][channel])]
    columns += [("mended", MENDED, trial["after"][channel])] if trial.get("after") else []
    measured = np.asarray(trial["measured"][channel], float)[rows]
    figure, (top, low) = look.new_figure(4.6, 3.4, 2, 1, sharex=True, height_ratios=(1.6, 1))
    top.plot(time[rows], measured, color=MEASURED, linewidth=4.0, alpha=0.5, label="measured")
    for name, colour, values in columns:
        simulated = np.asarray(values, float)[rows]
        top.plot(time[rows], simulated, color=colour, linewidth=1.3, label=f"{name} model")
        low.plot(time[rows], 1e3 * (measured - simulated), color=colour, linewidth=1.2)
    for ax in (top, low):
        look.style_axes(ax)
    top.set_ylabel("angle (rad)", fontsize=8.5)
    low.set_ylabel("off by (mrad)", fontsize=8.5)
    low.set_xlabel("time (s)", fontsize=8.5)
    figure.legend(
        *top.get_legend_handles_labels(),
        loc="outside lower center",
        ncols=3,
        frameon=False,
        fontsize=8,
    )
    return figure


def errors_by_trial(error: Mapping[str, Any]) -> Figure:
    """The error on each left-out trial under the declared and the mended model, and what noise
    alone leaves; `error` of a report.
    """
    trials = [row for row in error["per_trial"] if row.get("before") is not None]
    figure, (ax,) = look.new_figure(4.6, 3.4)
    for k, row in enumerate(trials):
        after = row["before"] if row.get("after") is None else row["after"]
        ax.plot([1e3 * row["before"], 1e3 * after], [k, k], color=look.GRID, linewidth=2, zorder=1)
        ax.plot(
            1e3 * row["before"], k, "o", color=DECLARED, label="declared model" if k == 0 else None
        )
        ax.plot(1e3 * after, k, "o", color=MENDED, label="mended model" if k == 0 else None)
    if (floor := error.get("noise_floor")) is not None:
        ax.axvline(1e3 * floor, color="#2f855a", linestyle="--", linewidth=1.3, label="noise alone")
    look.style_axes(ax)
    ax.set_yticks(range(len(trials)), [str(row["trial"]).replace("_", " ") for row in trials])
    ax.invert_yaxis()
    ax.set_xlim(0, None)
    ax.set_xlabel("error on the trial, left out of the fit (mrad)", fontsize=8.5)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure
