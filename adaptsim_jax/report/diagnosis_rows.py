"""Rows of the page's tables: effects found, the ladder of candidates, declared parameters before and after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report import diagnosis_words as words


def effect_rows(report: Mapping) -> list[dict[str, Any]]:
    """Each effect: `title`, `alternatives`, `physics` where the report has it, and its parameters with intervals."""
    rows = []
    for effect in report["effects"]:
        parameters = [
            {
                "name": words.plain(name),
                "value": fmt.between(p["value"], p["low"], p["high"], p["unit"]),
                "interval": None not in (p["low"], p["high"]),
            }
            for name, p in effect["parameters"].items()
        ]
        rows.append(
            {
                "title": words.effect_name(effect),
                "fitted_as": words.plain(effect["name"]) if effect["alternatives"] else None,
                "physics": effect.get("physics"),
                "parameters": parameters,
            }
        )
    return rows


def candidate_rows(report: Mapping) -> list[dict[str, Any]]:
    """The ladder, in the report's order (best first)."""
    largest = max([row["held_out_gain"] or 0.0 for row in report["candidates"]], default=0.0)
    return [
        {
            "name": words.plain(row["name"]),
            "where": words.plain(row["where"]),
            "status": words.status(row, report),
            "gain": fmt.percent(row["held_out_gain"]),
            "bar": max(0.0, 100 * (row["held_out_gain"] or 0.0) / largest) if largest > 0 else 0.0,
            "p": fmt.p_value(row["p_value"]),
            "why": row["why"],
        }
        for row in report["candidates"]
    ]


def declared_rows(report: Mapping) -> list[dict[str, Any]]:
    """Declared parameters: text before and after (no number where the data do not fix one), and where to draw them."""
    before, after = report["declared"]["before"], report["declared"]["after"]
    rows = []
    for name in dict.fromkeys([*before, *after]):
        stages = {"before": before.get(name), "after": after.get(name)}
        rows.append(
            {
                "name": name,
                "texts": {stage: _declared_text(row) for stage, row in stages.items()},
                "marks": _marks(stages),
                "identifiable": all(row["identifiable"] for row in stages.values() if row),
                "note": next((row["note"] for row in stages.values() if row and row.get("note")), ""),
            }
        )
    return rows


def _declared_text(row: Mapping | None) -> str:
    if row is None:
        return fmt.DASH
    if not row["identifiable"]:
        return "not identifiable"
    return fmt.between(row["value"], row["low"], row["high"], row["unit"])


def _marks(stages: Mapping[str, Mapping | None]) -> list[dict[str, Any]]:
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
