"""Diagnose measured pushes: which effects the declared push lacks, what is left, the mended model, and the push that tells more."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import adaptsim_jax
from adaptsim_jax.attribution.criteria import Criteria
from adaptsim_jax.attribution.trials import report as parts
from adaptsim_jax.attribution.trials.problem import TrialProblem
from adaptsim_jax.attribution.trials.select import TrialModel, TrialNamed, TrialSelection, select
from adaptsim_jax.core import config
from adaptsim_jax.core.files import output_folder, write_bytes
from adaptsim_jax.sysid.report.schema import check, new_report
from adaptsim_jax.tasks.pushing.diagnosis.catalogue import EFFECTS, grain
from adaptsim_jax.tasks.pushing.diagnosis.experiment import telling
from adaptsim_jax.tasks.pushing.diagnosis.problem import prepare, simulated
from adaptsim_jax.tasks.pushing.diagnosis.read import Pushed, read
from adaptsim_jax.tasks.pushing.planar import DRAKE

Page = Callable[[Path, dict[str, Any], dict[str, Any]], None]
MODEL, NEXT = "model.toml", "next_experiment.csv"
LOGS = {"log_e": ("e", "Pa")}
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
    effects = parts.considered(EFFECTS, exclude, "a push")
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
        parts.verdict(found.named, worst, criteria),
        message(pushed, found, over, worst),
        {"trials": len(pushed.names), "samples": int(pushed.mask.sum()), "held_out_trials": len(pushed.names)},
        effects=[_effect(problem, found, n) for n in found.named],
        error=_error(pushed, found, tracks),
        candidates=parts.candidate_rows(found),
        declared={
            k: parts.declared_rows(problem, m, LOGS) for k, m in (("before", found.null), ("after", found.final))
        },
        not_established=[
            f"{parts.words(n.effect.name)} or {parts.words(s)}: no push tells them apart, only a log of the arm by the "
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
    left = f"Left-out error {size(found.null)} to {size(found.final)} mm, {over:.1f} times the noise floor."
    if worst > 1.5 >= over:
        left += f" Some pushes are not followed: all together the fit leaves {worst:.1f} times the noise floor."
    return f"{parts.told(found.named, 'pushes')} {left}"


def _effect(problem: TrialProblem, found: TrialSelection, n: TrialNamed) -> dict[str, Any]:
    if n.effect.name != "grain":
        return parts.effect_row(problem, found, n)
    ratio, along = grain(*(float(found.final.fit.values[problem.index[q]]) for q in n.effect.quantities))
    return parts.effect_row(problem, found, n, ratio=ratio, smooth_direction_rad=along)


def _error(pushed: Pushed, found: TrialSelection, tracks: Mapping[str, np.ndarray]) -> dict[str, Any]:
    held = {"before": found.null.fit.held, "after": found.final.fit.held}
    one = lambda k, c: np.sqrt(
        (np.square(tracks[k][..., c] - pushed.xy[..., c]) * pushed.mask).sum(1) / pushed.mask.sum(1)
    )
    return parts.error_table(
        "median over left-out pushes of the RMS error of a coordinate of the track",
        pushed.noise,
        pushed.noise_source,
        pushed.names,
        {k: pushed.noise * np.sqrt(v) for k, v in held.items()},
        {name: ("m", pushed.noise, {k: one(k, c) for k in held}) for c, name in enumerate(("x", "y"))},
    )


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
