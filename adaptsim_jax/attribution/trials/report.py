"""The parts of `report.json` that every task of short trials has."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from adaptsim_jax.attribution.criteria import Criteria
from adaptsim_jax.attribution.trials.problem import TrialEffect, TrialProblem
from adaptsim_jax.attribution.trials.select import TrialModel, TrialNamed, TrialSelection, spread
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.base import NINETY

DRAWS = 400  # of trials, for the interval of an error


def considered(known: Sequence[TrialEffect], exclude: Sequence[str], what: str) -> tuple[TrialEffect, ...]:
    """`known` less those excluded. BadInput where one of these is none; what: of which task, in words."""
    names = {e.name for e in known}
    for name in exclude:
        if name not in names:
            raise BadInput(f"--exclude: {name!r} is no effect of {what}; it has {', '.join(sorted(names))}")
    return tuple(e for e in known if e.name not in exclude)


def words(name: str) -> str:
    """An effect's name, with its place or without, as people write it."""
    return name.partition("@")[0].replace("_", " ")


def verdict(named: Sequence[TrialNamed], over: float, criteria: Criteria) -> str:
    """The kind; over: what is left over the noise floor."""
    if not named:
        return "within_noise" if over <= criteria.explained else "structured_unattributed"
    if over > criteria.explained:
        return "partly_explained"
    return "explained_class" if any(n.alternatives or n.effect.same for n in named) else "explained"


def told(named: Sequence[TrialNamed], what: str) -> str:
    """What is named and how it was tested, one sentence; what: the trials in words."""
    lines = [
        f"{words(n.effect.name)} holds out in {n.test.better} of {n.test.folds} {what} "
        f"(takes {100 * n.test.gain:.0f} % off the squared error beside all others, p {n.test.p:.2g})"
        for n in named
    ]
    text = "; ".join(lines)
    return f"{text[:1].upper()}{text[1:]}."


def interval(problem: TrialProblem, model: TrialModel, name: str) -> tuple[float, float, float]:
    """A quantity's value and the ends of its interval."""
    i = problem.index[name]
    value, width = float(model.fit.values[i]), NINETY * float(spread(model)[i])
    return value, value - width, value + width


def effect_row(problem: TrialProblem, found: TrialSelection, n: TrialNamed, **more: Any) -> dict[str, Any]:
    """A row of `effects`; more: keys beside."""
    e, numbers = n.effect, {}
    for name in e.quantities:
        value, low, high = interval(problem, found.final, name)
        numbers[name] = {"value": value, "low": low, "high": high, "unit": problem.quantities[problem.index[name]].unit}
    return {
        "name": e.name,
        "where": e.where,
        "parameters": numbers,
        "physics": e.physics,
        "shown_by": e.seen,
        "alternatives": [*[f"{a.name}@{a.where}" for a, _ in n.alternatives], *e.same],
        "held_out_gain": n.test.gain,
        "p_value": n.test.p,
        "better": n.test.better,
        "folds": n.test.folds,
        "size_over_scatter": min(n.steady, 1e3),
        **more,
    }


def candidate_rows(found: TrialSelection) -> list[dict[str, Any]]:
    """Every effect of the catalogue and what became of it."""
    names = {n.effect.name for n in found.named}
    alike = {a.name for n in found.named for a, _ in n.alternatives}
    rows = []
    for s in found.scores:
        name = s.effect.name
        status = "accepted" if name in names else "look-alike" if name in alike else "rejected"
        why = {"accepted": "named", "look-alike": "does as well"}.get(status) or found.refused.get(
            name, "gains less than what was taken"
        )
        rows.append(
            {
                "name": name,
                "where": s.effect.where,
                "held_out_gain": float(np.clip(s.gain, -1.0, 1.0)),
                "p_value": float(min(1.0, s.p * len(found.scores))),
                "accepted": name in names,
                "status": status,
                "why": why,
            }
        )
    return rows


def error_table(
    metric: str,
    floor: float,
    source: str,
    names: Sequence[str],
    size: Mapping[str, np.ndarray],
    channels: Mapping[str, tuple[str, float, Mapping[str, np.ndarray]]],
) -> dict[str, Any]:
    """The table `error`, in m. size: `before`, `after` `[T]` of each left-out trial; channels: unit, floor and the same of each."""
    count = len(names)
    draws = np.random.default_rng(0).integers(0, count, (DRAWS, count))
    whole = lambda e, at=slice(None): float(np.median(e[at]))
    return {
        "metric": metric,
        "unit": "m",
        **{k: whole(v) for k, v in size.items()},
        "noise_floor": floor,
        "ceiling": None,
        "per_channel": {
            c: {"unit": unit, **{k: whole(v) for k, v in each.items()}, "noise_floor": least}
            for c, (unit, least, each) in channels.items()
        },
        "per_trial": [
            {
                "trial": name,
                **{k: float(v[i]) for k, v in size.items()},
                "per_channel": {c: {k: float(v[i]) for k, v in each.items()} for c, (_, _, each) in channels.items()},
            }
            for i, name in enumerate(names)
        ],
        "noise_floor_source": source,
        "intervals": {
            k: [float(z) for z in np.quantile([whole(v, d) for d in draws], [0.025, 0.975])] for k, v in size.items()
        },
    }


def declared_rows(problem: TrialProblem, model: TrialModel, logs: Mapping[str, tuple[str, str]]) -> dict[str, Any]:
    """Declared quantities as fitted. logs: name and unit of what is fitted as a logarithm to the base of ten."""
    out = {}
    for name in problem.declared:
        q, (value, low, high) = problem.quantities[problem.index[name]], interval(problem, model, name)
        known = high - low < 0.3 * (q.high - q.low)
        unit, key = q.unit, name
        if name in logs:
            value, low, high = (10.0 ** float(np.clip(z, q.low, q.high)) for z in (value, low, high))
            key, unit = logs[name]
        out[key] = {"value": value, "low": low, "high": high, "unit": unit, "identifiable": bool(known)}
    return out
