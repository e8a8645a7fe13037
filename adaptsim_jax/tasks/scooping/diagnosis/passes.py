"""The selection in passes: an emulator around what is believed, effects selected in it, and another around what was found."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.attribution.criteria import Criteria
from adaptsim_jax.attribution.trials.fit import TrialFit, declared_fit, mean_square
from adaptsim_jax.attribution.trials.problem import TrialEffect, TrialProblem
from adaptsim_jax.attribution.trials.report import left_by_fit
from adaptsim_jax.attribution.trials.select import (
    TrialModel,
    TrialNamed,
    TrialScore,
    TrialSelection,
    paired,
    select,
    spread,
    without,
)
from adaptsim_jax.tasks.scooping.diagnosis.catalogue import EFFECTS, HEIGHT, SHAPE, SHIFTS
from adaptsim_jax.tasks.scooping.diagnosis.emulate import PLACE, emulate, widths
from adaptsim_jax.tasks.scooping.diagnosis.problem import begun, prepare, quantities_of, scales, softened
from adaptsim_jax.tasks.scooping.diagnosis.read import Scooped
from adaptsim_jax.tasks.scooping.diagnosis.simulate import INDEX, OWN, expected
from adaptsim_jax.tasks.scooping.model import SHAPES

PASSES = 4
CRITERIA = Criteria(size=0.05, gap=0.05)
"""An emulator errs by some per cent of its own: less than a twentieth of the error is no effect, and no difference between two."""
FIRST = {"mu": 0.05, "log_e": 0.4, "h": 1e-3}
"""Widths of the first draws about the best of the grid; of a height that nobody saw three times as much."""
RIVAL = 1.5  # times the best shape's loss on the grid, up to which a shape is fitted
OMEGA = SHAPES[:2]
"""The shapes of the paper's Omega, of which the likeliest is taken where none is declared. Seen in one plane a box moves so much like
a cylinder that it would take up a pitch or a clearance: it has to be declared."""
Say = Callable[[str], None]


@dataclass(frozen=True)
class Found:
    """The selection, its problem, the shape, the rows' scales `[T, R, C]`, and tracks as simulated, `before` and `after`."""

    selection: TrialSelection
    problem: TrialProblem
    shape: str
    scale: np.ndarray
    tracks: dict[str, np.ndarray]


@dataclass(frozen=True)
class _Base:
    """A shape with the declared fit about it: values `[P]`, loss a number, and mean squares by scoop `[T]`."""

    shape: str
    values: np.ndarray
    loss: float
    held: np.ndarray


def effects_of(scooped: Scooped) -> tuple[TrialEffect, ...]:
    """The candidates of a recording: a shift in height only where it was seen, another height or shape only where one was declared."""
    seen = scooped.places.shape[-1] > 2
    own = tuple(replace(e, quantities=SHIFTS) if seen and e.name == "camera_shift" else e for e in EFFECTS)
    return (*own, *[HEIGHT] * (scooped.height is not None), *[SHAPE] * (scooped.shape is not None))


def diagnosed(scooped: Scooped, effects: tuple[TrialEffect, ...], criteria: Criteria, say: Say) -> Found:
    """What the selection finds: with the declared shape, or with the likeliest where none was declared or another holds out."""
    quantities = quantities_of(scooped)
    declared = ("mu", "log_e", "h") if scooped.height is None else ("mu", "log_e")
    free = SHAPE in effects
    effects = tuple(e for e in effects if e is not SHAPE)
    bases = _bases(scooped, quantities, declared, free, say)
    run = lambda base: _passes(scooped, base, effects, declared, quantities, criteria, say)
    fit = lambda shape: (
        next((b for b in bases if b.shape == shape), None) or _fitted(scooped, shape, quantities, declared)
    )
    if scooped.shape is None:
        found = run(bases[0])
        if left_by_fit(found.problem, found.selection.final) <= criteria.explained:
            return found
        # an effect may make another shape look likelier before it is named
        others = [run(fit(shape)) for shape in OMEGA if shape != found.shape]
        return min([found, *others], key=lambda other: sum(_alike(scooped, found, other)[1]))
    if bases[0].shape == scooped.shape:
        return run(bases[0])
    own, rival = fit(scooped.shape), run(bases[0])
    found = run(own)
    test = paired(*_alike(scooped, found, rival))
    if test.gain < criteria.size or test.p > criteria.confidence:
        return found
    named = TrialNamed(SHAPE, paired(own.held, bases[0].held), np.inf, ())
    score = TrialScore(SHAPE, {}, max(1.0 - bases[0].loss / own.loss, 0.0), test.p)
    selection = replace(
        rival.selection,
        null=found.selection.null,
        named=(named, *rival.selection.named),
        scores=(score, *rival.selection.scores),
    )
    return replace(rival, selection=selection, tracks={**rival.tracks, "before": found.tracks["before"]})


