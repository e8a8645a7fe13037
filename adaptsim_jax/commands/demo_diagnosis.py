"""The tour's diagnosis: a recording of a motor with a hanging rod, and what the model of it lacks."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from adaptsim_jax.attribution.diagnose import diagnose
from adaptsim_jax.commands.demo_config import HINGE, PENDULUM
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.core.progress import Report
from adaptsim_jax.report.diagnosis import write_diagnosis


class Diagnosed(NamedTuple):
    """report: as report.json; held_out: measured and simulated angles of a trial, as the page of a diagnosis is given them."""

    report: dict[str, Any]
    held_out: list[dict[str, Any]]


def hinge_part(out: Path, report: Report) -> Diagnosed:
    """Diagnose the sample of one hinge into `out/diagnosis`."""
    kept: dict[str, Any] = {}

    def page(folder: Path, found: dict[str, Any], evidence: dict[str, Any]) -> None:
        write_diagnosis(folder, found, evidence)
        kept.update(evidence)

    report(0, 1, "reading")
    found = diagnose(HINGE, out=output_folder(out / "diagnosis"), progress=report, page=page)
    report(1, 1, f"verdict: {found['verdict'].replace('_', ' ')}")
    return Diagnosed(found, list(kept.get("held_out") or [])[:1])


def double_part(out: Path, seed: int, report: Report) -> dict[str, Any]:
    """Diagnose the sample of the double pendulum into `out/double`."""
    from adaptsim_jax.commands.diagnose import diagnose as of_pendulum
    from adaptsim_jax.commands.diagnose import paced

    report(0, 1, "reading")
    found = of_pendulum(PENDULUM, out=output_folder(out / "double"), seed=seed, progress=paced(report))
    report(1, 1, f"verdict: {found['verdict'].replace('_', ' ')}")
    return found
