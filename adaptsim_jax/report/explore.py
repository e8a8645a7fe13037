"""What every page is made of: templates, and plots to explore.

Plots are figures as plain JSON, drawn by Plotly, which lies packed in the page, so that no network
is needed.

    html = explorer({"trial": ["01", "02"], "joint": ["elbow"]}, {(0, 0): View([figure]), (1, 0):
    View([figure])}, [Plot(...)])

goes where the plots are to stand, `script(True)` at the end of the body and
`templates/explore.css.j2` into the style. A figure is `{"data": [trace], "layout": {}}` as Plotly
has them, but

    colours    "--before" is that variable of the page's style sheet, "#0072B2" is made lighter on a
               dark page; "/25" behind either is its opacity in percent
    numbers    "@name" in a trace stands for that column of the explorer's `columns`, and {"minus":
               ["@a", "@b"], "times": 1e3} for 1e3 (a - b), so that what plots share is written once
    texts      are a little HTML to Plotly: what comes from files goes through `shown`

Tables of the class `sortable` sort by a click on a heading, by `data-v` of a cell where it has one;
with `data-most="8"` they show eight rows and a button for the rest.
"""

from __future__ import annotations

import base64
import gzip
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report import diagnosis_words as words

MOST_POINTS = 2000
"""Points of one trace."""
MIN_POINTS = 200
"""Points to which traces are thinned before whole trials are left out."""
MOST_NUMBERS = 300_000
"""Numbers of one explorer, of some nine characters each: with Plotly's 2 MB a page stays far below
6 MB.
"""
FILTERS = (
    *("quantity", "number", "percent", "p_value", "between", "listing", "count"),
    *("reward", "skill"),
)
"""Functions of `diagnosis_format` that templates call."""
MISSING = (
    "The plots to explore need the package plotly, which was not there when this page was made: "
    "pip install plotly."
)


@dataclass(frozen=True)
class Plot:
    """A place for one figure: a label for those who do not see it, and its height in CSS pixels."""

    label: str
    height: int = 380


@dataclass(frozen=True)
class View:
    """What one choice shows: a figure for each plot, and a line of text under the selectors."""

    figures: Sequence[Mapping]
    note: str = ""


@dataclass(frozen=True)
class SharedColumns:
    """Numbers by name that traces refer to; `add` returns the reference."""

    values: dict[str, list[float | None]] = field(default_factory=dict)

    def add(self, values: Any, step: float | None = None) -> str:
        name = f"c{len(self.values)}"
        self.values[name] = numbers(values, step)
        return f"@{name}"


def explorer(
    choices: Mapping[str, Sequence[str]],
    views: Mapping[tuple[int, ...], View],
    plots: Sequence[Plot],
    columns: SharedColumns | None = None,
) -> str:
    """The HTML of plots side by side with a selector for each of `choices` that leaves a choice;
    `views` by the option of each.
    """
    if plotly() is None:
        return f'<p class="note">{MISSING}</p>'
    table = {
        "columns": {} if columns is None else columns.values,
        "views": {
            ",".join(map(str, key)): {"note": v.note, "figures": list(v.figures)}
            for key, v in views.items()
        },
    }
    return filled("explorer.html.j2", table=in_script(table), choices=choices, plots=plots)


# ---------------------------------------------------------------- figures as Plotly has them


def line(name: str, x: Any, y: Any, style: Mapping, **more: Any) -> Table:
    """A trace of lines; `more` is Plotly's."""
    return {"type": "scatter", "mode": "lines", "name": name, "x": x, "y": y, "line": style} | more


def dots(name: str, x: Any, y: Any, marker: Mapping, **more: Any) -> Table:
    """A trace of markers that stands in no legend; `more` is Plotly's."""
    trace = {"type": "scatter", "mode": "markers", "name": name, "x": x, "y": y, "marker": marker}
    return trace | {"showlegend": False} | more


def band(name: str, x: Any, low: Any, high: Any, fill: str) -> list[Table]:
    """Traces that shade what lies between `low` and `high`, shown and hidden with `name`."""
    hidden = {"legendgroup": name, "hoverinfo": "skip", "showlegend": False}
    edge = line(name, x, low, {"width": 0}, **hidden)
    return [edge, edge | {"y": high, "fill": "tonexty", "fillcolor": fill}]


def axis(text: str, **more: Any) -> Table:
    """An axis with a title; `more` is Plotly's."""
    return {"title": {"text": text}} | more


def figure(data: Any, x: Any, y: Any, title: str = "", **layout: Any) -> Table:
    """A figure of traces with its two axes."""
    return {
        "data": data,
        "layout": {"xaxis": x, "yaxis": y, "title": {"text": title}} | layout,
    }


def script(plots: bool = True) -> str:
    """The one script of a page, with Plotly beside it where there are plots to draw."""
    code = f"<script>{filled('explore.js.j2')}</script>"
    if not plots or plotly() is None:
        return code
    about = "<!-- plotly.js, (c) Plotly, Inc., MIT licence; gzip in base64 -->"
    return f'{about}<script type="text/plain" id="plotly">{plotly()}</script>\n{code}'


@cache
def plotly() -> str | None:
    """plotly.min.js of the installed package, gzip in base64 (4.8 MB become 2); None where there is
    none. Imports nothing of it.
    """
    spec = find_spec("plotly")
    if spec and spec.origin:
        path = Path(spec.origin).parent / "package_data" / "plotly.min.js"
    else:
        path = None
    if path is None or not path.exists():
        return None
    return base64.b64encode(gzip.compress(path.read_bytes(), 6, mtime=0)).decode()


def shown(name: Any) -> str:
    """A name from a file as it is to stand in a figure: Plotly takes a little HTML in its texts."""
    return escape(str(name), quote=False)


def in_script(value: Any) -> str:
    """JSON that no `</script>` of a trial's name can end; NaN is refused (`numbers` makes it
    null).
    """
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def numbers(values: Any, step: float | None = None) -> list[float | None]:
    """Values rounded to `step` or a finer power of ten (by default a 20,000th of their span), null
    for what is not finite.
    """
    array = np.asarray(values, float).ravel()
    fine = array[np.isfinite(array)]
    span = float(np.ptp(fine)) if fine.size else 0.0
    step = step or span / 2e4 or float(np.max(np.abs(fine), initial=0.0)) / 1e6
    if step > 0:
        decimals = min(15, max(0, -math.floor(math.log10(step))))
    else:
        decimals = 0
    return [round(x, decimals) + 0.0 if math.isfinite(x) else None for x in array.tolist()]


def points(lengths: Sequence[int], series: int) -> tuple[int, int]:
    """`(most, kept)`: points a trace, and how many of the trials of `lengths` samples and `series`
    numbers a sample are kept, so that all of them stay within `MOST_NUMBERS`.
    """

    def total(most, trials):
        return series * sum(min(n, most) for n in lengths[:trials])

    trials = len(lengths)
    while trials > 1 and total(MIN_POINTS, trials) > MOST_NUMBERS:
        trials -= 1
    most = MOST_POINTS
    while most > MIN_POINTS and total(most, trials) > MOST_NUMBERS:
        most = max(MIN_POINTS, int(0.9 * most))
    return most, trials


# ---------------------------------------------------------------- templates


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("adaptsim_jax.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    for name in FILTERS:
        environment.filters[name] = getattr(fmt, name)
    environment.filters |= {"plain": words.plain, "effect": words.effect_of}
    return environment


def filled(template: str, **values: Any) -> str:
    """The text of a template of this room with these values in it."""
    return _environment().get_template(template).render(**values)
