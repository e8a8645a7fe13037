"""What simulated stretches of a mechanism contribute to its report, and the arrays behind its
page.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from adaptsim_jax.attribution import physical_inertias
from adaptsim_jax.attribution.candidates import CandidateScore
from adaptsim_jax.attribution.criteria import TEXT
from adaptsim_jax.attribution.fitted import (
    FittedTree,
    Selection,
    astray,
    held_error,
    times_floor,
)
from adaptsim_jax.attribution.forecast import angles_of, observed
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.parameters import INERTIA, Entry
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.sentences import (
    Remains,
    doubts,
    headline,
    label,
    place,
    read_so,
    shorter,
    soft_friction,
    standing,
    unused,
)
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.experiment import separated_by
from adaptsim_jax.diagnosis.finding import Named
from adaptsim_jax.diagnosis.report import (
    Account,
    Errors,
    Label,
    Scored,
    error_rows,
    interval_units,
    page_tracks,
    remarks,
)
from adaptsim_jax.effects.joints.actuator import SATURATION
from adaptsim_jax.effects.joints.friction import VISCOUS

MOST_SHOWN = 12  # stretches of a trial on the page


def account_of(
    machine: Machine, problem: TreeProblem, found: Selection, criteria: Criteria, horizon: float
) -> Account:
    """What the report says where simulated stretches judge."""
    remains = _remains(problem, found, criteria)
    left, log = remains.left or bool(remains.outliers), machine.log
    declared = partial(_declared, machine, problem)
    data = {
        "trials": len(machine.tracks),
        "samples": log.samples,
        "held_out_trials": len(np.unique(problem.fold)),
    }
    effects = [_effect(machine, problem, found, n) for n in found.named]
    both = {"before": found.null, "after": found.final}
    notes = [
        *log.notes,
        *machine.notes,
        *unused(machine),
        *standing(machine),
        *physical_inertias.sentence(problem, found.final, declared(found.final)),
        *soft_friction(problem, found.named, left, float(np.max(remains.times))),
        *read_so(problem, found),
        *shorter(found, criteria, horizon),
    ]
    stages = []
    for m in (*found.stages, found.final):
        added = [f"{c.effect} at {place(problem, c)}" for c in m.added]
        stages.append({"added": added, "error": float(np.median(held_error(problem, m)))})
    more = {
        "power": power_rows(problem, found.last, criteria),
        "fit_coordinates": {k: _coordinates(problem, model) for k, model in both.items()},
        "not_established": doubts(problem, found),
        "remaining": _remaining(problem, remains),
        "notes": notes,
        "stages": stages,
        "next_experiment": next_experiment(problem, found),
    }
    return Account(
        "mechanism",
        Path(machine.mechanism.path).name,
        data,
        partial(label, problem),
        effects,
        _scored(problem, found),
        headline(problem, found, remains, criteria),
        left,
        _error(problem, remains, horizon),
        declared,
        more,
    )


def next_experiment(problem: TreeProblem, found: Selection) -> Table | None:
    """Where a name has a look-alike: which joints to move, and how, to see either by itself.

    What shows an effect stands in its record; a joint's speed is that of the recording, so that it
    can be seen what was missing.
    """
    speeds = dict(zip(problem.joint_names, found.reach.speed, strict=True))
    units = dict(zip(problem.joint_names, problem.units, strict=True))

    def shown_by(called: Label) -> str:
        if called.where not in speeds:
            return f"{called.where}: {problem.effect(called.name).excitation}"
        here = f"here mostly below {speeds[called.where]:.2g} {units[called.where]}/s"
        return f"{called.where} ({here}): {problem.effect(called.name).excitation}"

    text = "{} does no better in this recording than {}. To separate them record, of {}."
    return separated_by(found, partial(label, problem), lambda z: z.words, shown_by, text)


def _remains(problem: TreeProblem, found: Selection, criteria: Criteria) -> Remains:
    after = held_error(problem, found.final)
    outlying = astray(problem, found.final, criteria, found.null)
    times = times_floor(problem, after)
    outliers = _outliers(problem, after, outlying, criteria)
    return Remains(
        held_error(problem, found.null),
        after,
        problem.floor[: problem.joints],
        times,
        bool(np.max(times) > criteria.explained),
        outliers,
        int(outlying.sum()),
    )


def _remaining(problem: TreeProblem, remains: Remains) -> Table:
    median = np.median(remains.after, 0)
    times = median / np.maximum(remains.noise, 1e-12)
    return {
        "error": float(np.median(remains.after)),
        "times_floor": float(np.max(remains.times)),
        "joints": by_joint(problem, median, times),
    }


def by_joint(problem: TreeProblem, error: np.ndarray, times: np.ndarray) -> Table:
    """Rows of `remaining`: error [n] and how many times the noise floor [n] that is."""
    return {
        name: {"error": float(error[j]), "times_floor": float(times[j])}
        for j, name in enumerate(problem.joint_names)
    }


def evidence_of(problem: TreeProblem, found: Selection, report: Mapping[str, Any]) -> Table:
    """The arrays behind the page of a report."""
    return {"held_out": _held_out(problem, found), "audit": remarks(report["notes"])}


def _outliers(
    problem: TreeProblem, after: np.ndarray, outlying: np.ndarray, criteria: Criteria
) -> list[tuple[str, str, float]]:
    """Trials of which much is left, however little on the whole: name, joint, times the noise floor
    (median over its stretches, or over those that are `outlying` [W] where there are a few such).
    """
    out = []
    for k, name in enumerate(problem.folds):
        mine = problem.fold == k
        if outlying.sum() >= criteria.few and np.any(mine & outlying):
            some = mine & outlying
        else:
            some = mine
        if np.any(some):
            over = times_floor(problem, after[some])
            worst = int(np.argmax(over))
            if over[worst] > criteria.outlying:
                out.append((name, problem.joint_names[worst], float(over[worst])))
    return sorted(out, key=lambda row: -row[2])


def _effect(machine: Machine, problem: TreeProblem, found: Selection, n: Named) -> Table:
    """What a row of `effects` says of a name besides its test."""
    c, model = n.candidate, found.final
    effect, numbers = problem.effect(c.effect), {}
    for e, row in _numbers_of(model):
        if e.owner != c.effect or not set(e.joints) <= set(c.joints):
            continue
        key = e.name
        if len(e.joints) == 1 and len(c.joints) > 1:
            key = f"{e.name}[{problem.joint_names[e.joints[0]]}]"
        value = row["value"]
        numbers[key] = row | {
            "low": max(row["low"], min(e.low, value)),
            "high": min(row["high"], max(e.high, value)),
        }
        parameter = next(p for p in effect.parameters if p.name == e.name)
        if parameter.held and parameter.meaning:
            numbers[key]["meaning"] = parameter.meaning
    if c.effect == SATURATION.name:
        numbers = with_limits(numbers)
    if c.effect == INERTIA:
        numbers = _of_a_body(machine, problem, model, next(iter(c.joints)))
    joints = [problem.joint_names[j] for j in c.joints]
    return {"joints": joints, "parameters": numbers, "physics": effect.physics}


def _of_a_body(
    machine: Machine, problem: TreeProblem, model: FittedTree, body: int
) -> dict[str, Table]:
    """A body's inertia as a person knows it, and not in the coordinates of the fit."""
    of = f" of {machine.tree.body_names[body]}"
    out = {}
    for key, row in physical_inertias.inertia_rows(machine, problem, model).items():
        if key.endswith(of) and not row["combination"]:
            quantity = key.removesuffix(of).replace(" ", "_")
            out[quantity] = {k: row[k] for k in ("value", "low", "high", "unit")}
    return out


