"""The selection in passes: an emulator around what is believed, effects selected in it, and another
around what was found.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Finding, Named
from adaptsim_jax.diagnosis.fit import Fit, mean_square
from adaptsim_jax.diagnosis.models import (
    Model,
    Score,
    finished,
    paired,
    spread,
)
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.rows import left_by_fit
from adaptsim_jax.diagnosis.search import backward_elimination, names_allowed
from adaptsim_jax.diagnosis.testing import preferred
from adaptsim_jax.diagnosis.trials import search_trials
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.tasks.scooping.diagnosis.catalogue import EFFECTS, HEIGHT, SHAPE, SHIFTS
from adaptsim_jax.tasks.scooping.diagnosis.emulate import PLACE, Emulator, emulate, widths
from adaptsim_jax.tasks.scooping.diagnosis.engine_objective import EngineObjective
from adaptsim_jax.tasks.scooping.diagnosis.problem import (
    begun,
    prepare,
    quantities_of,
    scales,
    softened,
)
from adaptsim_jax.tasks.scooping.diagnosis.read import Scooped
from adaptsim_jax.tasks.scooping.diagnosis.simulate import INDEX, OWN, expected
from adaptsim_jax.tasks.scooping.model import SHAPES

PASSES = 4
OWNED = 2
"""Emulators that a model which is judged has of its own, one after the other, at most."""
CRITERIA = Criteria(size=0.05, gap=0.05)
"""An emulator errs by some per cent of its own: less than a twentieth of the error is no effect,
and no difference between two.
"""
FIRST = {"mu": 0.05, "log_e": 0.4, "h": 1e-3}
"""Widths of the first draws about the best of the grid; of a height that nobody saw three times as
much.
"""
RIVAL = 1.5  # times the best shape's loss on the grid, up to which a shape is fitted
OMEGA = SHAPES[:2]
"""The shapes of the paper's Omega, of which the likeliest is taken where none is declared. Seen in
one plane a box moves so much like a cylinder that it would take up a pitch or a clearance: it has
to be declared.
"""
Report = Callable[[str], None]
Keep = Callable[[Problem], Callable[[Finding], None]]
Owned = Callable[[tuple[Effect, ...], np.ndarray], Model]


@dataclass(frozen=True)
class Found:
    """The selection, its problem, the shape, the rows' scales `[T, R, C]`, and tracks as simulated,
    `before` and `after`.
    """

    selection: Finding
    problem: Problem
    shape: str
    scale: np.ndarray
    tracks: dict[str, np.ndarray]


@dataclass(frozen=True)
class _Base:
    """A shape with the declared fit about it: values `[P]`, loss a number, and mean squares by
    scoop `[T]`.
    """

    shape: str
    values: np.ndarray
    loss: float
    held: np.ndarray


def effects_of(scooped: Scooped) -> tuple[Effect, ...]:
    """The candidates of a recording: a shift in height only where it was seen, another height or
    shape only where one was declared.
    """
    observed = scooped.places.shape[-1] > 2
    own = tuple(
        replace(e, parameters=SHIFTS) if observed and e.name == "camera_shift" else e
        for e in EFFECTS
    )
    return (*own, *[HEIGHT] * (scooped.height is not None), *[SHAPE] * (scooped.shape is not None))


def diagnosed(
    scooped: Scooped, effects: tuple[Effect, ...], criteria: Criteria, report: Report, keep: Keep
) -> Found:
    """What the selection finds: with the declared shape, or with the likeliest where none was
    declared or another holds out. keep: makes what is told of it as it goes.
    """
    quantities = quantities_of(scooped)
    if scooped.height is None:
        declared = ("mu", "log_e", "h")
    else:
        declared = ("mu", "log_e")
    free = SHAPE in effects
    effects = tuple(e for e in effects if e is not SHAPE)
    bases = _bases(scooped, quantities, declared, free, report)

    def run(base):
        return _passes(scooped, base, effects, declared, quantities, criteria, report, keep)

    def fit(shape):
        return next((b for b in bases if b.shape == shape), None) or _fitted(
            scooped, shape, quantities, declared
        )

    if scooped.shape is None:
        likeliest = run(bases[0])
        if left_by_fit(likeliest.problem, likeliest.selection.final) <= criteria.explained:
            return likeliest
        # an effect may make another shape look likelier before it is named
        others = [run(fit(shape)) for shape in OMEGA if shape != likeliest.shape]
        return min(
            [likeliest, *others], key=lambda other: sum(_alike(scooped, likeliest, other)[1])
        )
    if bases[0].shape == scooped.shape:
        return run(bases[0])
    own, rival = fit(scooped.shape), run(bases[0])
    found = run(own)
    test = paired(*_alike(scooped, found, rival))
    if not preferred(test, criteria.size, criteria.confidence):
        return found
    named = Named(SHAPE, paired(own.held, bases[0].held), np.inf)
    score = Score(SHAPE, {}, max(1.0 - bases[0].loss / own.loss, 0.0), test.p)
    selection = replace(
        rival.selection,
        null=found.selection.null,
        named=(named, *rival.selection.named),
        scores=(score, *rival.selection.scores),
    )
    return replace(
        rival, selection=selection, tracks={**rival.tracks, "before": found.tracks["before"]}
    )


def _alike(scooped: Scooped, one: Found, other: Found) -> tuple[np.ndarray, np.ndarray]:
    """Mean squares `[T]` of what both leave after, on one scale: the finer of theirs where both
    tell a row.
    """
    known = (one.scale > 0) & (other.scale > 0)
    scale = known * np.maximum(one.scale, other.scale)
    count = np.maximum(known.reshape(len(known), -1).sum(1), 1)

    def left(f):
        return np.square(np.asarray(softened(scale * (scooped.places - f.tracks["after"]))))

    def mean(f):
        return left(f).reshape(len(known), -1).sum(1) / count

    return mean(one), mean(other)


def _bases(scooped: Scooped, quantities, declared, free: bool, report: Report) -> list[_Base]:
    """Shapes with which the declared scoop fits about as well as with any, likeliest first."""
    report("shape")
    if scooped.shape is None:
        shapes = OMEGA
    elif free:
        shapes = SHAPES
    else:
        shapes = (scooped.shape,)
    starts = {shape: begun(scooped, shape, quantities) for shape in shapes}
    best = min(loss for _, loss in starts.values())
    found = []
    for shape, (points, loss) in starts.items():
        if loss <= RIVAL * best:
            report(shape)
            found.append(_fitted(scooped, shape, quantities, declared, points))
    return sorted(found, key=lambda b: b.loss)


def _fitted(
    scooped: Scooped, shape: str, quantities, declared, starts: np.ndarray | None = None
) -> _Base:
    """The declared fit from each of the starts, the best of them by the engine: a stiff piece and a
    soft one may both fit roughly.
    """
    if starts is None:
        starts = begun(scooped, shape, quantities)[0]
    width = widths()
    for n in declared:
        wide = 3.0 if n == "h" and scooped.places.shape[-1] < 3 else 1.0
        width[PLACE[INDEX[n]]] = wide * FIRST[n]
    fits, known = [], []
    for start in starts:
        own, made = _owned(scooped, shape, width, declared, quantities, CRITERIA)
        fits.append(own((), start).fit)
        known += [scales(scooped, emulator.stray) for emulator in made.values()]
    scale = np.min(known, 0)

    def left(fit):
        return scale * (
            scooped.places - expected(scooped, shape, np.tile(fit.values, (len(scooped.names), 1)))
        )

    fit = min(fits, key=lambda f: np.square(np.asarray(softened(left(f)))).sum())
    return _Base(shape, fit.values, fit.loss, fit.held)


def _passes(
    scooped: Scooped,
    base: _Base,
    effects,
    declared,
    quantities,
    criteria: Criteria,
    report: Report,
    keep: Keep,
) -> Found:
    """Effects selected about the declared fit, then about what was found, until nothing changes."""
    lowest, names = widths(base.shape), ()
    centre, width = base.values, widths()
    for turn in range(PASSES):
        report(f"pass {turn + 1}")
        emulator = emulate(scooped, base.shape, centre, width, turn)
        problem = prepare(scooped, emulator, effects, declared, quantities, centre)
        found = search_trials(problem, criteria, report, alike=False, keep=keep(problem))
        fit = found.final.fit
        now = tuple(e.name for e in found.final.added)
        moved = np.max(np.abs(fit.values - centre)[OWN] / width)
        centre = fit.values
        settled = turn > 0 or np.allclose(lowest, width)
        if now == names and moved < 2.5 and settled:
            break
        names = now
        width = _narrowed(problem, base.shape, found.final, problem.neutral, declared)
    own, _ = _owned(scooped, base.shape, emulator.width, declared, quantities, criteria)
    return _by_engine(
        scooped, base.shape, scales(scooped, emulator.stray), problem, found, criteria, own, report
    )


def _owned(
    scooped: Scooped, shape: str, width: np.ndarray, declared, quantities, criteria: Criteria
):
    """`fit(effects, values)`: the model with `effects` fitted from `values [P]`, each about its own
    optimum; and emulators as made.

    An emulator drawn around a rival, and narrowly where the model is asked, flatters the rival.
    Each model has therefore one of its own, of the values that it fits; width `[O]`: of the
    declared ones.
    """
    neutral = np.array([q.default for q in quantities])
    made: dict[tuple[bool, ...], Emulator] = {}

    def fit(effects: tuple[Effect, ...], values: np.ndarray) -> Model:
        free = {*declared, *(q for e in effects for q in e.names)}
        drawn = np.array([quantities[i].name in free for i in OWN])

        def outside(to):
            return np.max(drawn * np.abs(values[OWN] - to.centre) / to.width) > 1.0

        wide = width
        for turn in range(OWNED):
            emulator = made.get(tuple(drawn))
            if emulator is None or outside(emulator):
                size = np.maximum(widths(shape), 0.6 * np.abs(values - neutral)[OWN])
                wide = np.where([quantities[i].name in declared for i in OWN], wide, size)
                emulator = made[tuple(drawn)] = emulate(scooped, shape, values, wide, turn, drawn)
            problem = prepare(scooped, emulator, effects, declared, quantities, values)
            model = finished(problem, effects, values, criteria.rounds)
            values = model.fit.values
            if not outside(emulator):
                break
            wide = np.minimum(wide, _narrowed(problem, shape, model, neutral, declared))
        return replace(model, fit=replace(model.fit, loss=model.fit.loss / problem.counts.sum()))

    return fit, made


def _narrowed(
    problem: Problem, shape: str, model: Model, neutral: np.ndarray, declared
) -> np.ndarray:
    """Widths `[O]` of draws about a fitted model: of the declared values by how well they are
    known, of others by their size.
    """
    lowest = widths(shape)
    width = np.maximum(lowest, 0.6 * np.abs(model.fit.values - neutral)[OWN])
    for n in declared:
        i = INDEX[n]
        width[PLACE[i]] = np.clip(2.0 * spread(problem, model)[i], lowest[PLACE[i]], FIRST[n])
    return width


def _by_engine(
    scooped: Scooped,
    shape: str,
    scale,
    problem,
    found: Finding,
    criteria: Criteria,
    own: Owned,
    report: Report,
) -> Found:
    """What the emulator names, tested once more by the engine (`engine_objective.py`)."""
    report("by the engine")
    whole = replace(problem, quantities=quantities_of(scooped))
    known: dict[frozenset[str], tuple[Model, np.ndarray]] = {}
    trace = list(found.trace)

    def fit(effects, values) -> Model:
        key = frozenset(e.name for e in effects)
        if key not in known:
            if found.named:
                model = own(tuple(effects), values)
            else:
                model = found.null
            simulated, tracks = _simulated(scooped, shape, scale, problem, model.fit)
            known[key] = Model(tuple(effects), simulated), tracks
        return known[key][0]

    null = fit((), found.null.fit.values)
    objective = EngineObjective(problem, criteria, fit, null)
    model, rows = backward_elimination(objective, objective.model(found.final), trace)
    named, _ = names_allowed(objective, rows, alike=True)
    final = model.model
    tracks = {
        k: known[frozenset(e.name for e in m.added)][1]
        for k, m in (("before", null), ("after", final))
    }
    selection = replace(found, null=null, final=final, named=named, trace=tuple(trace))
    return Found(selection, whole, shape, scale, tracks)


def _simulated(scooped: Scooped, shape: str, scale, problem, fit: Fit) -> tuple[Fit, np.ndarray]:
    """A fit with its left-out errors by the engine, not the emulator; and these tracks."""
    tracks = expected(scooped, shape, fit.vectors)

    def left(out):
        return np.asarray(softened(scale * (scooped.places - out))).reshape(len(scooped.names), -1)

    whole = np.square(
        left(expected(scooped, shape, np.tile(fit.values, (len(scooped.names), 1))))
    ).sum()
    return replace(fit, held=mean_square(problem, left(tracks)), loss=float(whole)), tracks
