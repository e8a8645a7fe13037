"""Diagnose a recording of `task = "pendulum"`: a double pendulum is a mechanism like any other,
whose masses nobody declared.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from adaptsim_jax.attribution.diagnose import HORIZON, Page, Progress, examined, mjcf_files
from adaptsim_jax.attribution.model_toml import DECLARED
from adaptsim_jax.attribution.pendulum import (
    JOINTS,
    LINEAR,
    RIGID,
    declared_machine,
    declared_values,
    doubted,
    in_the_plane,
    model_file,
    own_catalogue,
    pendulum_machine,
)
from adaptsim_jax.attribution.yardsticks import STRETCHES
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.run import Run, command_of, plain
from adaptsim_jax.diagnosis.schema import check, new_report
from adaptsim_jax.diagnosis.written import cleared, write_all, write_partial
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.logs.meta import check_known
from adaptsim_jax.logs.model_file import declared_model
from adaptsim_jax.logs.noise.floor import noise_floor, smooth
from adaptsim_jax.logs.quality.audit import audit, usable
from adaptsim_jax.logs.quality.findings import Audit
from adaptsim_jax.logs.quality.pendulum_design import CHANNELS, check_conventions, pendulum_trials
from adaptsim_jax.logs.quality.trial_words import add_trials
from adaptsim_jax.logs.recording import read_recording, without_trials
from adaptsim_jax.logs.types import Recording, Trial
from adaptsim_jax.mechanisms.registry import make_plant
from adaptsim_jax.mend.pendulum_model import ModelFile, text_of

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
LEAST_ROWS = 64  # of a part of a trial between rows without angles, that is smoothed by itself


def diagnose_pendulum(
    data: str | Path | Recording,
    *,
    out: str | Path | None = None,
    exclude: Sequence[str] = (),
    without: Sequence[str] = (),
    criteria: Criteria | None = None,
    progress: Progress | None = None,
    page: Page | None = None,
    as_declared: bool = False,
    effects: Sequence[Effect] | None = None,
    reward: Callable[[ModelFile, ModelFile], dict[str, Any] | None] | None = None,
) -> dict[str, Any]:
    """Which effects a recorded double pendulum has that a rigid body lacks.

    Args:
        data: a folder with `meta.toml` (`task = "pendulum"`) and a CSV a trial, or the recording
                read.
        out: folder for the report, its page, `model.toml`, `declared.xml` and `model.xml`; None:
                nothing is written.
        exclude: names of effects that are not considered. without: names of trials that are left
                out.
        criteria: what counts as an effect. progress, page: as of `attribution.diagnose.diagnose`.
        as_declared: what the motion contradicts of the columns is taken all the same. effects: the
                catalogue, ours where None.
        reward: what the mended model is worth to the task, of the declared and the mended model.

    Returns:
        The report (`diagnosis.schema`). Raises BadInput where the data cannot be read, or
        contradict what is declared of them.
    """
    began = time.monotonic()
    say = progress or (lambda done, total, note: None)
    say(0.02, 1.0, "reading")
    if isinstance(data, Recording):
        read = data
    else:
        read = read_recording(data, without=without)
    recording = without_trials(read, without)
    checked = audit(recording)
    run = Run(
        command_of(
            recording.path, out=out, exclude=exclude, without=without, as_declared=as_declared
        ),
        began,
    )
    folder = None if out is None else cleared(output_folder(out))
    if checked.fault:
        data_told = {
            "trials": len(recording.trials),
            "samples": _samples(recording),
            "held_out_trials": 0,
        }
        report = new_report(
            recording.task, recording.model, "data_fault", checked.message, data_told
        )
        told = {"warnings": checked.warnings, "notes": [*recording.notes, *checked.limits]}
        return _written(report | told, {"audit": checked.rows}, run, folder, page, {})
    recording = masked(usable(recording, checked), checked)
    if as_declared:
        checked = checked
    else:
        checked = replace(checked, findings=checked.findings + check_conventions(recording))
    with TemporaryDirectory() as spare:
        if recording.model_file is None:
            machine = declared_machine(
                recording, first_parameters(recording, checked), Path(spare) / DECLARED
            )
        else:
            declared_model(
                recording, own_catalogue(recording.task, effects or ())
            )  # BadInput where it is of another rig
            machine = pendulum_machine(recording, recording.model_file, effects or ())
        report, evidence, whole = examined(
            machine,
            criteria or Criteria(),
            HORIZON,
            tuple(exclude),
            say,
            in_the_plane,
            effects,
            None if folder is None else lambda so_far: write_partial(folder, so_far),
            STRETCHES,
            torques=recording.model == LINEAR,
        )
        problem, found = whole.problem, whole.found
        report |= {"task": recording.task, "model": recording.model}

        def rows(model):
            return {
                k: asdict(v) | {"identifiable": v.fitted}
                for k, v in declared_values(recording, problem, model).items()
            }

        report["declared"] = {"before": rows(found.null), "after": rows(found.final)}
        report["warnings"] = [
            *checked.warnings,
            *doubted(recording.known, declared_values(recording, problem, found.final)),
        ]
        report["notes"] += checked.limits
        _of_unknown_masses(report, recording)
        add_trials(report, evidence, pendulum_trials(recording), CHANNELS)
        evidence["audit"] += checked.rows
        provenance = (
            {k: report[k] for k in ("verdict", "message")} | {"data": recording.path} | run.told()
        )
        null, _ = model_file(recording, problem, found.null, {})
        file, lost = model_file(recording, problem, found.final, provenance)
        report["notes"] += lost
        if reward is not None and found.named:
            try:
                report |= {"task_reward": worth} if (worth := reward(null, file)) else {}
            except (
                Exception
            ) as error:  # policies are trained for it: the search must not go with them
                report["warnings"].append(
                    f"what it is worth to the task is not known: {' '.join(str(error).split())}"
                )
        files = {}
        if folder is not None:
            files = {"model.toml": lambda: text_of(file)}
            if recording.model != LINEAR:  # which no MJCF can say
                files |= mjcf_files(machine, whole, criteria or Criteria())
        return _written(report, evidence, run, folder, page, files)


def first_parameters(recording: Recording, checked: Audit) -> np.ndarray:
    """Declared parameters [P] at which the fit begins: by regression of the momentum balance on the
    smoothed motion (`Plant.initial_theta`), which no simulation leads astray. Raises BadInput where
    `[known]` names what the model has not.
    """
    if recording.model not in (RIGID, LINEAR):
        raise BadInput(
            f'{recording.path}: model = "{recording.model}" is not diagnosed; write it as an MJCF, '
            f'and task = "mechanism"'
        )
    plant = make_plant(recording.model, recording.angle_zero, recording.geometry, recording.known)
    links = LINKS if recording.model == RIGID else ()
    check_known(recording.path, recording.known, (*plant.theta_names, *links))
    noise = noise_floor(recording, checked)
    motions = [(t, *smooth(t, noise)) for whole in recording.trials for t in _unbroken(whole)]
    if any(np.any(t.torque) for t in recording.trials):
        plant = plant
    else:
        plant = plant.unscaled()
    return plant.initial_theta([(t.time, q, v, t.torque) for t, q, v in motions])


def _unbroken(trial: Trial) -> list[Trial]:
    """The trial, or its parts between rows that have no angles: those of `LEAST_ROWS` or more, else
    the longest.
    """
    seen = np.all(np.isfinite(trial.q), axis=1)
    if seen.all():
        return [trial]
    parts = [
        p for p in np.split(np.arange(len(seen)), np.flatnonzero(np.diff(seen)) + 1) if seen[p[0]]
    ]
    longest = max(map(len, parts), default=0)

    def cut(z, rows):
        if z is None:
            return None
        return z[rows]

    return [
        replace(
            trial,
            **{
                name: cut(getattr(trial, name), p)
                for name in ("time", "q", "v", "torque", "commanded")
            },
        )
        for p in parts
        if len(p) >= min(LEAST_ROWS, longest)
    ]


def _of_unknown_masses(report: dict[str, Any], recording: Recording) -> None:
    """Where nothing of the masses is known, the gain g of one joint's torque is that of the other's
    by 1 / (1 + g), all masses and dampings being as many times less: put among the alternatives, in
    place.
    """
    gains = [e for e in report["effects"] if e["name"] == "torque_gain" and e["where"] in JOINTS]
    if recording.known or recording.model_file is not None or len(gains) != 1:
        return
    (effect,) = gains
    other = f"torque_gain@{JOINTS[1 - JOINTS.index(effect['where'])]}"
    if other not in effect["alternatives"]:
        effect["alternatives"].append(other)
    if report["verdict"] == "explained":
        report["verdict"] = "explained_class"
    size = 1.0 / (1.0 + effect["parameters"]["gain"]["value"]) - 1.0
    report["notes"].append(
        f"{other.replace('@', ' at ')} of {size:.3g}, with masses and dampings {1.0 + size:.3g} "
        f"times those told here, makes the same "
        "motion: no mass is known; give what is known of them under [known] in meta.toml."
    )


def masked(recording: Recording, checked: Audit) -> Recording:
    """The recording without the rows that the audit found frozen or spiked: their angles are
    NaN.
    """

    def hidden(t):
        if t.name in checked.valid:
            return np.where(checked.valid[t.name][:, None], t.q, np.nan)
        return t.q

    return replace(recording, trials=tuple(replace(t, q=hidden(t)) for t in recording.trials))


def _samples(recording: Recording) -> int:
    return sum(len(t.time) for t in recording.trials)


def _written(
    report, evidence, run: Run, folder: Path | None, page: Page | None, files
) -> dict[str, Any]:
    """With how it was run, checked, and written where a folder is given."""
    report["run"] = evidence["run"] = run.told()
    if folder is not None:
        write_all(folder, report, evidence, page or plain, files)
    return check(report)
