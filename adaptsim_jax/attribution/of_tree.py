"""The answer on a machine by its tree of joints: searched, reported, written to files, these run
beside the declared one.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from adaptsim_jax.attribution import model_toml
from adaptsim_jax.attribution.account import reported, write_so_far
from adaptsim_jax.attribution.criteria import CHOICE
from adaptsim_jax.attribution.equation.models import Span, TorqueSearch, made_apart
from adaptsim_jax.attribution.examine import examined
from adaptsim_jax.attribution.inquiry import Examined
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import TORQUE
from adaptsim_jax.attribution.mend import gain_notes, gains, lost, mjcf_files
from adaptsim_jax.attribution.numbers import number_rows
from adaptsim_jax.attribution.physical_inertias import named_by, otherwise
from adaptsim_jax.attribution.posed import DiagnosisSetting
from adaptsim_jax.attribution.replay import follows, recommended
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.progress import Note
from adaptsim_jax.diagnosis.recommended import WHOLE_TRIALS
from adaptsim_jax.diagnosis.written import Answer, DiagnosisRequest
from adaptsim_jax.mend.model_toml import FILE as MODEL_FILE


def answered(
    machine: Machine, setting: DiagnosisSetting, asked: DiagnosisRequest, notify: Note
) -> Answer:
    """What the torque along the motion, or simulated stretches, show of a machine."""
    keep = None if asked.folder is None else partial(write_so_far, asked.folder)
    found = examined(machine, setting, notify=notify, keep=keep)
    report, evidence = reported(found)
    _add_unlike(report, found)
    verify = None
    if asked.folder is not None:
        verify = partial(_verified, asked, found)
    summary = {k: report[k] for k in ("verdict", "message")} | asked.made
    numbers = number_rows(found, report["declared"]["after"])
    return Answer(report, evidence, _files(found, summary), verify, numbers)


def _add_unlike(report: Table, e: Examined) -> None:
    """Put into a report how the machine differs from its model file, in place."""
    machine, unlike = e.inquiry.machine, otherwise(report["declared"]["after"])
    report["notes"] += [*unlike, *gain_notes(machine), *lost(machine, e.problem, e.found)]
    if unlike and report["verdict"] == "within_noise":
        report["unlike_file"] = unlike[0]
        report["message"] = f"{report['message']} {unlike[0]} {named_by(unlike[0])}"


def _files(e: Examined, summary: Table) -> dict[str, Callable[[], str]]:
    """What makes the text of each file that holds the model. summary: of its provenance."""

    def text():
        return model_toml.text_of(e.problem, e.found.final, summary, gains(e.inquiry.machine))

    return {MODEL_FILE: text, **mjcf_files(e)}


def _verified(asked: DiagnosisRequest, e: Examined, folder: Path) -> Table:
    """Run the files of `folder` beside the declared one: over whole trials, too, of a machine that
    follows commands. Where the torque has judged, each part of the log by the same files, fitted
    without it.
    """
    machine, model = e.inquiry.machine, asked.model
    spans = {f"stretches of {CHOICE.horizon:g} s": CHOICE.horizon}
    if follows(machine):
        spans[WHOLE_TRIALS] = 0.0
    if machine.gain_unknown:  # the file's motors say nothing of a voltage or a current
        model = folder / model_toml.DECLARED
    if e.judge != TORQUE or e.by_torque is None:
        return recommended(asked.data, model, "tree", spans, asked.without)(folder)
    spans = {f"left-out {over}": span for over, span in spans.items()}
    with TemporaryDirectory() as made:
        apart: dict[Path, Span] = {}
        for part, search in made_apart(e.by_torque):
            place = Path(made, str(len(apart)))
            place.mkdir()
            for name, text in _files(_with_values(e, search), {}).items():
                (place / name).write_text(text())
            apart[place] = part
        return recommended(asked.data, model, "tree", spans, asked.without, apart)(folder)


def _with_values(e: Examined, search: TorqueSearch) -> Examined:
    """What was found with the values of another fit."""
    final = e.found.final
    final = replace(final, fit=replace(final.fit, vector=search.final))
    return replace(e, found=replace(e.found, final=final), by_torque=search)
