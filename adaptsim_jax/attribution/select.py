"""The search for effects by simulated stretches: the declared model, its fit, and what the one
search finds of it.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from adaptsim_jax.attribution.candidates import CandidateScore
from adaptsim_jax.attribution.estimate import fit, settled
from adaptsim_jax.attribution.fitted import FittedTree, Hint, Selection, held_error, over_floor
from adaptsim_jax.attribution.held_out import modelled
from adaptsim_jax.attribution.nested_models import eased
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem, beginnings, own_inertia, scaled_reach
from adaptsim_jax.attribution.tree_objective import DECLARED_ROUNDS, TreeObjective
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.finding import Finding
from adaptsim_jax.diagnosis.search import search


def select(
    problem: TreeProblem,
    null: Vector,
    criteria: Criteria,
    notify: Callable[[str], None] = lambda note: None,
    keep: "Callable[[Selection], None]" = lambda found: None,
    hint: Hint | None = None,
) -> Selection:
    """What simulated stretches show.

    Args:
        problem: stretches and candidates.
        null: what is fitted whatever is named, where its fit begins.
        criteria: what counts as an effect.
        notify: gets what is tried.
        keep: gets what is found, as it goes.
        hint: values and effects to go on from, of another objective, if they predict left-out folds
            better than the declared model.
    """
    first = declared(problem, null, criteria, roughly=hint is not None)
    notify("candidates")
    reach = scaled_reach(problem, *own_inertia(problem, first.fit.vector))
    smallest = criteria.noise_share * np.median(held_error(problem, first), 0)
    objective = TreeObjective(
        replace(problem, least=smallest),
        first,
        reach,
        criteria,
        notify,
        hint,
        lambda: declared(problem, null, criteria),
    )

    def selection(found: Finding, last: tuple[CandidateScore, ...] = ()) -> Selection:
        named = tuple(replace(n, models=()) for n in found.named)
        return Selection(**vars(found) | {"named": named}, last=last, reach=reach)

    found = search(objective, lambda found: keep(selection(found)))
    return selection(found, tuple(objective.scores_of(found.stages[-1], True)))


def declared(
    problem: TreeProblem, null: Vector, criteria: Criteria, roughly: bool = False
) -> FittedTree:
    """The declared model fitted; where that leaves far more than noise, also by way of the
    stretches' beginnings, over which a fit has fewer minima: of both the one that predicts better.
    roughly: only as far as another is to be compared with it.
    """
    glance = 2 * criteria.glance if roughly else None
    models = [modelled(problem, (), fit(problem, null, rounds=DECLARED_ROUNDS, glance=glance))]
    if (
        not roughly
        and criteria.beginning < 1.0
        and over_floor(problem, models[0]) > criteria.outlying
    ):
        begun = fit(beginnings(problem, criteria.beginning), null, rounds=DECLARED_ROUNDS)
        models.append(
            modelled(problem, (), fit(problem, begun.vector, begun.starts, rounds=DECLARED_ROUNDS))
        )
    return min(models, key=lambda m: over_floor(problem, m))


def select_shorter(
    problem: TreeProblem,
    null: Vector,
    criteria: Criteria,
    found: Selection,
    notify: Callable[[str], None] = lambda note: None,
) -> Selection:
    """A search over the beginnings of the stretches, where one over the whole named nothing and far
    more than noise is left.

    A joint that friction holds still, or a motion that runs away, has as many minima as it has
    turns. Over a short while it has few (progressive horizons in multiple shooting). What is named
    there is put into the whole, refitted only if that predicts better.
    """
    short = beginnings(problem, criteria.beginning)
    near = select(
        short, null, replace(criteria, beginning=1.0), notify
    )  # beginnings have none of their own
    if not near.named:
        return found
    vector = near.final.fit.vector
    starts, loss, _ = settled(
        problem, found.null.lin, vector, (near.final.fit.starts, found.null.fit.starts), refine=3
    )
    retained = replace(found.null.fit, vector=vector, starts=starts, loss=loss, code="stopped")
    refitted = fit(problem, vector, starts, rounds=criteria.rounds)
    models = [modelled(problem, near.final.added, f) for f in (retained, refitted)]
    final = min(models, key=lambda m: over_floor(problem, m))
    if eased(problem, found.null, final) < 0.0:
        return found
    return replace(near, null=found.null, final=final, stages=(found.null,), shorter=True)
