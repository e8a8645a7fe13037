"""Diagnose a recording of `task = "pendulum"`: a double pendulum is a mechanism like any other,
whose masses nobody declared.
"""

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.optimize import lsq_linear

from adaptsim_jax.attribution import model_toml
from adaptsim_jax.attribution.account import reported, write_so_far
from adaptsim_jax.attribution.examine import examined
from adaptsim_jax.attribution.inquiry import Examined
from adaptsim_jax.attribution.load import read_mended
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.measures import STRETCHES
from adaptsim_jax.attribution.mend import MODEL, mjcf_files
from adaptsim_jax.attribution.model_toml import DECLARED
from adaptsim_jax.attribution.pendulum import (
    LINEAR,
    MOST,
    PARAMETERS,
    RIGID,
    check_rig,
    declared_machine,
    declared_values,
    doubted,
    in_the_plane,
    own_keys,
    pendulum_machine,
    rig_of,
)
from adaptsim_jax.attribution.posed import DiagnosisSetting
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.core.progress import Note, Report, notes_of
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.run import Page, Run, command_of
from adaptsim_jax.diagnosis.schema import new_report, with_effects
from adaptsim_jax.diagnosis.written import Output, cleared, finished
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.actuator import TORQUE_GAIN
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.logs.log import Log
from adaptsim_jax.logs.log_meta import Rig
from adaptsim_jax.logs.pendulum import check_known, read_pendulum
from adaptsim_jax.logs.quality.audit import Audit, audit, usable
from adaptsim_jax.logs.quality.hypotheses import motion_of
from adaptsim_jax.logs.quality.pendulum_design import (
    WORDS,
    check_conventions,
    pendulum_trials,
    rig_design,
    tracks_of,
)
from adaptsim_jax.logs.quality.trial_words import add_trials
from adaptsim_jax.mechanisms.double_pendulum.plant import JOINTS
from adaptsim_jax.mend.model_toml import FILE as MODEL_FILE

LINKS = (
    "m1",
    "m2",
    "lc1",
    "lc2",
    "I1",
    "I2",
    "b1",
    "b2",
)  # of which base parameters are made, and which may be known


def diagnose_pendulum(
    data: str | Path | Log,
    *,
    out: str | Path | None = None,
    exclude: Sequence[str] = (),
    without: Sequence[str] = (),
    criteria: Criteria | None = None,
    progress: Report | None = None,
    page: Page | None = None,
    as_declared: bool = False,
    effects: Sequence[Effect] | None = None,
) -> Table:
    """Which effects a recorded double pendulum has that a rigid body lacks.

    Args:
        data: A folder with `meta.toml` (`task = "pendulum"`) and a CSV a trial, or the recording
            read.
        out: Folder for the report, its page, `model.toml`, `declared.xml` and `model.xml`; None:
            nothing is written.
        exclude: Names of effects that are not considered.
        without: Names of trials that are left out.
        criteria: What counts as an effect.
        progress, page: As of `attribution.diagnose.diagnose`.
        as_declared: What the motion contradicts of the columns is taken all the same.
        effects: The catalogue, ours where None.

    Returns:
        The report (`diagnosis.schema`). Raises BadInput where the data cannot be read, or
        contradict what is declared of them.
    """
    began = time.monotonic()
    notify = notes_of(progress)
    notify("reading")
    log = data if isinstance(data, Log) else read_pendulum(data, without=without)
    log = log.without([name for name in without if name in {t.name for t in log.trials}])
    rig, checked = rig_of(log), audit(log)
    given = {"exclude": exclude, "without": without, "as_declared": as_declared}
    run = Run(command_of(log.path, out, **given), began)
    folder = None if out is None else cleared(output_folder(out))
    output = Output(folder, page)
    if checked.fault:
        counts = {"trials": len(log.trials), "samples": log.samples, "held_out_trials": 0}
        report = new_report(rig.task, rig.model, "data_fault", checked.message, counts)
        report |= {"warnings": checked.warnings, "notes": [*log.notes, *checked.limits]}
        return finished(report, {"audit": checked.rows}, run, output)
    log = usable(log, checked)
    if not as_declared:
        checked = replace(checked, findings=checked.findings + check_conventions(log))
    setting = DiagnosisSetting(
        criteria or Criteria(),
        exclude=tuple(exclude),
        effects=effects,
        objective=STRETCHES,
        torques=rig.model == LINEAR,
    )
    return _searched(log, checked, setting, notify, run, output)


