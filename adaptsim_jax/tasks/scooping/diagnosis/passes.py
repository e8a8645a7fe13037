"""The selection in passes: an emulator around what is believed, effects selected in it, and another around what was found."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.attribution.criteria import Criteria
from adaptsim_jax.attribution.trials.fit import TrialFit, declared_fit, mean_square
from adaptsim_jax.attribution.trials.problem import TrialEffect, TrialProblem
from adaptsim_jax.attribution.trials.select import TrialModel, TrialSelection, select, spread
from adaptsim_jax.tasks.scooping.diagnosis.catalogue import EFFECTS, HEIGHT, SHIFTS
from adaptsim_jax.tasks.scooping.diagnosis.emulate import WIDTHS, emulate
from adaptsim_jax.tasks.scooping.diagnosis.problem import begun, prepare, quantities_of, scales, softened
from adaptsim_jax.tasks.scooping.diagnosis.read import Scooped
from adaptsim_jax.tasks.scooping.diagnosis.simulate import INDEX, OWN, expected
from adaptsim_jax.tasks.scooping.model import SHAPES

PASSES = 4
FIRST = {"mu": 0.05, "log_e": 0.4, "h": 1e-3}
"""Widths of the first draws about the best of the grid; of a height that nobody saw three times as much."""
RIVAL = 1.5  # times the best shape's loss on the grid, up to which a shape is fitted


@dataclass(frozen=True)
class Found:
    """The selection, its problem, the shape, the rows' scales `[T, R, C]`, and tracks as simulated, `before` and `after`."""

    selection: TrialSelection
    problem: TrialProblem
    shape: str
    scale: np.ndarray
    tracks: dict[str, np.ndarray]


def effects_of(scooped: Scooped) -> tuple[TrialEffect, ...]:
    """The candidates of a recording: a shift in height only where it was seen, another height only where one was declared."""
    seen = scooped.places.shape[-1] > 2
    own = tuple(replace(e, quantities=SHIFTS) if seen and e.name == "camera_shift" else e for e in EFFECTS)
    return (*own, HEIGHT) if scooped.height is not None else own


def diagnosed(
    scooped: Scooped, effects: tuple[TrialEffect, ...], criteria: Criteria, say: Callable[[str], None]
) -> Found:
    """All passes."""
    quantities = quantities_of(scooped)
    declared = ("mu", "log_e", "h") if scooped.height is None else ("mu", "log_e")
    say("shape")
    shape, centre = _shape(scooped, quantities, declared, say)
    width, names, found = WIDTHS.copy(), None, None
    for turn in range(PASSES):
        say(f"pass {turn + 1}")
        emulator = emulate(scooped, shape, centre, width, turn)
        problem = prepare(scooped, emulator, effects, declared, quantities, centre)
        found = select(problem, criteria, say)
        own = found.final.fit
        now = tuple(e.name for e in found.final.added)
        moved = np.max(np.abs(own.values - centre)[OWN] / width)
        centre = own.values
        if now == names and moved < 2.0:
            break
        names = now
        width = np.maximum(WIDTHS, 0.6 * np.abs(centre - problem.neutral)[OWN])
        for n in declared:
            i = INDEX[n]
            width[list(OWN).index(i)] = np.clip(2.0 * spread(found.final)[i], WIDTHS[list(OWN).index(i)], FIRST[n])
    say("simulated once more")
    scale = scales(scooped, emulator.stray)
    null, before = _simulated(scooped, shape, scale, problem, found.null.fit)
    final, after = _simulated(scooped, shape, scale, problem, found.final.fit)
    found = replace(found, null=TrialModel((), null), final=TrialModel(found.final.added, final))
    return Found(found, problem, shape, scale, {"before": before, "after": after})


def _shape(scooped: Scooped, quantities, declared, say) -> tuple[str, np.ndarray]:
    """The shape that is declared, or the one with which the declared scoop fits best, and that fit's values."""
    shapes = SHAPES if scooped.shape is None else (scooped.shape,)
    starts = {shape: begun(scooped, shape, quantities) for shape in shapes}
    best = min(loss for _, loss in starts.values())
    fits = []
    for shape, (start, loss) in starts.items():
        if loss > RIVAL * best:
            continue
        say(shape)
        width = WIDTHS.copy()
        for n in declared:
            wide = 3.0 if n == "h" and scooped.places.shape[-1] < 3 else 1.0
            width[list(OWN).index(INDEX[n])] = wide * FIRST[n]
        emulator = emulate(scooped, shape, start, width)
        problem = prepare(scooped, emulator, (), declared, quantities, start)
        fit = declared_fit(problem, 12)
        fits.append((fit.loss / problem.counts.sum(), shape, fit.values))
    _, shape, values = min(fits, key=lambda f: f[0])
    return shape, values


def _simulated(scooped: Scooped, shape: str, scale, problem, fit: TrialFit) -> tuple[TrialFit, np.ndarray]:
    """A fit with its left-out errors by the engine, not the emulator; and these tracks."""
    tracks = expected(scooped, shape, fit.vectors)
    r = np.asarray(softened(scale * (scooped.places - tracks))).reshape(len(scooped.names), -1)
    return replace(fit, held=mean_square(problem, r)), tracks
