"""What the page of a diagnosis draws: each function paints one figure of what it is given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report.diagnosis_svg import AFTER, BEFORE, CEILING, FLOOR, INK, MEASURED, MUTED, quiet, thin
from adaptsim_jax.report.diagnosis_words import plain

Paint = Callable[[Figure], None]
UNITS = {"q": "rad", "v": "rad/s", "tau": "N·m"}


def channel_unit(channel: str) -> str:
    """The SI unit of a pendulum channel by its stem (`q1` -> rad); empty for names that say nothing."""
    return UNITS.get(channel.rstrip("0123456789"), "")


def bar_range(ax: Axes, y: float, value: float, interval: Any, dots: list[float], colour: str) -> None:
    """One row: a pale bar to `value`, a dot a trial, the interval over it."""
    ax.barh(y, value, height=0.62, color=colour, alpha=0.28, linewidth=0)
    ax.plot([value, value], [y - 0.31, y + 0.31], color=colour, linewidth=2.6, solid_capstyle="butt")
    if dots:
        offsets = 0.22 * (np.arange(len(dots)) % 3 - 1)
        ax.plot(dots, y + offsets, "o", color=colour, markersize=3.6, alpha=0.75, markeredgewidth=0)
    if interval and None not in interval:
        ax.plot(interval, [y, y], color=INK, linewidth=1.3)
        ax.plot(interval, [y, y], "|", color=INK, markersize=7, markeredgewidth=1.3)


def error_pair(
    title: str, unit: str, pair: Mapping, dots: Mapping[str, list[float]], like: float | None = None
) -> Paint:
    """Declared against mended model in one channel, with noise floor and ceiling where they are known; `like`: the size whose
    unit is taken, so that neighbours share it."""
    shown = [(stage, pair[stage]) for stage in ("before", "after") if pair.get(stage) is not None]
    lines = {"noise_floor": pair.get("noise_floor"), "ceiling": pair.get("ceiling")}
    largest = max([value for _, value in shown] + [max(d, default=0.0) for d in dots.values()], default=0.0)
    factor, name = fmt.scaled(unit, largest if like is None else like)

    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        intervals = pair.get("intervals") or {}
        for row, (stage, value) in enumerate(shown):
            ends = [None if end is None else factor * end for end in intervals.get(stage) or []] or None
            colour = BEFORE if stage == "before" else AFTER
            bar_range(ax, -row, factor * value, ends, [factor * d for d in dots.get(stage, [])], colour)
        for key, colour, dashes in (("noise_floor", FLOOR, (4, 2)), ("ceiling", CEILING, (1.5, 1.5))):
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


def held_out(trial: Mapping, channel: str) -> Paint:
    """Measured and simulated on one held-out trial, and under it what each model leaves."""
    models = [(key, trial[key][channel]) for key in ("before", "after") if channel in (trial.get(key) or {})]
    columns = thin(trial["time"], trial["measured"][channel], *[values for _, values in models])
    time, measured, simulated = columns[0], columns[1], columns[2:]
    unit = (trial.get("units") or {}).get(channel) or trial.get("unit") or channel_unit(channel)
    colours = {"before": BEFORE, "after": AFTER}
    left = [measured - values for values in simulated]
    factor, name = fmt.scaled(unit, _largest(*left))

    def paint(figure: Figure) -> None:
        top, low = figure.subplots(2, 1, sharex=True, height_ratios=(1.7, 1))
        top.plot(time, measured, color=MEASURED, linewidth=3.2, alpha=0.55)
        for (key, _), values, rest in zip(models, simulated, left, strict=True):
            top.plot(time, values, color=colours[key], linewidth=1.2)
            low.plot(time, factor * rest, color=colours[key], linewidth=1.1)
        low.axhline(0, color=MUTED, linewidth=0.7)
        top.set(title=f"{channel}, {trial['trial']}", ylabel=unit)
        low.set(xlabel="time, s", ylabel=f"error, {name}" if name else "error")
        for ax in (top, low):
            quiet(ax)
        low.locator_params(axis="y", nbins=3)

    return paint


def seen_from(tracks: Mapping) -> str:
    """Where tracks are looked at from, by their `axes`."""
    return "the side" if "z" in (tracks.get("axes") or ()) else "above"


def regressor(found: Mapping, unit: str = "N m") -> Paint:
    """The torque that the model lacks without one effect, against what that effect follows, and the fitted effect."""
    x, y = thin(found["x"], found["y"], most=1200)
    factor, name = fmt.scaled(unit, percentile(y))

    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        ax.plot(x, factor * y, "o", color=MEASURED, markersize=2.2, alpha=0.45, markeredgewidth=0)
        centres, means, spread = _binned(found["x"], found["y"])
        ax.vlines(centres, factor * (means - spread), factor * (means + spread), color=INK, linewidth=1.1)
        ax.plot(centres, factor * means, "o", color=INK, markersize=4, markeredgewidth=0)
        if found.get("curve_x") is not None and found.get("curve_y") is not None:
            ax.plot(found["curve_x"], factor * np.asarray(found["curve_y"]), color=AFTER, linewidth=2.2)
        ax.axhline(0, color=MUTED, linewidth=0.7)
        ax.set(xlabel=found.get("x_label", ""), ylabel=f"missing torque, {name}", title=_regressor_title(found))
        _robust_limits(ax, factor * y)
        quiet(ax)

    return paint


def _regressor_title(found: Mapping) -> str:
    """The effect and its place, and how much of the missing torque it gives."""
    title = f"{plain(found['name'])} at {plain(found['where'])}" if found.get("name") else f"at {plain(found['where'])}"
    return title[:1].upper() + title[1:]


def broken(time: np.ndarray, *values: np.ndarray) -> tuple[np.ndarray, ...]:
    """NaN where stretches of time are left out, lest a line be drawn across."""
    step = np.diff(time)
    at = np.flatnonzero(step > 5.0 * np.median(step)) + 1 if len(step) else np.zeros(0, int)
    return tuple(np.insert(np.asarray(z, float), at, np.nan) for z in (time, *values))


def next_experiment(plan: Mapping) -> Paint:
    """The commanded torques to run next, a row a joint."""
    torque = np.asarray(plan["torque"], dtype=float).reshape(len(plan["time"]), -1)
    time, *rows = thin(plan["time"], *torque.T)
    factor, name = fmt.scaled("N m", float(np.max(np.abs(torque), initial=0.0)))

    def paint(figure: Figure) -> None:
        axes = np.atleast_1d(figure.subplots(len(rows), 1, sharex=True, sharey=True))
        for index, (ax, values) in enumerate(zip(axes, rows, strict=True)):
            ax.step(time, factor * values, where="post", color=AFTER, linewidth=1.2)
            ax.axhline(0, color=MUTED, linewidth=0.7)
            ax.set(title=f"commanded torque {index + 1}", ylabel=name)
            quiet(ax)
        axes[-1].set_xlabel("time, s")

    return paint


def paints(report: Mapping, evidence: Mapping) -> dict[str, tuple[Paint, float, str]]:
    """Figures by name for `figures/`: what to paint, height in inches, label; those with evidence only."""
    found: dict[str, tuple[Paint, float, str]] = {}
    for trial in (evidence.get("held_out") or [])[:1]:
        for channel in trial["measured"]:
            found[f"held_out_{channel}"] = (held_out(trial, channel), 3.2, f"{channel} held out")
    for index, row in enumerate(evidence.get("regressor") or []):
        name = "regressor" if index == 0 else f"regressor_{index + 1}"
        found[name] = (regressor(row), 3.2, "missing torque against what the effect follows")
    if (evidence.get("next_experiment") or {}).get("torque") is not None:
        found["next_experiment"] = (next_experiment(evidence["next_experiment"]), 3.2, "next experiment")
    error = report["error"]
    if error.get("before") is not None:
        dots = trial_dots(error, None)
        found["error"] = (
            error_pair(f"held-out {error['metric']}", error["unit"], error, dots),
            1.75,
            "error",
        )
    return found


def trial_dots(error: Mapping, channel: str | None) -> dict[str, list[float]]:
    """The error of each held-out trial, of `channel` or overall, before and after."""
    dots: dict[str, list[float]] = {"before": [], "after": []}
    for trial in error["per_trial"]:
        pair = trial if channel is None else (trial.get("per_channel") or {}).get(channel, {})
        for stage, values in dots.items():
            if pair.get(stage) is not None:
                values.append(pair[stage])
    return dots


def _binned(x: Any, y: Any, bins: int = 24) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre, mean and standard deviation of `y` in equal stretches of `x` that hold at least five points."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    fine = np.isfinite(x) & np.isfinite(y)
    x, y = x[fine], y[fine]
    if len(x) == 0 or np.ptp(x) == 0:
        return x[:0], y[:0], y[:0]
    index = np.clip((bins * (x - x.min()) / np.ptp(x)).astype(int), 0, bins - 1)
    groups = [index == i for i in range(bins) if np.sum(index == i) >= 5]
    middle, mean, spread = (np.array([f(z[g]) for g in groups]) for f, z in ((np.mean, x), (np.mean, y), (np.std, y)))
    return middle, mean, spread


def _largest(*columns: np.ndarray) -> float:
    finite = [np.abs(c[np.isfinite(c)]) for c in columns]
    return max((float(c.max()) for c in finite if c.size), default=0.0)


def percentile(values: np.ndarray, q: float = 99.0) -> float:
    """How large values are, wild ones left aside; 0 where none is finite."""
    finite = np.abs(values[np.isfinite(values)])
    return float(np.percentile(finite, q)) if finite.size else 0.0


def _robust_limits(ax: Axes, values: np.ndarray) -> None:
    """One wild estimate at a trial's edge must not flatten the rest."""
    bound = 1.6 * percentile(values)
    if 0 < bound < _largest(values):
        ax.set_ylim(-bound, bound)
