"""Diagnose measured pushes: which effects the declared push lacks, what is left, the mended model, and the push that tells more."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import adaptsim_jax
from adaptsim_jax.attribution.criteria import Criteria
from adaptsim_jax.attribution.trials.problem import TrialProblem
from adaptsim_jax.attribution.trials.select import TrialModel, TrialNamed, TrialSelection, select, spread
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import output_folder, write_bytes
from adaptsim_jax.effects.base import NINETY
from adaptsim_jax.sysid.report.schema import check, new_report
from adaptsim_jax.tasks.pushing.diagnosis.catalogue import EFFECTS, grain
from adaptsim_jax.tasks.pushing.diagnosis.experiment import telling
from adaptsim_jax.tasks.pushing.diagnosis.problem import prepare, simulated
from adaptsim_jax.tasks.pushing.diagnosis.read import Pushed, read
from adaptsim_jax.tasks.pushing.planar import DRAKE

Page = Callable[[Path, dict[str, Any], dict[str, Any]], None]
MODEL, NEXT = "model.toml", "next_experiment.csv"
OTHERS = ("model.xml", "leading.toml")  # of an earlier run of another kind into the same folder


def diagnose(
    data: str | Path | Pushed,
    *,
    out: str | Path | None = None,
    criteria: Criteria | None = None,
    exclude: tuple[str, ...] = (),
    progress: Callable[[float, float, str], None] | None = None,
    page: Page | None = None,
    named: str = "DATA",
) -> dict[str, Any]:
    """The report on a folder of pushes (or on `Pushed`); with `out` it is written there, with `model.toml` and, where names cannot
    be told apart, `next_experiment.csv`. exclude: effects that are not considered; named: what `Pushed` came of. Raises BadInput.
    """
    began = time.monotonic()
    criteria = criteria or Criteria()
    say = progress or (lambda done, total, note: None)
    pushed = data if isinstance(data, Pushed) else read(data)
    known = {e.name for e in EFFECTS}
    for name in exclude:
        if name not in known:
            raise BadInput(f"--exclude: {name!r} is no effect of a push; it has {', '.join(sorted(known))}")
    effects = tuple(e for e in EFFECTS if e.name not in exclude)
    folder = None if out is None else output_folder(out)
    problem = prepare(pushed, pushed.options, pushed.coefficients, effects)
    done = [0.05]

    def step(note: str) -> None:
        done[0] += 0.05 * (1.0 - done[0])
        say(done[0], 1.0, note)

    found = select(problem, criteria, step)
    report, evidence = reported(pushed, problem, found, criteria)
    plan = telling(pushed, found)
    if plan is not None:
        report["next_experiment"] = {k: plan[k] for k in ("message", "separates")} | (
            {"csv": NEXT} if plan["rows"] else {}
        )
    report["run"] = evidence["run"] = {
        "version": adaptsim_jax.__version__,
        "seed": 0,
        "command": f"adaptsim diagnose {named if isinstance(data, Pushed) else data} --out again",
        "seconds": round(time.monotonic() - began, 1),
    }
    report = check(report)
    if folder is not None:
        for name in (*OTHERS, MODEL, NEXT):
            (folder / name).unlink(missing_ok=True)
        write_bytes(folder / MODEL, config.dumps(model_table(pushed, problem, found)).encode())
        if plan is not None and plan["rows"]:
            rows = [f"{i},{a:.6f},{b:.6f}" for i, (a, b) in enumerate(plan["rows"], 1)]
            write_bytes(folder / NEXT, "\n".join(["trial,speed,angle", *rows, ""]).encode())
        if page is not None:
            page(folder, report, evidence)
    return report


def over_floor(model: TrialModel) -> float:
    """Left-out error over the noise floor, median over trials."""
    return float(np.sqrt(np.median(model.fit.held)))


def left_by_fit(problem: TrialProblem, model: TrialModel) -> float:
    """What the whole fit leaves over the noise floor, all trials together.

    A push that alone shows where a patch ends is predicted badly by the others though the model is right; a model that lacks
    something leaves more than noise where it was fitted, too.
    """
    return float(np.sqrt(model.fit.loss / problem.counts.sum()))


def _kind(named: tuple[TrialNamed, ...], over: float, criteria: Criteria) -> str:
    if not named:
        return "within_noise" if over <= criteria.explained else "structured_unattributed"
    if over > criteria.explained:
        return "partly_explained"
    return "explained_class" if any(n.alternatives or n.effect.same for n in named) else "explained"


def reported(
    pushed: Pushed, problem: TrialProblem, found: TrialSelection, criteria: Criteria
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The report, and the arrays behind its page."""
    over = over_floor(found.final)
    worst = max(over, left_by_fit(problem, found.final))
    tracks = {"before": simulated(pushed, pushed.options, pushed.coefficients, found.null.fit.vectors)}
    tracks["after"] = simulated(pushed, pushed.options, pushed.coefficients, found.final.fit.vectors)
    report = new_report(
        "pushing",
        "the planar push with lateral motion",
        _kind(found.named, worst, criteria),
        message(pushed, found, over, worst),
        {"trials": len(pushed.names), "samples": int(pushed.mask.sum()), "held_out_trials": len(pushed.names)},
        effects=[_effect(problem, found, n) for n in found.named],
        error=_error(pushed, found, tracks),
        candidates=_candidates(found),
        declared={"before": _declared(problem, found.null), "after": _declared(problem, found.final)},
        not_established=[
            f"{n.effect.name.replace('_', ' ')} or {s.replace('_', ' ')}: no push tells them apart, only a log of the arm by the "
            "camera's clock."
            for n in found.named
            for s in n.effect.same
        ],
        notes=list(pushed.notes),
        noise={"m": pushed.noise, "source": pushed.noise_source},
    )
    evidence = {
        "audit": [{"severity": "info", "where": "", "message": note} for note in pushed.notes],
        "held_out": _held_out(pushed, tracks, bool(found.named)),
        "tracks": _from_above(pushed, tracks, bool(found.named)),
    }
    return report, evidence


