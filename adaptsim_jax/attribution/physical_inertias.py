"""Fitted inertias in a person's terms: mass, centre of mass and inertia about it by body, and which
combinations the data fix.

The fit's own coordinates (`parameters.ETA`) are held near the declared ones by a prior where the
data say nothing, so a value by itself does not tell whether it was measured. A quantity counts as
fixed by the data where they narrow what the prior leaves of it to `INERTIAL.narrow`.
Motion alone never tells the inertial parameters of a tree one by one, only combinations of them
(Gautier and Khalil, 1990). Of these, what each joint carries when all joints are at zero is
reported: inertia about the axis and first moments across it.
"""

from dataclasses import dataclass

import numpy as np

from adaptsim_jax.attribution.criteria import INERTIAL
from adaptsim_jax.attribution.estimate import normal
from adaptsim_jax.attribution.fitted import FittedTree
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.parameters import BODY_NUMBERS, OF_BODIES
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.testing import deviates, jackknife
from adaptsim_jax.mechanisms.inertia_frames import (
    Frame,
    central,
    compose,
    in_frame,
    inverse,
    six_of,
    symmetric_of,
)

OF_BODY = (
    "mass",
    "centre of mass x",
    "centre of mass y",
    "centre of mass z",
    "inertia xx",
    "inertia yy",
    "inertia zz",
    "inertia xy",
    "inertia xz",
    "inertia yz",
)
UNITS = ("kg", "m", "m", "m", *["kg m^2"] * 6)
COORDINATE_STEP = 1e-4  # of a coordinate, for differences
FLAT_LENGTH = 1e-9  # 1: a direction across gravity that is shorter is none


@dataclass(frozen=True)
class InertialQuantity:
    """A number of all inertial coordinates: name, unit, value [2 + F] (the fit's, of each fold, the
    model file's), slope [P] by the vector.
    """

    name: str
    unit: str
    values: np.ndarray
    slope: np.ndarray
    combined: bool


def inertia_rows(machine: Machine, problem: TreeProblem, model: FittedTree) -> dict[str, Table]:
    """Rows of `declared` in the report: combinations by joint, then bodies; `identifiable` where
    the data fix the value.
    """
    vector = model.fit.vector
    if not any(e.owner in OF_BODIES for e in vector.entries):
        return {}
    left, prior = spreads(problem, model)
    rows, times = {}, deviates(len(model.held.vectors))
    for q in quantities(machine, problem, model):
        alone = float(np.sqrt(np.square(q.slope) @ np.square(prior)))
        if alone == 0.0:
            continue
        both = float(np.sqrt(max(q.slope @ left @ q.slope, 0.0)))
        width = times * max(float(jackknife(q.values[1:-1])), both)
        value = float(q.values[0])
        rows[q.name] = {
            "value": value,
            "low": value - width,
            "high": value + width,
            "unit": q.unit,
            "identifiable": bool(both < INERTIAL.narrow * alone),
            "combination": q.combined,
            "file": float(q.values[-1]),
        }
    return rows


def sentence(problem: TreeProblem, model: FittedTree, rows: dict[str, Table]) -> list[str]:
    """What the data fix of the inertial parameters, in words; nothing where none was fitted."""
    own = [i for i, e in enumerate(model.fit.vector.entries) if e.owner in OF_BODIES]
    if not own or not rows:
        return []
    left, prior = spreads(problem, model)
    share = left[np.ix_(own, own)] / prior[own] / prior[own][:, None]
    count = int(np.sum(np.sqrt(np.maximum(np.linalg.eigvalsh(share), 0.0)) < INERTIAL.narrow))
    fixed = {
        name: row["combination"]
        for name, row in rows.items()
        if row["identifiable"] and "combination" in row
    }
    named = [name for name, joined in fixed.items() if joined]
    bodies = [
        name
        for name, joined in fixed.items()
        if not joined and not rows[name]["low"] <= 0.0 <= rows[name]["high"]
    ]
    if named:
        which = f" ({'among them ' if len(named) < count else ''}{', '.join(named)})"
    else:
        which = ""
    if bodies:
        alone = ", ".join(bodies)
    else:
        alone = "no mass, centre of mass or inertia of a body"
    return [
        f"Of {len(own)} inertial parameters these data fix {count} "
        f"combination{'' if count == 1 else 's'}{which}; by itself {alone}. What they do not fix "
        "stays near what was declared."
    ]


