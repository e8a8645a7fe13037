"""Diagnose a recording of any mechanism: which effects its model file lacks, what is left, and a
better model file.

Read, check, declare, search, mend, verify, report: each step is a function of what the one before
returns. What follows targets is searched in closed loop, anything else by its tree of joints.
"""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from adaptsim_jax.attribution import of_servos, of_tree
from adaptsim_jax.attribution.conventions import (
    check_conventions,
    check_signals,
    mechanism_trials,
    words_of,
)
from adaptsim_jax.attribution.criteria import CHOICE
from adaptsim_jax.attribution.load import load
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import WHOLE
from adaptsim_jax.attribution.posed import DiagnosisSetting, scaled
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.core.progress import Report, notes_of
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.numbers import add_numbers
from adaptsim_jax.diagnosis.run import Page, Run, command_of
from adaptsim_jax.diagnosis.written import Answer, DiagnosisRequest, Output, cleared, finished
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.logs.pool import Data
from adaptsim_jax.logs.quality.findings import AuditFinding
from adaptsim_jax.logs.quality.trial_words import add_trials

HORIZON = CHOICE.horizon


def diagnose(
    data: Data,
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
    """Diagnose a recording (a folder with `task = "mechanism"`, or a log file with `model`; or
    several of one machine, pooled). Returns the report and, with `out`, writes it with `model.xml`.

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
    machine = load(data, model).without(without)
    notify("conventions")
    warned = () if as_declared else check_conventions(machine)
    machine, setting = _declared(machine, setting)
    folder = None if out is None else cleared(output_folder(out))
    command = command_of(
        data,
        out=out,
        model=model,
        exclude=exclude,
        without=without,
        as_declared=as_declared,
        yardstick=yardstick,
        horizon=None if horizon == HORIZON else horizon,
        simulator=_simulator_asked(machine),
    )
    asked = DiagnosisRequest(data, model, folder, tuple(without), Run(command, began))
    answer = of_servos.answered(machine, setting, asked, notify)
    if answer is None:
        answer = of_tree.answered(machine, setting, asked, notify)
    _add_signals(answer, machine, warned)
    add_numbers(answer.report, answer.evidence, answer.numbers, machine.log.labels)
    output = Output(folder, page, answer.files, answer.verify)
    return finished(answer.report, answer.evidence, asked.run, output)


def _declared(machine: Machine, setting: DiagnosisSetting) -> tuple[Machine, DiagnosisSetting]:
    """The machine with the gain of its drives, and stretches as long as trials where whole ones are
    to judge.
    """
    if setting.objective == WHOLE:
        setting = replace(setting, horizon=0.98 * min(t.span for t in machine.tracks))
    return scaled(machine, setting.horizon), setting


def _add_signals(answer: Answer, machine: Machine, warned: tuple[AuditFinding, ...]) -> None:
    """Put into a report, and what its page gets, what the signals say of themselves, in place."""
    report, evidence, checked = answer.report, answer.evidence, check_signals(machine)
    report["warnings"] = [*(f.message for f in warned), *checked.warnings]
    report["notes"] += checked.limits
    add_trials(report, evidence, mechanism_trials(machine), words_of(machine))
    checked = replace(checked, findings=(*warned, *checked.findings))
    evidence["audit"] = checked.rows + evidence["audit"]


def _simulator_asked(machine: Machine) -> str | None:
    """The simulator that the command has to name, for meta.toml says another."""
    meta = machine.log.meta
    return "tree" if meta.simulator == "mujoco" or meta.channels else None
