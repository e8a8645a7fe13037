"""Diagnose pushes: what the adapted simulator still gets wrong about a robot's pushes, named where it holds out."""

import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import adaptsim_jax
from adaptsim_jax.attribution.criteria import Criteria
from adaptsim_jax.attribution.trials import Model, Named, Problem, Selection, select, spread
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import output_folder, write_bytes, write_json
from adaptsim_jax.effects.base import NINETY
from adaptsim_jax.sysid.report.schema import check, new_report
from adaptsim_jax.tasks.pushing import model as pushing
from adaptsim_jax.tasks.pushing.effects import CATALOGUE, DECLARED
from adaptsim_jax.tasks.pushing.slide import ROW, STEP
from adaptsim_jax.tasks.pushing.tracks import Tracks, errors, predicted, problem_of, read_tracks

Page = Callable[[Path, dict[str, Any], dict[str, Any]], None]
NEXT = "next_experiment.csv"
STALE = ("model.toml", "leading.toml", "model.xml", "declared.xml", NEXT, "tracks.png")


def diagnose(
    data: str | Path,
    *,
    out: str | Path | None = None,
    criteria: Criteria | None = None,
    exclude: Sequence[str] = (),
    without: Sequence[str] = (),
    progress: Callable[[float, float, str], None] | None = None,
    page: Page | None = None,
) -> dict[str, Any]:
    """Diagnose a folder of pushes (`tracks.read_tracks`); returns the report and, with `out`, writes it with model.toml, tracks.png
    and, where effects cannot be told apart, next_experiment.csv: the push that would. Raises BadInput where the data cannot be read.
    """
    began, criteria = time.monotonic(), criteria or Criteria()
    say = progress or (lambda done, total, note: None)
    say(0.02, 1.0, "reading")
    tracks = read_tracks(data).without(without)
    known = [c.name for c in CATALOGUE]
    for name in exclude:
        config.pick("effect of a push", name, known)
    problem = problem_of(tracks)
    if exclude:
        problem = replace(problem, candidates=tuple(c for c in CATALOGUE if c.name not in exclude))
    share = [0.05]

    def step(note: str) -> None:
        share[0] += 0.06 * (1.0 - share[0])
        say(share[0], 1.0, note.replace("_", " "))

    step("declared model")
    found = select(problem, criteria, step)
    report, evidence = reported(tracks, problem, found, criteria)
    words = ["adaptsim", "diagnose", str(data), "--out", "again"]
    words += ["--exclude", *exclude] if exclude else []
    words += ["--without", *without] if without else []
    report["run"] = evidence["run"] = {
        "version": adaptsim_jax.__version__, "seed": 0, "command": shlex.join(words), "seconds": round(time.monotonic() - began, 1),
    }  # fmt: skip
    if plan := telling_push(tracks, problem, found):
        report["next_experiment"] = {
            "separates": plan["separates"], "distance": plan["distance"], "file": NEXT,
            "message": f"push at {plan['speed']:.3g} m/s and {plan['angle']:.3g} rad: there {plan['separates'][0]} and "
            f"{plan['separates'][1]} end {1e3 * plan['metres']:.1f} mm apart",
        }  # fmt: skip
    report = check(report)
    if out is not None:
        folder = output_folder(out)
        for name in STALE:
            (folder / name).unlink(missing_ok=True)
        write_bytes(folder / "model.toml", model_text(tracks, problem, found.final, report).encode())
        if plan:
            write_bytes(folder / NEXT, f"trial,speed,angle\n1,{plan['speed']:.4f},{plan['angle']:.4f}\n".encode())
        from adaptsim_jax.tasks.pushing.tracks_figure import save

        save(folder / "tracks.png", tracks, problem, found)
        (page or (lambda f, r, e: write_json(f / "report.json", r)))(folder, report, evidence)
    return report


