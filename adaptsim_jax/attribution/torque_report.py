"""What the torque along the measured motion contributes to a report, where it judges: errors,
headline, notes, and the page's curves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.attribution.criteria import TEXT, WINDOW
from adaptsim_jax.attribution.equation.balance import Balance, residual, rms
from adaptsim_jax.attribution.equation.carried import carried
from adaptsim_jax.attribution.equation.models import TorqueSearch, held_missing
from adaptsim_jax.attribution.measures import Measure, needed
from adaptsim_jax.attribution.parameters import INERTIA, Vector
from adaptsim_jax.attribution.problem import TreeProblem, moving
from adaptsim_jax.attribution.report import by_joint
from adaptsim_jax.attribution.sentences import label, place
from adaptsim_jax.attribution.shown import shown
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.diagnosis.report import Account, Headline, words
from adaptsim_jax.diagnosis.testing import deviates
from adaptsim_jax.logs.noise import difference_noise


@dataclass(frozen=True)
class TorqueFound:
    """What the balances say, and how much torque is missing of the declared model, fitted, and of
    the final one. factor: within which bodies were fitted.
    """

    found: TorqueSearch
    before: Measure
    after: Measure
    factor: float


def floor_of(problem: TreeProblem, balances: Sequence[Balance]) -> np.ndarray:
    """Noise of the torques in a window [n]: of what is told, by third differences; at least a
    thousandth of it.
    """
    out = np.zeros(problem.joints)
    for b in balances:
        rows = float(np.median(np.diff(b.mean.indptr)))  # of a window
        noise = difference_noise([b.u[:, run].T for run in b.runs]) / np.sqrt(0.35 * rows)
        out[list(b.group.joints)] = np.maximum(noise, 1e-3 * rms(needed(problem, b)))
    return out


def by_torque(
    account: Account, problem: TreeProblem, e: TorqueFound, criteria: Criteria
) -> Account:
    """An account with headline, errors and remains in terms of torques."""
    found, after = e.found, e.after
    floor = floor_of(problem, [w.balance for w in found.searches])
    times = after.error / np.maximum(floor, 1e-12)
    # below a share of the torque nothing would be named
    minimum = np.maximum(criteria.explained * floor, criteria.torque.worth * after.still)
    remaining = {
        "error": _pooled(after),
        "times_floor": float(np.max(times, where=moving(problem), initial=0.0)),
        "joints": by_joint(problem, after.error, times),
    }
    notes = [
        *account.more["notes"],
        *carried_notes(problem, found),
        *unnamed_notes(problem, found),
        *bound_notes(problem, found, e.factor),
    ]
    over = after.error > np.maximum(minimum, 1e-12)
    return replace(
        account,
        headline=headline(problem, e),
        left=bool(np.any(moving(problem) & over)),
        error=_error(problem, e, floor),
        more={
            **account.more,
            "remaining": remaining,
            "notes": notes,
            "power": power_rows(problem, found),
        },
    )


def power_rows(problem: TreeProblem, found: TorqueSearch) -> list[Table]:
    """What these recordings would show beside what is in the final model."""
    rows = []
    for w in found.searches:
        left = w.whole.left_out(w.rows)
        rows += [r for r in shown(problem, w.balance, w.final, w.state.reach, left) if r["size"]]
    return rows


def _pooled(m: Measure) -> float:
    """Mean share of the torque's size that is missing, over joints that have any."""
    base = np.maximum(m.still, 1e-300)
    if np.any(m.still > 0):
        return float(np.mean((m.error / base)[m.still > 0]))
    return 0.0


def _error(problem: TreeProblem, e: TorqueFound, floor: np.ndarray) -> Table:
    found, before, after = e.found, e.before, e.after

    def pair(a, b):
        return {"before": float(a), "after": float(b) if found.added else None}

    channels = {
        name: {
            "unit": before.units[j],
            **pair(before.error[j], after.error[j]),
            "noise_floor": float(floor[j]),
        }
        for j, name in enumerate(problem.joint_names)
    }
    base = np.maximum(before.still, 1e-300)
    trials = []
    for w_trial, name in _trials(found):
        each = [_share(found, w_trial, k, base) for k in (0, 1)]
        trials.append({"trial": name, **pair(*each), "per_channel": {}})
    return {
        "metric": "torque along the measured motion that is missing in left-out blocks, as a share "
        "of the torque, mean over joints",
        "unit": "1",
        "stretch_s": WINDOW.span,
        **pair(_pooled(before), _pooled(after)),
        "noise_floor": float(np.mean(floor / base)),
        "per_channel": channels,
        "per_trial": trials,
        "noise_floor_source": "third differences of the torques",
    }


def _trials(found: TorqueSearch) -> list[tuple[int, str]]:
    if not found.searches:
        return []
    b = found.searches[0].balance
    return [(int(t), b.names[int(t)]) for t in np.unique(b.trial)]


