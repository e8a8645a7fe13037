"""Figures of the push: bottles over iterations beside the parameters believed in, and the
parameters that methods found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import MaxNLocator, NullLocator

from adaptsim_jax.report import figures as look
from adaptsim_jax.tasks.pushing.model import PATCH_SIDE, PATCH_X, RADIUS, START

BOTTLE, GOAL, PATCH, TARGET = "#0072B2", "#D49A00", "#c3cad3", "#8b0000"
ACROSS, NEAR, REACH = (
    (-0.22, 0.22),
    0.5,
    (1.12, 1.5),
)  # m: what of the table is shown, and how far at least and at most
SYMBOLS = {
    "pushing": {"mu": "μ table", "e": "e (Pa)", "mu_p": "μ patch", "y_p": "patch y (m)"},
    "scooping": {"mu": "μ piece", "e": "e (Pa)", "g": "shape", "h": "h (m)"},
}
"""What a task's parameters are called in figures, where that is not their name."""


@dataclass(frozen=True)
class Push:
    """One push: its goal `[2]` m, the bottle's track `[T, 2]` m, and its reward."""

    goal: Any
    track: Any
    reward: float


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


def axes_of(space: Any, task: str) -> list[Axis]:
    """Omega as the figures of `task` need it."""
    called = SYMBOLS.get(task, {})
    return [
        Axis(p.name, p.low, p.high, p.scale == "log", called.get(p.name, ""))
        for p in space.parameters
    ]


def pushes_over_iterations(
    panels: Sequence[Sequence[Sequence[Push]]],
    heads: Sequence[Sequence[str]],
    params: np.ndarray,
    axes: Sequence[Axis],
    *,
    patch: float | None = None,
    target: Sequence[float] | None = None,
    first: int = 0,
) -> Figure:
    """As the paper's figure: rows of table tops with the pushes of an iteration each, and the
    parameters over iterations.

    `panels[row][column]` are the pushes to draw in one table top; `heads[row]` its titles, or of
    the first row alone for all; `params [I + 1, D]` physical.
    patch: the patch's place across (m) where it is known; target: the target's parameters where
    there are any; first: the number of the first of `params`.
    """
    rows, across = len(panels), max(len(row) for row in panels)
    along = along_of(*(push.track for row in panels for pushes in row for push in pushes))
    height = 1.12 * (along[1] - along[0]) / (ACROSS[1] - ACROSS[0]) + 0.35
    figure = Figure(
        figsize=(1.12 * across + 2.9, max(height * rows + 0.1, 3.3)), layout="constrained"
    )
    frames: Any = figure.subfigures(1, 2, width_ratios=[1.12 * across + 0.35, 2.45])
    tops = frames[0].subplots(rows, across, squeeze=False, sharex=True, sharey=True)
    for r in range(rows):
        for c, ax in enumerate(tops[r]):
            ax.set_visible(c < len(panels[r]))
            table_top(ax, patch, along)
            for push in panels[r][c] if c < len(panels[r]) else ():
                draw_push(ax, push)
            if c < len(panels[r]):
                ax.set_xlabel(_said(panels[r][c]), fontsize=7.5, color=look.MUTED, labelpad=2)
                ax.set_title(
                    heads[r][c] if r < len(heads) else "", fontsize=8, color=look.INK, pad=3
                )
    frames[0].supylabel("x (m), away from the arm", fontsize=8, color=look.MUTED)
    parameters_over_iterations(frames[1], first + np.arange(len(params)), params, axes, target)
    return figure


def along_of(*tracks: Any) -> tuple[float, float]:
    """What of the table is shown of `tracks [..., 2]` m: from near the arm to where a bottle came,
    within reason.
    """
    ahead = np.concatenate([np.asarray(track)[..., 0].ravel() for track in tracks])
    farthest = ahead[np.isfinite(ahead)].max(initial=NEAR)  # a push that failed has no track
    return NEAR, float(np.clip(farthest + 0.05, *REACH))


def _said(pushes: Sequence[Push]) -> str:
    return "reward " + ", ".join(f"{push.reward:.2f}" for push in pushes)