def reported(
    tracks: Tracks, problem: Problem, found: Selection, criteria: Criteria
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The report, and the arrays behind its page."""
    before, after = (errors(tracks, problem, m.folds) for m in (found.null, found.final))
    floor = tracks.noise * np.sqrt(2.0)
    over = float(np.median(after) / floor)
    kind = _kind(found.named, over, criteria)
    pair = lambda pick: {"before": float(np.median(pick(before))), "after": float(np.median(pick(after)))}
    rng = np.random.default_rng(0)
    draws = rng.integers(0, len(before), (400, len(before)))
    interval = lambda e: [float(z) for z in np.quantile(np.median(e[draws], 1), [0.025, 0.975])]
    error = {
        "metric": "median over left-out pushes of the RMS distance between track and simulation", "unit": "m", **pair(lambda e: e),
        "noise_floor": float(floor), "noise_floor_source": "third differences of the tracks",
        "per_channel": {"place": {"unit": "m", **pair(lambda e: e), "noise_floor": float(floor)}},
        "per_trial": [{"trial": t, "before": float(b), "after": float(a)}
                      for t, b, a in zip(tracks.trials, before, after, strict=True)],
        "intervals": {"before": interval(before), "after": interval(after)},
    }  # fmt: skip
    odd = [t for t, a in zip(tracks.trials, after, strict=True) if a > 6.0 * np.median(after) and a > 3.0 * floor]
    notes = list(tracks.notes)
    if odd:
        notes.append(
            f"trial {', '.join(odd)}: left far more than the others; look at it, and run again with --without {' '.join(odd)}"
        )
    if not found.named and over > criteria.explained:
        notes.append(f"the declared model is simulated in steps of {1e3 * STEP:g} ms")
    report = new_report(
        "pushing", "slide", kind, _message(found, before, after, over), {
            "trials": len(tracks.trials), "samples": int(tracks.seen.sum()), "held_out_trials": len(tracks.trials)},
        effects=[_effect(problem, found, n) for n in found.named], error=error, candidates=_candidates(found),
        declared={"before": _declared(problem, found.null), "after": _declared(problem, found.final)},
        not_established=list(found.dropped), notes=notes,
        remaining={"error": float(np.median(after)), "times_floor": over, "joints": {}},
        stages=[{"added": [c.name for c in m.added], "error": float(np.median(errors(tracks, problem, m.folds)))}
                for m in (*found.stages, found.final)],
    )  # fmt: skip
    evidence = {"audit": [{"severity": "info", "where": "", "message": n} for n in notes]}
    return report, evidence


def _kind(named: tuple[Named, ...], over: float, criteria: Criteria) -> str:
    if not named:
        return "within_noise" if over <= criteria.explained else "structured_unattributed"
    if over > criteria.explained:
        return "partly_explained"
    return "explained_class" if any(n.alternatives for n in named) else "explained"


def _message(found: Selection, before: np.ndarray, after: np.ndarray, over: float) -> str:
    size = lambda e: f"{1e3 * np.median(e):.3g} mm"
    if not found.named:
        told = f"The declared push, fitted, is {size(before)} off on left-out pushes, {over:.1f} times the noise floor."
        return f"{told} No effect of the catalogue holds out." if over > 1.5 else f"{told} Nothing need be added."
    parts = []
    for n in found.named:
        others = f" (or {', '.join(a.name.replace('_', ' ') for a in n.alternatives)})" if n.alternatives else ""
        parts.append(
            f"{n.candidate.name.replace('_', ' ')}{others} holds out in {n.test.better} of {n.test.folds} pushes (p {n.test.p:.2g})"
        )
    told = "; ".join(parts)
    rest = f"what remains is {over:.1f} times the noise floor"
    return f"{told[:1].upper()}{told[1:]}. Left-out error {size(before)} to {size(after)}; {rest}."


def _effect(problem: Problem, found: Selection, n: Named) -> dict[str, Any]:
    at, wide = problem.at(n.candidate.parameters), NINETY * spread(found.final)
    value = found.final.vector
    return {
        "name": n.candidate.name, "where": n.candidate.place, "joints": [], "physics": n.candidate.physics,
        "parameters": {problem.parameters[i].name: {"value": float(value[i]), "low": float(value[i] - wide[i]),
                       "high": float(value[i] + wide[i]), "unit": problem.parameters[i].unit} for i in at},
        "alternatives": [f"{a.name}@{a.place}" for a in n.alternatives], "held_out_gain": n.test.gain, "p_value": n.test.p,
        "better": n.test.better, "folds": n.test.folds, "size_over_scatter": float(min(n.steady, 1e3)),
    }  # fmt: skip


def _candidates(found: Selection) -> list[dict[str, Any]]:
    names = {n.candidate.name for n in found.named}
    alike = {a.name for n in found.named for a in n.alternatives}
    return [
        {"name": c.name, "where": c.place, "held_out_gain": float(np.clip(gain, -1, 1)),
         "p_value": float(min(1.0, p * len(found.first))),
         "accepted": c.name in names, "status": "accepted" if c.name in names else "look-alike" if c.name in alike else "rejected",
         "why": "named" if c.name in names else "does as well" if c.name in alike else "gains less than what was taken"}
        for c, gain, p in found.first
    ]  # fmt: skip


def _declared(problem: Problem, model: Model) -> dict[str, Any]:
    wide = NINETY * spread(model)
    out = {}
    for name, i in zip(DECLARED, problem.at(DECLARED), strict=True):
        p, v = problem.parameters[i], float(model.vector[i])
        inside = p.low < v < p.high and wide[i] < 0.25 * (p.high - p.low)
        out[name] = {"value": v, "low": v - wide[i], "high": v + wide[i], "unit": p.unit, "identifiable": bool(inside)}
    return out


def model_text(tracks: Tracks, problem: Problem, model: Model, report: dict[str, Any]) -> str:
    """`model.toml`: parameters of the declared push and of the effects."""
    value = lambda i: {"value": float(model.vector[i]), "unit": problem.parameters[i].unit}
    parts = [
        "# Pushes fitted by `adaptsim diagnose`.",
        config.dumps({"schema": 1, "task": "pushing", "model": "slide"}),
    ]
    parts += [f"[declared.{n}]\n" + config.dumps(value(i)) for n, i in zip(DECLARED, problem.at(DECLARED), strict=True)]
    for c in model.added:
        parts.append("[[effects]]\n" + config.dumps({"name": c.name, "where": c.place}))
        parts += [
            f"[effects.parameters.{n}]\n" + config.dumps(value(i))
            for n, i in zip(c.parameters, problem.at(c.parameters), strict=True)
        ]
    told = {k: report[k] for k in ("verdict", "message")} | {"data": tracks.path} | report["run"]
    return "\n".join([*parts, config.dumps({"provenance": told})])


def telling_push(tracks: Tracks, problem: Problem, found: Selection) -> dict[str, Any] | None:
    """The push of a grid at which the first class's members differ most, each fitted; None where nothing is told as a class."""
    from adaptsim_jax.attribution.trials import added, without

    first = next((n for n in found.named if n.alternatives), None)
    if first is None:
        return None
    rival = first.alternatives[0]
    other = added(problem, without(problem, found.final, first.candidate), rival)
    speeds, angles = np.linspace(pushing.ACTION_LOW[0], pushing.ACTION_HIGH[0], 5), np.linspace(-0.3, 0.3, 7)
    grid = np.array([(s, a) for s in speeds for a in angles])
    duration = float(np.ceil(max(tracks.duration, 0.9) / ROW) * ROW)
    when = jnp.linspace(0.0, duration, 30)
    with jax.enable_x64(True):
        run = jax.vmap(lambda v, a: predicted(v, a, when, duration), (None, 0))
        one, two = (np.asarray(run(jnp.asarray(m.vector), jnp.asarray(grid))) for m in (found.final, other))
    apart = np.sqrt(np.square(one - two).sum(-1)).max(1)
    best = int(np.argmax(apart))
    return {"speed": float(grid[best, 0]), "angle": float(grid[best, 1]), "metres": float(apart[best]),
            "distance": float(apart[best] / tracks.noise), "separates": [first.candidate.name, rival.name]}  # fmt: skip


def checked(data: str | Path) -> None:
    """Raises BadInput where the data cannot be read, before anything is written."""
    if not Path(data).is_dir():
        raise BadInput(f"{data}: is no folder; put actions.csv and tracks there")
    read_tracks(data)