def _share(found: TorqueSearch, trial: int, which: int, base: np.ndarray) -> float:
    shares = []
    for k, left in held_missing(found)[which].items():
        b = found.searches[k].balance
        own = rms(left[b.trial == trial])
        shares += list(own / base[list(b.group.joints)])
    return float(np.mean(shares))


def headline(problem: TreeProblem, e: TorqueFound) -> Headline:
    """Sentences of the message."""
    before, after = (f"{100 * _pooled(m):.0f} %" for m in (e.before, e.after))
    by: dict[str, list[str]] = {}
    for n in e.found.named:
        name, where = label(problem, n.candidate)
        by.setdefault(words(name), []).append(where)
    names = "; ".join(f"{name} at {', '.join(where)}" for name, where in by.items())
    error, still = e.after.error, e.after.still
    j = int(np.argmax(error / np.maximum(still, 1e-300)))
    worst = f"{problem.joint_names[j]}, {error[j]:.3g} of {still[j]:.3g} {e.after.units[j]}"
    return Headline(
        f"The declared model, fitted, misses {before} of the torque along the measured motion.",
        f"{names[:1].upper()}{names[1:]}: held out by the torque along the measured motion, of "
        f"which {before} is missing without and {after} with (left-out blocks, mean over joints; "
        f"most is left at {worst}).",
        enough=Headline.none,
    )


def carried_notes(problem: TreeProblem, found: TorqueSearch) -> list[str]:
    """Which mass at one body says what all fitted bodies say."""
    lines = []
    for w in found.searches:
        if (c := carried(w)) is None:
            continue
        width = deviates(len(w.whole.by_fold)) * c.error
        lines.append(
            f"About {c.mass:.3g} kg [{c.mass - width:.3g}, {c.mass + width:.3g}] more than the "
            f"file says is carried behind {problem.joint_names[c.joint]}: by itself it takes off "
            f"{100 * c.share:.0f} % of what all fitted bodies do (in logarithms)."
        )
    return lines


def unnamed_notes(problem: TreeProblem, found: TorqueSearch) -> list[str]:
    """What is fitted, since it predicts, and has no name, by effect and reason."""
    by: dict[tuple[str, str], list[str]] = {}
    for w in found.searches:
        for c, why in w.unnamed:
            if c in w.added:
                by.setdefault((c.effect, why), []).append(place(problem, c))
    return [
        f"{words(name)} at {', '.join(where)} is fitted and not named: {why}."
        for (name, why), where in by.items()
    ]


def bound_notes(problem: TreeProblem, found: TorqueSearch, factor: float) -> list[str]:
    """Bodies whose fit ends where a body of the file's kind ends: what would explain it."""
    at = set()
    for w in found.searches:
        for e, z in w.final.pairs():
            if e.owner == INERTIA and abs(z) > 0.98 * e.high:
                at.add(problem.joint_names[e.joints[0]])
    if not at:
        return []
    return [
        f"The fit of the bodies moved by {', '.join(sorted(at))} ends at {factor:g} times "
        f"(or 1/{factor:g} of) what the model file says, and is held there: a rotor, a gain of the "
        "torques, a payload or friction that is not in the catalogue would explain it; "
        "`[fit] factor` in meta.toml widens it."
    ]


def curves(problem: TreeProblem, found: TorqueSearch, final: Vector) -> dict[str, list[Table]]:
    """Of the page: torque measured and modelled over time by joint, and friction against speed, of
    a final vector.
    """
    over_time, friction = [], []
    for w in found.searches:
        b = w.balance
        torques = needed(problem, b)
        left = [residual(problem, b, v) for v in (Vector((), np.zeros(0)), final)]
        rubbing = {e.name for e in problem.effects if e.traits.resists}
        without = [
            0.0 if e.owner in rubbing and e.off == 0.0 and e.low <= 0.0 else z
            for e, z in final.pairs()
        ]
        resists = residual(problem, b, final.at(np.array(without)))
        speed, count = b.averaged(b.v), len(torques)
        some = np.unique(np.linspace(0, count - 1, min(TEXT.curve_rows, count)).astype(int))
        gaps = np.where(np.diff(b.trial) != 0, b.time[:-1] - b.time[1:] + 0.5, 0.0)
        clock = b.time + np.concatenate([[0.0], np.cumsum(gaps)])
        for k, j in enumerate(b.group.joints):
            joint = {"joint": problem.joint_names[j], "unit": problem.force_units[j]}
            curve = {
                "time": clock[some],
                "measured": torques[some, k],
                "file": (torques + left[0])[some, k],
                "fitted": (torques + left[1])[some, k],
            }
            over_time.append(joint | curve)
            by_speed = {
                "speed": speed[some, k],
                "missing": -resists[some, k],
                "modelled": (left[1] - resists)[some, k],
            }
            friction.append(joint | by_speed)
    return {"torque": over_time, "friction": friction}