def _searched(
    log: Log,
    checked: Audit,
    setting: DiagnosisSetting,
    notify: Note,
    run: Run,
    output: Output,
) -> Table:
    """The report on a recording that is sound, written. See `diagnose_pendulum`."""
    rig, folder = rig_of(log), output.folder
    keep = None if folder is None else partial(write_so_far, folder)
    with TemporaryDirectory() as spare:
        machine = _machine(log, setting.effects, Path(spare))
        found = examined(machine, setting, in_the_plane, notify, keep)
        report, evidence = _reported(log, found, checked)
        provenance = {k: report[k] for k in ("verdict", "message")}
        provenance |= {"data": log.path} | run.as_dict()
        files = {**mjcf_files(found), MODEL_FILE: partial(_model_text, rig, found, provenance)}
        if rig.model == LINEAR:  # which no MJCF can say
            del files[MODEL]
        return finished(report, evidence, run, replace(output, files=files))


def _machine(log: Log, effects: Sequence[Effect] | None, spare: Path) -> Machine:
    """The rig as a mechanism: by its mended model, or as declared (written to the folder `spare`).

    Raises BadInput where its model is of another rig.
    """
    rig = rig_of(log)
    if rig.model_file is None:
        return declared_machine(log, first_parameters(log), spare / DECLARED)
    check_rig(rig)
    given, declared = read_mended(rig.model_file)
    known = {e.name: e for e in (*MACHINE, *(effects or ()))}
    made = pendulum_machine(log, declared)
    return model_toml.applied(given, rig.model_file, made, tuple(known.values()))


def _model_text(rig: Rig, e: Examined, provenance: Table) -> str:
    """`model.toml` of what was found."""
    return model_toml.text_of(e.problem, e.found.final, provenance, more=own_keys(rig))


def _reported(log: Log, e: Examined, checked: Audit) -> tuple[Table, Table]:
    """The report in the rig's own numbers, and the arrays behind its page."""
    rig, problem = rig_of(log), e.problem

    def rows(model):
        return {
            k: asdict(v) | {"identifiable": v.fitted}
            for k, v in declared_values(rig, problem, model).items()
        }

    report, evidence = reported(
        e, lambda made: replace(made, task=rig.task, model=rig.model, declared=rows)
    )
    report["warnings"] = [
        *checked.warnings,
        *doubted(rig.known, declared_values(rig, problem, e.found.final)),
    ]
    report["notes"] += checked.limits
    _of_unknown_masses(report, rig)
    add_trials(report, evidence, pendulum_trials(log), WORDS)
    evidence["audit"] += checked.rows
    return report, evidence


def first_parameters(log: Log) -> np.ndarray:
    """Declared parameters [P] at which the fit begins.

    By bounded least squares on block means of the motion, which no simulation leads astray: torques
    are linear in them. Where no torque acts, which fixes them up to a common factor, the first is
    held at 1, unless one of them is known. Raises BadInput where `[known]` names what the model has
    not.
    """
    rig = rig_of(log)
    names = PARAMETERS[rig.model]
    if rig.model == RIGID and "l1" not in rig.geometry:
        raise BadInput("meta.toml: [geometry] lacks l1, the length of link 1; add it in metres")
    check_known(log.path, rig.known, (*names, *(LINKS if rig.model == RIGID else ())))
    low = np.array([lowest for _, lowest in names.values()])
    theta = np.array([rig.known.get(k, at) for k, at in zip(names, low, strict=True)])
    free = np.array([name not in rig.known for name in names])
    if not log.driven and free.all():
        theta[0], free[0] = 1.0, False
    motion = motion_of(tracks_of(log))
    dampings = motion.v[:, :, None] * np.eye(2)
    columns = np.concatenate([rig_design(rig)(motion, True), dampings], 2).reshape(-1, len(theta))
    size = np.linalg.norm(columns, axis=0) + 1e-30
    rest = motion.tau.reshape(-1) - columns[:, ~free] @ theta[~free]
    bounds = low[free] * size[free], MOST * size[free]
    theta[free] = lsq_linear(columns[:, free] / size[free], rest, bounds).x / size[free]
    return theta


def _of_unknown_masses(report: Table, rig: Rig) -> None:
    """Where nothing of the masses is known, the gain g of one joint's torque is that of the other's
    by 1 / (1 + g), all masses and dampings being as many times less: put among the alternatives, in
    place.
    """
    gains = [e for e in report["effects"] if e["name"] == TORQUE_GAIN.name and e["where"] in JOINTS]
    if rig.known or rig.model_file is not None or len(gains) != 1:
        return
    (effect,) = gains
    other = f"torque_gain@{JOINTS[1 - JOINTS.index(effect['where'])]}"
    if other not in effect["alternatives"]:
        effect["alternatives"].append(other)
    with_effects(report, report["effects"])
    size = 1.0 / (1.0 + effect["parameters"]["gain"]["value"]) - 1.0
    report["notes"].append(
        f"{other.replace('@', ' at ')} of {size:.3g}, with masses and dampings {1.0 + size:.3g} "
        "times those told here, makes the same motion: no mass is known; give what is known of "
        "them under [known] in meta.toml."
    )
