"""A page that shows an adaptation beside its baselines: one self-contained HTML file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.report import explore
from adaptsim_jax.report import figures as look
from adaptsim_jax.report.explore import Plot, View, explorer, filled, numbers, shown


def write_adaptation_page(results: Mapping[str, Any], path: Path) -> Path:
    """Write the page for `results` (of `compare`) to `path`, whole or not at all. Raises BadInput
    where it cannot.
    """
    write_bytes(path, render(results).encode())
    return path


def render(results: Mapping[str, Any]) -> str:
    """The page as text."""
    rows = results["rows"]
    settings = list(dict.fromkeys(r["setting"] for r in rows))
    methods = list(dict.fromkeys(r["method"] for r in rows))
    cells = {(r["method"], r["setting"]): _cell(r) for r in rows}
    curves = _rewards(results)
    if "reward" not in results:
        words = _CURVES
    elif "trials_axis" in results:
        words = _DEPLOYED
    else:
        words = _PLAIN_CURVES
    caption = words.format(over=_OVER[look.one_seed(rows)])
    return filled(
        "adaptation.html.j2",
        results=results,
        headline=headline(
            rows,
            "Reward"
            if "reward" in results and "trials_axis" not in results
            else "Normalized reward",
        ),
        scale=_scale(results),
        best="best iteration" if "trials_axis" not in results else "after all target trials",
        over="one seed, no interval" if look.one_seed(rows) else "mean over seeds",
        settings=[(s, look.setting(s)) for s in settings],
        methods=[(m, look.label(m), look.colour(m)) for m in methods],
        cells=cells,
        curves=curves,
        caption=caption,
        script=explore.script(bool(curves)),
    )


_CURVES = (
    "Reward of the best distribution at each iteration: {over}. "
    "0 is one policy for all of Omega (UDR), 1 the best policy whose parameters lie in Omega."
)
_PLAIN_CURVES = (
    "Reward of the best distribution at each iteration (for methods without distributions: at each "
    "of their budgets of "
    "target trials): {over}."
)
_DEPLOYED = "Return of what is deployed after so many target trials: {over}."
_OVER = {
    False: "median over seeds, shaded between the quartiles",
    True: "one seed, nothing to shade",
}
_NORMALISED = (
    "0 is UDR, 1 the best policy of Omega. {beside} AdaptSim spends {starts} target rollouts an "
    "iteration, system identification "
    "one."
)
_INTERVAL = {
    False: "Beside each mean its 95 % interval over seeds.",
    True: "One seed, no interval.",
}
_TARGETS = (
    " Targets: WD is within Omega, the box of parameters that may be simulated; OOD are outside "
    "of it."
)


def headline(rows: list[Mapping[str, Any]], what: str = "Normalized reward") -> str:
    """One sentence: how AdaptSim did beside the better SysID baseline, in the settings where both
    ran.
    """
    by = {(r["method"], r["setting"]): r["mean"] for r in rows}
    parts = []
    for setting in dict.fromkeys(r["setting"] for r in rows):
        ours = by.get(("adaptsim", setting))
        known = [by.get((m, setting), None) for m in ("sysid_bayes", "sysid_point")]
        known = [v for v in known if v is not None]
        if ours is None:
            continue
        if known:
            note = f" (system identification {max(known):.2f})"
        else:
            note = ""
        parts.append(f"{look.setting(setting)} {ours:.2f}{note}")
    if not parts:
        return f"{what}s of the methods that ran"
    return f"{what} of AdaptSim: " + ", ".join(parts)


def _scale(results: Mapping[str, Any]) -> str:
    note = _INTERVAL[look.one_seed(results["rows"])]
    if any(r["setting"] in look.SETTINGS for r in results["rows"]):
        note += _TARGETS
    if "reward" in results:
        return f"{look.reward_of(results, long=True)}. {note}"
    return _NORMALISED.format(beside=note, starts=results["starts"])


def _cell(r: Mapping[str, Any]) -> dict[str, str]:
    def number(v):
        if v is None:
            return "fails"
        return f"{v:.2f}"

    if r["low"] == r["high"]:
        spread = ""
    else:
        spread = f"{number(r['low'])} to {number(r['high'])}"
    value = "" if r["mean"] is None else f"{r['mean']:.6g}"
    return {
        "mean": number(r["mean"]),
        "value": value,
        "spread": spread,
        "final": number(r["final_mean"]),
    }


# ---------------------------------------------------------------- plots to explore, setting by
# setting


def _rewards(results: Mapping[str, Any]) -> str:
    """Two plots for each setting, of the rows that have a curve over iterations; empty where none
    has.
    """
    rows = [r for r in results["rows"] if len(r["curve"]["median"]) > 1]
    settings = list(dict.fromkeys(r["setting"] for r in rows))
    bottom, what, axis = look.lower_limit(results), look.reward_of(results), look.axis_of(results)
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
