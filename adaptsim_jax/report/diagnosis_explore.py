"""What a diagnosis's page lets its reader explore: each trial measured and simulated, and
tracks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.report import diagnosis_figures as figures
from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report.diagnosis_figures import thin
from adaptsim_jax.report.diagnosis_words import plain
from adaptsim_jax.report.explore import (
    Plot,
    SharedColumns,
    View,
    axis,
    dots,
    explorer,
    figure,
    line,
    points,
    shown,
)

COLOURS = {"measured": "--measured", "before": "--before", "after": "--after"}
NAMES = {"measured": "measured", "before": "declared model", "after": "mended model"}


def held_out(trials: Sequence[Mapping], error: Mapping) -> tuple[str, int]:
    """Measured and simulated by trial and channel, with the residual beneath, and how many trials
    there was no room for.
    """
    trials = [trial for trial in trials if len(trial["time"]) and trial["measured"]]
    if not trials:
        return "", 0
    channels = list(dict.fromkeys(channel for trial in trials for channel in trial["measured"]))
    if (
        _kind(channels) == "joint"
    ):  # what a reader looks for comes first: where the declared model is furthest off
        channels.sort(key=lambda c: -((error["per_channel"].get(c) or {}).get("before") or 0.0))
    models = 2 if trials[0].get("after") is None else 3
    max_points, shown_trials = points(
        [len(trial["time"]) for trial in trials], 1 + models * len(channels)
    )
    columns, views = SharedColumns(), {}
    for i, trial in enumerate(trials[:shown_trials]):
        time = columns.add(thin(trial["time"], most=max_points)[0])
        for j, channel in enumerate(channels):
            if channel in trial["measured"]:
                drawn = _residual(trial, channel, columns, time, max_points)
                views[i, j] = View(
                    [drawn], _note(trial, channel, error, len(trial["time"]), max_points)
                )
    choices = {
        "trial": [str(trial["trial"]) for trial in trials[:shown_trials]],
        _kind(channels): channels,
    }
    label = "measured and simulated over time, and beneath it the error, measured minus simulated"
    return explorer(choices, views, [Plot(label, 460)], columns), len(trials) - shown_trials


def _kind(channels: Sequence[str]) -> str:
    """What to call a channel: the double pendulum's are signals of a joint, a track's are
    coordinates.
    """
    if all(figures.channel_unit(c) for c in channels):
        return "signal"
    if {"x", "z"} & set(channels):
        return "coordinate"
    return "joint"


def _residual(
    trial: Mapping, channel: str, columns: SharedColumns, time: str, max_points: int
) -> Table:
    stages = [stage for stage in ("before", "after") if channel in (trial.get(stage) or {})]
    measured, *simulated = thin(
        trial["measured"][channel], *[trial[s][channel] for s in stages], most=max_points
    )
    residuals = [measured - values for values in simulated]
    unit = (
        (trial.get("units") or {}).get(channel)
        or trial.get("unit")
        or figures.channel_unit(channel)
    )
    factor, name = fmt.scaled(
        unit, max((figures.percentile(residual) for residual in residuals), default=0.0)
    )
    sizes = [size for residual in residuals if (size := figures.percentile(residual)) > 0]
    step = max(min(sizes, default=0.0) / 300, figures.percentile(measured) / 1e7) or None
    measured_column = columns.add(measured, step)
    hover = {"hovertemplate": f"%{{y:.5~g}} {fmt.unit_name(unit)}"}
    data: list[Table] = [_line(time, measured_column, "measured", 5, opacity=0.6, **hover)]
    for stage, values in zip(stages, simulated, strict=True):
        simulated_column = columns.add(values, step)
        data.append(_line(time, simulated_column, stage, 1.6, legendgroup=stage, **hover))
        lower_style = {"yaxis": "y2", "showlegend": False, "legendgroup": stage}
        residual = {"minus": [measured_column, simulated_column], "times": factor}
        trace = _line(
            time, residual, stage, 1.4, hovertemplate=f"%{{y:.4~g}} {name}", **lower_style
        )
        data.append(trace | {"name": f"{NAMES[stage]}: error"})
    lower = {"domain": [0.0, 0.34], "nticks": 4, "zeroline": True}
    return figure(
        data,
        axis("time, s", anchor="y2", unifiedhovertitle={"text": "%{x} s"}),
        axis(_named(channel, fmt.unit_name(unit)), domain=[0.42, 1.0], nticks=6),
        yaxis2=axis(_named("error", name), **lower),
        hovermode="x unified",
        hoversubplots="axis",
        legend={"uirevision": "all"},  # what is hidden stays hidden from trial to trial
    )


def _line(x: Any, y: Any, stage: str, width: float, **more: Any) -> Table:
    return line(NAMES[stage], x, y, {"color": COLOURS[stage], "width": width}, **more)


def _named(name: str, unit: str) -> str:
    return shown(f"{plain(name)}, {unit}" if unit else plain(name))


def _note(trial: Mapping, channel: str, error: Mapping, samples: int, max_points: int) -> str:
    """This trial's own error in the channel, as the report has it, and whether samples are passed
    over.
    """
    trial_row = next(
        (row for row in error["per_trial"] if str(row["trial"]) == str(trial["trial"])), {}
    )
    pair = (trial_row.get("per_channel") or {}).get(channel) or {}
    unit = (error["per_channel"].get(channel) or {}).get("unit") or figures.channel_unit(channel)

    def size_of(value, like):
        return fmt.quantity(value, unit, like=like).replace(" ", "\u00a0")

    parts = []
    if pair.get("before") is not None:
        size = max(pair["before"], pair.get("after") or 0.0)
        parts.append(f"error: declared {size_of(pair['before'], size)}")
        if pair.get("after") is not None and trial.get("after") is not None:
            parts.append(f"mended {size_of(pair['after'], size)}")
    stride = -(-samples // max_points)
    if stride > 1:
        parts.append(f"one in {stride} of {samples:,} samples is drawn")
    return ", ".join(parts)


def tracks(track_table: Mapping) -> str:
    """Tracks of all trials seen from above (or the plane of their `axes`), measured and simulated,
    each to its end.
    """
    x, y = track_table.get("axes") or ("x", "y")
    all_of = {key: [np.asarray(t, float) for t in track_table.get(key) or []] for key in COLOURS}
    max_points, shown_trials = points(
        [
            max(map(len, own_tracks))
            for own_tracks in zip(*filter(None, all_of.values()), strict=False)
        ],
        6,
    )
    columns, data = SharedColumns(), []
    for key, own_tracks in all_of.items():
        if not own_tracks:
            continue
        drawn = own_tracks[:shown_trials]
        gap = [[np.nan, np.nan]]
        rows = [np.vstack([np.stack(thin(*t.T, most=max_points), 1), gap]) for t in drawn]
        path, ends = np.vstack(rows), np.array([t[-1] for t in drawn])
        width, opacity = (5, 0.6) if key == "measured" else (1.4, 0.95)
        step = float(np.nanmax(np.ptp(ends, axis=0), initial=0.0)) / 1e4 or None
        along, up = (columns.add(path[:, k], step) for k in (0, 1))
        data.append(_line(along, up, key, width, opacity=opacity, legendgroup=key))
        marker = {"color": COLOURS[key], "size": 7 if key == "measured" else 5}
        along, up = (columns.add(ends[:, k], step) for k in (0, 1))
        data.append(dots(NAMES[key], along, up, marker, legendgroup=key, hoverinfo="skip"))
    for trace in data:
        trace["hovertemplate"] = "%{x:.4~g}, %{y:.4~g} m"
    plane = figure(data, axis(f"{x}, m"), axis(f"{y}, m", scaleanchor="x"))
    trials = max(map(len, all_of.values()))
    if shown_trials < trials:
        note = f"the first {shown_trials} of {trials} trials"
    else:
        note = ""
    view = View([plane], note)
    if data:
        return explorer({}, {(): view}, [Plot("tracks, measured and simulated", 480)], columns)
    return ""
