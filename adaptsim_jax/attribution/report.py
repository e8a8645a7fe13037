"""The report on a mechanism, and the arrays behind its page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.attribution import inertias_told
from adaptsim_jax.attribution.held_out import (
    FittedTree,
    astray,
    held_error,
    most_over_floor,
    over_floor,
)
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.parameters import INERTIA, Entry
from adaptsim_jax.attribution.power import power_rows
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.select import Selection
from adaptsim_jax.attribution.sentences import (
    doubts,
    message,
    place,
    read_so,
    shorter,
    soft_friction,
    standing,
    unused,
)
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Named
from adaptsim_jax.diagnosis.rows import candidate_row, tested
from adaptsim_jax.diagnosis.schema import new_report, verdict_of
from adaptsim_jax.effects.base import NINETY
from adaptsim_jax.effects.joints.actuator import SATURATION
from adaptsim_jax.effects.joints.friction import VISCOUS


def _numbers(error: np.ndarray) -> float:
    return float(np.median(error))


def reported(
    machine: Machine, problem: TreeProblem, found: Selection, criteria: Criteria, horizon: float
) -> dict[str, Any]:
    """The report."""
    before, after = held_error(problem, found.null), held_error(problem, found.final)
    noise = problem.floor[: problem.joints]
    floor = float(np.median(noise))
    over = over_floor(problem, found.final)
    named = found.named
    astray_count = astray(problem, found.final, criteria, found.null)
    outliers = _outliers(problem, found, astray_count, criteria)
    effects = [_effect(machine, problem, found, n) for n in named]
    remains = most_over_floor(problem, after) > criteria.explained
    kind = verdict_of(effects, remains or bool(outliers))
    log = machine.log
    data = {
        "trials": len(machine.tracks),
        "samples": log.samples,
        "held_out_trials": len(np.unique(problem.fold)),
    }
    remaining = {
        "error": _numbers(after),
        "times_floor": over,
        "joints": {
            name: {
                "error": float(np.median(after[:, j])),
                "times_floor": float(np.median(after[:, j]) / max(noise[j], 1e-12)),
            }
            for j, name in enumerate(problem.joint_names)
        },
    }
    after_rows = _declared(machine, problem, found.final)
    fixed = inertias_told.sentence(problem, found.final, after_rows)
    return new_report(
        "mechanism",
        Path(machine.mechanism.path).name,
        kind,
        message(problem, found, before, after, over, outliers, int(astray_count.sum()), criteria),
        data,
        effects=effects,
        error=_error(problem, found, before, after, noise, floor, horizon),
        candidates=_candidates(problem, found),
        power=power_rows(problem, found.last, criteria),
        declared={"before": _declared(machine, problem, found.null), "after": after_rows},
        fit_coordinates={
            "before": _coordinates(problem, found.null),
            "after": _coordinates(problem, found.final),
        },
        not_established=doubts(problem, found),
        remaining=remaining,
        notes=[
            *log.notes,
            *machine.notes,
            *unused(machine),
            *standing(machine),
            *fixed,
            *soft_friction(problem, named, kind, over),
            *read_so(problem, found),
            *shorter(found, criteria, horizon),
        ],
        stages=[
            {
                "added": [f"{c.effect} at {place(problem, c)}" for c in m.added],
                "error": _numbers(held_error(problem, m)),
            }
            for m in (*found.stages, found.final)
        ],
    )


def evidence_of(
    problem: TreeProblem, found: Selection, report: Mapping[str, Any]
) -> dict[str, Any]:
    """The arrays behind the page of a report."""
    notes = [{"severity": "info", "where": "", "message": note} for note in report["notes"]]
    return {"held_out": _held_out(problem, found), "audit": notes}


def _outliers(
    problem: TreeProblem, found: Selection, outlying: np.ndarray, criteria: Criteria
) -> list[tuple[str, str, float]]:
    """Trials of which much is left, however little on the whole: name, joint, times the noise floor
    (median over its stretches, or over those that are `far` [W] off where there are a few such).
    """
    noise, after = (
        np.maximum(problem.floor[: problem.joints], 1e-12),
        held_error(problem, found.final),
    )
    out = []
    for k, name in enumerate(problem.folds):
        mine = problem.fold == k
        if outlying.sum() >= criteria.few and np.any(mine & outlying):
            some = mine & outlying
        else:
            some = mine
        if np.any(some):
            over = np.median(after[some], 0) / noise
            worst = int(np.argmax(over))
            if over[worst] > criteria.odd:
                out.append((name, problem.joint_names[worst], float(over[worst])))
    return sorted(out, key=lambda row: -row[2])


def _effect(machine: Machine, problem: TreeProblem, found: Selection, n: Named) -> dict[str, Any]:
    c, model = n.candidate, found.final
    spread = model.spread
    numbers = {}
    for i, e in enumerate(model.fit.vector.entries):
        if e.owner == c.effect and set(e.joints) <= set(c.joints):
            value, width = float(model.fit.vector.values[i]), NINETY * float(spread[i])
            own = len(e.joints) == 1 and len(c.joints) > 1
            if own:
                key = f"{e.name}[{problem.joint_names[e.joints[0]]}]"
            else:
                key = e.name
            low, high = (
                max(value - width, min(e.low, value)),
                min(value + width, max(e.high, value)),
            )
            numbers[key] = {"value": value, "low": low, "high": high, "unit": e.unit}
            held = next(p for p in problem.effect(c.effect).parameters if p.name == e.name)
            if held.held and held.meaning:
                numbers[key]["meaning"] = held.meaning
    numbers = with_limits(numbers) if c.effect == SATURATION.name else numbers
    if c.effect == INERTIA:  # as a person knows it, and not in the coordinates of the fit
        body = next(iter(c.joints))
        of = f" of {machine.tree.body_names[body]}"
        rows = inertias_told.inertia_rows(machine, problem, model)
        numbers = {
            key.removesuffix(of).replace(" ", "_"): {
                k: row[k] for k in ("value", "low", "high", "unit")
            }
            for key, row in rows.items()
            if key.endswith(of) and not row["combination"]
        }
    return {
        "name": c.effect,
        "where": place(problem, c),
        "joints": [problem.joint_names[j] for j in c.joints],
        "parameters": numbers,
        "physics": problem.effect(c.effect).physics,
        "alternatives": [f"{a.effect}@{place(problem, a)}" for a in n.alternatives],
        **tested(n),
    }


def with_limits(numbers: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
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


def _error(
    problem: TreeProblem, found: Selection, before, after, noise, floor: float, horizon: float
) -> dict[str, Any]:
    rng = np.random.default_rng(0)

    def pair(pick):
        return {
            "before": float(np.median(pick(before))),
            "after": float(np.median(pick(after))),
        }

    channels = {}
    for j, name in enumerate(problem.joint_names):
        unit = "rad" if problem.kinds[j] == "hinge" else "m"
        channels[name] = {
            "unit": unit,
            **pair(lambda e, j=j: e[:, j]),
            "noise_floor": float(noise[j]),
        }
    per_trial = []
    for k, name in enumerate(problem.folds):
        mine = problem.fold == k
        if mine.any():
            own = {
                n: pair(lambda e, j=j, mine=mine: e[mine][:, j])
                for j, n in enumerate(problem.joint_names)
            }
            per_trial.append(
                {"trial": name, **pair(lambda e, mine=mine: e[mine]), "per_channel": own}
            )
    draws = rng.integers(0, len(before), (400, len(before)))

    def interval(e):
        return [float(z) for z in np.quantile([np.median(e[d]) for d in draws], [0.025, 0.975])]

    kinds = set(problem.kinds)
    if kinds == {"hinge"}:
        unit = "rad"
    elif kinds == {"slide"}:
        unit = "m"
    else:
        unit = "1"
    return {
        "metric": f"median over left-out stretches of {horizon:g} s and joints of the RMS error of "
        f"simulated angles, starts fitted",
        "unit": unit,
        "stretch_s": horizon,
        **pair(lambda e: e),
        "noise_floor": floor,
        "ceiling": None,
        "per_channel": channels,
        "per_trial": per_trial,
        "noise_floor_source": "third differences of the angles",
        "intervals": {"before": interval(before), "after": interval(after)},
    }


def _candidates(problem: TreeProblem, found: Selection) -> list[dict[str, Any]]:
    """What is named, with what it takes off beside all others. Then what was scored about the
    declared model, best first.
    """
    names = {(n.candidate.effect, n.candidate.joints) for n in found.named}
    alike = {(a.effect, a.joints) for n in found.named for a in n.alternatives}
    why = {key[:2]: words for key, words in found.refused().items()}
    total = max(found.stages[0].fit.total, 1e-12)
    if names:
        other = "predicts left-out trials less well than what was chosen"
    else:
        other = "no clear gain on left-out trials"

    def row(c, gain, p, status, why):
        return candidate_row(c.effect, place(problem, c), gain, p, status, why)

    rows = [row(n.candidate, n.test.gain, n.test.p, "accepted", "named") for n in found.named]
    for s in found.scores:
        key = s.candidate.effect, s.candidate.joints
        if key in names or (s.held_out <= 0.0 and key not in alike):
            continue
        if key in alike:
            status, words = ("look-alike", "does as well")
        else:
            status, words = ("rejected", other)
        rows.append(
            row(
                s.candidate,
                s.held_out / total,
                min(1.0, s.p * len(found.scores)),
                status,
                why.get(key, words),
            )
        )
    return rows[:40]


def _declared(machine: Machine, problem: TreeProblem, model: FittedTree) -> dict[str, Any]:
    """Fitted inertias, as a person knows them (`inertias_told`), and dampings."""
    late = (
        Criteria.least_shift * problem.reach.dt
    )  # s, which nobody can tell of commands: so much damping, times kp
    stiff = {
        j: -late * k
        for g in problem.groups
        for j, k in zip(g.joints, g.actuator[2] * g.gear**2, strict=True)
    }

    def wider(row, more):
        return row | {"low": row["low"] - more, "high": row["high"] + more}

    dampings = {
        f"{e.name} of {problem.joint_names[e.joints[0]]}": wider(row, stiff[e.joints[0]])
        | {"identifiable": True, "file": float(machine.tree.damping[e.joints[0]])}
        for e, row in _numbers_of(model)
        if e.owner == VISCOUS.name
    }
    return inertias_told.inertia_rows(machine, problem, model) | dampings


def _coordinates(problem: TreeProblem, model: FittedTree) -> dict[str, Any]:
    """Inertias in the fit's own coordinates, without unit, about the declared ones."""
    return {
        f"{e.name} of {problem.joint_names[e.joints[0]]}": row
        for e, row in _numbers_of(model)
        if e.owner == INERTIA
    }


