"""Diagnose any simulator: what recorded stretches show, what is left, what could have been found,
what to run next.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.files import output_folder
from adaptsim_jax.core.progress import notes_of
from adaptsim_jax.diagnosis import rows
from adaptsim_jax.diagnosis.criteria import REPORT, Criteria
from adaptsim_jax.diagnosis.experiment import discriminating, power_rows
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.models import Model
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.report import (
    Account,
    Errors,
    Headline,
    error_rows,
    interval_units,
    page_tracks,
    report_of,
    withhold_names,
)
from adaptsim_jax.diagnosis.run import Page, Run
from adaptsim_jax.diagnosis.simulator import Simulator, check_simulator
from adaptsim_jax.diagnosis.starts import problem_of
from adaptsim_jax.diagnosis.straight import doing_nothing, skill
from adaptsim_jax.diagnosis.testing import smallest_p
from adaptsim_jax.diagnosis.trials import search_trials
from adaptsim_jax.diagnosis.written import MODEL, Output, cleared, finished, keeping
from adaptsim_jax.mend.model_toml import Form, Value, added_effects

METRIC = "median over left-out stretches of the RMS error of a signal over its noise, starts fitted"


def diagnose_simulator(
    simulator: Simulator,
    *,
    out: str | Path | None = None,
    criteria: Criteria | None = None,
    exclude: Sequence[str] = (),
    progress: Callable[[float, float, str], None] | None = None,
    page: Page | None = None,
    proposals: Mapping[str, Simulator] | None = None,
    name: str = "simulator",
    command: str | None = None,
) -> Table:
    """Which of a simulator's candidates hold out on left-out stretches.

    Args:
        simulator: What predicts, and what was measured (`diagnosis.simulator.Simulator`).
        out: Folder for `report.json`, its page, `model.toml` and what the simulator writes of its
            own; None: nothing is written.
        criteria: What counts as an effect.
        exclude: Names of candidates that are not considered.
        progress: Told of `(done, total, note)`.
        page: Writes the report and its page, a plain `report.json` where None.
        proposals: by name, the same simulator over stretches that could be run (what is measured
            in them does not matter): the report says which tells the look-alikes apart.
        name: Of the model, in the report.
        command: What gives the same answer, told there.

    Returns:
        The report (`diagnosis.schema`); errors are over each signal's noise. Raises BadInput where
        sizes or names do not agree.
    """
    began = time.monotonic()
    check_simulator(simulator)
    criteria = criteria or Criteria()
    retained = rows.check_exclude(tuple(exclude), simulator.candidates, "simulator")
    folder = None if out is None else cleared(output_folder(out))
    step = notes_of(progress)
    step("starts")
    problem = problem_of(simulator, retained)
    found = search_trials(problem, criteria, step, keep=keeping(folder, "simulator", name, problem))
    report, evidence = reported(simulator, problem, found, criteria, proposals or {}, name)
    run = Run(command or f"diagnose_simulator({name})", began)
    values = by_name(problem, found.final)
    own = {file: partial(make, values) for file, make in getattr(simulator, "mended", {}).items()}
    files = {MODEL: mended_model(problem, found, name).text, **own}
    output = Output(folder, page, files, getattr(simulator, "verify", None))
    return finished(report, evidence, run, output)


def reported(
    simulator: Simulator,
    problem: Problem,
    found: Finding,
    criteria: Criteria,
    proposals: Mapping[str, Simulator],
    name: str,
) -> tuple[Table, Table]:
    """The report, and the arrays behind its page."""
    s = simulator.stretches
    both = {"before": unweighted(problem, found.null), "after": unweighted(problem, found.final)}
    worst = max(rows.over_floor(both["after"]), rows.left_by_fit(problem, found.final))
    tracks = {k: predictions(simulator, problem, m) for k, m in both.items()}
    notes = getattr(simulator, "notes", lambda values: [])
    data = {
        "trials": len(s.names),
        "samples": int((s.seen > 0).any(2).sum()),
        "held_out_trials": len(np.unique(np.asarray(problem.fold))),
    }
    effects = rows.effect_rows(problem, found)
    scores = rows.scored(found, criteria.alpha)
    error = _error(simulator, problem, both, tracks)
    more = {
        "not_established": rows.same_rows(found, "stretch"),
        "power": power_rows(problem, found, criteria),
        "notes": [*few(problem), *notes(by_name(problem, found.final))],
        "next_experiment": discriminating(simulator, found, proposals),
    }
    account = Account(
        "simulator",
        name,
        data,
        rows.label,
        effects,
        scores,
        headline(found),
        worst > criteria.explained,
        error,
        lambda model: rows.declared_rows(problem, model, {}),
        more,
    )
    report = report_of(found, account)
    check_skill(report, criteria)
    shown = {"measured": s.measured, **tracks}
    if not found.named:
        del shown["after"]
    shown = {key: np.where(s.seen > 0, z, np.nan) for key, z in shown.items()}
    units = {c.name: c.unit for c in simulator.channels}
    curves = page_tracks(s.names, units, s.trial, s.time, shown)
    return report, {"audit": [], "held_out": curves}


def unweighted(problem: Problem, model: Model) -> Model:
    """The model with left-out errors as they are. Weights serve the fit alone: what needs no model
    is compared without them.
    """
    if problem.weight is None:
        return model
    held = model.fit.held / np.square(problem.weight)
    return replace(model, fit=replace(model.fit, held=held))


def by_name(problem: Problem, model: Model) -> dict[str, float]:
    """Values of all quantities."""
    return {q.name: float(model.fit.values[i]) for i, q in enumerate(problem.quantities)}


def check_skill(report: Table, criteria: Criteria) -> None:
    """Withhold names where no model does better than a straight line or holding still, in place."""
    e = report["error"]
    skill = e["skill"]["after"]
    if skill is None or skill >= REPORT.worthless_skill:
        return
    lowest = min(e["straight_line"], e["hold_still"])
    why = (
        f"The model predicts nothing: it leaves {e['after']:.3g} times the noise, doing nothing "
        f"leaves {lowest:.3g}; no effect is named."
    )
    withhold_names(report, why, e["after"] > criteria.explained)


def few(problem: Problem) -> list[str]:
    """A note where so few stretches can show little, whatever they show."""
    count = len(np.unique(np.asarray(problem.block)))
    minimum = smallest_p(count)
    if minimum <= 0.05:
        return []
    return [
        f"Only {count} stretches are compared: a paired test over so few shows no more than p = "
        f"{minimum:.2g}. Cut more, or record more."
    ]


def headline(found: Finding) -> Headline:
    """Sentences of the message."""

    def size(m):
        return f"{rows.over_floor(m):.3g}"

    return Headline(
        f"The declared model, fitted, predicts left-out stretches to {size(found.null)} times the "
        "noise.",
        f"{rows.named_words(found.named, 'folds')} Left-out error {size(found.null)} to "
        f"{size(found.final)} times the noise.",
        none="No candidate holds out.",
    )


def mended_model(problem: Problem, found: Finding, name: str) -> Form:
    """`model.toml`: declared quantities as fitted, and what each named effect adds."""
    value = {q.name: float(found.final.fit.values[i]) for i, q in enumerate(problem.quantities)}
    units = {q.name: q.unit for q in problem.quantities}
    declared = {q: Value(value[q], unit=units[q]) for q in problem.declared}
    effects = added_effects([n.candidate for n in found.named], value)
    return Form("simulator", name, declared, effects)


def predictions(simulator: Simulator, problem: Problem, model: Model) -> np.ndarray:
    """Outputs `[W, R, C]` of stretches that are predicted with what the others say, each from its
    best start.
    """
    noise = np.array([c.noise for c in simulator.channels])
    measured = np.nan_to_num(simulator.stretches.measured)
    left = problem.residuals(model.fit.vectors).reshape(measured.shape)
    return (
        measured
        - (left if problem.weight is None else left / problem.weight[:, None, None]) * noise
    )


def _error(
    simulator: Simulator,
    problem: Problem,
    both: Mapping[str, Model],
    tracks: Mapping[str, np.ndarray],
) -> Table:
    s = simulator.stretches
    some, trial = np.unique(s.trial, return_inverse=True)

    def rms(key: str, c: int) -> np.ndarray:
        off = np.square(tracks[key][..., c] - s.measured[..., c]) * s.seen[..., c]
        square = np.bincount(trial, off.sum(1)) / np.maximum(
            np.bincount(trial, s.seen[..., c].sum(1)), 1
        )
        return np.sqrt(square)[trial]

    channels = {
        c.name: Errors(c.unit, c.noise, {k: rms(k, i) for k in both})
        for i, c in enumerate(simulator.channels)
    }
    names = [s.names[k] for k in some]
    whole = Errors("1", 1.0, {k: np.sqrt(m.fit.held) for k, m in both.items()})
    over = interval_units(np.asarray(problem.fold), trial)
    table = error_rows(METRIC, "declared noise", names, whole, channels, trial, over)
    noise = np.array([c.noise for c in simulator.channels])
    line, still = (
        float(np.median(np.sqrt(np.square(z / noise).mean(1))))
        for z in doing_nothing(s.time, np.nan_to_num(s.measured), s.seen > 0)
    )
    zero = {"straight_line": line, "hold_still": still}
    return table | zero | {"skill": {k: skill(table[k], line, still) for k in both}}
