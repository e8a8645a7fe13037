"""The page of a sweep, `report.html` beside its table: what was best, rewards over each swept
value, learning curves, every member.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.report import diagnosis_format as fmt
from adaptsim_jax.report import explore, sweep_figures
from adaptsim_jax.report import figures as look
from adaptsim_jax.report.explore import filled
from adaptsim_jax.report.sweep_figures import TRAINING, earned, interval

MOST_MEMBERS = 1000
"""Rows of the table of members; results.csv has them all."""


def write_sweep_page(found: Mapping[str, Any], out: Path) -> Path:
    """Write the page of `results.json` into the sweep's folder, whole or not at all. Raises
    BadInput where it cannot.
    """
    write_bytes(out / "report.html", render(found).encode())
    return out / "report.html"


def render(found: Mapping[str, Any]) -> str:
    """The page as text, of a sweep that is finished or still runs."""
    rewards = [TRAINING, *found["spec"]["targets"]]
    groups = sweep_figures.groups(found)
    combinations = [
        _combination(name, rows, found["swept"], rewards) for name, rows in groups.items()
    ]
    over, curves = sweep_figures.over_values(found), sweep_figures.curves(groups)
    return filled(
        "sweep.html.j2",
        found=found,
        left=found["members"] - found["done"] - found["failed"],
        names=[_title(name) for name in rewards],
        best=_best(combinations, rewards),
        over=over,
        curves=curves,
        combinations=combinations,
        members=[_member(row, found["swept"], rewards) for row in found["rows"][:MOST_MEMBERS]],
        more_members=max(0, len(found["rows"]) - MOST_MEMBERS),
        failed=[row for row in found["rows"] if row["status"] == "failed"][:20],
        script=explore.script(bool(over or curves)),
    )


def _title(reward_name: str) -> str:
    if reward_name == TRAINING:
        return "training"
    return look.setting(reward_name)


def _combination(
    name: str, rows: Sequence[Mapping], swept: Sequence[str], rewards: Sequence[str]
) -> dict[str, Any]:
    """Means over the members of one combination of values, with the half widths of their 95 %
    intervals.
    """
    found = [interval([v for row in rows if (v := earned(row, r)) is not None]) for r in rewards]
    return {
        "name": name,
        "values": [_value(rows[0], key) for key in swept],
        "members": len(rows),
        "rewards": [
            {"value": f["mean"], "text": _text(f["mean"]), "half": _text(f["half"])} for f in found
        ],
    }


def _member(row: Mapping, swept: Sequence[str], rewards: Sequence[str]) -> dict[str, Any]:
    found = [earned(row, r) if row["status"] == "done" else None for r in rewards]
    return {
        "member": row["member"],
        "seed": row["seed"],
        "status": row["status"],
        "values": [_value(row, key) for key in swept],
        "rewards": [{"value": value, "text": _text(value)} for value in found],
    }


def _value(row: Mapping, key: str) -> str:
    value = row["values"].get(key)
    if isinstance(value, str):
        return value
    if value is None:
        return ""
    return json.dumps(value)


def _text(value: float | None) -> str:
    if value is None:
        return fmt.DASH
    return fmt.fixed(value, 3)


def _best(combinations: Sequence[Mapping], rewards: Sequence[str]) -> list[dict[str, str]]:
    """The combination of the largest mean for each reward."""
    best = []
    for i, name in enumerate(rewards):
        known = [c for c in combinations if c["rewards"][i]["value"] is not None]
        if known:
            top = max(known, key=lambda c: c["rewards"][i]["value"])
            own = top["rewards"][i]
            half = f" ± {own['half']}" if own["half"] != fmt.DASH else ""
            best.append({"name": _title(name), "reward": own["text"] + half, "values": top["name"]})
    return best
