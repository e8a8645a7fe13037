"""The figures of the tour: learning curves, and the picture that sums the tour up."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from adaptsim_jax.report import figures as look
from adaptsim_jax.report import figures_comparison as draw

CURVES = ("adaptsim", "sysid_bayes", "sysid_point")


def learning_curves(metrics: Sequence[Sequence[Mapping[str, Any]]]) -> Figure:
    """Mean reward after the last adaptation step of each round's trajectories, a line for each run's `metrics.jsonl`."""
    figure, (ax,) = look.new_figure(4.6, 2.9)
    for i, rows in enumerate(metrics):
        steps = [row["adaptation_steps"] / 1000 for row in rows]
        # the reward has no lower end: a few hopeless starts would flatten all the rest
        reward = np.clip([row["final_reward"] for row in rows], -1.0, 1.0)
        ax.plot(steps, reward, color=look.colour("adaptsim"), alpha=0.45 + 0.25 * (i % 3), linewidth=1.3)
    look.quiet(ax)
    ax.set_ylim(-1.05, 1.05)
    ax.set_xlabel("adaptation steps in simulation (thousands)", fontsize=9)
    ax.set_ylabel("reward after adapting\n(1: best possible in Ω)", fontsize=9)
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
