"""Figures of scooping: trials over iterations from the side, beside the parameters believed in."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from adaptsim_jax.report import figures as look
from adaptsim_jax.report.figures_pushing import Axis, parameters_over_iterations
from adaptsim_jax.report.scoop_video import ScoopClip, draw_scoop
from adaptsim_jax.tasks.scooping import model


def scoops_over_iterations(
    clips: Sequence[ScoopClip],
    heads: Sequence[str],
    rewards: Sequence[float],
    params: np.ndarray,
    axes: Sequence[Axis],
    *,
    moments: Sequence[float] = (0.35, 0.5, 1.0),
    target: Sequence[float] | None = None,
) -> Figure:
    """As the paper's figure: a column for each iteration shown, the trial at `moments` s from top
    to bottom, and the parameters over all iterations; `params [I + 1, D]` physical, `rewards` of
    the iterations shown.
    """
    columns, rows = len(clips), len(moments)
    figure = Figure(
        figsize=(1.75 * columns + 2.9, max(1.08 * rows + 0.5, 3.6)), layout="constrained"
    )
    frames: Any = figure.subfigures(1, 2, width_ratios=[1.75 * columns + 0.3, 2.45])
    plots = frames[0].subplots(rows, columns, squeeze=False)
    for c, clip in enumerate(clips):
        last = len(clip.piece) - 1
        for r, moment in enumerate(moments):
            draw_scoop(plots[r, c], clip, round(last * moment / model.SECONDS))
            if c == 0:
                plots[r, c].set_ylabel(f"{moment:g} s", fontsize=8, color=look.MUTED)
        plots[0, c].set_title(heads[c], fontsize=8, color=look.INK, pad=3)
        plots[-1, c].set_xlabel(
            f"reward {rewards[c]:.2f}", fontsize=7.5, color=look.MUTED, labelpad=2
        )
    parameters_over_iterations(frames[1], np.arange(len(params)), params, axes, target)
    return figure
