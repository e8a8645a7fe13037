"""Diagnose measured tosses: which effects the declared toss lacks, what is left, and the mended
model.
"""

from pathlib import Path

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.progress import notes_of
from adaptsim_jax.diagnosis import rows as parts
from adaptsim_jax.diagnosis.criteria import REPORT, Criteria
from adaptsim_jax.diagnosis.experiment import separated_by
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.models import Model
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.report import (
    Account,
    Errors,
    Headline,
    error_rows,
    remarks,
    report_of,
    words,
)
from adaptsim_jax.diagnosis.trials import search_trials
from adaptsim_jax.diagnosis.written import keeping
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.mend.model_toml import Form, Value, added_effects
from adaptsim_jax.tasks.toss.body import mended_xml
from adaptsim_jax.tasks.toss.catalogue import effects
from adaptsim_jax.tasks.toss.flight import Flight, free_flight, whole_tosses
from adaptsim_jax.tasks.toss.flight import words as flight_words
from adaptsim_jax.tasks.toss.problem import Follow, prepare
from adaptsim_jax.tasks.toss.read import Tossed, read
from adaptsim_jax.tasks.trial_diagnosis import Diagnose

XML = "model.xml"
CRITERIA = Criteria(
    rounds=3, glance=1
)  # a simulation of strikes is rough: fits gain little after a few rounds
LOGS = {"log_time": ("contact_time", "s")}
MEASURE = {
    "clock_scale": "time the recording against another clock",
    "length_scale": "record two marks whose distance is known",
    "body_size": "measure the body",
    "plane_height": "record a point on the plane",
    "plane_turn": "record three points on the plane, and level it",
    "tilt": "level the table",
    "drag": "drop the body from higher, or push it along a longer slide",
    "speed_friction": "record slides at twice the speed",
    "grain": "record slides in eight directions",
}


def assess(
    tossed: Tossed,
    considered: tuple[Effect, ...],
    criteria: Criteria,
    progress,
    folder: Path | None,
):
    """See `trial_diagnosis.Diagnose`."""
    notify = notes_of(progress)
    notify("starts of the windows")
    problem, follow = prepare(tossed, considered)
    keep = keeping(folder, "toss", _model(tossed), problem, LOGS)
    found = search_trials(problem, criteria, notify, keep=keep)
    report, evidence = reported(tossed, problem, follow, found, criteria)
    values = fitted(problem, found.final)
    xml = {XML: lambda: mended_xml(tossed.body, values, not_in_file(found, values))}
    return report, evidence, None, mended_model(found, values), xml


def fitted(problem: Problem, model: Model) -> dict[str, float]:
    """Values of all quantities by name."""
    return {q.name: float(v) for q, v in zip(problem.quantities, model.fit.values, strict=True)}


def mended_model(found: Finding, values: dict[str, float]) -> Form:
    """`model.toml`: declared parameters as fitted, and what each named effect adds."""
    declared = {
        "friction": Value(values["friction"]),
        "contact_time": Value(10.0 ** values["log_time"], unit="s"),
        "damping": Value(values["damping"]),
    }
    effects = added_effects([n.candidate for n in found.named], values)
    return Form("toss", XML, declared, effects)


def not_in_file(found: Finding, values: dict[str, float]) -> list[str]:
    """What was named and MJCF cannot hold, a line each."""
    return [
        f"not in this file: {n.candidate.name} "
        f"({', '.join(f'{q} = {values[q]:.4g}' for q in n.candidate.names)})"
        for n in found.named
        if not n.candidate.in_mjcf
    ]


def left(follow: Follow, model: Model) -> np.ndarray:
    """What each window leaves over the noise `[W]`, its toss predicted with what the others say."""
    return np.sqrt(np.square(follow.of(model.fit.vectors)[1]).sum((1, 2)) / follow.windows.free)


def reported(
    tossed: Tossed, problem: Problem, follow: Follow, found: Finding, criteria: Criteria
) -> tuple[Table, Table]:
    """The report, and the arrays behind its page."""
    both = (("before", found.null), ("after", found.final))
    over = {k: left(follow, m) for k, m in both}
    tracks = {k: follow.simulated(m.fit.vectors) for k, m in both}
    error = _error(tossed, follow, tracks)
    flown, thrown = free_flight(tossed), {k: whole_tosses(tossed, m.fit.vectors) for k, m in both}
    whole = {k: float(np.median(z)) if len(z) else None for k, z in thrown.items()}
    windows = {
        "count": len(follow.windows.toss),
        "over_noise": {k: float(np.median(v)) for k, v in over.items()},
        "followed": {k: float(np.mean(v <= REPORT.followed)) for k, v in over.items()},
    }
    more = {
        "not_established": _classes(found),
        "notes": list(tossed.notes),
        "noise": {"m": tossed.noise, "rad": tossed.noise_turn, "source": tossed.noise_source},
        "windows": windows,
        "whole_tosses": {"unit": "m", **whole},
        "free_flight": None if flown is None else _flight(flown),
        "next_experiment": separated_by(
            found,
            parts.label,
            lambda label: words(label.name),
            lambda label: MEASURE.get(label.name, ""),
            "{} and {} are told apart by themselves: {}.",
        ),
    }
    count = len(tossed.names)
    account = Account(
        "toss",
        _model(tossed),
        {"trials": count, "samples": int(follow.windows.mask.sum()), "held_out_trials": count},
        parts.label,
        parts.effect_rows(problem, found),
        parts.scored(found),
        headline(found, windows["over_noise"], error, whole, flown),
        float(np.median(over["after"])) > criteria.explained,
        error,
        lambda model: parts.declared_rows(problem, model, LOGS),
        more,
    )
    evidence = {
        "audit": remarks(tossed.notes),
        "held_out": _held_out(tossed, follow, tracks, bool(found.named)),
        "tracks": _from_above(follow, tracks, bool(found.named)),
    }
    return report_of(found, account), evidence


