"""Diagnose measured scoops: which effects the declared scoop lacks, what is left, the mended model,
and the scoop that tells more.
"""

from functools import partial
from pathlib import Path

import numpy as np

from adaptsim_jax.diagnosis import rows
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.written import keeping
from adaptsim_jax.mend.model_toml import Form, Value, added_effects
from adaptsim_jax.tasks.scooping.diagnosis.experiment import informative_scoops
from adaptsim_jax.tasks.scooping.diagnosis.passes import CRITERIA, Found, diagnosed, effects_of
from adaptsim_jax.tasks.scooping.diagnosis.read import KIND, Scooped, read
from adaptsim_jax.tasks.scooping.model import SHAPES
from adaptsim_jax.tasks.trial_diagnosis import Diagnose, TracksFound, reported

MODEL = "the hydroelastic scoop"


def assess(scooped: Scooped, effects, criteria: Criteria, progress, folder: Path | None):
    """See `trial_diagnosis.Diagnose`."""
    s, keep = scooped, partial(keeping, folder, "scooping", MODEL)
    found = diagnosed(scooped, effects, criteria, rows.stepping(progress, 0.02), keep)
    known = np.any(found.scale > 0, -1) * 1.0
    observed = rows.Recorded(
        KIND.trial,
        KIND.trials,
        s.names,
        s.time,
        s.places,
        s.mask,
        s.channels,
        s.noise,
        s.noise_source,
        known,
    )
    side = (0, 2) if len(s.channels) > 2 else (0, 1)
    notes = [*s.notes, _message(found, known, s.mask)]
    made = TracksFound(
        "scooping", MODEL, observed, found.problem, found.selection, found.tracks, notes
    )
    report, evidence = reported(
        made,
        criteria,
        side,
        noise={"m": s.noise, "source": s.noise_source},
        piece={"shape": found.shape, "declared": s.shape is not None},
    )
    evidence["tracks"]["axes"] = [s.channels[i] for i in side]
    return report, evidence, informative_scoops(scooped, found), mended_model(scooped, found), {}


def _message(found: Found, known: np.ndarray, mask: np.ndarray) -> str:
    share = 100.0 * known.sum() / max(mask.sum(), 1.0)
    floor = float(np.median(1e3 / found.scale[found.scale > 0]))
    return (
        f"the piece moves like {'an ' if found.shape == SHAPES[0] else 'a '}{found.shape}; "
        f"{share:.0f} % of the rows can be told beforehand, half of them to {floor:.2g} mm: errors "
        "are over what each row can be told to"
    )


def mended_model(scooped: Scooped, found: Found) -> Form:
    """`model.toml`: declared parameters as fitted, and what each named effect adds."""
    problem, fitted = found.problem, found.selection.final.fit.values
    value = {q.name: float(fitted[i]) for i, q in enumerate(problem.quantities)}
    declared = {
        "mu": Value(value["mu"]),
        "e": Value(10.0 ** value["log_e"], unit="Pa"),
        "g": Value(float(SHAPES.index(found.shape))),
        "h": Value(value["h"], unit="m"),
    }
    own = {"clearance": scooped.options.clearance, "press": scooped.options.press}
    units = {q.name: q.unit for q in problem.quantities}
    effects = added_effects([n.candidate for n in found.selection.named], value, units)
    return Form("scooping", MODEL, declared, effects, own)


diagnose = Diagnose(
    KIND.trial,
    Scooped,
    read,
    effects_of,
    assess,
    CRITERIA,
    ("place_x", "place_y", "pitch", "rate", "distance"),
)
