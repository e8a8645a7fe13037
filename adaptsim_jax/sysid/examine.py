"""One recording examined: the declared model, the search for effects, what left-out trials say of it, the verdict."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.logs.noise.floor import NoiseFloor
from adaptsim_jax.logs.quality.findings import Audit
from adaptsim_jax.logs.types import Recording
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.decide import Evidence, Verdict, decide, open_to_rivals
from adaptsim_jax.sysid.estimate.fit import seen_anew
from adaptsim_jax.sysid.estimate.fitted import Fit, force_ratio
from adaptsim_jax.sysid.estimate.problem import Diverged, Problem
from adaptsim_jax.sysid.evaluate.crossval import CrossValidation, cross_validate
from adaptsim_jax.sysid.evaluate.flexible import flexible_bound
from adaptsim_jax.sysid.evaluate.power import Power, power, powered
from adaptsim_jax.sysid.evaluate.residual import ResidualDiagnosis, residual_diagnosis, residual_torque
from adaptsim_jax.sysid.nuisance.null_model import timed
from adaptsim_jax.sysid.nuisance.prefilter import fit_unfiltered, revised, told
from adaptsim_jax.sysid.report.results import add_ceiling, add_leading, floor_of, report_of
from adaptsim_jax.sysid.rivals.kinematics import remeasured
from adaptsim_jax.sysid.rivals.known_parameters import freed
from adaptsim_jax.sysid.rivals.torque_scale import rescaled
from adaptsim_jax.sysid.score.table import ScoreTable, view
from adaptsim_jax.sysid.select import forward
from adaptsim_jax.sysid.select.backward import backward_eliminated
from adaptsim_jax.sysid.select.phase_refinement import phases_refined, phases_refined_early
from adaptsim_jax.sysid.select.refine import refined
from adaptsim_jax.sysid.select.trace import Trace

STAGES = 9
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Diagnosis:
    """All that a diagnosis found; `report` is what goes into report.json. leading: the likeliest model where nothing is named."""

    problem: Problem
    found: Trace
    before: ResidualDiagnosis
    after: ResidualDiagnosis
    error_before: CrossValidation
    error_after: CrossValidation
    powers: list[Power]
    verdict: Verdict
    first: ScoreTable
    report: dict[str, Any]
    evidence: dict[str, Any]
    leading: Fit | None = None


def examine(
    recording: Recording,
    checked: Audit,
    noise: NoiseFloor,
    effects: Sequence[Effect],
    criteria: Criteria,
    seed: int,
    say: Progress,
) -> Diagnosis:
    """Everything between reading and writing. A filter of the angles that shows only once an effect is named has them examined anew
    without it, and one that an effect had passed for those as they were written."""
    sought = searched(recording, checked, noise, effects, criteria, say)
    if sought.found.added:
        smoothed = revised(sought.problem, sought.found.final, sought.found.view)
        if smoothed is not None:
            sought = searched(recording, checked, noise, effects, criteria, say, smoothed)
    return concluded(sought, checked, effects, seed, say)


class Searched(NamedTuple):
    """The declared model `base` with its view `first` and residual, what it leaves unexplained (share of the torque `[n]`), and what
    the search found beside it."""

    problem: Problem
    base: Fit
    first: ScoreTable
    before: ResidualDiagnosis
    force: np.ndarray
    found: Trace


def searched(
    recording: Recording,
    checked: Audit,
    noise: NoiseFloor,
    effects: Sequence[Effect],
    criteria: Criteria,
    say: Progress,
    smoothed: float | None = None,
) -> Searched:
    """The declared model and the search beside it. smoothed: by a filter of which `s` [s^2], 0 for none; looked for where None."""
    say(2, STAGES, "declared model")
    try:
        problem, base, first = fit_unfiltered(recording, checked, noise, effects, smoothed, criteria)
    except Diverged as error:
        raise BadInput(f"{recording.path}: {error}") from None
    problem, first = phases_refined_early(*timed(problem, base, first), base)
    force = base.parts.force_std() / problem.torque_scale
    before = residual_diagnosis(problem, first, base.parts, force)
    say(3, STAGES, "candidates")
    fair = seen_anew(problem, base, first.response)
    problem, found = forward.search(problem, fair, first, say=lambda note: say(4, STAGES, note))
    say(5, STAGES, "what is left")
    problem, found = phases_refined(problem, found)
    return Searched(problem, base, first, before, force, refined(problem, found))


def concluded(sought: Searched, checked: Audit, effects: Sequence[Effect], seed: int, say: Progress) -> Diagnosis:
    """What left-out trials say of the search, the verdict, and the report."""
    problem, base, first, before, force, found = sought
    found, tested = backward_eliminated(problem, found)
    found = rescaled(problem, found)
    seen = found.view
    after = before
    if found.added:
        left = force_ratio(found.final, found.base)
        many = left > problem.criteria.explained  # then what is left says nothing of where
        rest = force if many else found.final.parts.force_std() / problem.torque_scale
        after = residual_diagnosis(problem, seen, found.final.parts, rest)
    powers = power(problem, seen)
    say(6, STAGES, "held-out trials, declared model")
    error_before = cross_validate(problem, base, first)
    flexible = flexible_bound(problem, base, first, error_before.fold)
    evidence = Evidence(
        found, before, after, force, error_before, floor_of(problem), powered(powers),
        1.0 if flexible is None else flexible.rmse / error_before.rmse(),
        known=problem.recording.known, length=problem.recording.geometry.get("l1"),
    )  # fmt: skip
    say(7, STAGES, "held-out trials, mended model")
    verdict, evidence = judged(problem, base, tested, effects, evidence)
    error_after = error_before if evidence.error_after is None else evidence.error_after
    errors, rng = (error_before, error_after), np.random.default_rng(seed)
    report, shown = report_of(problem, found, after, *errors, powers, verdict, rng)
    add_ceiling(report["error"], flexible)
    leading = None if verdict.named else found.leading or (found.final if found.added else None)
    if leading is not None:
        tried = cross_validate(problem, leading, view(problem, leading))
        leading = leading if add_leading(report, problem, leading, found, tried) else None
    shown["residual_torque"] = residual_torque(problem, first.lin, base.parts)
    shown["audit"] = findings(checked)
    if problem.recording.smoothing:
        shown["audit"].append({"severity": "info", "where": "", "message": told(problem.recording)})
    return Diagnosis(problem, found, before, after, *errors, powers, verdict, first, report, shown, leading)


def judged(
    problem: Problem,
    base: Fit,
    tested: CrossValidation | None,
    effects: Sequence[Effect],
    evidence: Evidence,
) -> tuple[Verdict, Evidence]:
    """The verdict, and the evidence on which it rests: what costs fits is looked for only where it could change what is said.
    tested: held-out errors of the mended model, if the search has them."""
    found = evidence.found
    if decide(evidence, problem.criteria).named:
        error = tested or cross_validate(problem, found.final, found.view)
        evidence = replace(evidence, error_after=error)
    if open_to_rivals(decide(evidence, problem.criteria)):
        evidence = replace(evidence, freed=freed(problem, effects))
    if open_to_rivals(decide(evidence, problem.criteria)):
        evidence = replace(evidence, remeasured=remeasured(problem, base, effects, found.first))
    return decide(evidence, problem.criteria), evidence


def findings(checked: Audit) -> list[dict[str, str]]:
    """The audit's findings as the page shows them."""
    return [
        {"severity": f.severity, "where": " ".join(x for x in (f.trial, f.where) if x), "message": f.message}
        for f in checked.findings
    ]
