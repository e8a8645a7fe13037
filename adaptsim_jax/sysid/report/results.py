"""What a diagnosis found, in the words and numbers of `report.json`."""

from typing import Any

import numpy as np

from adaptsim_jax.diagnosis.schema import new_report
from adaptsim_jax.effects.base import NINETY
from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.decide import Verdict
from adaptsim_jax.sysid.estimate.fitted import Fit, force_ratio
from adaptsim_jax.sysid.estimate.problem import Problem, any_torque
from adaptsim_jax.sysid.evaluate.crossval import CrossValidation
from adaptsim_jax.sysid.evaluate.flexible import FlexibleBound
from adaptsim_jax.sysid.evaluate.power import Power
from adaptsim_jax.sysid.evaluate.residual import ResidualDiagnosis
from adaptsim_jax.sysid.report.union_intervals import reach_over_classes
from adaptsim_jax.sysid.score.table import Ranked
from adaptsim_jax.sysid.select.trace import Trace


def report_of(
    problem: Problem, found: Trace, after: ResidualDiagnosis, error_before: CrossValidation, error_after: CrossValidation,
    powers: list[Power], verdict: Verdict, rng: np.random.Generator,
) -> tuple[dict[str, Any], dict[str, Any]]:  # fmt: skip
    """The report and the arrays behind its figures."""
    recording = problem.recording
    samples = sum(len(t.time) for t in recording.trials)
    data = {"trials": len(recording.trials), "samples": samples, "held_out_trials": len(recording.trials)}
    last = found.final if verdict.named else found.base
    report = new_report(
        recording.task, recording.model, verdict.name, verdict.message, data,
        effects=[_effect(problem, found, e) for e in found.added] if verdict.named else [],
        error=_error(problem, error_before, error_after if verdict.named else error_before, rng),
        candidates=_candidates(problem, found, verdict),
        declared={"before": _declared(problem, found.base), "after": _declared(problem, last)},
        not_established=_not_established(problem, found, verdict, powers),
        leftover=[dict(zip(("joint", "variable", "share", "p_value"), p, strict=True)) for p in after.told()],
        unexplained_torque=_torques(problem, found),
        power=[_power(p) for p in powers],
        noise={"message": problem.noise.message, "source": problem.noise.source},
        decided_by=list(verdict.rules),
    )  # fmt: skip
    if verdict.named:
        reach_over_classes(report["declared"]["after"], problem, found)
    report["error"]["noise_floor_source"] = problem.noise.source
    return report, _evidence(problem, error_before, error_after if verdict.named else None, report)


def _number(value: Any, error: float, unit: str) -> dict[str, Any]:
    return {
        "value": float(value),
        "low": float(value - NINETY * error),
        "high": float(value + NINETY * error),
        "unit": unit,
    }


def _within(number: dict[str, Any], low: float, high: float) -> dict[str, Any]:
    """The interval of a parameter no wider than what it may be; its value stays inside."""
    value = number["value"]
    return number | {"low": max(number["low"], min(low, value)), "high": min(number["high"], max(high, value))}


def _effect(problem: Problem, found: Trace, instance: tuple[str, str]) -> dict[str, Any]:
    layout = problem.model.layout
    effect = layout.instances[layout.index(*instance)].effect
    at = layout.instances[layout.index(*instance)].at
    fitted = found.final.candidate.parameters(*instance)
    parameters = {}
    for k, p in enumerate(effect.parameters):
        value, error = fitted.get(p.name, (found.final.candidate.eff[at.start + k], 0.0))
        parameters[p.name] = _within(_number(value, error, p.unit), *(float(z[at.start + k]) for z in problem.bounds))
    return {
        "name": instance[0], "where": instance[1], "parameters": parameters, "physics": effect.physics,
        "alternatives": [f"{e}@{w}" for e, w in found.classes.get(instance, ())],
    }  # fmt: skip


def _declared(problem: Problem, model: Fit) -> dict[str, Any]:
    names, point = model.candidate.names, model.candidate.refit.point.z
    spread = np.sqrt(np.diag(model.candidate.refit.covariance))
    out = {}
    for k, (name, unit) in enumerate(zip(problem.plant.theta_names, problem.plant.theta_units, strict=True)):
        if name in names:
            i = names.index(name)
            out[name] = _number(point[i], spread[i], unit) | {"identifiable": bool(spread[i] < abs(point[i]) + 1e-12)}
        else:
            value = float(model.candidate.theta[k])
            out[name] = _number(value, 0.0, unit) | {"identifiable": False, "note": "known, not fitted"}
    for name, where in problem.base:  # a mended model that was declared: its effects are declared parameters
        for parameter, (value, error) in model.candidate.parameters(name, where).items():
            unit = _unit(problem, name, where, parameter)
            out[f"{name} {where} {parameter}"] = _number(value, error, unit) | {
                "identifiable": bool(error < abs(value))
            }
    for name, physical in problem.plant.physical(model.candidate.theta, problem.recording.known).items():
        if name not in out:
            value = None if physical.value is None else float(physical.value)
            out[name] = {"value": value, "low": None, "high": None, "unit": physical.unit}
            out[name] |= {"identifiable": bool(physical.identifiable)}
    return out