def with_limits(numbers: dict[str, Table]) -> dict[str, Table]:
    """With limits of force as a data sheet has them [N m or N] before the share that is cut off the
    largest torque.
    """
    limits = {}
    for key in [k for k in numbers if k.startswith("cut")]:
        cut, peak = numbers[key], numbers[key.replace("cut", "peak", 1)]

        def at(share, peak=peak):
            return (1.0 - share) * peak["value"]

        limit = {
            "value": at(cut["value"]),
            "low": at(cut["high"]),
            "high": at(cut["low"]),
            "unit": peak["unit"],
        }
        limits[key.replace("cut", "limit", 1)] = limit
    return limits | numbers


def _error(problem: TreeProblem, remains: Remains, horizon: float) -> Table:
    both = {"before": remains.before, "after": remains.after}
    channels = {}
    for j, name in enumerate(problem.joint_names):
        own = {k: e[:, j] for k, e in both.items()}
        channels[name] = Errors(problem.units[j], float(remains.noise[j]), own)
    unit = problem.units[0] if len(set(problem.units)) == 1 else "1"
    metric = (
        f"median over left-out stretches of {horizon:g} s and joints of the RMS error of simulated "
        "angles, starts fitted"
    )
    whole = Errors(unit, float(np.median(remains.noise)), both)
    source = "third differences of the angles"
    over = interval_units(problem.fold, problem.groups[0].stretches.trial[: len(problem.fold)])
    table = error_rows(metric, source, problem.folds, whole, channels, problem.fold, over)
    return table | {"stretch_s": horizon}