def _classes(found: Finding) -> list[str]:
    return [
        f"{words(n.candidate.name)} or {words(s)}: no toss tells them apart."
        for n in found.named
        for s in n.candidate.same
    ]


def _model(tossed: Tossed) -> str:
    return f"a free body over a plane, by MuJoCo ({Path(tossed.body.path).name})"


def headline(
    found: Finding, over: dict[str, float], error: Table, whole, flown: Flight | None
) -> Headline:
    """Sentences of the message. over: what is left of windows over the noise; whole: errors [m] of
    whole tosses, None where there is none.
    """

    def size(k):
        return f"{1e3 * error[k]:.3g}"

    declared = (
        f"The declared body, fitted, predicts windows of left-out tosses to {size('before')} "
        f"mm, {over['before']:.1f} times the noise floor (median over windows)."
    )
    mended = (
        f"{parts.named_words(found.named, 'tosses')} Left-out error {size('before')} to "
        f"{size('after')} mm; windows are left at {over['after']:.1f} times the noise floor "
        "(median)."
    )
    more = ""
    if whole["before"] is not None:
        after = f" to {1e3 * whole['after']:.3g}" if found.named else ""
        before = f"{1e3 * whole['before']:.3g}"
        more += f" Whole tosses from their flight alone: {before}{after} mm (median)."
    if flown is not None:
        flown_words = flight_words(flown)
        more += f" {flown_words[:1].upper()}{flown_words[1:]}"
    return Headline(declared, mended, more)


def _flight(flown: Flight) -> Table:
    return {
        "gravity": {"value": flown.gravity, "low": flown.low, "high": flown.high, "unit": "m/s^2"},
        "declared": flown.declared,
        "tosses": len(flown.each),
        "class": ["length_scale", "clock_scale", "gravity"] if flown.off else [],
        "if_length_scale": flown.scale,
        "if_clock_fast": flown.clock,
    }


def _error(tossed: Tossed, follow: Follow, tracks: dict[str, np.ndarray]) -> Table:
    w, trials = follow.windows, len(tossed.names)
    rows = np.bincount(w.toss, w.mask.sum(1), trials)

    def rms(which: str, channel: int | None) -> np.ndarray:
        off = np.square(tracks[which] - w.place) * w.mask[..., None]
        if channel is None:
            each = off.sum(1).mean(1)
        else:
            each = off.sum(1)[:, channel]
        return np.sqrt(np.bincount(w.toss, each, trials) / rows)

    def errors(channel: int | None) -> Errors:
        return Errors("m", tossed.noise, {k: rms(k, channel) for k in ("before", "after")})

    return error_rows(
        "median over left-out tosses of the RMS error of a coordinate, over windows with fitted "
        "starts",
        tossed.noise_source,
        tossed.names,
        errors(None),
        {name: errors(c) for c, name in enumerate("xyz")},
    )


def _joined(follow: Follow, toss: int, rows: np.ndarray) -> np.ndarray:
    """Rows `[n, ...]` of a toss's windows, NaN after each, of `rows [W, R, ...]`."""
    gap = np.full((1, *rows.shape[2:]), np.nan)
    cut = [rows[w][follow.windows.mask[w] > 0] for w in np.flatnonzero(follow.windows.toss == toss)]
    return np.concatenate([z for part in cut for z in (part, gap)][:-1])


def _held_out(tossed: Tossed, follow: Follow, tracks, mended: bool) -> list[Table]:
    out, w = [], follow.windows
    begun = np.stack([tossed.time[t][a] for t, a in zip(w.toss, w.first, strict=True)])
    clock = begun[:, None] + w.time
    for i, name in enumerate(tossed.names):

        def channels(z, i=i):
            return dict(zip("xyz", _joined(follow, i, z).T, strict=True))

        time_of = _joined(follow, i, clock)
        gaps = np.flatnonzero(np.isnan(time_of))
        time_of[gaps] = time_of[gaps - 1]
        out.append(
            {
                "trial": name,
                "unit": "m",
                "time": time_of,
                "measured": channels(w.place),
                "before": channels(tracks["before"]),
                "after": channels(tracks["after"]) if mended else None,
            }
        )
    return out


def _from_above(follow: Follow, tracks, mended: bool) -> Table:
    trials = range(len(follow.tossed.names))

    def cut(z):
        return [_joined(follow, i, z[..., :2]) for i in trials]

    return {
        "measured": cut(follow.windows.place),
        "before": cut(tracks["before"]),
        "after": cut(tracks["after"]) if mended else None,
    }


diagnose = Diagnose("toss", Tossed, read, lambda tossed: effects(tossed.body), assess, CRITERIA)
