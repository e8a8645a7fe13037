"""Matplotlib figures as small inline SVG that follows the page's colours, light or dark, and its
font.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from html import escape
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

INK, MUTED, GRID = "#20262e", "#5d6875", "#dde2e8"
MEASURED, BEFORE, AFTER = "#7b8794", "#c4540a", "#1767b0"
FLOOR, CEILING = "#2f855a", "#8a4bbf"
THEMED = {
    INK: "ink",
    MUTED: "muted",
    GRID: "grid",
    MEASURED: "measured",
    BEFORE: "before",
    AFTER: "after",
    FLOOR: "floor",
    CEILING: "ceiling",
}
"""Colour in the figure -> CSS variable of the page. The hex values are the light theme."""

STYLE: Any = {
    "svg.fonttype": "none",
    "text.parse_math": False,
    "font.size": 10.0,
    "font.family": ["DejaVu Sans"],
    "text.color": INK,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "lines.linewidth": 1.4,
    "figure.constrained_layout.use": True,
    "path.simplify_threshold": 0.3,
}
WIDTH = 5.0
"""Inches (72 to an inch in SVG): a phone's width and not far from half a page, so text keeps its
size.
"""


def draw(paint: Callable[[Figure], None], height: float, label: str) -> str:
    """The SVG of what `paint` draws on a transparent figure; `label` is for those who do not see
    it.
    """
    with matplotlib.rc_context(STYLE):
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
        lambda found: f"{float(found.group()):.2f}".rstrip("0").rstrip("."),
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
    taken = []
    for column in arrays:
        whole = column[: len(column) // stride * stride].reshape(-1, stride)
        taken.append(np.where(np.isnan(whole).any(axis=1), np.nan, whole[:, 0]))
    return taken