def _scored(problem: TreeProblem, found: Selection) -> list[Scored]:
    """What is named, with what it takes off beside all others. Then what was scored about the
    declared model, best first.
    """
    named = {label(problem, n.candidate) for n in found.named}
    alike = {label(problem, a) for n in found.named for a in n.alternatives}
    total = max(found.stages[0].fit.total, 1e-12)
    if named:
        other = "predicts left-out trials less well than what was chosen"
    else:
        other = "no clear gain on left-out trials"
    rows = [Scored(n.candidate, n.test.gain, n.test.p, "named") for n in found.named]
    for s in found.scores:
        called = label(problem, s.candidate)
        if called not in named and (s.held_out > 0.0 or called in alike):
            p = s.p * len(found.scores)
            rows.append(Scored(s.candidate, s.held_out / total, p, other))
    return rows[: TEXT.candidates]


def power_rows(
    problem: TreeProblem, scores: Sequence[CandidateScore], criteria: Criteria
) -> list[Table]:
    """Rows of `power` of candidates that act linearly through one number: the size that
    `TEXT.power` of recordings like this one would show.

    Args:
        problem: The recording as it was fitted.
        scores: Of candidates about the final model, with `scatter`, the cluster-robust standard
            error of an amplitude.
        criteria: Its level is corrected for the number of candidates and of their shapes, as in
            the score test.

    Returns:
        `{name, where, size, unit, power}`, sizes in the unit of the amplitude, by name and place.
    """
    level = criteria.alpha / max(len(scores), 1)

    def times(points: int) -> float:
        return float(stats.norm.isf(0.5 * level / points) + stats.norm.isf(1.0 - TEXT.power))

    rows = [
        {
            **label(problem, s.candidate)._asdict(),
            "size": times(s.points) * s.scatter,
            "unit": s.candidate.entries[0].unit,
            "power": TEXT.power,
        }
        for s in scores
        if s.scatter > 0.0 and not problem.effect(s.candidate.effect).jump
    ]
    return sorted(rows, key=lambda row: (row["name"], row["where"]))


def _declared(machine: Machine, problem: TreeProblem, model: FittedTree) -> Table:
    """Fitted inertias, as a person knows them (`physical_inertias`), and dampings."""
    late = (
        Criteria.min_shift * problem.reach.dt
    )  # s, which nobody can tell of commands: so much damping, times kp
    stiff = {
        j: -late * k
        for g in problem.groups
        for j, k in zip(g.joints, g.actuator[2] * g.gear**2, strict=True)
    }

    def wider(row, more):
        return row | {"low": row["low"] - more, "high": row["high"] + more}

    dampings = {}
    for e, row in _numbers_of(model):
        if e.owner == VISCOUS.name:
            j = e.joints[0]
            declared = {"identifiable": True, "file": float(machine.tree.damping[j])}
            dampings[f"{e.name} of {problem.joint_names[j]}"] = wider(row, stiff[j]) | declared
    return physical_inertias.inertia_rows(machine, problem, model) | dampings


def _coordinates(problem: TreeProblem, model: FittedTree) -> Table:
    """Inertias in the fit's own coordinates, without unit, about the declared ones."""
    return {
        f"{e.name} of {problem.joint_names[e.joints[0]]}": row
        for e, row in _numbers_of(model)
        if e.owner == INERTIA
    }


def _numbers_of(model: FittedTree) -> list[tuple[Entry, Table]]:
    out = []
    for e, value, half in zip(
        model.fit.vector.entries, model.fit.vector.values, model.half_width, strict=True
    ):
        width = float(half)
        out.append(
            (
                e,
                {
                    "value": float(value),
                    "low": value - width,
                    "high": value + width,
                    "unit": e.unit,
                },
            )
        )
    return out


def _held_out(problem: TreeProblem, found: Selection) -> list[Mapping[str, Any]]:
    """Measured angles and those predicted of left-out folds, trial by trial, stretches one after
    the other.
    """
    s, (measured, seen) = problem.groups[0].stretches, observed(problem)
    shown = {
        "measured": np.where(seen > 0, measured, np.nan),
        "before": angles_of(problem, found.null.held.paths),
    }
    if found.named:
        shown["after"] = angles_of(problem, found.final.held.paths)
    units = dict(zip(problem.joint_names, problem.units, strict=True))
    count = len(problem.fold)
    return page_tracks(s.names, units, s.trial[:count], s.time.T[:count], shown, MOST_SHOWN)
