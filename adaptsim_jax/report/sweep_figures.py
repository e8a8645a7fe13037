"""Figures of a sweep's page: rewards over each swept value, and learning curves by combination of
values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.report import figures as look
from adaptsim_jax.report.explore import (
    Plot,
    SharedColumns,
    View,
    axis,
    band,
    explorer,
    figure,
    line,
    shown,
)

TRAINING = "training"
"""The reward of Phase 1's last tenth of rounds, beside those in targets."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MOST_DRAWN = 10
"""Combinations whose medians are drawn together; all have a plot of their own, up to
`MOST_CHOICES`.
"""
MOST_CHOICES = 60
MOST_ROUNDS = 400
"""Points of one learning curve."""
SYMBOLS = ("circle", "square", "triangle-up", "diamond", "triangle-down", "pentagon", "star")


def earned(row: Mapping, name: str) -> float | None:
    """What a finished member earned in training or in a target; None where it has no reward
    there.
    """
    if name == TRAINING:
        return row["train_reward"]
    return row["targets"][name]["reward"]


def interval(values: list[float]) -> Table:
    """mean, half (of the 95 % interval of the mean) and count of `values`."""
    from scipy.stats import t

    count = len(values)
    mean = float(np.mean(values)) if count else None
    if count > 1:
        half = float(t.ppf(0.975, count - 1) * np.std(values, ddof=1) / np.sqrt(count))
    else:
        half = None
    return {"mean": mean, "half": half, "count": count}


def groups(results: Mapping) -> dict[str, list[Mapping]]:
    """Finished members by their combination of values, in words."""
    rows: dict[str, list[Mapping]] = {}
    last_words = [
        key.rsplit(".", 1)[-1] for key in results["swept"]
    ]  # a legend has no room for the tables that a key is in
    short_of = dict(
        zip(
            results["swept"],
            last_words if len(set(last_words)) == len(last_words) else results["swept"],
            strict=True,
        )
    )
    for row in results["rows"]:
        if row["status"] == "done":
            name = ", ".join(
                f"{short_of.get(key, key)} {value}" for key, value in row["values"].items()
            )
            rows.setdefault(name or "all members", []).append(row)
    return rows


class SweptRewards(NamedTuple):
    """Mean rewards over the values of one swept key: rows of `summary` by reward, in the order of
    `values`. numbers: Whether values are numbers. log: Whether they span so much that an axis is to
    be logarithmic. note: What means are over.
    """

    values: list[Any]
    numbers: bool
    log: bool
    lines: dict[str, list[Mapping]]
    note: str


def swept_rewards(results: Mapping, key: str) -> SweptRewards:
    """Collect the rewards of one swept key."""
    rows = [r for r in results["summary"] if r["key"] == key and r["mean"] is not None]
    values = list({repr(r["value"]): r["value"] for r in rows}.values())
    is_numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    if is_numeric:
        values = sorted(values)
    is_log = is_numeric and len(values) > 2 and min(values) > 0 and max(values) / min(values) >= 20
    order = [repr(v) for v in values]
    lines: dict[str, list[Mapping]] = {}
    for row in sorted(rows, key=lambda r: order.index(repr(r["value"]))):
        lines.setdefault(row["reward"], []).append(row)
    lines = {name: lines[name] for name in look.distinct(rows, "reward")}
    fewest, over = min(((r["count"], r["over"]) for r in rows), default=(0, "members"))
    return SweptRewards(values, is_numeric, is_log, lines, f"95 % intervals over {fewest} {over}")


def over_values(results: Mapping) -> str:
    """Mean rewards over the values of each swept key with 95 % intervals, a line a reward. Empty
    where nothing was swept.
    """
    views = {}
    for i, key in enumerate(results["swept"]):
        swept = swept_rewards(results, key)
        note = f"means with {swept.note}, the other values averaged over"
        views[(i,)] = View([_over(swept, key)], note)
    if views:
        return explorer({"over": results["swept"]}, views, [Plot("reward over a swept value", 400)])
    return ""


def _over(swept: SweptRewards, key: str) -> Table:
    data = []
    for i, (name, rows) in enumerate(swept.lines.items()):
        colour, dash = COLOURS[(i - 1) % len(COLOURS)], "solid"
        if name == TRAINING:
            colour, dash = "--muted", "dot"
        half = [None if r["half"] is None else round(r["half"], 4) for r in rows]
        values = [r["value"] if swept.numbers else shown(r["value"]) for r in rows]
        trace = line(
            shown(look.setting(name)),
            values,
            [round(r["mean"], 4) for r in rows],
            {"color": colour, "width": 2, "dash": dash},
            hovertemplate="%{y:.3f}",
            error_y={"type": "data", "array": half, "color": colour, "thickness": 1.4},
            marker={"color": colour, "size": 8, "symbol": SYMBOLS[i % len(SYMBOLS)]},
        )
        data.append(trace | {"mode": "lines+markers"})
    across = axis(shown(key), nticks=8) if swept.numbers else axis(shown(key), type="category")
    if swept.log:
        across |= {"type": "log", "exponentformat": "power"}
    if swept.numbers and len(swept.values) <= 6:
        texts = [f"{v:g}" for v in swept.values]
        across |= {"tickmode": "array", "tickvals": swept.values, "ticktext": texts}
    return figure(data, across, axis("reward"), hovermode="x unified")


