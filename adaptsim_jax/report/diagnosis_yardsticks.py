"""Does the model predict at all: the yardsticks of a report as rows, torque over time and friction
against speed as figures.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report import diagnosis_svg as svg
from adaptsim_jax.report.diagnosis_svg import AFTER, BEFORE, MEASURED

NAMES = {
    "stretches": "simulated stretches of {span:.3g} s",
    "whole": "whole simulated trials",
    "torque": "torque along the measured motion",
}
MOST_POINTS = 900  # of a figure's curve


def rows(report: Mapping[str, Any]) -> list[dict[str, str]]:
    """A row for each yardstick and joint: what is left of the declared and of the mended model,
    what needs no model leaves, and skills.
    """
    told = report.get("yardsticks") or {}
    out = []
    for name in NAMES:
        first = (told.get("declared") or {}).get(name)
        if first is None:
            continue
        last = (told.get("mended") or {}).get(name) or first
        torque = name == "torque"
        if torque:
            error, base = ("missing", "constant")
        else:
            error, base = ("error", "straight_line")
        title = NAMES[name].format(span=first["span_s"]) + (
            ", the judge" if told.get("judge") == name else ""
        )
        for joint, row in first["joints"].items():
            mended, unit = last["joints"][joint], row["unit"]
            out.append(
                {
                    "yardstick": title,
                    "joint": joint,
                    "before": fmt.quantity(row[error], unit),
                    "after": fmt.quantity(mended[error], unit),
                    "base": fmt.quantity(row[base], unit),
                    "skill_before": _skill(row["skill"]),
                    "skill_after": _skill(mended["skill"]),
                }
            )
            title = ""
    return out


def _skill(value: float | None) -> str:
    if value is None or not np.isfinite(value):
        return fmt.DASH
    return f"{value:.2f}".replace("-", "−")


def torque_figures(evidence: Mapping[str, Any]) -> list[str]:
    """Torque measured, by the file and as fitted, over time, a picture a joint."""
    return [
        svg.draw(
            _over_time(row),
            2.2,
            f"torque at {row['joint']} over time: measured, by the file, as fitted",
        )
        for row in evidence.get("torque") or []
    ]


def friction_figures(evidence: Mapping[str, Any]) -> list[str]:
    """What resists against speed, points, and the model of it, a picture a joint."""
    return [
        svg.draw(
            _against_speed(row), 2.2, f"torque that resists at {row['joint']} against its speed"
        )
        for row in evidence.get("friction") or []
    ]


def _some(count: int) -> np.ndarray:
    return np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).astype(int))


def _over_time(row: Mapping[str, Any]):
    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        at = _some(len(row["time"]))
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


def _against_speed(row: Mapping[str, Any]):
    def paint(figure: Figure) -> None:
        ax = figure.subplots()
        at = _some(len(row["speed"]))
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


def why(report: Mapping[str, Any]) -> str:
    """Which yardstick judged, and why."""
    told = report.get("yardsticks") or {}
    judge: str = told.get("judge") or ""
    if judge in NAMES:
        return f"Judged by {NAMES[judge].format(span=_span(told, judge))}: {told['why']}."
    return ""


def _span(told: Mapping[str, Any], judge: Any) -> float:
    return float(((told.get("declared") or {}).get(judge) or {}).get("span_s") or 0.0)
