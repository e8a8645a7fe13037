"""Diagnose a recording of any mechanism: which effects its model file lacks, what is left, and a
better model file.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from adaptsim_jax.attribution import closed_loop, model_toml, servo_files
from adaptsim_jax.attribution.account import reported, write_so_far
from adaptsim_jax.attribution.conventions import (
    channels,
    check_conventions,
    check_signals,
    mechanism_trials,
)
from adaptsim_jax.attribution.criteria import CHOICE
from adaptsim_jax.attribution.examine import examined
from adaptsim_jax.attribution.inquiry import Examined
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import WHOLE
from adaptsim_jax.attribution.mend import (
    gain_notes,
    gains,
    lost,
    mjcf_files,
)
from adaptsim_jax.attribution.physical_inertias import named_by, otherwise
from adaptsim_jax.attribution.posed import DiagnosisSetting, scaled
from adaptsim_jax.attribution.replay import follows, recommended
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.core.progress import Note, Report, notes_of
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.recommended import WHOLE_TRIALS
from adaptsim_jax.diagnosis.run import Page, Run, command_of
from adaptsim_jax.diagnosis.written import Output, cleared, finished
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.logs.quality.findings import AuditFinding
from adaptsim_jax.logs.quality.trial_words import add_trials
from adaptsim_jax.mend.model_toml import FILE as MODEL_FILE

HORIZON = CHOICE.horizon


def diagnose(
    data: str | Path,
    *,
    model: str | Path | None = None,
    out: str | Path | None = None,
    criteria: Criteria | None = None,
    horizon: float = HORIZON,
    exclude: tuple[str, ...] = (),
    without: tuple[str, ...] = (),
    progress: Report | None = None,
    page: Page | None = None,
    as_declared: bool = False,
    effects: Sequence[Effect] | None = None,
    yardstick: str | None = None,
) -> dict[str, Any]:
    """Diagnose a recording (a folder with `task = "mechanism"`, or a log file with `model`).
    Returns the report and, with `out`, writes it with `model.xml`.

    Raises BadInput where the data or the model cannot be read, or the data contradict what is
    declared of their columns.

    Args:
        exclude: Effects that are not considered.
        without: Trials left out.
        as_declared: Conventions that the motion contradicts are taken all the same.
        effects: The catalogue, ours where None.
        yardstick: Stretches, whole or torque, where not the one that tells most is to judge.
    """
    began = time.monotonic()
    setting = DiagnosisSetting(criteria or Criteria(), horizon, tuple(exclude), effects, yardstick)
    notify = notes_of(progress)
    notify("reading")
    declared = load(data, model).without(without)
    notify("conventions")
    warned = () if as_declared else check_conventions(declared)
    if yardstick == WHOLE:
        span = 0.98 * min(float(t.time[-1] - t.time[0]) for t in declared.tracks)
        setting = replace(setting, horizon=span)
    declared = scaled(declared, setting.horizon)
    folder = None if out is None else cleared(output_folder(out))
    keep = None if folder is None else partial(write_so_far, folder)
    command = command_of(
        data,
        out=out,
        model=model,
        exclude=exclude,
        without=without,
        as_declared=as_declared,
        yardstick=yardstick,
        horizon=None if horizon == HORIZON else horizon,
        simulator=_simulator_asked(declared),
    )
    run = Run(command, began)
    made = {"data": str(data), **run.as_dict()}
    if servos := _in_closed_loop(declared, setting, notify):
        report, evidence = closed_loop.reported(servos)
        files, verify = servo_files.files(servos, made), servo_files.verifier(servos)
    else:
        found = examined(declared, setting, notify=notify, keep=keep)
        report, evidence = reported(found)
        _of_the_file(report, declared, found)
        files = _files(report, declared, found, made)
        verify = None if folder is None else verifier(data, model, folder, declared, without)
    _of_the_signals(report, evidence, declared, warned)
    return finished(report, evidence, run, Output(folder, page, files, verify))


def _in_closed_loop(
    machine: Machine, setting: DiagnosisSetting, notify: Note
) -> closed_loop.ServoDiagnosis | None:
    """What the closed loop of a machine's servos shows, where nothing else was asked for."""
    if setting.objective not in (None, WHOLE) or setting.effects is not None:
        return None
    few = setting.criteria.torque.simulated
    return closed_loop.diagnosed(machine, setting.exclude, few, notify)


def _of_the_file(
    report: dict[str, Any],
    machine: Machine,
    e: Examined,
) -> None:
    """Put into a report how the machine differs from its model file, in place."""
    unlike = otherwise(report["declared"]["after"])
    report["notes"] += [*unlike, *gain_notes(machine), *lost(machine, e.problem, e.found)]
    if unlike and report["verdict"] == "within_noise":
        report["unlike_file"] = unlike[0]
        report["message"] = f"{report['message']} {unlike[0]} {named_by(unlike[0])}"


def _of_the_signals(
    report: dict[str, Any],
    evidence: dict[str, Any],
    machine: Machine,
    warned: tuple[AuditFinding, ...],
) -> None:
    """Put into a report, and what its page gets, what the signals say of themselves, in place."""
    checked = check_signals(machine)
    report["warnings"] = [*(f.message for f in warned), *checked.warnings]
    report["notes"] += checked.limits
    add_trials(report, evidence, mechanism_trials(machine), channels(machine))
    checked = replace(checked, findings=(*warned, *checked.findings))
    evidence["audit"] = checked.rows + evidence["audit"]


def _simulator_asked(machine: Machine) -> str | None:
    """The simulator that the command has to name, for meta.toml says another."""
    meta = machine.log.meta
    return "tree" if meta.simulator == "mujoco" or meta.channels else None


def _files(
    report: dict[str, Any], machine: Machine, e: Examined, run: dict[str, Any]
) -> dict[str, Callable[[], str]]:
    """What makes the text of each file that holds the model."""
    summary = {k: report[k] for k in ("verdict", "message")} | run

    def text():
        final = e.found.final
        return model_toml.text_of(e.problem, final, summary, gains(machine))

    return {MODEL_FILE: text, **mjcf_files(e)}


def verifier(
    data: str | Path,
    model: str | Path | None,
    folder: Path,
    declared: Machine,
    without: Sequence[str],
) -> Callable[[Path], dict[str, Any]]:
    """What runs the files of `folder` beside the declared one: over whole trials, too, of a machine
    that follows commands.
    """
    spans = {f"stretches of {CHOICE.horizon:g} s": CHOICE.horizon}
    if follows(declared):
        spans[WHOLE_TRIALS] = 0.0
    if declared.gain_unknown:  # the file's motors say nothing of a voltage or a current
        model = folder / model_toml.DECLARED
    return recommended(data, model, "tree", spans, without)