def curves(members: Mapping[str, Sequence[Mapping]]) -> str:
    """Rewards of Phase 1 over rounds: medians of the best combinations together, then each
    combination's seeds.
    """
    curve_of = {name: _matrix(rows) for name, rows in members.items()}
    curve_of = {name: curve for name, curve in curve_of.items() if curve.size}
    if not curve_of:
        return ""
    columns, views = SharedColumns(), {}
    ends = {name: np.nanmean(curve[:, -20:]) for name, curve in curve_of.items()}
    best = sorted(curve_of, key=lambda name: -float(np.nan_to_num(ends[name], nan=-np.inf)))
    if len(curve_of) > 1:
        choices = ["medians", *best[:MOST_CHOICES]]
    else:
        choices = list(curve_of)
    rounds = {
        n: columns.add(_drawn_rounds(n) + 1, 1.0) for n in {c.shape[1] for c in curve_of.values()}
    }
    for i, choice in enumerate(choices):
        if choice in curve_of:
            views[(i,)] = View([_seeds(members[choice], curve_of[choice], rounds, columns)])
        else:
            n_hidden = len(curve_of) - MOST_DRAWN
            if n_hidden > 0:
                note = f"the best {MOST_DRAWN} of {len(curve_of)}, the others one by one"
            else:
                note = ""
            views[(i,)] = View(
                [_medians({name: curve_of[name] for name in best[:MOST_DRAWN]}, rounds, columns)],
                note,
            )
    height = 380 + 14 * min(len(curve_of), MOST_DRAWN)  # names in the legend, one a line on a phone
    return explorer(
        {"show": choices}, views, [Plot("reward over rounds of Phase 1", height)], columns
    )


def _matrix(rows: Sequence[Mapping]) -> np.ndarray:
    """Curves `[members, rounds]`, to the shortest."""
    curves = [row["curve"] for row in rows if row.get("curve")]
    length = min(map(len, curves), default=0)
    return np.array([curve[:length] for curve in curves], float).reshape(len(curves), length)


def _drawn_rounds(length: int) -> np.ndarray:
    """Rounds that are drawn, evenly taken, the last one always."""
    return np.unique(np.linspace(0, length - 1, min(length, MOST_ROUNDS)).round().astype(int))


def _over_rounds(data: list[Table], title: str, rounds: int) -> Table:
    ticks = {"dtick": 1} if rounds <= 10 else {}  # no tick between two rounds
    rewards = axis("reward of the last step")
    return figure(data, axis("round", **ticks), rewards, title, hovermode="closest")


def _medians(
    curve_of: Mapping[str, np.ndarray], rounds: Mapping[int, str], columns: SharedColumns
) -> Table:
    data: list[Table] = []
    for i, (name, curve) in enumerate(curve_of.items()):
        low, median, high = np.nanpercentile(
            curve[:, _drawn_rounds(curve.shape[1])], [25, 50, 75], axis=0
        )
        colour, x, title = COLOURS[i % len(COLOURS)], rounds[curve.shape[1]], shown(name)
        if len(curve) > 1:
            edges = (columns.add(edge, 1e-4) for edge in (low, high))
            data += [b | {"legendgroup": name} for b in band(title, x, *edges, fill=f"{colour}/15")]
        pen = {"color": colour, "width": 1.8, "dash": "solid" if i < len(COLOURS) else "dash"}
        hover = {"legendgroup": name, "hovertemplate": "round %{x}: %{y:.3f}"}
        data.append(line(title, x, columns.add(median, 1e-4), pen, **hover))
    n_rounds = max(c.shape[1] for c in curve_of.values())
    return _over_rounds(data, "median and quartiles over seeds", n_rounds)


def _seeds(
    rows: Sequence[Mapping], curve: np.ndarray, rounds: Mapping[int, str], columns: SharedColumns
) -> Table:
    drawn_rows = [row for row in rows if row.get("curve")]
    data, x = [], rounds[curve.shape[1]]
    for i, row in enumerate(drawn_rows[:30]):
        y = columns.add(curve[i, _drawn_rounds(curve.shape[1])], 1e-4)
        pen = {"color": COLOURS[i % len(COLOURS)], "width": 1.4}
        hover = "round %{x}: %{y:.3f}"
        data.append(line(f"seed {row['seed']}", x, y, pen, hovertemplate=hover))
    if len(drawn_rows) <= 30:
        title = "each seed"
    else:
        title = f"the first 30 of {len(drawn_rows)} seeds"
    return _over_rounds(data, title, curve.shape[1])
