"""Structure that no named candidate explains: how much there is, and where it sits."""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.sysid.criteria import Criteria
from adaptsim_jax.sysid.estimate.generic_forces import generic_names
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.estimate.variance import VarianceComponents
from adaptsim_jax.sysid.evaluate.spectrum import Line, line
from adaptsim_jax.sysid.nuisance.feedback import regulated
from adaptsim_jax.sysid.score.table import ScoreTable

SURE = 0.05  # p-value of a further place that is told
FOLLOWED = {"past": "what it did just before", "other": "the other joint's motion"}  # groups whose names say too little


@dataclass(frozen=True)
class ResidualDiagnosis:
    """The generic dictionary about one model. p_value is corrected for the groups tried; share is the held-out fall of
    the whitened sum of squares; places: `(joint, variable, share, p_value)`, first those at the joint where it likeliest sits, the
    surest of them first; line: a sharp line in the spectrum of the unexplained force, one of the places; answered: whether the
    commands answer to the motion, so that chance follows it a little (`nuisance/feedback.py`); doubt: another joint that it may sit
    at, with the reason."""

    p_value: float
    share: float
    gain: float
    places: tuple[tuple[str, str, float, float], ...]
    line: Line | None = None
    answered: bool = False
    doubt: tuple[str, str] | None = None

    def where(self) -> str:
        """The first place in words, to go after "it sits at"."""
        joint, variable, _, _ = self.places[0]
        joint = joint.replace("joint", "joint ")
        if self.sharp:
            return f"{joint}, where the unexplained torque has a {variable}"
        return f"{joint} and follows {FOLLOWED.get(variable, f'its {variable}')}"

    def beside(self) -> str:
        """The doubt as a clause, to end a sentence with; empty without one."""
        if self.doubt is None:
            return ""
        other, reason = self.doubt
        return f"; or at {other.replace('joint', 'joint ')}, {reason}"

    def told(self, most: int = 4) -> list[tuple[str, str, float, float]]:
        """The places worth telling: the first; one at the other joint, where that is in doubt; and what is sure at the first."""
        first, *rest = self.places
        other = [p for p in rest if self.doubt and p[0] == self.doubt[0]][:1]
        return [first, *other, *(p for p in rest if p[0] == first[0] and p[3] < SURE)][:most]

    @property
    def sharp(self) -> bool:
        """Whether the first place is the line."""
        return self.line is not None and self.places[0][1] == self.line.words()


def residual_diagnosis(
    problem: Problem, view: ScoreTable, parts: VarianceComponents, force: np.ndarray
) -> ResidualDiagnosis:
    """Score the generic dictionary group by group: which variable of which joint the residual follows.

    parts: residual covariance of the model in view; force `[n]`: unexplained force at each joint as a share of its torque.
    """
    atoms = view.generic()
    names = generic_names(problem.plant.joint_dim)
    groups = list(dict.fromkeys(names))
    picked = lambda wanted: [a for a, n in zip(atoms, names, strict=True) if wanted(n)]
    places = []
    for group in groups:
        score = view.scorer.score(picked(lambda n, group=group: n == group))
        places.append((*group, max(score.held_out_share, 0.0), min(1.0, score.p_value * len(groups)), score.gain))
    best = min(p[3] for p in places)
    share = max(p[2] for p in places)
    gain = float(max(p[4] for p in places))
    if (sharp := line(problem, view, parts)) is not None:
        places.append((sharp.joint, sharp.words(), sharp.share, sharp.p_value, 0.0))
    joints = problem.plant.joints
    much = dict(zip(joints, force, strict=True))
    if _alike(force, problem.criteria):
        whole = [view.scorer.score(picked(lambda n, joint=joint: n[0] == joint)) for joint in joints]
        much = {joint: min(s.gain, s.robust) for joint, s in zip(joints, whole, strict=True)}
    # of those at one joint the surest: a large gain that trials do not share says nothing
    places.sort(key=lambda p: (-much[p[0]], p[3], -p[4]))
    doubt = _doubt(problem, places, _alike(force, problem.criteria))
    return ResidualDiagnosis(
        best, share, gain, tuple(p[:4] for p in places), sharp, regulated(problem.windows, problem.criteria), doubt
    )


def _alike(force: np.ndarray, criteria: Criteria) -> bool:
    """Whether about as much of the torque is unexplained at another joint as at that with most: a sensor that is off does that,
    and a force at one joint whose own parameters answer for it. Which joint's dictionary explains more then says more."""
    low, high = np.sort(force)[-2:] if len(force) > 1 else (0.0, 1.0)
    return bool(high < criteria.joints_alike * low or high == 0.0)


def _doubt(problem: Problem, places: list[tuple], alike: bool) -> tuple[str, str] | None:
    """The other joint that it may sit at. A scale of one joint's command is the inverse scale of the other's: masses and
    frictions are in units of the torque."""
    first, variable = places[0][:2]
    there = [p for p in places if p[0] != first]
    if not there:
        return None
    other, sure = there[0][0], there[0][3] < SURE
    torque = np.asarray(problem.windows.torque)
    driven = [joint for joint, std in zip(problem.plant.joints, torque.std((0, 1)), strict=True) if std > 0]
    if variable == "command" and {first, other} <= set(driven):
        return other, "if it is the torque's scale, whose inverse there is the same"
    return (other, "where as much is unexplained") if alike and sure else None


def residual_torque(problem: Problem, lin, parts) -> list[dict]:
    """The unexplained torque over time at each joint, for figures: `[{joint, time, value, std, window}]`."""
    from adaptsim_jax.sysid.estimate.variance import unexplained_force

    mean, std = unexplained_force(lin, parts)
    times = problem.windows.times[:, :-1]
    live = (problem.windows.dt > 0) & problem.windows.real[:, None]
    first = np.asarray(problem.windows.trial) == problem.windows.trial[0]
    pick = live & first[:, None]
    return [
        {"joint": joint, "time": times[pick], "value": mean[:, j][pick], "std": std[:, j][pick]}
        for j, joint in enumerate(problem.plant.joints)
    ]