def table_top(ax: Any, patch: float | None, along: tuple[float, float]) -> None:
    """The table from above, the arm below, y to the left as the arm sees it."""
    ax.set_xlim(ACROSS[1], ACROSS[0])
    ax.set_ylim(*along)
    ax.set_aspect("equal")
    ax.set_facecolor("#f6f3ee")
    ax.spines[:].set_color("#d9d3c8")
    ax.tick_params(colors=look.MUTED, labelsize=7, length=2)
    ax.set_xticks([])
    ax.set_yticks([t for t in (0.6, 0.8, 1.0, 1.2, 1.4) if t < along[1]])
    if patch is not None:
        low = (patch - PATCH_SIDE / 2, PATCH_X - PATCH_SIDE / 2)
        ax.add_patch(
            Rectangle(low, PATCH_SIDE, PATCH_SIDE, facecolor=PATCH, edgecolor="none", zorder=1)
        )


def draw_push(ax: Any, push: Push) -> None:
    """The bottle where it stood (dashed), its way, where it ended, and a cross at the goal; clipped
    to the table top.
    """
    track, goal = np.asarray(push.track), np.asarray(push.goal)
    end = (float(track[-1, 1]), float(track[-1, 0]))
    ax.add_patch(
        Circle(
            (START[1], START[0]),
            RADIUS,
            fill=False,
            edgecolor=look.MUTED,
            linewidth=0.8,
            linestyle=(0, (2, 2)),
            zorder=2,
        )
    )
    way = np.concatenate([[START], track])
    ax.plot(way[:, 1], way[:, 0], color=BOTTLE, linewidth=1.3, zorder=3)
    bottle = Circle(
        end, RADIUS, facecolor=BOTTLE, alpha=0.35, edgecolor=BOTTLE, linewidth=1.0, zorder=3
    )
    ax.add_patch(bottle)
    ax.plot(goal[1], goal[0], "x", color=GOAL, markersize=6.5, markeredgewidth=2.2, zorder=4)


def parameters_over_iterations(
    figure: Any, numbers: np.ndarray, params: np.ndarray, axes: Sequence[Axis], target
) -> None:
    """Omega shaded, what was simulated with at each of `numbers`, and the target dashed where there
    is one.
    """
    plots = np.atleast_1d(figure.subplots(len(axes), 1, sharex=True))
    for k, (ax, axis) in enumerate(zip(plots, axes, strict=True)):
        look.quiet(ax)
        if axis.log:
            ax.set_yscale("log")
            ax.yaxis.set_minor_locator(NullLocator())
        ax.axhspan(axis.low, axis.high, color="#eef2f6", zorder=0)
        ax.plot(
            numbers,
            params[:, k],
            color=BOTTLE,
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


def parameters_found(results: Mapping[str, Any], axes: Sequence[Axis]) -> Figure:
    """Where each method's best policy was trained, a seed a dot: a row a setting, a column a
    parameter.

    From results.json of `adaptsim compare`; methods that adapt no parameters have no `best_params`
    and are left out.
    """
    rows = [r for r in results["rows"] if r.get("best_params")]
    settings = list(dict.fromkeys(r["setting"] for r in rows))
    methods = look.in_order({r["method"] for r in rows})
    size = (1.75 * len(axes) + 1.3, (0.19 * len(methods) + 0.55) * len(settings) + 0.5)
    figure, plots = look.new_figure(*size, len(settings), len(axes), sharex="col", sharey=True)
    grid = np.array(plots).reshape(len(settings), len(axes))
    for i, setting in enumerate(settings):
        found = {
            r["method"]: np.atleast_2d(r["best_params"]) for r in rows if r["setting"] == setting
        }
        for k, axis in enumerate(axes):
            _dots(grid[i, k], methods, found, k, axis, results["settings"][setting]["params"][k])
        grid[i, 0].set_ylabel(look.setting(setting), fontsize=8.5)
        grid[i, 0].set_yticks(range(len(methods))[::-1], [look.label(m) for m in methods])
        grid[i, 0].set_ylim(-0.7, len(methods) - 0.3)
    for k, axis in enumerate(axes):
        grid[0, k].set_title(axis.symbol or axis.name, fontsize=9, color=look.INK)
    figure.supxlabel(
        "Ω shaded; target dashed; bars are means over seeds", fontsize=8, color=look.MUTED
    )
    return figure


def _dots(
    ax: Any,
    methods: Sequence[str],
    found: Mapping[str, np.ndarray],
    k: int,
    axis: Axis,
    target: float,
) -> None:
    look.quiet(ax)
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
