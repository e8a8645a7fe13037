"""Figures of the appendix's experiments: rewards against a setting, and against trials."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from adaptsim_jax.report import figures as look


def against(
    rows: Mapping[str, Sequence[Mapping[str, Any]]],
    ticks: Sequence[str],
    xlabel: str,
    bottom: float = -0.4,
) -> Figure:
    """Best-iteration reward of several methods against a setting of the experiment, as the range
    figure of the appendix.
    """
    figure, (ax,) = look.new_figure(4.2, 3.0)
    places = np.arange(len(ticks))
    for i, (method, points) in enumerate(rows.items()):
        mean, low, high = (
            np.array([bottom - 1 if p[key] is None else p[key] for p in points])
            for key in ("mean", "low", "high")
        )
        at = places + 0.07 * (i - (len(rows) - 1) / 2)
        ax.vlines(at, low, high, color=look.colour(method), linewidth=2)
        ax.plot(
            at,
            mean,
            marker=look.marker(method),
            markersize=6,
            linewidth=1.4,
            label=look.label(method),
            **look.style(method),
        )
    look.style_axes(ax)
    ax.set_ylim(bottom, 1.08)
    ax.set_xticks(places, ticks)
    ax.set_xlabel(xlabel, fontsize=9)
    ax.set_ylabel("best-iteration " + look.REWARD.replace(" (", "\n("), fontsize=9)
    ax.legend(frameon=False, fontsize=8, loc="lower left")
    return figure


def reward_against_trials(
    panels: Mapping[str, Sequence[Mapping[str, Any]]], bottom: float = 0.0
) -> Figure:
    """A panel a setting: mean over seeds of the best reward so far against target rollouts, a curve
    for each N.
    """
    shades = ["#56B4E9", "#0072B2", "#E69F00", "#D55E00"]
    figure, axes = look.new_figure(2.15 * len(panels) + 0.6, 2.9, 1, len(panels), sharey=True)
    for ax, (setting, rows) in zip(axes, panels.items(), strict=True):
        for i, r in enumerate(rows):
            ax.plot(
                r["trials"],
                r["so_far"],
                color=shades[i],
                linestyle=["-", "--", "-.", ":"][i],
                label=r["method"],
                linewidth=1.7,
            )
        look.style_axes(ax)
        ax.set_title(look.setting(setting), fontsize=9, color=look.INK)
        ax.set_ylim(bottom, 1.05)
        ax.set_xlabel("target rollouts", fontsize=8.5)
    axes[0].set_ylabel("best so far, " + look.REWARD.replace(" (", "\n("), fontsize=8.5)
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    return figure
