"""Structure that no named candidate explains: how much there is, and where it sits."""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.closeloop.basis import generic_names
from adaptsim_jax.closeloop.problem import Problem
from adaptsim_jax.closeloop.view import View


@dataclass(frozen=True)
class Leftover:
    """The generic dictionary about one model. p_value is corrected for the groups tried; share is the held-out fall of
    the whitened sum of squares; places: `(joint, variable, share, p_value)`, the surest first."""

    p_value: float
    share: float
    gain: float
    places: tuple[tuple[str, str, float, float], ...]


def leftover(problem: Problem, view: View) -> Leftover:
    """Score the generic dictionary group by group: which variable of which joint the residual follows."""
    atoms = view.generic()
    names = generic_names(problem.plant.joint_dim)
    groups = list(dict.fromkeys(names))
    places = []
    for group in groups:
        score = view.scorer.score([a for a, n in zip(atoms, names, strict=True) if n == group])
        places.append((*group, max(score.held_out_share, 0.0), min(1.0, score.p_value * len(groups)), score.gain))
    places.sort(key=lambda p: (p[3], -p[4]))  # a large gain that trials do not share says nothing
    best = min(p[3] for p in places)
    share = max(p[2] for p in places)
    return Leftover(best, share, float(max(p[4] for p in places)), tuple(p[:4] for p in places))


def residual_torque(problem: Problem, lin, parts) -> list[dict]:
    """The unexplained torque over time at each joint, for figures: `[{joint, time, value, std, window}]`."""
    from adaptsim_jax.closeloop.disturbance import unexplained_force

    mean, std = unexplained_force(lin, parts)
    times = problem.windows.times[:, :-1]
    live = (problem.windows.dt > 0) & problem.windows.real[:, None]
    first = np.asarray(problem.windows.trial) == problem.windows.trial[0]
    pick = live & first[:, None]
    return [
        {"joint": joint, "time": times[pick], "value": mean[:, j][pick], "std": std[:, j][pick]}
        for j, joint in enumerate(problem.plant.joints)
    ]
