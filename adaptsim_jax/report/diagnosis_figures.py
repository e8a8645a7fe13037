"""What the page of a diagnosis and a replay draw, as small inline SVG that follows the page's
colours, light or dark, and its font.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report import figures as look

if TYPE_CHECKING:
    from adaptsim_jax.attribution.replay import Replay

INK, MUTED, GRID = look.INK, look.MUTED, look.GRID
MEASURED, BEFORE, AFTER = "#7b8794", "#c4540a", "#1767b0"
FLOOR = "#2f855a"
THEMED = {
    INK: "ink",
    MUTED: "muted",
    GRID: "grid",
    MEASURED: "measured",
    BEFORE: "before",
    AFTER: "after",
    FLOOR: "floor",
}
"""Colour in the figure -> CSS variable of the page. The hex values are the light theme."""

STYLE = Path(__file__).with_name("diagnosis.mplstyle")
WIDTH = 5.0
"""Inches (72 to an inch in SVG): a phone's width and not far from half a page, so text keeps its
size.
"""


def draw(paint: Callable[[Figure], None], height: float, label: str) -> str:
    """The SVG of what `paint` draws on a transparent figure; `label` is for those who do not see
    it.
    """
    with style.context(STYLE):
        figure = Figure(figsize=(WIDTH, height))
        FigureCanvasSVG(figure)
        paint(figure)
        buffer = io.StringIO()
        figure.savefig(
            buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None}
        )
    return themed(buffer.getvalue(), label)


def themed(svg: str, label: str) -> str:
    """Inline form: no prolog, colours as CSS variables, two decimals, ids that cannot clash on one
    page.
    """
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.S)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    for colour, name in THEMED.items():
        svg = svg.replace(colour, f"var(--{name})")
    # of places, not of what is written
    svg = re.sub(
        r"-?\d+\.\d{3,}(?!\d*</text>)",
        lambda match: f"{float(match.group()):.2f}".rstrip("0").rstrip("."),
        svg,
    )
    svg = re.sub(r"font: (?:normal )?([\d.]+px) [^;\"]*", r"font-size: \1", svg)
    head = re.search(r'viewBox="[^"]*"', svg)
    box = head.group() if head else ""
    opening = f'<svg {box} role="img" aria-label="{escape(label)}" xmlns:xlink="http://www.w3.org/1999/xlink">'
    return re.sub(r"<svg[^>]*>", lambda _: opening, svg, count=1)


def thin(*columns: np.ndarray, most: int = 700) -> list[np.ndarray]:
    """Every column at no more than `most` rows, evenly taken; a gap (NaN) within a stride stays a
    gap.
    """
    arrays = [np.asarray(column, dtype=float) for column in columns]
    stride = max(1, -(-len(arrays[0]) // most))  # rounded up
    if stride == 1:
        return arrays
    thinned = []
    for column in arrays:
        blocks = column[: len(column) // stride * stride].reshape(-1, stride)
        thinned.append(np.where(np.isnan(blocks).any(axis=1), np.nan, blocks[:, 0]))
    return thinned


# ---------------------------------------------------------------- errors

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
    """Declared against mended model in one channel, with its noise floor where it is known;
    `like`: the size whose unit is taken, so that neighbours share it.
    """
    shown = [(stage, pair[stage]) for stage in ("before", "after") if pair.get(stage) is not None]
    floor = pair.get("noise_floor")
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
        if floor is not None:
            ax.axvline(factor * floor, color=FLOOR, linewidth=1.7, dashes=(4, 2))
        names = {"before": "declared", "after": "mended"}
        ax.set_yticks([-row for row in range(len(shown))], [names[stage] for stage, _ in shown])
        ax.tick_params(axis="y", length=0, labelcolor=INK)
        ax.set(xlim=(0, None), ylim=(-len(shown) + 0.45, 0.55), title=title, xlabel=name)
        ax.locator_params(axis="x", nbins=6)
        ax.grid(axis="y", visible=False)
        ax.spines["left"].set_visible(False)

    return paint


def view_side(tracks: Mapping) -> str:
    """Say where tracks are looked at from, by their `axes`."""
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


# ---------------------------------------------------------------- torque and friction

MOST_POINTS = 900  # of a figure's curve


def torque_figures(evidence: Mapping) -> list[str]:
    """Torque measured, by the file and as fitted, over time, a picture a joint."""
    return [
        draw(
            _over_time(row),
            2.2,
            f"torque at {row['joint']} over time: measured, by the file, as fitted",
        )
        for row in evidence.get("torque") or []
    ]


def friction_figures(evidence: Mapping) -> list[str]:
    """What resists against speed, points, and the model of it, a picture a joint."""
    return [
        draw(_against_speed(row), 2.2, f"torque that resists at {row['joint']} against its speed")
        for row in evidence.get("friction") or []
    ]


def _drawn_rows(count: int) -> np.ndarray:
    return np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).astype(int))


def _over_time(row: Mapping):
    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        at = _drawn_rows(len(row["time"]))
        for key, colour, width, label in (
            ("measured", MEASURED, 2.2, "measured"),
            ("file", BEFORE, 0.9, "file"),
            ("fitted", AFTER, 0.9, "fitted"),
        ):
            ax.plot(
                np.asarray(row["time"])[at],
                np.asarray(row[key])[at],
                color=colour,
                linewidth=width,
                label=label,
            )
        ax.set(title=row["joint"], xlabel="s", ylabel=row["unit"])

    return paint


def _against_speed(row: Mapping):
    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        at = _drawn_rows(len(row["speed"]))
        speed, missing = np.asarray(row["speed"])[at], np.asarray(row["missing"])[at]
        order = np.argsort(speed)
        ax.plot(speed, missing, ".", color=MEASURED, markersize=2.2, label="along the motion")
        ax.plot(
            speed[order],
            np.asarray(row["modelled"])[at][order],
            color=AFTER,
            linewidth=1.2,
            label="fitted",
        )
        ax.set(
            title=row["joint"],
            xlabel="rad/s" if row["unit"] == "N m" else "m/s",
            ylabel=row["unit"],
        )

    return paint


# ---------------------------------------------------------------- replay

MOST_JOINTS, MOST_STRETCHES = 6, 16
PANEL = (9.0, 1.7)  # inches, of a joint


def save_replay(replay: Replay, path: Path) -> None:
    """Draw the first trial: a panel for each joint (the worst first where there are many), measured
    and simulated, stretch after stretch.
    """
    joints = sorted(np.argsort(-np.median(replay.error, 0))[:MOST_JOINTS])
    stretches = np.flatnonzero(replay.trial == replay.trial[0])[:MOST_STRETCHES]
    width, height = PANEL
    figure, panels = look.new_figure(width, height * len(joints) + 0.8, len(joints), sharex=True)
    for axis, j in zip(panels, joints, strict=True):
        for w in stretches:
            is_measured = replay.seen[w, :, j] > 0
            axis.plot(
                replay.time[w, is_measured],
                replay.measured[w, is_measured, j],
                color=MEASURED,
                linewidth=2.2,
            )
            axis.plot(replay.time[w], replay.simulated[w, :, j], color=BEFORE, linewidth=1.0)
        unit = "rad" if replay.kinds[j] == "hinge" else "m"
        look.style_axes(axis)
        axis.set_ylabel(f"{replay.joint_names[j]} [{unit}]", fontsize=8)
        error = 1e3 * np.median(replay.error[:, j])
        axis.set_title(f"median error {error:.3g} m{unit}", fontsize=8, loc="right", pad=2)
    panels[-1].set_xlabel(f"time in trial {replay.trial_names[replay.trial[0]]} [s]")
    measured, simulated = panels[0].get_lines()[:2]
    figure.legend(
        [measured, simulated],
        ["measured", "simulated"],
        loc="outside upper left",
        ncols=2,
        frameon=False,
        fontsize=8,
    )
    look.save(figure, path)
