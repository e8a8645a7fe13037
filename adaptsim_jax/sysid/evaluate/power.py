"""What these data could have shown: the smallest size of each candidate that would have been found."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.score.table import ScoreTable

COMMON = ("coulomb", "quadratic_drag", "bias", "spring", "torque_gain", "delay")


@dataclass(frozen=True)
class Power:
    """One instance: `smallest`, the effect torque as a share of the joint's torque RMS that would be found four times
    in five; `enough` where that is at most `matters`."""

    name: str
    where: str
    smallest: float
    matters: float

    @property
    def enough(self) -> bool:
        return self.smallest <= self.matters


def power(problem: Problem, view: ScoreTable) -> list[Power]:
    """Smallest detectable share of each candidate, from the information in its projected signature.

    The effect torque of a unit amplitude is taken from the signature itself: the torque on one joint, of white spectrum
    up to 3 Hz, whose outputs are as large.
    """
    ranked = view.ranked()
    level = problem.criteria.alpha / max(len(ranked), 1)
    scale = _force_scale(problem, view)
    out = []
    for r in ranked:
        need = np.sqrt(chi2.isf(level / r.tried, r.score.freedom)) + 0.84
        column = list(r.atom.columns)
        information, size = (np.sum(z**2, (0, 1)) for z in (view.scorer.columns(column), view.lin.atoms[:, :, column]))
        joint = int(r.instance[1][-1]) - 1 if r.instance[1].startswith("joint") else 0
        share = need / np.sqrt(np.maximum(information, 1e-300)) * np.sqrt(size) * scale[joint]
        out.append(Power(*r.instance, float(np.min(share)), problem.criteria.matters))
    return out


def _force_scale(problem: Problem, view: ScoreTable) -> np.ndarray:
    """Share of the joint's torque RMS per unit of output norm, for slow forces on each joint `[n]`."""
    impulse, dt = view.lin.impulse, view.lin.dt
    time = np.cumsum(dt, axis=1)
    scale = []
    for j in range(impulse.shape[2]):
        norms = []
        for hertz in (0.7, 1.5, 3.0):
            force = np.sqrt(2) * np.cos(2 * np.pi * hertz * time) * (dt > 0)
            norms.append(np.sum(np.einsum("wml,wl->wm", impulse[:, :, j], force) ** 2))
        scale.append(1.0 / np.sqrt(np.mean(norms)) / max(problem.torque_rms[j], 1e-12))
    return np.array(scale)


def powered(found: list[Power]) -> bool:
    """Whether most common effects of a size that matters would have been seen."""
    common = [p.enough for p in found if p.name in COMMON]
    return bool(np.mean(common) >= 0.5) if common else False
