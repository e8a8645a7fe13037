"""Figures of `adaptsim compare` and of the sweeps, drawn from results.json and nothing else."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator, NullLocator

from adaptsim_jax.report import figures as look


def parameter_map(
    reward_map: Any, target: Sequence[float], found: Mapping[str, np.ndarray]
) -> Figure:
    """Figure 5 of the paper: colours are the best reward possible at two parameters, marks what
    methods found `[S, 2]`.
    """
    figure, (ax,) = look.new_figure(4.6, 3.7)
    bottom = -0.5
    levels = np.linspace(bottom, 1.0, 16)
    filled = ax.contourf(
        reward_map.x,
        reward_map.y,
        np.clip(reward_map.reward, bottom, 1.0),
        levels=levels,
        cmap="cividis",
    )
    bar = figure.colorbar(filled, ax=ax, ticks=np.arange(bottom, 1.01, 0.25), pad=0.02)
    bar.set_label(f"reward (0 UDR, 1 best in Ω; below {bottom:g} as {bottom:g})", fontsize=8)
    bar.ax.tick_params(labelsize=7.5)
    (x0, y0), (x1, y1) = reward_map.low, reward_map.high
    ax.add_patch(
        Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, edgecolor="white", linewidth=1.6)
    )
    ax.annotate(
        "Ω", (x0, y1), xytext=(4, -11), textcoords="offset points", color="white", fontsize=10
    )
    for method, points in found.items():
        marks = {
            "color": look.colour(method),
            "markeredgecolor": "white",
            "markeredgewidth": 0.8,
            "markersize": 6.5,
        }
        ax.plot(
            *np.asarray(points).T,
            look.marker(method),
            label=look.label(method),
            linestyle="",
            clip_on=False,
            **marks,
        )
    ax.plot(
        *target,
        "*",
        color="#8b0000",
        markersize=15,
        markeredgecolor="white",
        label="target",
        linestyle="",
    )
    ax.set_xlabel(f"{reward_map.names[0]} (kg)", fontsize=9)
    ax.set_ylabel(f"{reward_map.names[1]} (kg)", fontsize=9)
    ax.tick_params(labelsize=8)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure


# ---------------------------------------------------------------- parameters
#
# The parameters of a simulation in figures: over iterations, and as methods found them.

FOUND, TARGET = "#0072B2", "#8b0000"


@dataclass(frozen=True)
class Axis:
    """A parameter's range, for axes: name, Omega's bounds, whether it is spread logarithmically,
    and what it is called there (its name where that is empty).
    """

    name: str
    low: float
    high: float
    log: bool = False
    symbol: str = ""


def axes_of(space: Any, symbols: Mapping[str, str]) -> list[Axis]:
    """Omega as figures need it. symbols: What a parameter is called there, where that is not its
    name.
    """
    return [
        Axis(p.name, p.low, p.high, p.scale == "log", symbols.get(p.name, ""))
        for p in space.parameters
    ]


def parameters_over_iterations(
    figure: Any, numbers: np.ndarray, params: np.ndarray, axes: Sequence[Axis], target
) -> None:
    """Omega shaded, what was simulated with at each of `numbers`, and the target dashed where there
    is one.
    """
    plots = np.atleast_1d(figure.subplots(len(axes), 1, sharex=True))
    for k, (ax, axis) in enumerate(zip(plots, axes, strict=True)):
        look.style_axes(ax)
        if axis.log:
            ax.set_yscale("log")
            ax.yaxis.set_minor_locator(NullLocator())
        ax.axhspan(axis.low, axis.high, color="#eef2f6", zorder=0)
        ax.plot(
            numbers,
            params[:, k],
            color=FOUND,
            linewidth=1.4,
            marker="o",
            markersize=2.6,
            label="found",
        )
        if target is not None:
            ax.axhline(target[k], color=TARGET, linewidth=1.0, linestyle="--", label="target")
        ax.set_ylim(*_limits(axis, params[:, k], target[k] if target is not None else None))
        ax.set_ylabel(axis.symbol or axis.name, fontsize=7.5)
        ax.tick_params(labelsize=7)
        ax.grid(False, axis="x")
    plots[-1].set_xlabel("iteration", fontsize=8)
    plots[-1].xaxis.set_major_locator(MaxNLocator(6, integer=True))
    note = "Ω shaded" + (", target dashed" if target is not None else "")
    figure.suptitle(f"simulated with ({note})", fontsize=7.5, color=look.INK)


def _limits(axis: Axis, values: np.ndarray, target: float | None) -> tuple[float, float]:
    """Omega with a margin, and the target where it lies outside."""
    every = np.array([axis.low, axis.high, *values, *([] if target is None else [target])], float)
    if axis.log:
        low, high = np.log10(every.min()), np.log10(every.max())
        return 10 ** (low - 0.1 * (high - low)), 10 ** (high + 0.1 * (high - low))
    margin = 0.1 * np.ptp(every)
    return every.min() - margin, every.max() + margin


def parameters_found(results: Mapping, axes: Sequence[Axis]) -> Figure:
    """Draw where each method's best policy was trained, a seed a dot: a row a setting, a column a
    parameter.

    From results.json of `adaptsim compare`; methods that adapt no parameters have no `best_params`
    and are left out.
    """
    rows = [r for r in results["rows"] if r.get("best_params")]
    settings = look.distinct(rows, "setting")
    methods = look.in_order({r["method"] for r in rows})
    size = (1.75 * len(axes) + 1.3, (0.19 * len(methods) + 0.55) * len(settings) + 0.5)
    figure, plots = look.new_figure(*size, len(settings), len(axes), sharex="col", sharey=True)
    grid = np.array(plots).reshape(len(settings), len(axes))
    for i, setting in enumerate(settings):
        found = {
            r["method"]: np.atleast_2d(r["best_params"]) for r in rows if r["setting"] == setting
        }
        for k, axis in enumerate(axes):
            _values_found(
                grid[i, k], methods, found, k, axis, results["settings"][setting]["params"][k]
            )
        grid[i, 0].set_ylabel(look.setting(setting), fontsize=8.5)
        grid[i, 0].set_yticks(range(len(methods))[::-1], [look.label(m) for m in methods])
        grid[i, 0].set_ylim(-0.7, len(methods) - 0.3)
    for k, axis in enumerate(axes):
        grid[0, k].set_title(axis.symbol or axis.name, fontsize=9, color=look.INK)
    figure.supxlabel(
        "Ω shaded; target dashed; bars are means over seeds", fontsize=8, color=look.MUTED
    )
    return figure


def _values_found(
    ax: Any,
    methods: Sequence[str],
    found: Mapping[str, np.ndarray],
    k: int,
    axis: Axis,
    target: float,
) -> None:
    look.style_axes(ax)
    ax.grid(False, axis="y")
    if axis.log:
        ax.set_xscale("log")
        ax.xaxis.set_minor_locator(NullLocator())
    ax.axvspan(axis.low, axis.high, color="#eef2f6", zorder=0)
    ax.axvline(target, color=TARGET, linewidth=1.1, linestyle="--", zorder=1)
    for method, values in found.items():
        y, seeds = len(methods) - 1 - methods.index(method), values[:, k]
        spread = 0.16 * ((np.arange(len(seeds)) % 5) - 2) / 2
        mark = {
            "color": look.colour(method),
            "markersize": 3.6,
            "markeredgecolor": "white",
            "markeredgewidth": 0.4,
        }
        ax.plot(seeds, y + spread, look.marker(method), **mark, zorder=3)
        middle = np.exp(np.log(seeds).mean()) if axis.log else seeds.mean()
        ax.plot(
            [middle, middle],
            [y - 0.32, y + 0.32],
            color=look.colour(method),
            linewidth=1.8,
            zorder=2,
        )
    ax.tick_params(labelsize=7.5)
    if not axis.log:
        ax.xaxis.set_major_locator(MaxNLocator(4, integer=axis.name == "g"))