def otherwise(rows: dict[str, Table]) -> list[str]:
    """Which combinations, masses or dampings that the file gives the data fix at another value than
    it does, the three furthest off: a payload, another part.
    """

    def damped(name, row):
        return name.startswith("damping of ") and row["file"] > 0.0

    def wanted(name, row):
        return row.get("combination") or name.startswith("mass of ") or damped(name, row)

    some = {name: row for name, row in rows.items() if wanted(name, row)}
    largest: dict[str, float] = {}
    for row in some.values():
        largest[row["unit"]] = max(largest.get(row["unit"], 0.0), abs(row["file"]))
    fixed = {name: row for name, row in some.items() if row["identifiable"]}
    off = {}
    for name, row in fixed.items():
        size = max(abs(row["file"]), INERTIAL.different * largest[row["unit"]], 1e-12)
        if (
            abs(row["value"] - row["file"]) > INERTIAL.different * size
            and not row["low"] <= row["file"] <= row["high"]
        ):
            off[name] = abs(row["value"] - row["file"]) / size
    different = []
    for name in sorted(off, key=lambda n: -off[n])[:3]:
        row = fixed[name]
        different.append(f"{name} {row['value']:.3g} {row['unit']} (file {row['file']:.3g})")
    if different:
        return [f"Unlike the model file, by these data: {', '.join(different)}."]
    return []


def named_by(unlike: str) -> str:
    """What has it named that fitted bodies or damping take up. unlike: a note of `otherwise`."""
    if " mass " in unlike or "inertia" in unlike or "moment" in unlike:
        key, like = ("inertias", "a load that the file does not know")
    else:
        key, like = ("damping", "a bearing or a grease that is not the file's")
    return (
        f"{like[:1].upper()}{like[1:]} looks so: with {key} = false under [fit] in meta.toml it is "
        "named as an effect."
    )


def spreads(problem: TreeProblem, model: FittedTree) -> tuple[np.ndarray, np.ndarray]:
    """Covariance [P, P] of the vector by data and prior together, and the prior's standard
    deviations [P] (0 where it has none).
    """
    lin, vector = model.lin, model.fit.vector
    hess = model.hess
    if hess is None:
        hess = normal(problem, lin.residual, lin.start, lin.shared).hess.sum(0) + np.diag(
            vector.precision
        )
    size = np.sqrt(np.maximum(np.diagonal(hess), 1e-300))
    scaled = hess / size / size[:, None]
    left = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) / size / size[:, None]
    prior = np.array([e.prior if np.isfinite(e.prior) else 0.0 for e in vector.entries])
    return left, prior


def quantities(machine: Machine, problem: TreeProblem, model: FittedTree) -> list[InertialQuantity]:
    """All that is told of inertias, joints first."""
    tree, vector = machine.tree, model.fit.vector
    file = np.where([e.owner in OF_BODIES for e in vector.entries], 0.0, vector.values)
    fits = np.stack([vector.values, *model.held.vectors, file])
    place = {(e.joints[0], e.name): i for i, e in enumerate(vector.entries) if e.owner in OF_BODIES}
    found: dict[
        int, tuple[np.ndarray, np.ndarray]
    ] = {}  # inertial parameters [2 + F, 10] of a body, their slope [10, P]
    for g in problem.groups:
        by_fit = [g.inertias.at(vector.at(row).bodies(g.joints)) for row in fits]
        for k, j in enumerate(g.joints):
            slope = np.zeros((10, len(vector)))
            for c, name in enumerate(BODY_NUMBERS):
                if (j, name) in place:
                    slope[:, place[j, name]] = by_fit[0][1][k][:, c]
            found[j] = np.stack([value[k] for value, _ in by_fit]), slope
    out = [q for j in range(tree.n) for q in _carried(machine, found, j)]
    return out + [
        q for j in range(tree.n) if not tree.massless[j] for q in _body(machine, *found[j], j)
    ]


