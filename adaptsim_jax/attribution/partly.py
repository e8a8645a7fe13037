"""A double pendulum that the strict search leaves without a name, examined effect by effect.

The search of `sysid` names effects where they explain all but the noise, and nothing else; a real rig lacks many things at once.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from adaptsim_jax.attribution.catalogue import MACHINE
from adaptsim_jax.attribution.criteria import Criteria
from adaptsim_jax.attribution.diagnose import HORIZON, Page, Progress, examined, mjcf_files, plain
from adaptsim_jax.attribution.model_toml import DECLARED
from adaptsim_jax.attribution.pendulum import declared_machine, in_the_plane, model_file
from adaptsim_jax.attribution.written import cleared, write_all
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.diagnosis.schema import check
from adaptsim_jax.logs.model_file import write_model
from adaptsim_jax.logs.quality.pendulum_design import CHANNELS, pendulum_trials
from adaptsim_jax.logs.quality.trial_words import add_trials
from adaptsim_jax.logs.types import Recording
from adaptsim_jax.mechanisms.double_pendulum.rigid import BASE_NAMES


def partly_explained(
    recording: Recording,
    strict: Mapping[str, Any],
    *,
    out: str | Path | None = None,
    exclude: Sequence[str] = (),
    criteria: Criteria | None = None,
    progress: Progress | None = None,
    page: Page | None = None,
) -> dict[str, Any] | None:
    """The report on what holds out by itself, or None where nothing does. strict: the report of the strict search, of which the
    declared model's base parameters are the start. With `out` the folder gets declared.xml, model.xml, model.toml and the report.
    """
    began = time.monotonic()
    theta = np.array([strict["declared"]["before"][k]["value"] for k in BASE_NAMES])
    known = {e.name for e in MACHINE}
    with TemporaryDirectory() as spare:
        machine = declared_machine(recording, theta, Path(spare) / DECLARED)
        report, evidence, problem, found = examined(
            machine, criteria or Criteria(), HORIZON, [n for n in exclude if n in known], progress or (lambda *_: None),
            lambda vector: in_the_plane(vector, tuple(recording.known)),
        )  # fmt: skip
        if not found.named:
            return None
        report |= {"task": recording.task, "model": recording.model}
        report["notes"] += [
            "The strict search named nothing: no effect explains all but the noise. Each one here holds out by itself."
        ]
        of_trials = (strict.get("trials") or {}).get("warnings") or []
        report["warnings"] = [w for w in strict.get("warnings") or [] if w not in of_trials]
        evidence["audit"] += [{"severity": "warn", "where": "", "message": w} for w in report["warnings"]]
        add_trials(report, evidence, pendulum_trials(recording), CHANNELS)
        run = dict(strict["run"])
        report["run"] = evidence["run"] = run | {"seconds": round(run["seconds"] + time.monotonic() - began, 1)}
        told = {k: report[k] for k in ("verdict", "message")} | {"data": recording.path} | report["run"]
        file, lost = model_file(recording, problem, found, told)
        report["notes"] += lost
        report = check(report)
        if out is not None:
            folder = cleared(output_folder(out))
            write_model(folder / "model.toml", replace(file, path=str(folder / "model.toml")))
            write_all(folder, report, evidence, page or plain, mjcf_files(machine, problem, found, criteria or Criteria()))
        return report
