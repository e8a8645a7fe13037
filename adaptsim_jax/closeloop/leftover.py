"""Structure that no named candidate explains: how much there is, and where it sits."""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.closeloop.basis import generic_names
from adaptsim_jax.closeloop.disturbance import Components
from adaptsim_jax.closeloop.lines import Line, line
from adaptsim_jax.closeloop.problem import Problem
from adaptsim_jax.closeloop.regulated import regulated
from adaptsim_jax.closeloop.view import View


@dataclass(frozen=True)
class Leftover:
    """The generic dictionary about one model. p_value is corrected for the groups tried; share is the held-out fall of
    the whitened sum of squares; places: `(joint, variable, share, p_value)`, first those at the joint where most force is
    unexplained, the surest of them first; line: a sharp line in the spectrum of the unexplained force, one of the places; answered:
    whether the commands answer to the motion, so that chance follows it a little (`regulated.py`)."""

    p_value: float
    share: float
    gain: float
    places: tuple[tuple[str, str, float, float], ...]
    line: Line | None = None
    answered: bool = False

    def where(self) -> str:
        """The first place in words, to go after "it sits at"."""
        joint, variable, _, _ = self.places[0]
        joint = joint.replace("joint", "joint ")
        if self.sharp:
            return f"{joint}, where the unexplained torque has a {variable}"
        return f"{joint} and follows its {variable}"

    @property
    def sharp(self) -> bool:
        """Whether the first place is the line."""
        return self.line is not None and self.places[0][1] == self.line.words()


def leftover(problem: Problem, view: View, parts: Components, force: np.ndarray) -> Leftover:
    """Score the generic dictionary group by group: which variable of which joint the residual follows.

    parts: residual covariance of the model in view; force `[n]`: unexplained force at each joint as a share of its torque,
    which says better than any dictionary which joint it is.
    """
    atoms = view.generic()
    names = generic_names(problem.plant.joint_dim)
    groups = list(dict.fromkeys(names))
    places = []
    for group in groups:
        score = view.scorer.score([a for a, n in zip(atoms, names, strict=True) if n == group])
        places.append((*group, max(score.held_out_share, 0.0), min(1.0, score.p_value * len(groups)), score.gain))
    best = min(p[3] for p in places)
    share = max(p[2] for p in places)
    gain = float(max(p[4] for p in places))
    if (sharp := line(problem, view, parts)) is not None:
        places.append((sharp.joint, sharp.words(), sharp.share, sharp.p_value, 0.0))
    much = dict(zip(problem.plant.joints, force, strict=True))
    # of those at one joint the surest: a large gain that trials do not share says nothing
    places.sort(key=lambda p: (-much[p[0]], p[3], -p[4]))
    return Leftover(best, share, gain, tuple(p[:4] for p in places), sharp, regulated(problem.windows))


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