def _unit(problem: Problem, effect: str, where: str, parameter: str) -> str:
    layout = problem.model.layout
    chosen = layout.instances[layout.index(effect, where)].effect
    return next(p.unit for p in chosen.parameters if p.name == parameter)


def floor_of(problem: Problem) -> float:
    """Standard deviation of the sensors' noise over all measured angles, rad."""
    return float(
        np.sqrt(np.mean([problem.noise.std[c] ** 2 for c in problem.plant.outputs[: problem.plant.joint_dim]]))
    )


def _error(problem: Problem, before: CrossValidation, after: CrossValidation | None, rng) -> dict[str, Any]:
    noise = problem.noise.std
    channels = problem.plant.outputs[: before.squared.shape[1]]
    per_channel = {}
    for k, c in enumerate(channels):
        per_channel[c] = {
            "unit": "rad", "before": before.rmse(k), "after": None if after is None else after.rmse(k), "noise_floor": noise[c],
            "intervals": {"before": before.interval(k, rng), "after": None if after is None else after.interval(k, rng)},
        }  # fmt: skip
    names = [t.name for t in problem.recording.trials]
    per_trial = [_trial_error(name, i, before, after, channels) for i, name in enumerate(names)]
    length = float(np.median(problem.windows.dt.sum(1)[problem.windows.real]))
    return {
        "metric": f"RMSE of joint angles simulated over {length:.2g} s stretches of held-out trials, initial states fitted",
        "stretch_s": length, "unit": "rad", "before": before.rmse(), "after": None if after is None else after.rmse(),
        "noise_floor": floor_of(problem),
        "ceiling": None, "per_channel": per_channel, "per_trial": per_trial,
        "intervals": {"before": before.interval(None, rng), "after": None if after is None else after.interval(None, rng)},
    }  # fmt: skip


def add_leading(report: dict[str, Any], problem: Problem, model: Fit, found: Trace, after: CrossValidation) -> bool:
    """Put what the likeliest set of effects reaches into the report, where that set explains too little for a name; whether it
    simulates left-out trials any better than the declared model, and so is worth trying."""
    names = [e for e in model.active if e not in found.base.active]
    words = " and ".join(f"{name.replace('_', ' ')} at {where}" for name, where in names)
    if after.rmse() >= report["error"]["before"]:
        worse = f"The likeliest set, {words}, simulates held-out trials no better than the declared model."
        report["not_established"].append(worse)
        return False
    layout = problem.model.layout
    effects = []
    for name, where in names:
        units = {p.name: p.unit for p in layout.instances[layout.index(name, where)].effect.parameters}
        fitted = model.candidate.parameters(name, where)
        numbers = {p: _number(value, spread, units[p]) for p, (value, spread) in fitted.items()}
        effects.append({"name": name, "where": where, "parameters": numbers})
    left, reached = force_ratio(model, found.base), after.rmse()
    interval = after.interval(None, np.random.default_rng(0))
    told = {"effects": effects, "after": reached, "interval": interval, "unexplained_left": left}
    report["error"]["leading"] = told
    report["not_established"].append(
        f"The likeliest set, {words}, would bring the held-out error from {1e3 * report['error']['before']:.3g} to "
        f"{1e3 * reached:.3g} mrad and leave {100 * left:.0f} % of the unexplained torque: not enough for a name. "
        "leading.toml has it, to be tried."
    )
    return True


def add_ceiling(error: dict[str, Any], found: FlexibleBound | None) -> None:
    """Put the flexible model's held-out error into the report's `error`, and what its forces follow.

    Where its linearisation misses more than the declared model does, smooth forces help nothing: that is the ceiling.
    """
    if found is None:
        return
    if found.rmse > error["before"]:
        error["ceiling"], error["ceiling_groups"] = error["before"], []
        for row in error["per_channel"].values():
            row["ceiling"] = row["before"]
        return
    error["ceiling"] = found.rmse
    error["ceiling_groups"] = [f"{variable} at {joint}" for joint, variable in found.groups]
    for row, value in zip(error["per_channel"].values(), found.per_channel, strict=True):
        row["ceiling"] = float(value)


def _trial_error(name: str, i: int, before: CrossValidation, after: CrossValidation | None, channels) -> dict[str, Any]:
    pair = lambda k: {"before": before.rmse(k, i), "after": None if after is None else after.rmse(k, i)}
    return {"trial": name, **pair(None), "per_channel": {c: pair(k) for k, c in enumerate(channels)}}


def _candidates(problem: Problem, found: Trace, verdict: Verdict) -> list[dict[str, Any]]:
    """Every candidate once, best first, with why it was or was not taken."""
    count = len(found.ranked)
    refits = {}
    for t in found.tried:
        refits.setdefault(t.active[-1], t)
    order = sorted(
        found.ranked, key=lambda r: -(refits[r.instance].total if r.instance in refits else -1e18 + r.score.gain)
    )
    return [_candidate(r, refits.get(r.instance), found, verdict, problem.criteria, count) for r in order]


