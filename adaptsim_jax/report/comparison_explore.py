"""What the page of a comparison lets its reader explore, setting by setting: rewards over
iterations, and every seed's best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from adaptsim_jax.report import figures as look
from adaptsim_jax.report.explore import Plot, View, explorer, numbers, shown


def rewards(results: Mapping[str, Any]) -> str:
    """Two plots for each setting, of the rows that have a curve over iterations; empty where none
    has.
    """
    rows = [r for r in results["rows"] if len(r["curve"]["median"]) > 1]
    settings = list(dict.fromkeys(r["setting"] for r in rows))
    bottom, what, axis = look.least(results), look.reward_of(results), look.axis_of(results)
    views = {}
    for i, name in enumerate(settings):
        mine = [r for r in results["rows"] if r["setting"] == name]
        views[(i,)] = View(
            [
                _curves([r for r in rows if r["setting"] == name], bottom, what, axis),
                _seeds(mine, bottom, axis),
            ]
        )
    height = 380 + 10 * max(0, len({r["method"] for r in rows}) - 5)  # more names in the legend
    plots = [
        Plot(f"reward over {axis}", height),
        Plot("best reward of each seed, by method", height),
    ]
    if rows:
        return explorer({"setting": [look.setting(s) for s in settings]}, views, plots)
    return ""


def _curves(
    rows: Sequence[Mapping[str, Any]], bottom: float, what: str, axis: str
) -> dict[str, Any]:
    """Median over seeds with its quartiles, a line a method. No value is drawn where the policy
    destabilised the target.
    """
    data: list[dict[str, Any]] = []
    most = 0
    for r in rows:
        name, style = shown(look.label(r["method"])), look.style(r["method"])
        if axis == look.ITERATIONS:
            x = list(range(len(r["curve"]["median"])))
        else:
            x = r["trials"]
        most = max(most, x[-1])
        common = {"type": "scatter", "mode": "lines", "x": x, "legendgroup": name, "name": name}
        if len(r["per_seed"]) > 1:
            low, high = (
                [bottom - 10 if v is None else v for v in r["curve"][key]] for key in ("q25", "q75")
            )
            edge = common | {"line": {"width": 0}, "hoverinfo": "skip", "showlegend": False}
            data.append(edge | {"y": numbers(low)})
            data.append(
                edge | {"y": numbers(high), "fill": "tonexty", "fillcolor": f"{style['color']}/18"}
            )
        dash = "dash" if style["linestyle"] == "--" else "solid"
        line = {"color": style["color"], "width": 2.2, "dash": dash}
        middle = [None if v is None else round(v, 4) for v in r["curve"]["median"]]
        data.append(common | {"y": middle, "line": line, "hovertemplate": "%{y:.3f}"})
    layout = {
        "xaxis": {
            "title": {"text": axis},
            "tickformat": "d",
            **({"dtick": 1} if most < 8 else {"nticks": 8}),
        },
        "yaxis": {"title": {"text": what.replace(" (", "<br>(")}, "range": [bottom, 1.08]},
        "hovermode": "x unified",
        "title": {"text": f"over {axis}"},
    }
    return {"data": data, "layout": layout}


def _seeds(rows: Sequence[Mapping[str, Any]], bottom: float, axis: str) -> dict[str, Any]:
    """Best iteration, or what is deployed at last: every seed as a dot, and the mean with its 95 %
    interval where there are seeds to take one over.
    """
    data: list[dict[str, Any]] = []
    names = [shown(look.label(r["method"])) for r in rows]
    for r, name in zip(rows, names, strict=True):
        colour, seeds = (
            look.colour(r["method"]),
            [(i, v) for i, v in enumerate(r["per_seed"]) if v is not None],
        )
        common = {"type": "scatter", "mode": "markers", "name": name, "showlegend": False}
        dots = {
            "x": [round(v, 4) for _, v in seeds],
            "y": [name] * len(seeds),
            "text": [f"seed {i}" for i, _ in seeds],
        }
        dots |= {
            "marker": {"color": colour, "size": 7, "opacity": 0.45},
            "hovertemplate": "%{x:.3f}, %{text}",
        }
        data.append(common | dots)
        if r["mean"] is not None and len(r["per_seed"]) > 1:
            mean = {
                "x": [round(r["mean"], 4)],
                "y": [name],
                "marker": {"color": colour, "size": 10, "symbol": "diamond"},
            }
            if r["low"] is not None and r["high"] is not None:
                bar = {
                    "array": [round(r["high"] - r["mean"], 4)],
                    "arrayminus": [round(r["mean"] - r["low"], 4)],
                }
                mean["error_x"] = bar | {
                    "type": "data",
                    "symmetric": False,
                    "color": colour,
                    "thickness": 2.2,
                }
            data.append(common | mean | {"hovertemplate": "%{x:.3f}, mean"})
    found = [v for r in rows for v in r["per_seed"] if v is not None]
    left = bottom if found and min(found) < bottom else None
    if axis == look.ITERATIONS:
        best = "best-iteration reward"
    else:
        best = "normalized return of what is deployed at last"
    layout = {
        "xaxis": {"title": {"text": best}, **({} if left is None else {"range": [left, 1.08]})},
        "yaxis": {
            "categoryorder": "array",
            "categoryarray": names[::-1],
            "range": [-0.6, len(names) - 0.4],
        },
        "title": {
            "text": "every seed, and the mean"
            if any(len(r["per_seed"]) > 1 for r in rows)
            else "one seed"
        },
    }
    return {"data": data, "layout": layout}
