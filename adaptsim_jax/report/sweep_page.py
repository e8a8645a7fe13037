"""The page of a sweep, `report.html` beside its table: what was best, rewards over each swept
value, learning curves, every member.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.report import explore, sweep_figures
from adaptsim_jax.report import figures as look
from adaptsim_jax.report.explore import filled
from adaptsim_jax.report.sweep_figures import TRAINING, earned, interval

MOST_MEMBERS = 1000
"""Rows of the table of members; results.csv has them all."""


def write_sweep_page(found: Mapping, out: Path) -> Path:
    """Write the page of `results.json` into the sweep's folder, whole or not at all. Raises
    BadInput where it cannot.
    """
    write_bytes(out / "report.html", render(found).encode())
    return out / "report.html"


def render(found: Mapping) -> str:
    """The page as text, of a sweep that is finished or still runs."""
    rewards = [TRAINING, *found["spec"]["targets"]]
    groups = sweep_figures.groups(found)
    combinations = [(name, rows, _means(rows, rewards)) for name, rows in groups.items()]
    over, curves = sweep_figures.over_values(found), sweep_figures.curves(groups)
    failed = [row for row in found["rows"] if row["status"] == "failed"]
    return filled(
        "sweep.html.j2",
        found=found,
        left=found["members"] - found["done"] - found["failed"],
        rewards=rewards,
        names={name: look.setting(name) for name in rewards},
        best=_best(combinations, rewards),
        over=over,
        curves=curves,
        combinations=combinations,
        members=found["rows"][:MOST_MEMBERS],
        earned=earned,
        written=written,
        failed=failed[:20],
        script=explore.script(bool(over or curves)),
    )


def _means(rows: Sequence[Mapping], rewards: Sequence[str]) -> list[Table]:
    """Return of each reward the mean over the members of one combination, with the half width of
    its 95 % interval.
    """
    return [interval([v for row in rows if (v := earned(row, r)) is not None]) for r in rewards]


def written(value: Any) -> str:
    """A swept value as it stands in a table."""
    if isinstance(value, str):
        return value
    if value is None:
        return ""
    return json.dumps(value)


def _best(combinations: Sequence[tuple], rewards: Sequence[str]) -> list[tuple[str, Any, str]]:
    """Return of each reward its name, the largest mean, and the combination that has it."""
    best = []
    for i, name in enumerate(rewards):
        known = [(means[i], group) for group, _, means in combinations if means[i]["count"]]
        if known:
            best.append((name, *max(known, key=lambda one: one[0]["mean"])))
    return best