def _body(
    machine: Machine, values: np.ndarray, slope: np.ndarray, j: int
) -> list[InertialQuantity]:
    """Mass, centre of mass and inertia about it, in the axes of the model file's body."""
    frames, name = machine.mechanism.frames, machine.tree.body_names[j]
    frame = inverse((frames.place[name], frames.rotation[name]))
    central = np.stack([_central(v, frame) for v in values])
    size = COORDINATE_STEP * np.maximum(np.abs(slope).max(1), 1e-12)
    change = []
    for h, e in zip(size, np.eye(10), strict=True):
        difference = _central(values[0] + h * e, frame) - _central(values[0] - h * e, frame)
        change.append(difference / (2 * h))
    by = np.stack(change, 1) @ slope
    return [
        InertialQuantity(f"{what} of {name}", UNITS[k], central[:, k], by[k], False)
        for k, what in enumerate(OF_BODY)
    ]


def _central(inertial: np.ndarray, frame: Frame) -> np.ndarray:
    mass, com, about = central(in_frame(inertial, frame))
    return np.array([mass, *com, *np.diagonal(about), about[0, 1], about[0, 2], about[1, 2]])


def _carried(machine: Machine, found: dict, j: int) -> list[InertialQuantity]:
    """What joint j moves, with every joint at zero, about its own axis: linear in all inertial
    parameters.
    """
    tree, frames = machine.tree, machine.mechanism.frames
    total, slope = 0.0, 0.0
    for i in range(j, tree.n):
        frame = _frame(tree, i, j)
        if frame is not None:
            move = np.stack([_moved(e, frame) for e in np.eye(10)], 1)
            total, slope = total + found[i][0] @ move.T, slope + move @ found[i][1]
    name = tree.joint_names[j]

    def make(what, unit, row):
        return InertialQuantity(f"{what} {name}", unit, np.asarray(total) @ row, row @ slope, True)

    unit = np.eye(10)
    if tree.kinds[j] == "slide":
        return [make("mass on", "kg", unit[0])]
    if tree.body_names[j] in frames.rotation:
        axes = frames.rotation[tree.body_names[j]]
    else:
        axes = np.eye(3)
    along = np.abs(axes[2])  # of the joint's axis, in the body's own
    across = [k for k in range(3) if k != int(np.argmax(along))]
    rows = [make("inertia about", "kg m^2", unit[9])]
    for k in across:
        flat = np.array([*axes[:2, k], 0.0])  # what gravity about the axis sees of it
        if np.linalg.norm(flat) > FLAT_LENGTH:
            rows.append(make(f"first moment {'xyz'[k]} at", "kg m", flat @ unit[1:4]))
    return rows


def _frame(tree, i: int, j: int) -> Frame | None:
    """Joint i's frame in that of joint j at zero angles; None where j does not carry i."""
    frame: Frame = (np.zeros(3), np.eye(3))
    while i != j:
        if i < j:
            return None
        frame = compose((np.asarray(tree.place)[i], np.asarray(tree.rotation)[i]), frame)
        i = tree.parent[i]
    return frame


def _moved(inertial: np.ndarray, frame: Frame) -> np.ndarray:
    """Inertial parameters [10] given in `frame`, in the frame that it is given in; linear, also
    where nothing is massive.
    """
    mass, first, about = inertial[0], inertial[1:4], symmetric_of(inertial[4:])
    place, turn = frame
    spread = turn @ (0.5 * np.trace(about) * np.eye(3) - about) @ turn.T  # integral of x x'
    first = turn @ first
    spread = (
        spread + np.outer(place, first) + np.outer(first, place) + mass * np.outer(place, place)
    )
    return np.concatenate(
        [[mass], first + mass * place, six_of(np.trace(spread) * np.eye(3) - spread)]
    )
