"""Diagnose measured data: read, audit, fit, search, judge, report."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from adaptsim_jax.core.files import output_folder, write_bytes
from adaptsim_jax.diagnosis.run import Page, Run, command_of, plain
from adaptsim_jax.diagnosis.schema import check, new_report
from adaptsim_jax.effects.base import Effect, Parameter
from adaptsim_jax.effects.registry import catalogue, effect_named
from adaptsim_jax.logs.model_file import write_model
from adaptsim_jax.logs.noise.floor import noise_floor
from adaptsim_jax.logs.quality.audit import audit, usable
from adaptsim_jax.logs.quality.findings import Audit, Finding
from adaptsim_jax.logs.quality.pendulum_design import CHANNELS, check_conventions, pendulum_trials
from adaptsim_jax.logs.quality.trial_words import add_trials
from adaptsim_jax.logs.recording import read_recording, without_trials
from adaptsim_jax.logs.types import Recording
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.design.experiment import CSV, csv_of, next_experiment
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.evaluate.evidence import evidence_of
from adaptsim_jax.sysid.examine import STAGES, Diagnosis, Progress, examine, findings
from adaptsim_jax.sysid.report.augmented_model import fitted_model
from adaptsim_jax.sysid.select.trace import Trace

Reward = Callable[[Problem, Trace], dict[str, Any] | None]


def diagnose(
    data: str | Path | Recording,
    *,
    out: str | Path | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    effects: Sequence[Effect] | None = None,
    exclude: Sequence[str] = (),
    without: Sequence[str] = (),
    irrelevant: int = 0,
    settings: Criteria | None = None,
    follow_up: bool = True,
    reward: Reward | None = None,
    page: Page | None = None,
    as_declared: bool = False,
) -> dict[str, Any]:
    """Diagnose a folder of measured data; returns the report and, with `out`, writes it with its model and next experiment.

    effects: the catalogue to use (the task's own where None); exclude: names left out of it; without: trials left out;
    irrelevant: so many useless candidates are added, for tests. reward: what a named model is worth to a task, `(problem,
    found) -> {...} or None`; page: writes the report into the folder in the place of a plain `report.json`, `(folder, report,
    evidence)`. `commands.diagnose` gives both. as_declared: conventions that the motion contradicts are taken all the same. Raises
    BadInput where the data cannot be read, or contradict what is declared of their columns.
    """
    began = time.monotonic()
    say = progress or (lambda done, total, note: None)
    read = data if isinstance(data, Recording) else read_recording(data, without=without)
    recording = without_trials(read, without)
    known = tuple(effects or catalogue(recording.task))
    left_out = [effect_named(name, known).name for name in exclude]
    command = command_of(recording.path, seed=seed, exclude=left_out, without=without, as_declared=as_declared)
    run = Run(command, began, seed)
    say(1, STAGES, "audit")
    checked = audit(recording)
    if checked.fault:
        report = faulty(recording, checked) | told_in_short(recording, checked)
        return finish(report, {"audit": findings(checked)}, out, recording, run, None, page)
    chosen = tuple(e for e in known if e.name not in exclude) + useless(irrelevant)
    recording = usable(recording, checked)
    checked = checked if as_declared else replace(checked, findings=checked.findings + check_conventions(recording))
    noise = noise_floor(recording, checked)
    result = examine(recording, checked, noise, chosen, settings or Criteria(), seed, say)
    result.report.update(told_in_short(recording, checked))
    result.report["warnings"] += impossible(result.report["declared"]["before"], recording)
    add_trials(result.report, result.evidence, pendulum_trials(recording), CHANNELS)
    result.evidence["audit"] += [{"severity": "info", "where": "", "message": note} for note in recording.notes]
    if follow_up:
        add_follow_up(result, seed, say, reward)
    return finish(result.report, result.evidence, out, recording, run, result, page)


def add_follow_up(result: Diagnosis, seed: int, say: Progress, reward: Reward | None = None) -> None:
    """Put into the report what to do next: the next experiment, and what the mended model is worth to the task."""
    problem, found, named, report = result.problem, result.found, result.verdict.named, result.report
    say(8, STAGES, "next experiment")
    if plan := next_experiment(problem, found, named, result.powers, seed):
        report["next_experiment"], result.evidence["next_experiment"] = plan.told()
    if named and reward is not None and (worth := reward(problem, found)):
        report["task_reward"] = worth


def useless(count: int) -> tuple[Effect, ...]:
    """Candidates that explain nothing: a force that follows the square of an hour-long cosine."""

    def force(p, m):
        import jax.numpy as jnp

        return p["size"] * jnp.cos(37.0 * m.t + 11.0 * m.q) ** 3

    size = Parameter("size", "N m", -1.0, 1.0, 0.0)
    return tuple(
        Effect(f"irrelevant_{i}", "force", (size,), force, "nothing physical", "nothing shows it") for i in range(count)
    )


def regressors(result: Diagnosis) -> list[dict[str, Any]]:
    """For the page: each named effect's torque against what it follows."""
    found = result.found
    if not result.verdict.named:
        return []
    rows = evidence_of(result.problem, found.final, found.view, result.first, found.added)
    return [row.shown() for row in rows]


def told_in_short(recording: Recording, checked: Audit) -> dict[str, list[str]]:
    """`warnings`: a sentence for each kind of warning and channel, and the trials left out; `notes`: of the reader."""
    lines = [f"left out: {', '.join(checked.exclude)}"] if checked.exclude else []
    groups: dict[tuple[str, str], list[Finding]] = {}
    for f in checked.findings:
        if f.severity == "warn":
            groups.setdefault((f.kind, f.where if f.kind != "gap" else ""), []).append(f)
    cut = sorted({f.where for f in checked.findings if f.kind == "saturation" and f.severity == "info"})
    only = "where only its log is cut, and not the torque, what is named is wrong"
    limits = [f"{name} rests at its largest values: {only}" for name in cut]
    for (_, where), found in groups.items():
        first = found[0]
        place = f"{first.trial}: " if first.trial else ""
        more = f" (and so in {len(found) - 1} more trial{'s' if len(found) > 2 else ''})" if len(found) > 1 else ""
        own = "" if not where or first.message.startswith(where) or where in first.message else f"{where} "
        lines.append(f"{place}{own}{first.message}{more}")
    return {"warnings": lines, "notes": [*recording.notes, *limits]}


def impossible(declared: dict[str, Any], recording: Recording) -> list[str]:
    """A warning where the known values leave a link with less than no inertia, by more than a fit errs."""
    told = []
    for name, total in (("I1", "p1"), ("I2", "p3")):
        value = (declared.get(name) or {}).get("value")
        if value is not None and value < -0.1 * abs(declared[total]["value"]):
            known = ", ".join(f"{k} = {v:g}" for k, v in recording.known.items())
            told.append(
                f"with {known} known, {name} would be {value:.3g} kg m^2: no link has that; masses in kg, lengths in m?"
            )
    return told


def faulty(recording: Recording, checked: Audit) -> dict[str, Any]:
    """The report on data that contradict themselves."""
    samples = sum(len(t.time) for t in recording.trials)
    data = {"trials": len(recording.trials), "samples": samples, "held_out_trials": 0}
    return new_report(recording.task, recording.model, "data_fault", checked.message, data)


def finish(
    report,
    evidence,
    out,
    recording: Recording,
    run: Run,
    result: Diagnosis | None,
    page: Page | None,
) -> dict[str, Any]:
    """Add how it was run, and write what was asked for."""
    report["run"] = evidence["run"] = run.told()
    report = check(report)
    if out is not None:
        folder = output_folder(out)
        if result is not None:
            evidence["regressor"] = regressors(result)
        write_models(folder, result, report, recording.path)
        (folder / CSV).unlink(missing_ok=True)  # of an earlier run into the same folder
        if plan := evidence.get("next_experiment"):
            write_bytes(folder / plan["csv"], csv_of(plan["time"], plan["torque"]))
        (page or plain)(folder, report, evidence)
    return report


def write_models(folder: Path, result: Diagnosis | None, report: dict[str, Any], data: str | Path) -> None:
    """The mended model as `model.toml`; where nothing is named but a set of effects leads, that set as `leading.toml`. Those of an
    earlier run into the same folder go."""
    for name in ("model.toml", "leading.toml"):
        (folder / name).unlink(missing_ok=True)
    if result is None:
        return
    told = {key: report[key] for key in ("verdict", "message")} | {"data": data} | report["run"]
    model = result.found.final if result.verdict.named else result.found.base
    write_model(folder / "model.toml", fitted_model(result.problem, model, told))
    if result.leading is not None:
        told["message"] = "Not established: the likeliest set of effects, which explains too little for a name."
        write_model(folder / "leading.toml", fitted_model(result.problem, result.leading, told))