def _numbers_of(model: FittedTree) -> list[tuple[Entry, dict[str, Any]]]:
    out = []
    for e, value, spread in zip(
        model.fit.vector.entries, model.fit.vector.values, model.spread, strict=True
    ):
        width = NINETY * float(spread)
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
    pair = [m.held.paths for m in (found.null, found.final)]
    s = problem.groups[0].stretches
    out = []
    for k, name in enumerate(s.names):
        lanes = [w for w in range(len(problem.fold)) if s.trial[w] == k][:12]
        if not lanes:
            continue
        entry: dict[str, Any] = {
            "trial": name,
            "units": {
                n: "rad" if k == "hinge" else "m"
                for n, k in zip(problem.joint_names, problem.kinds, strict=True)
            },
            "time": np.concatenate([np.append(s.time[:, w], s.time[-1, w]) for w in lanes]),
        }

        def flat(z, lanes=lanes):
            return np.concatenate([np.append(z[:, w], np.nan) for w in lanes])

        for key in ("measured", "before", "after"):
            entry[key] = {}
        for g, a, b in zip(problem.groups, *pair, strict=True):
            for at, j in enumerate(g.joints):
                name_j = problem.joint_names[j]
                entry["measured"][name_j] = flat(
                    np.where(g.stretches.seen[:, at] > 0, g.stretches.q[:, at], np.nan)
                )
                entry["before"][name_j], entry["after"][name_j] = (
                    flat(a.sensed[:, at]),
                    flat(b.sensed[:, at]),
                )
        if not found.named:
            entry["after"] = None
        out.append(entry)
    return out
