"""Declared parameters where several effects explain the data alike: each of them would put the parameters elsewhere.

A motor whose torque is a third too large at one joint and masses to match move just as one whose torque is too small at
the other. Where the data do not tell which, neither do they tell the masses: the interval has to reach over both.
"""

from typing import Any

import numpy as np

from adaptsim_jax.effects.base import NINETY
from adaptsim_jax.sysid.estimate.fitted import Fit
from adaptsim_jax.sysid.estimate.problem import Problem
from adaptsim_jax.sysid.select.trace import Trace


def class_members(found: Trace) -> list[Fit]:
    """The likeliest model with each of the alternatives in the place of its effect."""
    out = []
    for effect, alternatives in found.classes.items():
        for other in alternatives:
            active = {other if a == effect else a for a in found.final.active}
            models = [t for t in found.tried if set(t.active) == active]
            if models:
                out.append(max(models, key=lambda t: t.total))
    return out


def reach_over_classes(declared: dict[str, Any], problem: Problem, found: Trace) -> None:
    """Widen the intervals of `declared` (the report's `after`) to what each member of the classes would make of them."""
    for model in class_members(found):
        names, point = model.candidate.names, model.candidate.refit.point.z
        error = np.sqrt(np.diag(model.candidate.refit.covariance))
        for name in (n for n in problem.plant.theta_names if n in names and n in declared):
            entry, i = declared[name], names.index(name)
            if entry.get("low") is None:
                continue
            low, high = float(point[i] - NINETY * error[i]), float(point[i] + NINETY * error[i])
            if low < entry["low"] or high > entry["high"]:
                entry["low"], entry["high"] = min(low, entry["low"]), max(high, entry["high"])
                entry["note"] = "the interval reaches over all effects that explain the data alike"