def message(pushed: Pushed, found: TrialSelection, over: float, worst: float) -> str:
    """What was found, in a few sentences."""
    size = lambda m: f"{1e3 * pushed.noise * over_floor(m):.3g}"
    if not found.named:
        told = f"The declared push, fitted, predicts left-out tracks to {size(found.null)} mm, {over:.1f} times the noise floor."
        return f"{told} No effect of the catalogue holds out." if worst > 1.5 else f"{told} Nothing need be added."
    lines = [
        f"{n.effect.name.replace('_', ' ')} holds out in {n.test.better} of {n.test.folds} pushes "
        f"(takes {100 * n.test.gain:.0f} % off the squared error beside all others, p {n.test.p:.2g})"
        for n in found.named
    ]
    told = "; ".join(lines)
    left = f"Left-out error {size(found.null)} to {size(found.final)} mm, {over:.1f} times the noise floor."
    if worst > 1.5 >= over:
        left += f" Some pushes are not followed: all together the fit leaves {worst:.1f} times the noise floor."
    return f"{told[:1].upper()}{told[1:]}. {left}"


def _interval(problem: TrialProblem, model: TrialModel, name: str) -> tuple[float, float, float]:
    i = problem.index[name]
    value, width = float(model.fit.values[i]), NINETY * float(spread(model)[i])
    return value, value - width, value + width


def _effect(problem: TrialProblem, found: TrialSelection, n: TrialNamed) -> dict[str, Any]:
    e = n.effect
    numbers = {}
    for name in e.quantities:
        value, low, high = _interval(problem, found.final, name)
        numbers[name] = {"value": value, "low": low, "high": high, "unit": problem.quantities[problem.index[name]].unit}
    more = {}
    if e.name == "grain":
        ratio, along = grain(*(float(found.final.fit.values[problem.index[q]]) for q in e.quantities))
        more = {"ratio": ratio, "smooth_direction_rad": along}
    return {
        "name": e.name,
        "where": e.where,
        "parameters": numbers,
        "physics": e.physics,
        "shown_by": e.seen,
        "alternatives": [*[f"{a.name}@{a.where}" for a, _ in n.alternatives], *[f"{s}@command" for s in e.same]],
        "held_out_gain": n.test.gain,
        "p_value": n.test.p,
        "better": n.test.better,
        "folds": n.test.folds,
        "size_over_scatter": min(n.steady, 1e3),
        **more,
    }


