"""What the page of a sweep lets its reader explore: rewards over each swept value, and learning
curves by combination of values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from adaptsim_jax.report import figures as look
from adaptsim_jax.report.explore import Columns, Plot, View, explorer, shown
from adaptsim_jax.report.figures_sweep import COLOURS

TRAINING = "training"
"""The reward of Phase 1's last tenth of rounds, beside those in targets."""
MOST_DRAWN = 10
"""Combinations whose medians are drawn together; all have a plot of their own, up to
`MOST_CHOICES`.
"""
MOST_CHOICES = 60
MOST_ROUNDS = 400
"""Points of one learning curve."""
SYMBOLS = ("circle", "square", "triangle-up", "diamond", "triangle-down", "pentagon", "star")


def earned(row: Mapping[str, Any], name: str) -> float | None:
    """What a finished member earned in training or in a target; None where it has no reward
    there.
    """
    if name == TRAINING:
        return row["train_reward"]
    return row["targets"][name]["reward"]


def interval(values: list[float]) -> dict[str, Any]:
    """mean, half (of the 95 % interval of the mean) and count of `values`."""
    from scipy.stats import t

    count = len(values)
    mean = float(np.mean(values)) if count else None
    if count > 1:
        half = float(t.ppf(0.975, count - 1) * np.std(values, ddof=1) / np.sqrt(count))
    else:
        half = None
    return {"mean": mean, "half": half, "count": count}


def groups(found: Mapping[str, Any]) -> dict[str, list[Mapping[str, Any]]]:
    """Finished members by their combination of values, in words."""
    rows: dict[str, list[Mapping[str, Any]]] = {}
    last = [
        key.rsplit(".", 1)[-1] for key in found["swept"]
    ]  # a legend has no room for the tables that a key is in
    short = dict(
        zip(found["swept"], last if len(set(last)) == len(last) else found["swept"], strict=True)
    )
    for row in found["rows"]:
        if row["status"] == "done":
            name = ", ".join(
                f"{short.get(key, key)} {value}" for key, value in row["values"].items()
            )
            rows.setdefault(name or "all members", []).append(row)
    return rows


def over_values(found: Mapping[str, Any]) -> str:
    """Mean rewards over the values of each swept key with 95 % intervals, a line a reward; empty
    where nothing was swept.
    """
    views = {
        (i,): View([_over(found, key)], _over_note(found, key))
        for i, key in enumerate(found["swept"])
    }
    if views:
        return explorer({"over": found["swept"]}, views, [Plot("reward over a swept value", 400)])
    return ""


def _rows(found: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    return [r for r in found["summary"] if r["key"] == key and r["mean"] is not None]


def _over_note(found: Mapping[str, Any], key: str) -> str:
    least, over = min(((r["count"], r["over"]) for r in _rows(found, key)), default=(0, "members"))
    return f"means with 95 % intervals over {least} {over}, the other values averaged over"


def _over(found: Mapping[str, Any], key: str) -> dict[str, Any]:
    rows = _rows(found, key)
    values = list({repr(r["value"]): r["value"] for r in rows}.values())
    plain = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    values = sorted(values) if plain else values
    data = []
    for i, name in enumerate(dict.fromkeys(r["reward"] for r in rows)):
        mine = {repr(r["value"]): r for r in rows if r["reward"] == name}
        some = [v for v in values if repr(v) in mine]
        if name == TRAINING:
            colour = "--muted"
        else:
            colour = COLOURS[(i - 1) % len(COLOURS)]
        half = [None if (h := mine[repr(v)]["half"]) is None else round(h, 4) for v in some]
        data.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": shown(look.setting(name)),
                "hovertemplate": "%{y:.3f}",
                "x": some if plain else [shown(v) for v in some],
                "y": [round(mine[repr(v)]["mean"], 4) for v in some],
                "error_y": {"type": "data", "array": half, "color": colour, "thickness": 1.4},
                "line": {
                    "color": colour,
                    "width": 2,
                    "dash": "dot" if name == TRAINING else "solid",
                },
                "marker": {"color": colour, "size": 8, "symbol": SYMBOLS[i % len(SYMBOLS)]},
            }
        )
    axis: dict[str, Any] = (
        {"title": {"text": shown(key)}, "nticks": 8}
        if plain
        else {"title": {"text": shown(key)}, "type": "category"}
    )
    if plain and len(values) > 2 and min(values) > 0 and max(values) / min(values) >= 20:
        axis |= {"type": "log", "exponentformat": "power"}
    if plain and len(values) <= 6:
        axis |= {"tickmode": "array", "tickvals": values, "ticktext": [f"{v:g}" for v in values]}
    layout = {
        "xaxis": axis,
        "yaxis": {"title": {"text": "reward"}},
        "hovermode": "x unified",
        "title": {"text": ""},
    }
    return {"data": data, "layout": layout}


