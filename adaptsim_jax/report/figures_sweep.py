"""Figures of a sweep: reward over each swept value, and learning curves."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from adaptsim_jax.report import figures as look

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "os^Dvp*"


def draw(found: dict[str, Any], out: Path) -> list[Path]:
    """A figure for each swept key of `results.json`, and one of the learning curves; returns the
    files.
    """
    files = [
        look.save(over_values(found, key), out / f"reward_{key.replace('.', '_')}.png")
        for key in found["swept"]
    ]
    if any(row.get("curve") for row in found["rows"]):
        files.append(look.save(curves(found), out / "curves.png"))
    return [Path(f) for f in files]


def over_values(found: dict[str, Any], key: str) -> Figure:
    """Mean rewards over the values of `key` with 95 % intervals: a line for each target, or one for
    Phase 1 where there is none.
    """
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    wanted = found["spec"]["targets"] or ["training"]
    rows = [
        r
        for r in found["summary"]
        if r["key"] == key and r["mean"] is not None and r["reward"] in wanted
    ]
    values = list({repr(r["value"]): r["value"] for r in rows}.values())
    plain = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    values = sorted(values) if plain else values
    names = list(dict.fromkeys(r["reward"] for r in rows))
    for i, name in enumerate(names):
        mine = {repr(r["value"]): r for r in rows if r["reward"] == name}
        some = [v for v in values if repr(v) in mine]
        if plain:
            x = np.array(some, float)
        else:
            x = np.array([values.index(v) for v in some], float)
        mean = [mine[repr(v)]["mean"] for v in some]
        half = [mine[repr(v)]["half"] or 0.0 for v in some]
        colour, mark = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
        axes.errorbar(
            x,
            mean,
            half,
            capsize=3,
            color=colour,
            marker=mark,
            markersize=4,
            label=look.setting(name),
        )
    if not plain:
        axes.set_xticks(range(len(values)), [str(v) for v in values])
    elif len(values) > 2 and min(values) > 0 and max(values) / min(values) >= 20:
        axes.set_xscale("log")
    least, over = min(((r["count"], r["over"]) for r in rows), default=(0, "members"))
    axes.set_xlabel(
        f"{key} (means with 95 % intervals over {least} {over}, other values averaged over)",
        fontsize=8,
    )
    axes.set_ylabel("reward")
    axes.grid(color=look.GRID)
    if names:
        axes.legend(fontsize=8)
    return figure


def curves(found: dict[str, Any], most: int = 6) -> Figure:
    """Rewards of Phase 1 over rounds: median and quartiles over seeds, for each combination of
    values (the first `most`).
    """
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes, groups = figure.subplots(), {}
    for row in found["rows"]:
        if row["status"] == "done":
            groups.setdefault(tuple(f"{k} {v}" for k, v in row["values"].items()), []).append(
                row["curve"]
            )
    for i, (name, rows) in enumerate(list(groups.items())[:most]):
        length = min(map(len, rows))
        low, mid, high = np.nanpercentile(
            np.array([r[:length] for r in rows], float), [25, 50, 75], axis=0
        )
        colour, x = COLOURS[i % len(COLOURS)], np.arange(1, length + 1)
        axes.plot(x, mid, color=colour, linewidth=1.2, label=", ".join(name) or "all members")
        axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
    if len(groups) > most:
        more = f"; {len(groups) - most} more combinations not drawn"
    else:
        more = ""
    axes.set_xlabel(f"round (median and quartiles over seeds{more})")
    axes.set_ylabel("reward of the last step")
    axes.grid(color=look.GRID)
    axes.legend(fontsize=8)
    return figure
