"""Whether the bodies and the damping of the model file need be fitted: two nested models of a machine that follows commands.

Fitted bodies take up much of what a stiff servo's friction, rotor or encoder does. Where those of the file, with few
effects named beside them, tell left-out torques as well, they are the file's: the model with fewer numbers is taken.
"""

import numpy as np

from adaptsim_jax.attribution.equation.confirmed import confirmed
from adaptsim_jax.attribution.equation.models import Said, model_of
from adaptsim_jax.attribution.equation.search import Witness
from adaptsim_jax.attribution.equation.solve import FLOOR, means
from adaptsim_jax.attribution.held_out import over_floor, paired
from adaptsim_jax.attribution.parameters import INERTIA, Vector
from adaptsim_jax.attribution.problem import Problem
from adaptsim_jax.attribution.weights import losses
from adaptsim_jax.diagnosis.criteria import Criteria

FITTED = (INERTIA, "viscous")


def filed(null: Vector) -> Vector:
    """The entries without bodies and damping, which stay as the file has them."""
    return null.without([e.key for e in null.entries if e.owner in FITTED])


def chosen(problem: Problem, held: Said, free: Said, criteria: Criteria) -> Said:
    """What is found with the file's bodies, where it tells left-out torques as well as what is found with fitted ones, by no more
    names that simulation bears out (where fitted ones have taken all of it up, by a few); else the latter. A command error shows more
    than any motion does, and it is enough that left-out stretches are simulated as well, or to within the noise."""
    if not enough(problem, held, free, criteria):
        return free
    held, free = (confirmed(problem, s, model_of(problem, s, s.final, s.added), criteria) for s in (held, free))
    return held if len(held.named) <= (len(free.named) or criteria.torque.filed) else free


def enough(problem: Problem, held: Said, free: Said, criteria: Criteria) -> bool:
    """Whether the file's bodies predict as well as fitted ones."""
    d = np.concatenate([_worse(*both) for both in zip(held.witnesses, free.witnesses, strict=True)])
    if 1.0 - np.exp(-d.mean()) < criteria.torque.gain:
        return True
    return _simulates(problem, held, free, criteria)


def _simulates(problem: Problem, held: Said, free: Said, criteria: Criteria) -> bool:
    own = model_of(problem, held, held.final, held.added)
    if over_floor(problem, own) <= criteria.explained:
        return True
    other = model_of(problem, free, free.final, free.added)
    test = paired(problem, own.held.loss, losses(problem, other.held.paths, own.fit.weights))
    return test.gain <= criteria.size or test.p > criteria.confidence


def _worse(held: Witness, free: Witness) -> np.ndarray:
    """Logarithms [B] of what the first leaves of left-out blocks over what the second does."""
    rows = free.rows
    loss = [
        means(rows.clear * np.square(w.whole.left_out(w.rows) / rows.size), rows.block).mean(1) for w in (held, free)
    ]
    usual = FLOOR * np.median(loss[0])
    return np.log((loss[0] + usual) / (loss[1] + usual))
