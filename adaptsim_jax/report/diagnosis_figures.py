"""What the page of a diagnosis draws: each function paints one figure of what it is given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report.diagnosis_svg import AFTER, BEFORE, CEILING, FLOOR, INK

Paint = Callable[[Figure], None]
UNITS = {"q": "rad", "v": "rad/s", "tau": "N·m"}


def channel_unit(channel: str) -> str:
    """The SI unit of a pendulum channel by its stem (`q1` -> rad); empty for names that say
    nothing.
    """
    return UNITS.get(channel.rstrip("0123456789"), "")


def bar_range(
    ax: Axes, y: float, value: float, interval: Any, dots: list[float], colour: str
) -> None:
    """One row: a pale bar to `value`, a dot a trial, the interval over it."""
    ax.barh(y, value, height=0.62, color=colour, alpha=0.28, linewidth=0)
    ax.plot(
        [value, value], [y - 0.31, y + 0.31], color=colour, linewidth=2.6, solid_capstyle="butt"
    )
    if dots:
        offsets = 0.22 * (np.arange(len(dots)) % 3 - 1)
        ax.plot(dots, y + offsets, "o", color=colour, markersize=3.6, alpha=0.75, markeredgewidth=0)
    if interval and None not in interval:
        ax.plot(interval, [y, y], color=INK, linewidth=1.3)
        ax.plot(interval, [y, y], "|", color=INK, markersize=7, markeredgewidth=1.3)


def error_pair(
    title: str, unit: str, pair: Mapping, dots: Mapping[str, list[float]], like: float | None = None
) -> Paint:
    """Declared against mended model in one channel, with noise floor and ceiling where they are
    known; `like`: the size whose unit is taken, so that neighbours share it.
    """
    shown = [(stage, pair[stage]) for stage in ("before", "after") if pair.get(stage) is not None]
    lines = {"noise_floor": pair.get("noise_floor"), "ceiling": pair.get("ceiling")}
    largest = max(
        [value for _, value in shown] + [max(d, default=0.0) for d in dots.values()], default=0.0
    )
    factor, name = fmt.scaled(unit, largest if like is None else like)

    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        intervals = pair.get("intervals") or {}
        for row, (stage, value) in enumerate(shown):
            ends = [
                None if end is None else factor * end for end in intervals.get(stage) or []
            ] or None
            colour = BEFORE if stage == "before" else AFTER
            bar_range(
                ax, -row, factor * value, ends, [factor * d for d in dots.get(stage, [])], colour
            )
        for key, colour, dashes in (
            ("noise_floor", FLOOR, (4, 2)),
            ("ceiling", CEILING, (1.5, 1.5)),
        ):
            if (mark := lines[key]) is not None:
                ax.axvline(factor * mark, color=colour, linewidth=1.7, dashes=dashes)
        names = {"before": "declared", "after": "mended"}
        ax.set_yticks([-row for row in range(len(shown))], [names[stage] for stage, _ in shown])
        ax.tick_params(axis="y", length=0, labelcolor=INK)
        ax.set(xlim=(0, None), ylim=(-len(shown) + 0.45, 0.55), title=title, xlabel=name)
        ax.locator_params(axis="x", nbins=6)
        ax.grid(axis="y", visible=False)
        ax.spines["left"].set_visible(False)

    return paint


def seen_from(tracks: Mapping) -> str:
    """Where tracks are looked at from, by their `axes`."""
    if "z" in (tracks.get("axes") or ()):
        return "the side"
    return "above"


def trial_dots(error: Mapping, channel: str | None) -> dict[str, list[float]]:
    """The error of each held-out trial, of `channel` or overall, before and after."""
    dots: dict[str, list[float]] = {"before": [], "after": []}
    for trial in error["per_trial"]:
        if channel is None:
            pair = trial
        else:
            pair = (trial.get("per_channel") or {}).get(channel, {})
        for stage, values in dots.items():
            if pair.get(stage) is not None:
                values.append(pair[stage])
    return dots


def percentile(values: np.ndarray) -> float:
    """How large values are, wild ones left aside; 0 where none is finite."""
    finite = np.abs(values[np.isfinite(values)])
    if finite.size:
        return float(np.percentile(finite, 99.0))
    return 0.0