def curves(members: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Rewards of Phase 1 over rounds: medians of the best combinations together, then each
    combination's seeds.
    """
    found = {name: _matrix(rows) for name, rows in members.items()}
    found = {name: curve for name, curve in found.items() if curve.size}
    if not found:
        return ""
    columns, views = Columns(), {}
    best = sorted(
        found, key=lambda name: -float(np.nan_to_num(np.nanmean(found[name][:, -20:]), nan=-np.inf))
    )
    if len(found) > 1:
        choices = ["medians", *best[:MOST_CHOICES]]
    else:
        choices = list(found)
    rounds = {n: columns.add(_taken(n) + 1, 1.0) for n in {c.shape[1] for c in found.values()}}
    for i, choice in enumerate(choices):
        if choice in found:
            views[(i,)] = View([_seeds(members[choice], found[choice], rounds, columns)])
        else:
            left = len(found) - MOST_DRAWN
            if left > 0:
                note = f"the best {MOST_DRAWN} of {len(found)}, the others one by one"
            else:
                note = ""
            views[(i,)] = View(
                [_medians({name: found[name] for name in best[:MOST_DRAWN]}, rounds, columns)], note
            )
    height = 380 + 14 * min(len(found), MOST_DRAWN)  # names in the legend, one a line on a phone
    return explorer(
        {"show": choices}, views, [Plot("reward over rounds of Phase 1", height)], columns
    )


def _matrix(rows: Sequence[Mapping[str, Any]]) -> np.ndarray:
    """Curves `[members, rounds]`, to the shortest."""
    some = [row["curve"] for row in rows if row.get("curve")]
    length = min(map(len, some), default=0)
    return np.array([curve[:length] for curve in some], float).reshape(len(some), length)


def _taken(length: int) -> np.ndarray:
    """Rounds that are drawn, evenly taken, the last one always."""
    return np.unique(np.linspace(0, length - 1, min(length, MOST_ROUNDS)).round().astype(int))


def _layout(title: str, rounds: int) -> dict[str, Any]:
    # no tick between two rounds
    if rounds <= 10:
        whole = {"dtick": 1}
    else:
        whole = {}
    axes = {
        "xaxis": {"title": {"text": "round"}} | whole,
        "yaxis": {"title": {"text": "reward of the last step"}},
    }
    return axes | {"hovermode": "closest", "title": {"text": title}}


def _medians(
    found: Mapping[str, np.ndarray], rounds: Mapping[int, str], columns: Columns
) -> dict[str, Any]:
    data: list[dict[str, Any]] = []
    for i, (name, curve) in enumerate(found.items()):
        low, middle, high = np.nanpercentile(curve[:, _taken(curve.shape[1])], [25, 50, 75], axis=0)
        colour = COLOURS[i % len(COLOURS)]
        common = {
            "type": "scatter",
            "mode": "lines",
            "x": rounds[curve.shape[1]],
            "legendgroup": name,
            "name": shown(name),
        }
        if len(curve) > 1:
            edge = common | {"line": {"width": 0}, "hoverinfo": "skip", "showlegend": False}
            data.append(edge | {"y": columns.add(low, 1e-4)})
            data.append(
                edge
                | {"y": columns.add(high, 1e-4), "fill": "tonexty", "fillcolor": f"{colour}/15"}
            )
        line = {"color": colour, "width": 1.8, "dash": "solid" if i < len(COLOURS) else "dash"}
        data.append(
            common
            | {
                "y": columns.add(middle, 1e-4),
                "line": line,
                "hovertemplate": "round %{x}: %{y:.3f}",
            }
        )
    return {
        "data": data,
        "layout": _layout(
            "median and quartiles over seeds", max(c.shape[1] for c in found.values())
        ),
    }


def _seeds(
    rows: Sequence[Mapping], curve: np.ndarray, rounds: Mapping[int, str], columns: Columns
) -> dict[str, Any]:
    some = [row for row in rows if row.get("curve")]
    data = []
    for i, row in enumerate(some[:30]):
        y = columns.add(curve[i, _taken(curve.shape[1])], 1e-4)
        line = {"color": f"{COLOURS[i % len(COLOURS)]}", "width": 1.4}
        data.append(
            {"type": "scatter", "mode": "lines", "x": rounds[curve.shape[1]], "y": y, "line": line}
            | {"name": f"seed {row['seed']}", "hovertemplate": "round %{x}: %{y:.3f}"}
        )
    if len(some) <= 30:
        title = "each seed"
    else:
        title = f"the first 30 of {len(some)} seeds"
    return {"data": data, "layout": _layout(title, curve.shape[1])}
