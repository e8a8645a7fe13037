"""Whether the bodies and the damping of the model file need be fitted: two nested models of a
machine that follows commands.

Fitted bodies take up much of what a stiff servo's friction, rotor or encoder does. Where those of
the file, with few effects named beside them, tell left-out torques as well, they are the file's:
the model with fewer numbers is taken.
"""

from collections.abc import Callable

import numpy as np

from adaptsim_jax.attribution.equation.confirmed import confirmed
from adaptsim_jax.attribution.equation.models import TorqueSearch, model_of
from adaptsim_jax.attribution.equation.search import GroupSearch
from adaptsim_jax.attribution.held_out import FittedTree, over_floor, paired
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.weights import losses
from adaptsim_jax.diagnosis.alternatives import preferred
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.testing import log_ratio, share
from adaptsim_jax.effects.joints.catalogue import OWN

FITTED = tuple(e.name for e in OWN if e.traits.fitted)


def without_bodies(null: Vector) -> Vector:
    """The entries without bodies and damping, which stay as the file has them."""
    return null.without([e.key for e in null.entries if e.owner in FITTED])


def searched(
    problem: TreeProblem, search: Callable[[Vector], TorqueSearch], null: Vector, criteria: Criteria
) -> tuple[TorqueSearch, TorqueSearch, bool]:
    """`(found, usual, asked)`: what is found with the file's bodies or with fitted ones. What is
    found with fitted ones, where these were sought. Whether simulation was asked of each name.
    search: along the motion, with the entries of a vector fitted.

    Fitted bodies (hundreds of numbers of a humanoid) are not sought where the file's simulate
    left-out stretches to within the noise with one name at most, for they cannot do better, nor of
    a machine of very many joints. Else the file's are taken where they tell left-out torques as
    well, by no more names that simulation bears out (where fitted ones have taken all of it up, by
    a few). A command error shows more than any motion does, and it is enough that left-out
    stretches are simulated as well, or to within the noise.
    """
    held = search(without_bodies(null))
    model, own = model_of(problem, held, held.final, held.added), None
    if over_floor(problem, model) <= criteria.explained:
        own = confirmed(problem, held, model, criteria)
        if len(own.named) <= 1:
            return own, held, True
    if problem.joints > criteria.torque.whole:
        return own or held, held, own is not None
    free = search(null)
    other = model_of(problem, free, free.final, free.added)
    if not own and not enough(problem, (held, free), (model, other), criteria):
        return free, free, False
    own = own or confirmed(problem, held, model, criteria)
    fitted = confirmed(problem, free, other, criteria)
    return (
        (own if len(own.named) <= (len(fitted.named) or criteria.torque.file_names) else fitted),
        free,
        True,
    )


def enough(
    problem: TreeProblem,
    found: tuple[TorqueSearch, TorqueSearch],
    models: tuple[FittedTree, FittedTree],
    criteria: Criteria,
) -> bool:
    """Whether the file's bodies predict as well as fitted ones: what was found with both, and the
    models of it.
    """
    d = np.concatenate([_worse(*both) for both in zip(*(s.searches for s in found), strict=True)])
    if share(d) < criteria.torque.gain:
        return True
    own, other = models
    if over_floor(problem, own) <= criteria.explained:
        return True
    test = paired(problem, own.held.loss, losses(problem, other.held.paths, own.fit.weights))
    return not preferred(test, criteria.size, criteria.confidence)


def _worse(held: GroupSearch, free: GroupSearch) -> np.ndarray:
    """Logarithms [B] of what the first leaves of left-out blocks over what the second does."""
    loss = [free.rows.loss(w.whole.left_out(w.rows)).mean(1) for w in (held, free)]
    return log_ratio(*loss)