def _alike(scooped: Scooped, one: Found, other: Found) -> tuple[np.ndarray, np.ndarray]:
    """Mean squares `[T]` of what both leave after, on one scale: the finer of theirs where both tell a row."""
    known = (one.scale > 0) & (other.scale > 0)
    scale = known * np.maximum(one.scale, other.scale)
    count = np.maximum(known.reshape(len(known), -1).sum(1), 1)
    left = lambda f: np.square(np.asarray(softened(scale * (scooped.places - f.tracks["after"]))))
    mean = lambda f: left(f).reshape(len(known), -1).sum(1) / count
    return mean(one), mean(other)


def _bases(scooped: Scooped, quantities, declared, free: bool, say: Say) -> list[_Base]:
    """Shapes with which the declared scoop fits about as well as with any, likeliest first."""
    say("shape")
    shapes = OMEGA if scooped.shape is None else SHAPES if free else (scooped.shape,)
    starts = {shape: begun(scooped, shape, quantities) for shape in shapes}
    best = min(loss for _, loss in starts.values())
    found = []
    for shape, (start, loss) in starts.items():
        if loss <= RIVAL * best:
            say(shape)
            found.append(_fitted(scooped, shape, quantities, declared, start))
    return sorted(found, key=lambda b: b.loss)


def _fitted(scooped: Scooped, shape: str, quantities, declared, start: np.ndarray | None = None) -> _Base:
    start = begun(scooped, shape, quantities)[0] if start is None else start
    width = widths()
    for n in declared:
        wide = 3.0 if n == "h" and scooped.places.shape[-1] < 3 else 1.0
        width[PLACE[INDEX[n]]] = wide * FIRST[n]
    problem = prepare(scooped, emulate(scooped, shape, start, width), (), declared, quantities, start)
    fit = declared_fit(problem, 12)
    return _Base(shape, fit.values, fit.loss / problem.counts.sum(), fit.held)


def _passes(scooped: Scooped, base: _Base, effects, declared, quantities, criteria: Criteria, say: Say) -> Found:
    """Effects selected about the declared fit, then about what was found, until nothing changes."""
    least, names = widths(base.shape), ()
    centre, width = base.values, widths()
    for turn in range(PASSES):
        say(f"pass {turn + 1}")
        emulator = emulate(scooped, base.shape, centre, width, turn)
        problem = prepare(scooped, emulator, effects, declared, quantities, centre)
        found = select(problem, criteria, say)
        fit = found.final.fit
        now = tuple(e.name for e in found.final.added)
        moved = np.max(np.abs(fit.values - centre)[OWN] / width)
        centre = fit.values
        settled = turn > 0 or np.allclose(least, width)
        if now == names and moved < 2.5 and settled:
            break
        names = now
        width = np.maximum(least, 0.6 * np.abs(centre - problem.neutral)[OWN])
        for n in declared:
            i = INDEX[n]
            width[PLACE[i]] = np.clip(2.0 * spread(found.final)[i], least[PLACE[i]], FIRST[n])
    return _judged(scooped, base.shape, scales(scooped, emulator.stray), problem, found, criteria, say)


def _judged(scooped: Scooped, shape: str, scale, problem, found: TrialSelection, criteria: Criteria, say: Say) -> Found:
    """What the emulator names, tested once more by the engine itself: each beside the others; what does not hold out is dropped."""
    say("by the engine")
    engine = lambda fit: _simulated(scooped, shape, scale, problem, fit)
    null, before = engine(found.null.fit)
    model, named, refused = found.final, list(found.named), dict(found.refused)
    final, after = (null, before) if not named else engine(model.fit)
    while named:
        rows = []
        for n in named:
            less = without(problem, model, n.effect, criteria.rounds)
            test = paired(engine(less.fit)[0].held if less.added else null.held, final.held)
            rows.append((n, less, test))
        failing = [r for r in rows if r[2].gain < criteria.size or r[2].p > criteria.confidence]
        if not failing:
            named = [replace(n, test=test) for n, _, test in rows]
            break
        gone, model, test = min(failing, key=lambda r: r[2].gain)
        refused[gone.effect.name] = f"dropped by the engine: held-out gain {100 * test.gain:.1f} %, p {test.p:.2g}"
        named = [n for n in named if n is not gone]
        final, after = engine(model.fit) if named else (null, before)
    found = replace(
        found, null=TrialModel((), null), final=TrialModel(model.added, final), named=tuple(named), refused=refused
    )
    return Found(found, problem, shape, scale, {"before": before, "after": after})


def _simulated(scooped: Scooped, shape: str, scale, problem, fit: TrialFit) -> tuple[TrialFit, np.ndarray]:
    """A fit with its left-out errors by the engine, not the emulator; and these tracks."""
    tracks = expected(scooped, shape, fit.vectors)
    r = np.asarray(softened(scale * (scooped.places - tracks))).reshape(len(scooped.names), -1)
    return replace(fit, held=mean_square(problem, r)), tracks
