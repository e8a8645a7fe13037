"""The tour's diagnoses: recordings of a motor with a hanging rod and of a double pendulum, and what
the models of them lack.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from adaptsim_jax.commands.diagnose import diagnose
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.core.progress import Report
from adaptsim_jax.report.diagnosis import write_diagnosis


class Diagnosed(NamedTuple):
    """report: as report.json; held_out: measured and simulated angles of a trial, as the page of a
    diagnosis is given them.
    """

    report: dict[str, Any]
    held_out: list[dict[str, Any]]


def diagnosed(data: Path, out: Path, report: Report) -> Diagnosed:
    """Diagnose a sample into the folder `out`."""
    kept: dict[str, Any] = {}

    def page(folder: Path, found: dict[str, Any], evidence: dict[str, Any]) -> None:
        write_diagnosis(folder, found, evidence)
        kept.update(evidence)

    report(0, 1, "reading")
    found = diagnose(data, out=output_folder(out), progress=report, page=page)
    report(1, 1, f"verdict: {found['verdict'].replace('_', ' ')}")
    return Diagnosed(found, list(kept.get("held_out") or [])[:1])