def _error(pushed: Pushed, found: TrialSelection, tracks: Mapping[str, np.ndarray]) -> dict[str, Any]:
    held = {"before": found.null.fit.held, "after": found.final.fit.held}
    size = {k: pushed.noise * np.sqrt(v) for k, v in held.items()}
    rng = np.random.default_rng(0)
    draws = rng.integers(0, len(pushed.names), (400, len(pushed.names)))
    whole = lambda e, at=slice(None): float(np.median(e[at]))
    one = lambda k, c: np.sqrt(
        (np.square(tracks[k][..., c] - pushed.xy[..., c]) * pushed.mask).sum(1) / pushed.mask.sum(1)
    )
    channels = {
        name: {"unit": "m", **{k: whole(one(k, c)) for k in held}, "noise_floor": pushed.noise}
        for c, name in enumerate(("x", "y"))
    }
    trials = [
        {
            "trial": name,
            **{k: float(size[k][i]) for k in held},
            "per_channel": {n: {k: float(one(k, c)[i]) for k in held} for c, n in enumerate(("x", "y"))},
        }
        for i, name in enumerate(pushed.names)
    ]
    return {
        "metric": "median over left-out pushes of the RMS error of a coordinate of the track",
        "unit": "m",
        **{k: whole(v) for k, v in size.items()},
        "noise_floor": pushed.noise,
        "ceiling": None,
        "per_channel": channels,
        "per_trial": trials,
        "noise_floor_source": pushed.noise_source,
        "intervals": {
            k: [float(z) for z in np.quantile([whole(v, d) for d in draws], [0.025, 0.975])] for k, v in size.items()
        },
    }


def _candidates(found: TrialSelection) -> list[dict[str, Any]]:
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


def _declared(problem: TrialProblem, model: TrialModel) -> dict[str, Any]:
    out = {}
    for name in problem.declared:
        q, (value, low, high) = problem.quantities[problem.index[name]], _interval(problem, model, name)
        known = high - low < 0.3 * (q.high - q.low)
        if name == "log_e":
            value, low, high = (10.0 ** float(np.clip(z, q.low, q.high)) for z in (value, low, high))
        unit = "Pa" if name == "log_e" else q.unit
        out["e" if name == "log_e" else name] = {
            "value": value,
            "low": low,
            "high": high,
            "unit": unit,
            "identifiable": bool(known),
        }
    return out


def model_table(pushed: Pushed, problem: TrialProblem, found: TrialSelection) -> dict[str, Any]:
    """`model.toml`: declared parameters as fitted, and what each named effect adds."""
    value = lambda name: float(found.final.fit.values[problem.index[name]])
    return {
        "schema": 1,
        "task": "pushing",
        "friction": pushed.options.friction,
        "mass": pushed.options.mass,
        "coefficients": "drake" if pushed.coefficients == DRAKE else "native",
        "parameters": {"mu": value("mu"), "e": 10.0 ** value("log_e"), "mu_p": value("mu_p"), "y_p": value("y_p")},
        "effects": {n.effect.name: {q: value(q) for q in n.effect.quantities} for n in found.named},
    }


def _held_out(pushed: Pushed, tracks, mended: bool) -> list[dict[str, Any]]:
    out = []
    for i, name in enumerate(pushed.names):
        k = pushed.mask[i] > 0
        channels = lambda z, i=i, k=k: {"x": z[i][k, 0], "y": z[i][k, 1]}
        out.append(
            {
                "trial": name,
                "unit": "m",
                "time": pushed.time[i][k],
                "measured": channels(pushed.xy),
                "before": channels(tracks["before"]),
                "after": channels(tracks["after"]) if mended else None,
            }
        )
    return out


def _from_above(pushed: Pushed, tracks, mended: bool) -> dict[str, Any]:
    cut = lambda z: [z[i][pushed.mask[i] > 0] for i in range(len(pushed.names))]
    return {
        "measured": cut(pushed.xy),
        "before": cut(tracks["before"]),
        "after": cut(tracks["after"]) if mended else None,
    }
