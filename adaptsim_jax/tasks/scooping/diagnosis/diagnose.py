"""Diagnose measured scoops: which effects the declared scoop lacks, what is left, the mended model,
and the scoop that tells more.
"""

from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from adaptsim_jax.core.config import Table
from adaptsim_jax.core.progress import notes_of
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.written import keeping
from adaptsim_jax.mend.model_toml import Form, Value
from adaptsim_jax.tasks.scooping import model
from adaptsim_jax.tasks.scooping.diagnosis.passes import CRITERIA, Found, diagnosed, effects_of
from adaptsim_jax.tasks.scooping.diagnosis.read import Scooped, read
from adaptsim_jax.tasks.scooping.diagnosis.simulate import executed, places, poses
from adaptsim_jax.tasks.scooping.model import SHAPES
from adaptsim_jax.tasks.scooping.motion import KIND
from adaptsim_jax.tasks.trial_diagnosis import (
    Diagnose,
    TracksFound,
    look_alikes,
    mended_form,
    next_trials,
    observed_rows,
    reported,
)

MODEL = "the hydroelastic scoop"


def assess(scooped: Scooped, effects, criteria: Criteria, progress, folder: Path | None):
    """See `trial_diagnosis.Diagnose`."""
    s, keep = scooped, partial(keeping, folder, "scooping", MODEL)
    found = diagnosed(scooped, effects, criteria, notes_of(progress), keep)
    known = np.any(found.scale > 0, -1) * 1.0
    observed = observed_rows(s, KIND, known)
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

    def declared(value):
        return {
            "mu": Value(value["mu"]),
            "e": Value(10.0 ** value["log_e"], unit="Pa"),
            "g": Value(float(SHAPES.index(found.shape))),
            "h": Value(value["h"], unit="m"),
        }

    own = {"clearance": scooped.options.clearance, "press": scooped.options.press}
    return mended_form(found.problem, found.selection, ("scooping", MODEL), declared, own)


GRID = (4, 3, 3)
"""Pitches, rates and distances of the scoops that a next one is chosen from."""
COPIES = 4
"""Scoops of an action, as an arm repeats it."""
PLACE = (0.03, 0.02)
"""m: away from the middle, where a scale and a turn show."""


def informative_scoops(scooped: Scooped, found: Found) -> Table | None:
    """The scoops of a grid that tell a named effect and its look-alikes apart; see `next_trials`.
    Noise is what the camera and the copies of a scoop scatter by.

    None where nothing that was named has look-alikes.
    """
    pairs = look_alikes(found.selection)
    if not pairs:
        return None
    ends = zip(model.ACTION_LOW, model.ACTION_HIGH, GRID, strict=True)
    grid = np.array(list(product(*(np.linspace(*end) for end in ends))))
    count, time = len(grid), np.arange(0.0, model.SECONDS, 1 / 60)
    many = replace(
        scooped,
        actions=grid,
        starts=np.tile(PLACE, (count, 1)),
        aside=np.zeros((count, 2)),
        time=np.tile(time, (count, 1)),
        places=np.zeros((count, len(time), scooped.places.shape[-1])),
    )

    def tracks(values):
        """Mean and scatter `[count, R, C]` over copies."""
        trials = np.repeat(np.arange(count), COPIES)
        every = np.tile(values, (len(trials), 1))
        actions = grid[trials] + executed(scooped, len(trials))
        out = places(many, every, poses(many, found.shape, every, trials, actions), trials)
        out = out.reshape(count, COPIES, *out.shape[1:])
        return out.mean(1), out.std(1)

    own, scatter = tracks(found.selection.final.fit.values)
    scores, sizes = [], []
    for _, _, m in pairs:
        other, wide = tracks(m.fit.values)
        distance = np.abs(other - own)
        clear = distance / np.sqrt(scooped.noise**2 + np.square(scatter) + np.square(wide))
        scores.append(np.sqrt(np.square(clear).sum(-1)).max(1))
        sizes.append(np.sqrt(np.square(distance).sum(-1)).max(1))
    worst = int(np.argmin([s.max() for s in scores]))
    score = scores[worst]
    size = 1e3 * sizes[worst][np.argsort(-score)[0]]
    words = (f"tracks differ by {score.max():.1f} times what scoops scatter by,", f"{size:.2g} mm")
    rows = np.concatenate([np.tile(PLACE, (count, 1)), grid], 1)
    return next_trials(pairs[worst], score, rows, KIND, words)


diagnose = Diagnose(
    KIND.trial,
    Scooped,
    read,
    effects_of,
    assess,
    CRITERIA,
    ("place_x", "place_y", "pitch", "rate", "distance"),
)
