"""The answer on a machine by its tree of joints: searched, reported, written to files, these run
beside the declared one.
"""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from adaptsim_jax.attribution import model_toml
from adaptsim_jax.attribution.account import reported, write_so_far
from adaptsim_jax.attribution.criteria import CHOICE
from adaptsim_jax.attribution.examine import examined
from adaptsim_jax.attribution.inquiry import Examined
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.mend import gain_notes, gains, lost, mjcf_files
from adaptsim_jax.attribution.physical_inertias import named_by, otherwise
from adaptsim_jax.attribution.posed import DiagnosisSetting
from adaptsim_jax.attribution.replay import follows, recommended
from adaptsim_jax.core.progress import Note
from adaptsim_jax.diagnosis.recommended import WHOLE_TRIALS
from adaptsim_jax.diagnosis.written import Answer, Asked
from adaptsim_jax.mend.model_toml import FILE as MODEL_FILE


def answered(machine: Machine, setting: DiagnosisSetting, asked: Asked, notify: Note) -> Answer:
    """What the torque along the motion, or simulated stretches, show of a machine."""
    keep = None if asked.folder is None else partial(write_so_far, asked.folder)
    found = examined(machine, setting, notify=notify, keep=keep)
    report, evidence = reported(found)
    _add_unlike(report, found)
    verify = None
    if asked.folder is not None:
        verify = verifier(asked.data, asked.model, asked.folder, machine, asked.without)
    return Answer(report, evidence, _files(report, found, asked.made), verify)


def _add_unlike(report: dict[str, Any], e: Examined) -> None:
    """Put into a report how the machine differs from its model file, in place."""
    machine, unlike = e.inquiry.machine, otherwise(report["declared"]["after"])
    report["notes"] += [*unlike, *gain_notes(machine), *lost(machine, e.problem, e.found)]
    if unlike and report["verdict"] == "within_noise":
        report["unlike_file"] = unlike[0]
        report["message"] = f"{report['message']} {unlike[0]} {named_by(unlike[0])}"


def _files(
    report: dict[str, Any], e: Examined, made: dict[str, Any]
) -> dict[str, Callable[[], str]]:
    """What makes the text of each file that holds the model. made: how the report was made."""
    summary = {k: report[k] for k in ("verdict", "message")} | made

    def text():
        return model_toml.text_of(e.problem, e.found.final, summary, gains(e.inquiry.machine))

    return {MODEL_FILE: text, **mjcf_files(e)}


def verifier(
    data: str | Path,
    model: str | Path | None,
    folder: Path,
    machine: Machine,
    without: Sequence[str],
) -> Callable[[Path], dict[str, Any]]:
    """What runs the files of `folder` beside the declared one: over whole trials, too, of a machine
    that follows commands.
    """
    spans = {f"stretches of {CHOICE.horizon:g} s": CHOICE.horizon}
    if follows(machine):
        spans[WHOLE_TRIALS] = 0.0
    if machine.gain_unknown:  # the file's motors say nothing of a voltage or a current
        model = folder / model_toml.DECLARED
    return recommended(data, model, "tree", spans, without)
