"""The figures of the tour: learning curves, and the picture that sums the tour up."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from adaptsim_jax.report import figures as look
from adaptsim_jax.report import figures_comparison as draw

SHADES = ("#0072B2", "#56B4E9", "#004d7a")
CURVES = ("adaptsim", "sysid_bayes", "sysid_point")


def learning_curves(metrics: Sequence[Sequence[Mapping[str, Any]]]) -> Figure:
    """Mean reward that is learned from, a line for each run's `metrics.jsonl`.

    It lies in [0, 1]; the task's own reward has no lower end, and a few hopeless starts would hide all the rest.
    """
    figure, (ax,) = look.new_figure(4.6, 2.9)
    for i, rows in enumerate(metrics):
        steps = [row["adaptation_steps"] / 1000 for row in rows]
        ax.plot(steps, [row["shaped"] for row in rows], color=SHADES[i % len(SHADES)], linewidth=1.5)
    look.quiet(ax)
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
    """The paper's figure 5: the best policy's parameters of each seed on the map of what could be earned."""
    found = {row["method"]: np.array(row["best_params"])[:, :2] for row in rows if row["method"] in CURVES}
    figure = draw.parameter_map(chart, target, found)
    figure.set_size_inches(4.6, 3.9)
    return figure
