"""Diagnose measured scoops: which effects the declared scoop lacks, what is left, the mended model, and the scoop that tells more."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.files import output_folder
from adaptsim_jax.diagnosis import rows as trials
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.rows import Seen
from adaptsim_jax.diagnosis.run import Page, Run, command_of
from adaptsim_jax.diagnosis.schema import new_report
from adaptsim_jax.diagnosis.written import cleared
from adaptsim_jax.tasks.scooping.diagnosis.experiment import telling
from adaptsim_jax.tasks.scooping.diagnosis.passes import CRITERIA, Found, diagnosed, effects_of
from adaptsim_jax.tasks.scooping.diagnosis.read import KIND, Scooped, read
from adaptsim_jax.tasks.scooping.model import SHAPES

MODEL = "the hydroelastic scoop"
COLUMNS = ("place_x", "place_y", "pitch", "rate", "distance")


def diagnose(
    data: str | Path | Scooped,
    *,
    out: str | Path | None = None,
    criteria: Criteria | None = None,
    exclude: tuple[str, ...] = (),
    progress: Callable[[float, float, str], None] | None = None,
    page: Page | None = None,
    named: str = "DATA",
) -> dict[str, Any]:
    """The report on a folder of scoops (or on `Scooped`); with `out` it is written there, with `model.toml` and, where names cannot
    be told apart, `next_experiment.csv`. exclude: effects that are not considered; named: what `Scooped` came of. Raises BadInput.
    """
    began = time.monotonic()
    criteria = criteria or CRITERIA
    scooped = data if isinstance(data, Scooped) else read(data)
    effects = trials.check_exclude(exclude, effects_of(scooped), KIND.trial)
    folder = None if out is None else cleared(output_folder(out))
    step = trials.stepping(progress, 0.02)
    found = diagnosed(scooped, effects, criteria, step, partial(trials.keeping, folder, "scooping", MODEL))
    report, evidence = reported(scooped, found, criteria)
    run = Run(command_of(named if isinstance(data, Scooped) else data, out=out, exclude=exclude), began)
    plan, model = telling(scooped, found), model_table(scooped, found)
    return trials.finished(report, evidence, run, plan, folder, model, COLUMNS, page)


def reported(scooped: Scooped, found: Found, criteria: Criteria) -> tuple[dict[str, Any], dict[str, Any]]:
    """The report, and the arrays behind its page."""
    s, selection, problem = scooped, found.selection, found.problem
    judged = np.any(found.scale > 0, -1) * 1.0
    seen = Seen(
        KIND.trial, KIND.trials, s.names, s.time, s.places, s.mask, s.channels, s.noise, s.noise_source, judged
    )  # fmt: skip
    over = trials.over_floor(selection.final)
    worst = max(over, trials.left_by_fit(problem, selection.final))
    mended = bool(selection.named)
    notes = [*s.notes, _told(found, judged, s.mask)]
    report = new_report(
        "scooping",
        MODEL,
        trials.verdict(selection.named, worst, criteria),
        trials.message(seen, selection, over, worst),
        {"trials": len(s.names), "samples": int(s.mask.sum()), "held_out_trials": len(s.names)},
        effects=[trials.effect_row(problem, selection, n) for n in selection.named],
        error=trials.error_table(seen, selection, found.tracks),
        candidates=trials.candidate_rows(selection),
        declared={
            "before": trials.declared_rows(problem, selection.null),
            "after": trials.declared_rows(problem, selection.final),
        },
        not_established=trials.same_rows(selection, KIND.trial),
        notes=notes,
        noise={"m": s.noise, "source": s.noise_source},
        piece={"shape": found.shape, "declared": s.shape is not None},
    )
    side = (0, 2) if len(s.channels) > 2 else (0, 1)
    evidence = {
        "audit": [{"severity": "info", "where": "", "message": note} for note in notes],
        "held_out": trials.held_out(seen, found.tracks, mended),
        "tracks": trials.plane_tracks(seen, found.tracks, mended, side) | {"axes": [s.channels[i] for i in side]},
    }
    return report, evidence


def _told(found: Found, judged: np.ndarray, mask: np.ndarray) -> str:
    share = 100.0 * judged.sum() / max(mask.sum(), 1.0)
    floor = float(np.median(1e3 / found.scale[found.scale > 0]))
    return (
        f"the piece moves like {'an ' if found.shape == SHAPES[0] else 'a '}{found.shape}; {share:.0f} % of the rows can be told "
        f"beforehand, half of them to {floor:.2g} mm: errors are over what each row can be told to"
    )


def model_table(scooped: Scooped, found: Found) -> dict[str, Any]:
    """`model.toml`: declared parameters as fitted, and what each named effect adds."""
    values, index = found.selection.final.fit.values, found.problem.index
    value = lambda name: float(values[index[name]])
    g = float(SHAPES.index(found.shape))
    return {
        "schema": 1,
        "task": "scooping",
        "clearance": scooped.options.clearance,
        "press": scooped.options.press,
        "parameters": {"mu": value("mu"), "e": 10.0 ** value("log_e"), "g": g, "h": value("h")},
        "effects": {n.effect.name: {q: value(q) for q in n.effect.quantities} for n in found.selection.named},
    }
