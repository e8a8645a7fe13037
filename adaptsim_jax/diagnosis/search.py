"""Which effects a recording shows: forward by score tests and left-out data, backward by nested
models, then against look-alikes.

The search is the same for every objective (`objective.py`). Whether one is added, its objective
decides (`rounds`). Whether it stays is read in `rules.py`, by numbers of `criteria.py`.
"""

from collections.abc import Callable, Sequence

from adaptsim_jax.diagnosis.finding import Finding, Named, Step
from adaptsim_jax.diagnosis.objective import FittedCandidate, Model, Objective, Refused
from adaptsim_jax.diagnosis.rules import Evidence, refusal

Keep = Callable[[Finding], None]


def search(objective: Objective, keep: Keep = lambda found: None, alike: bool = True) -> Finding:
    """What a recording shows.

    Args:
        objective: models of the recording, fitted and compared.
        keep: gets what is found, as it goes.
        alike: whether look-alikes of what is named are sought.
    """
    null = objective.declared()
    opening = tuple(objective.scores(null))
    model, begun = objective.begun(null)
    trace, stages = list(begun), [null]
    if model is not null:
        stages.append(model)

    def partial(null: Model, model: Model) -> Finding:
        return Finding(null, model, (), tuple(trace), opening, tuple(stages))

    keep(partial(null, model))
    while len(model.added) < objective.most_effects and not objective.within_noise(model):
        best = forward_step(objective, model, trace)
        if best is None:
            break
        model, null = objective.taken(best), objective.updated(null)
        stages.append(model)
        keep(partial(null, model))
    model, rows = backward_elimination(objective, model, trace)
    named, unnamed = names_allowed(objective, rows, alike)
    null, model = objective.closed(null, model, rows)
    return Finding(null, model, named, tuple(trace), opening, tuple(stages), unnamed)


def forward_step(objective: Objective, base: Model, trace: list[Step]) -> FittedCandidate | None:
    """The best model with one effect more that predicts what was left out better; None where no
    candidate does.
    """
    for attempts, ended in objective.rounds(base):
        best = None
        for one in attempts:
            action = "tried" if one.passed else "refused"
            trace.append(Step(action, one.candidate, one.test, one.reason))
            if one.passed and (best is None or objective.better(one, best)):
                best = one
        if best is not None:
            trace.append(Step("added", best.candidate, best.test, None))
            return best
        if ended is not None:
            trace.append(Step("ended", None, None, ended))
    return None


def backward_elimination(
    objective: Objective, model: Model, trace: list[Step]
) -> tuple[Model, list[Evidence]]:
    """Effects that do not hold out beside all others go, and those that fewer numbers do as well as
    are replaced, until all stay.

    Returns:
        The model of those that stay, and the evidence of each.
    """
    tested_last: set = set()
    model, steps = objective.members(model)
    trace += steps
    while True:
        rows = objective.evidence(model, [c for c in model.added if c.key not in tested_last])
        refused = refusals(rows)
        if tested_last and not refused:
            rows += objective.evidence(model, [c for c in model.added if c.key in tested_last])
            refused = refusals(rows)
        tested_last |= {e.candidate.key for e in rows if objective.tested_last(e)}
        if refused:
            model, steps = objective.reduced(model, refused)
        else:
            model, steps = objective.simpler(model, rows)
        if not steps:
            return model, rows
        trace += steps


def refusals(rows: Sequence[Evidence]) -> Refused:
    """Effects that fail a rule of any stage, with the reason of each, but for those that stay
    without a name.
    """
    reasons = [(e, refusal(e)) for e in rows if not e.stays_unnamed]
    return [(e, reason) for e, reason in reasons if reason is not None]


def names_allowed(
    objective: Objective, rows: Sequence[Evidence], alike: bool
) -> tuple[tuple[Named, ...], tuple]:
    """Effects that have a name, each with those that do as well in its place; and those that stay
    in the model without one, each with the reason.
    """
    named, unnamed = [], []
    for e in rows:
        reason = objective.unnamed(e)
        if reason is not None:
            unnamed.append((e.candidate, reason))
            continue
        others = look_alikes(objective, e) if alike else []
        names, models = tuple(a.candidate for a in others), tuple(a.model for a in others)
        named.append(Named(e.candidate, e.test, e.steadiness, names, models))
    return tuple(named), tuple(unnamed)


def look_alikes(objective: Objective, e: Evidence) -> list[FittedCandidate]:
    """Effects that do as well in the place of one: these data do not separate them.

    One with fewer numbers may have taken the name before (`simpler`).
    """
    return [one for one in objective.in_place_of(e) if one.passed]
