"""Figures of the push: table tops from above, over iterations beside the parameters believed in."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from adaptsim_jax.report import figures as look
from adaptsim_jax.report.figures_comparison import Axis, parameters_over_iterations
from adaptsim_jax.tasks.pushing.film import BOTTLE, GOAL, PATCH
from adaptsim_jax.tasks.pushing.model import PATCH_SIDE, PATCH_X, RADIUS, START

ACROSS, NEAR = (-0.22, 0.22), 0.5  # m of the table that is shown
REACH = (1.12, 1.5)  # m: how far it is shown at least and at most


@dataclass(frozen=True)
class Push:
    """One push: its goal `[2]` m, the bottle's track `[T, 2]` m, and its reward."""

    goal: Any
    track: Any
    reward: float


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
    patch: The patch's place across (m) where it is known. target: The target's parameters where
    there are any. first: The number of the first of `params`.
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
                ax.set_xlabel(_rewards(panels[r][c]), fontsize=7.5, color=look.MUTED, labelpad=2)
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


def _rewards(pushes: Sequence[Push]) -> str:
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
    """The bottle where it stood (dashed), its way, where it ended, and a cross at the goal. Clipped
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


def before_after(pushes: Mapping[str, Sequence[Push]], patch: float) -> Figure:
    """Table tops from above, a goal after the other: for each the push of every policy, by the name
    that the policy has.

    patch: The patch's place across, m.
    """
    goals = len(next(iter(pushes.values())))
    along = along_of(*(push.track for some in pushes.values() for push in some))
    height = 2.1 * (along[1] - along[0]) / (ACROSS[1] - ACROSS[0]) + 0.6
    columns = goals * len(pushes)
    figure, axes = look.new_figure(2.2 * columns + 0.4, height, 1, columns, sharey=True)
    panels = [(g, who, some[g]) for g in range(goals) for who, some in pushes.items()]
    for ax, (g, who, push) in zip(axes, panels, strict=True):
        table_top(ax, patch, along)
        draw_push(ax, push)
        ax.set_title(f"goal {g + 1}, {who}", fontsize=9.5, color=look.INK, pad=4)
        off = 100 * float(np.linalg.norm(np.asarray(push.track)[-1] - push.goal))
        if np.isfinite(off):
            words = f"{off:.1f} cm from the goal"
        else:
            words = "the push failed"
        ax.set_xlabel(words, fontsize=8.5, color=look.INK, labelpad=4)
    axes[0].set_ylabel("x (m), away from the arm", fontsize=8.5, color=look.MUTED)
    return figure
