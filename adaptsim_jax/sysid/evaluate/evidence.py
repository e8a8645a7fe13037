"""The cause made visible: the torque that a model lacks without one effect, against the variable that the effect follows.

For each named effect, the mended model is simulated with that effect alone taken out. What the measurements then ask for
beyond it, and what the effect itself gives, both as torques at its joint, come from the same estimator
(`variance.unexplained_force`): whatever that smooths, it smooths in both, so the two may be laid over each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.sysid.estimate import variance
from adaptsim_jax.sysid.estimate.candidate import compressed, linearised
from adaptsim_jax.sysid.estimate.fitted import Fit, Instance
from adaptsim_jax.sysid.estimate.problem import Problem, at_point
from adaptsim_jax.sysid.estimate.variance import Linearised
from adaptsim_jax.sysid.score.table import ScoreTable

BINS = 32
SURE = 1.3  # times the median uncertainty: rows that say less, at the ends of windows, are left out
LEAST_FOLLOWED = 0.5  # of the effect's variance: a variable that shows less of it is not the one to plot against


@dataclass(frozen=True)
class Evidence:
    """One named effect, row by row: `x [n]` in the unit of `x_label`, `y [n]` N m that the model without it lacks, `std
    [n]` N m its uncertainty, `effect [n]` N m what the effect gives; `curve_x`, `curve_y [b]` its mean over bins of x;
    `explained`: share of the sum of squares of y that the effect accounts for."""

    name: str
    where: str
    x: np.ndarray
    y: np.ndarray
    std: np.ndarray
    effect: np.ndarray
    x_label: str
    curve_x: np.ndarray
    curve_y: np.ndarray
    explained: float

    def shown(self) -> dict:
        """What the page draws (`evidence['regressor']`)."""
        return {
            "name": self.name, "where": self.where, "x": self.x, "y": self.y, "x_label": self.x_label,
            "y_label": "torque, N m", "curve_x": self.curve_x, "curve_y": self.curve_y, "explained": self.explained,
        }  # fmt: skip


def evidence_of(
    problem: Problem, model: Fit, view: ScoreTable, declared: ScoreTable, effects: Sequence[Instance]
) -> list[Evidence]:
    """Evidence for each of `effects`, all of which act in `model`.

    `view` is about `model`: from its path come the variables. Impulse responses come from `declared`, the view about the
    declared model: a joint that friction holds does not answer to a force at all, and would hide what held it.
    """
    c = model.candidate
    full = at_point(problem, c.active, c.theta, c.eff, c.refit.point.x0)
    out = []
    for instance in effects:
        rest = tuple(a for a in c.active if a != instance)
        without = at_point(problem, rest, c.theta, c.eff, c.refit.point.x0)
        if not np.isfinite(without.residual).all():
            continue  # the model runs away without it: there is no torque to show
        lacking = _about(problem, without, declared)
        given = replace(lacking, residual=lacking.residual - _about(problem, full, declared).residual)
        parts = variance.estimate(lacking, declared.response.kernels, start=model.parts)
        (y, std), (own, _) = variance.unexplained_force(lacking, parts), variance.unexplained_force(given, parts)
        out.append(_evidence(problem, model, view, instance, y, std, own))
    return out


def _about(problem: Problem, result, view: ScoreTable) -> Linearised:
    """Rows of a result, with the impulse responses of the model in view: rivals share them."""
    lin = compressed(problem, linearised(problem, result))
    return replace(lin, impulse=view.lin.impulse, dt=view.lin.dt)


def _evidence(problem: Problem, model: Fit, view: ScoreTable, instance: Instance, y, std, own) -> Evidence:
    """Pick the joint and the variable, and bin the effect over it."""
    joint = _joint(instance, own)
    pick = (problem.windows.dt > 0) & problem.windows.real[:, None]
    pick &= std[:, joint] < SURE * np.median(std[:, joint][pick])
    y, std, own = y[:, joint][pick], std[:, joint][pick], own[:, joint][pick]
    label, x = _variable(_variables(problem, model, view, instance, joint, pick), own)
    centres, index = _bins(x)
    curve = np.array([own[index == b].mean() for b in range(len(centres))])
    explained = 1.0 - float(np.sum((y - own) ** 2) / max(np.sum(y**2), 1e-300))
    return Evidence(instance[0], f"joint{joint + 1}", x, y, std, own, label, centres, curve, explained)


def _joint(instance: Instance, own: np.ndarray) -> int:
    """The effect's own joint; for the base and for sensors, the joint at which the torque appears most."""
    name = instance[1]
    if name.startswith("joint"):
        return int(name.removeprefix("joint")) - 1
    return int(np.argmax(np.square(own).sum((0, 2))))


def _variables(
    problem: Problem, model: Fit, view: ScoreTable, instance: Instance, joint: int, pick
) -> dict[str, np.ndarray]:
    """Label -> value at the middle of each row, of what a torque at `joint` may follow."""
    path, n, layout = view.path, problem.plant.joint_dim, problem.model.layout
    step = np.where(path.dt > 0, path.dt, 1.0)
    middle = 0.5 * (path.x[:, 1:] + path.x[:, :-1])
    q, v, u = middle[..., joint], middle[..., n + joint], path.u[..., joint]
    t = path.time[:, :-1] + 0.5 * path.dt
    k, effect = joint + 1, layout.instances[layout.index(*instance)].effect
    found = {
        f"speed v{k}, rad/s": v,
        f"angle q{k}, rad": q,
        f"torque tau{k}, N m": u,
        f"acceleration of joint {k}, rad/s²": np.diff(path.x[..., n + joint], axis=1) / step,
        f"rate of the torque tau{k}, N m/s": np.gradient(u, axis=1) / step,
        f"|tau{k}| with the sign of v{k}, N m": np.abs(u) * np.sign(v),
        "time in the trial, s": t,
    }
    for name, value, of in (("order", q, "angle"), ("frequency", 2 * np.pi * t, "time")):
        if name in {p.name for p in effect.shapes}:
            at = layout.instances[layout.index(*instance)].at.start + [p.name for p in effect.parameters].index(name)
            found[f"phase of its {of} period, rad"] = np.mod(model.candidate.eff[at] * value, 2 * np.pi)
    return {label: z[pick] for label, z in found.items()}


def _variable(variables: dict[str, np.ndarray], own: np.ndarray) -> tuple[str, np.ndarray]:
    """The variable that the effect's torque follows most closely; the torque itself where it follows none alone."""
    spread = max(float(np.var(own)), 1e-300)
    followed = {}
    for label, x in variables.items():
        centres, index = _bins(x)
        followed[label] = sum(np.sum(index == b) * np.var(own[index == b]) for b in range(len(centres)))
    best = min(followed, key=lambda label: followed[label])
    if followed[best] / (spread * len(own)) > 1.0 - LEAST_FOLLOWED:
        return "torque that the effect gives, N m", own
    return best, variables[best]


def _bins(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres `[b]` of equally wide bins that hold rows, the outer 0.5 % in the outermost; bin of each row `[n]`."""
    low, high = np.quantile(x, [0.005, 0.995])
    index = np.clip((BINS * (x - low) / max(high - low, 1e-12)).astype(int), 0, BINS - 1)
    full, index = np.unique(index, return_inverse=True)
    return low + (full + 0.5) * (high - low) / BINS, index
