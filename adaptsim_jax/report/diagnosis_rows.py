"""Rows of the page's tables: effects, declared parameters before and after, and the audit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from adaptsim_jax.core.config import Table
from adaptsim_jax.effects.registry import of_joints
from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report import diagnosis_words as words

FACTORS = {
    "camera_scale": "scale",
    "camera_scale_at_start": "scale_start",
    "length_scale": "scale",
    "speed_scale": "speed_scale",
    "lift_scale": "lift_scale",
    "clock_scale": "clock",
}
"""Parameters of effects on short trials that report.json has as a share more (0: none), and people read as a factor
(1: none).
"""  # noqa: E501


def effect_rows(report: Mapping) -> list[Table]:
    """Each effect: `title`, `fitted_as` in a class, `physics` where given, parameters with
    intervals. Not those that a finer shape would have and that stayed at zero.
    """
    rows = []
    for effect in report["effects"]:
        parameters = [
            _parameter_row(effect, name, p)
            for name, p in effect["parameters"].items()
            if p.get("meaning") or not p["value"] == p["low"] == p["high"] == 0.0
        ]
        fitted_as = None
        if effect["alternatives"]:
            fitted_as = words.plain(words.name_and_place(effect["name"], "")[0])
        rows.append(
            {
                "title": words.effect_name(effect),
                "fitted_as": fitted_as,
                "physics": effect.get("physics"),
                "parameters": parameters,
            }
        )
    return rows


def _parameter_row(effect: Mapping, name: str, p: Mapping) -> Table:
    if p["value"] == p["low"] == p["high"]:
        value = fmt.quantity(p["value"], p["unit"])
        return {"name": _held(name, p), "value": value, "interval": False}
    factor = _is_factor(effect, name)
    note = " (1: none)" if factor else ""
    return {
        "name": name.replace("_", " ") + note,
        "value": fmt.between(*_shown(p, factor), p["unit"]),
        "interval": None not in (p["low"], p["high"]),
    }


def _held(name: str, p: Mapping) -> str:
    """A parameter that was chosen, not fitted."""
    meaning = p.get("meaning")
    return name.replace("_", " ") + (f" ({meaning})" if meaning else "")


def _is_factor(effect: Mapping, name: str) -> bool:
    known = of_joints().get(effect["name"])
    if known is not None:
        return any(p.factor for p in known.parameters if p.name == name)
    return FACTORS.get(effect["name"]) == name


def _shown(p: Mapping, factor: bool) -> tuple[float | None, float | None, float | None]:
    """Value, low and high as people read them."""
    more = 1.0 if factor else 0.0
    value, low, high = (
        None if p[key] is None else more + p[key] for key in ("value", "low", "high")
    )
    return value, low, high


def declared_rows(report: Mapping) -> list[Table]:
    """Declared parameters: text before and after (no number where the data fix none), the model
    file's value, and where to draw.
    """
    meanings = words.BASE if report["task"] == "pendulum" else {}
    before, after = report["declared"]["before"], report["declared"]["after"]
    rows = []
    for name in dict.fromkeys([*before, *after]):
        stages = {"before": before.get(name), "after": after.get(name)}
        fitted = [row for row in stages.values() if row]
        in_file = (fmt.quantity(row["file"], row["unit"]) for row in fitted if "file" in row)
        notes = (row["note"] for row in fitted if row.get("note"))
        rows.append(
            {
                "name": name,
                "texts": {stage: _declared_text(row) for stage, row in stages.items()},
                "marks": _marks(stages),
                "identifiable": all(row["identifiable"] for row in fitted),
                "file": next(in_file, ""),
                "note": next(notes, meanings.get(name, "")),
            }
        )
    return rows


def _declared_text(row: Mapping | None) -> str:
    if row is None:
        return fmt.DASH
    if not row["identifiable"]:
        return "not identifiable"
    return fmt.between(row["value"], row["low"], row["high"], row["unit"])


def _marks(stages: Mapping[str, Mapping | None]) -> list[Table]:
    """Per stage the interval and the value in percent of a common range."""
    shown = {
        stage: row
        for stage, row in stages.items()
        if row and row["identifiable"] and None not in (row["value"], row["low"], row["high"])
    }
    ends = [end for row in shown.values() for end in (row["low"], row["high"], row["value"])]
    if not ends or max(ends) <= min(ends):
        return []
    low, span = min(ends), max(ends) - min(ends)

    def place(x: float) -> float:
        return round(4 + 92 * (x - low) / span, 2)

    return [
        {
            "stage": stage,
            "left": place(row["low"]),
            "width": round(place(row["high"]) - place(row["low"]), 2),
            "value": place(row["value"]),
        }
        for stage, row in shown.items()
    ]


def number_rows(report: Mapping) -> list[Table]:
    """Numbers by trial and log, those first in which one is apart: name, value, spread over each,
    which are apart and what they say, and what can be exchanged.
    """
    rows = []
    for row in report.get("numbers") or []:
        unit, like = row["unit"], abs(row["value"])
        each = {e["of"]: fmt.quantity(e["value"], unit, like=like) for e in row["each"]}
        others = [f"{z['name']} ({fmt.number(z['correlation'], 2)})" for z in row["like"]]
        spreads = {k: fmt.quantity(row[k], unit, 2, like) for k in ("trials", "logs")}
        told = {
            "name": row["name"],
            "value": fmt.between(row["value"], row["low"], row["high"], unit, like),
            "apart": [f"{name}: {each[name]}" for name in row["apart"]],
            "like": ", ".join(others),
        }
        rows.append(told | spreads)
    return sorted(rows, key=lambda row: not row["apart"])


def by_error(trials: Mapping) -> list[Mapping]:
    """Trials with their own errors, where some of them differ: those first, then by error."""
    if not trials.get("headline"):
        return []
    return sorted(
        trials["each"],
        key=lambda row: (not row["odd"], -(row["error"] or row["unexplained_torque"] or 0.0)),
    )


def audit_rows(evidence: Mapping) -> list[dict[str, str]]:
    """Findings, faults first."""
    order = {"fault": 0, "error": 0, "warning": 1}
    rows = [
        {key: str(row.get(key, "")) for key in ("severity", "where", "message")}
        for row in evidence.get("audit") or []
    ]
    return sorted(rows, key=lambda row: order.get(row["severity"], 2))


# ---------------------------------------------------------------- does the model predict at all

NAMES = {
    "stretches": "simulated stretches of {span:.3g} s",
    "whole": "whole simulated trials",
    "torque": "torque along the measured motion",
}


def why_judge(report: Mapping) -> str:
    """Which yardstick judged, and why."""
    measures = report.get("yardsticks") or {}
    judge: str = measures.get("judge") or ""
    if judge in NAMES:
        return f"Judged by {NAMES[judge].format(span=_span(measures, judge))}: {measures['why']}."
    return ""


def _span(measures: Mapping, judge: Any) -> float:
    return float(((measures.get("declared") or {}).get(judge) or {}).get("span_s") or 0.0)