def _candidate(r: Ranked, refit: Fit | None, found: Trace, verdict: Verdict, criteria: Criteria, count: int):
    accepted = verdict.named and r.instance in found.added
    alike = any(r.instance in rivals for rivals in found.classes.values())
    status, why = "rejected", ""
    if accepted:
        status, why = "accepted", "explains the residual, held out, better than its rivals"
        if refit is not None:
            why += f"; refitted, it leaves {100 * force_ratio(refit, found.base):.2g} % of the unexplained torque"
    elif r.score.retained < 1e-2:
        status, why = "confounded", "the declared parameters can do the same with this motion"
    elif alike and verdict.named:
        status, why = "look-alike", "these data cannot tell it from the accepted effect"
    elif refit is not None and refit.at_bound():
        why = f"refitted, {refit.at_bound()[0].split('/')[2]} runs to the edge of what it may be"
    elif refit is not None and (odd := dict(refit.amiss).get(r.instance)):
        why = f"refitted, {odd}"
    elif refit is not None and force_ratio(refit, found.base) > 1.0 - criteria.least_fall:
        why = "refitted, it leaves the unexplained torque as it was"
    elif refit is not None:
        why = f"refitted, it leaves {100 * force_ratio(refit, found.base):.0f} % of the unexplained torque"
    elif r.corrected(count) >= criteria.alpha:
        why = "no more than chance, corrected for all that was tried"
    else:
        why = "explains less than the candidates that were refitted"
    gain = float(np.clip(r.score.held_out_share, -1e6, 1.0))
    return {
        "name": r.instance[0], "where": r.instance[1], "held_out_gain": gain, "p_value": r.corrected(count),
        "accepted": bool(accepted), "status": status, "why": why,
        "explained_torque": None if refit is None else float(1.0 - force_ratio(refit, found.base) ** 2),
    }  # fmt: skip


def _not_established(problem: Problem, found: Trace, verdict: Verdict, powers: list[Power]) -> list[str]:
    lines = [] if any_torque(problem.recording) else [_unscaled(problem)]
    hidden = [
        n
        for n, p in problem.plant.physical(found.base.candidate.theta, problem.recording.known).items()
        if not p.identifiable
    ]
    if hidden:
        lines.append(f"{', '.join(hidden)} one by one: the motion fixes only the combinations listed.")
    absorbed = [f"{r.instance[0]} at {r.instance[1]}" for r in found.ranked if r.score.retained < 1e-2]
    if absorbed:
        lines.append(f"{', '.join(absorbed)}: the declared parameters would absorb it.")
    weak = [f"{p.name} at {p.where}" for p in powers if not p.enough and p.smallest < 1e6]
    if weak:
        lines.append(
            f"Effects of {100 * problem.criteria.matters:.0f} % of the torque would have gone unseen: {', '.join(weak[:6])}."
        )
    if verdict.named:
        lines.append("Whether the named effect is the cause or only acts like it within this motion.")
    return lines


def _unscaled(problem: Problem) -> str:
    name, unit = problem.plant.theta_names[0], problem.plant.theta_units[0]
    known = [n for n in problem.recording.known if n in problem.plant.theta_names]
    given = " and ".join(known) if known else f"{name} = 1 {unit}, which is arbitrary"
    return f"How large masses and torques are: no torque was applied, and motions alone fix ratios. All sizes go with {given}."


def _torques(problem: Problem, found: Trace) -> dict[str, Any]:
    return {
        joint: {"before": float(b), "after": float(a), "unit": "N m", "torque_rms": float(r)}
        for joint, b, a, r in zip(
            problem.plant.joints,
            found.base.parts.force_std(),
            found.final.parts.force_std(),
            problem.torque_rms,
            strict=True,
        )
    }


def _power(p: Power) -> dict[str, Any]:
    return {"name": p.name, "where": p.where, "size": min(p.smallest, 1e3), "unit": "share of torque RMS", "power": 0.8}


def _evidence(
    problem: Problem, before: CrossValidation, after: CrossValidation | None, report: dict[str, Any]
) -> dict[str, Any]:
    """Measured against simulated, trial by trial, windows one after the other."""
    channels = problem.plant.outputs[: before.squared.shape[1]]
    shown = []
    measured = np.where(np.isnan(before.simulated), np.nan, np.asarray(problem.windows.measured))
    for i, trial in enumerate(problem.recording.trials):
        pick = (before.trial == i) & problem.windows.real
        if not pick.any():
            continue
        flat = lambda z, k, pick=pick: np.concatenate([np.append(row, np.nan) for row in z[pick][:, :, k]])
        time = np.concatenate([np.append(row, row[-1]) for row in problem.windows.times[pick]])
        entry = {"trial": trial.name, "time": time}
        entry["measured"] = {c: flat(measured, k) for k, c in enumerate(channels)}
        entry["before"] = {c: flat(before.simulated, k) for k, c in enumerate(channels)}
        entry["after"] = None if after is None else {c: flat(after.simulated, k) for k, c in enumerate(channels)}
        shown.append(entry)
    return {"held_out": shown, "leftover": report["leftover"]}
