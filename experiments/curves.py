"""Figures of the experiments: rewards over iterations, against a setting, and against trials.

python experiments/curves.py --results results/results.json --out reward_over_iterations.png
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

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


def reward_over_iterations(results: Mapping[str, Any], methods: Sequence[str] = ()) -> Figure:
    """A panel a setting: median over seeds of the best distribution's reward at each iteration,
    with its quartiles.
    """
    bottom = look.lower_limit(results)
    rows = [
        r
        for r in results["rows"]
        if len(r["curve"]["median"]) > 1 and (not methods or r["method"] in methods)
    ]
    if "trials_axis" in results:
        by = {r["method"]: r["trials"] for r in rows}
    else:
        by = {}
    settings = look.distinct(rows, "setting")
    width = max(2.15 * len(settings) + 0.6, 4.6)
    figure, axes = look.new_figure(width, 2.9, 1, len(settings), sharey=True)
    for ax, setting in zip(axes, settings, strict=True):
        for r in (r for r in rows if r["setting"] == setting):
            median_curve(
                ax,
                r["curve"],
                look.style(r["method"]),
                look.label(r["method"]),
                bottom,
                by.get(r["method"]),
            )
        look.style_axes(ax)
        ax.axhline(1, color=look.INK, linewidth=0.8, linestyle=":")
        ax.set_title(look.setting(setting), fontsize=9, color=look.INK)
        ax.set_ylim(bottom, 1.08)
        ax.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        ax.set_xlabel(look.axis_of(results), fontsize=8.5)
    axes[0].set_ylabel(look.reward_of(results).replace(" (", "\n("), fontsize=8.5)
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(
        handles,
        names,
        loc="outside lower center",
        ncols=min(len(names), max(int(width / 1.5), 1)),
        frameon=False,
        fontsize=8,
    )
    return figure


def median_curve(
    ax,
    curve: Mapping[str, Any],
    style: dict,
    label: str,
    bottom: float,
    trials: Sequence[int] | None = None,
) -> None:
    """Draw the median of `curve` with its quartiles, over iterations or `trials`."""
    # None stands for minus infinity, a policy that destabilised the target; it is drawn below the
    # panel.
    median, q25, q75 = (
        np.array(look.finite_or(bottom - 10, curve[key])) for key in ("median", "q25", "q75")
    )
    if trials is None:
        iterations = np.arange(len(median))
    else:
        iterations = np.asarray(trials)
    ax.fill_between(iterations, q25, q75, color=style["color"], alpha=0.15, linewidth=0)
    ax.plot(iterations, median, linewidth=1.7, label=label, **style)


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--results", type=Path, required=True, help="of `adaptsim compare`")
    arguments.add_argument("--out", type=Path, required=True, help="the PNG to write")
    args = arguments.parse_args()
    results = json.loads(args.results.read_text(encoding="utf-8"))
    print(f"written: {look.save(reward_over_iterations(results), args.out)}")


if __name__ == "__main__":
    main()
