"""The double pendulum of `task = "pendulum"` as one mechanism among others: its declared model by
what its `meta.toml` says, and its parameters as that task names them.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from adaptsim_jax.attribution.fitted import FittedTree
from adaptsim_jax.attribution.machine import Machine, machine
from adaptsim_jax.attribution.parameters import INERTIA, Vector
from adaptsim_jax.attribution.problem import TreeProblem, values_of
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.diagnosis.testing import deviates, jackknife
from adaptsim_jax.effects.joints.friction import VISCOUS
from adaptsim_jax.logs.log import Log
from adaptsim_jax.logs.log_meta import Rig
from adaptsim_jax.mechanisms.double_pendulum.plant import JOINTS, double_pendulum_mjcf
from adaptsim_jax.mechanisms.mjcf import read_mechanism
from adaptsim_jax.mend.model_toml import Value, read_model_table

LINK = ("size", "stretch_y", "shift_y")
RIGID, LINEAR = "rigid_body", "linearized"
DAMPINGS = {"b1": ("N m s/rad", 0.0), "b2": ("N m s/rad", 0.0)}
PARAMETERS = {
    RIGID: {
        "p1": ("kg m^2", 1e-6),
        "p3": ("kg m^2", 1e-6),
        "h1": ("kg m", -1e2),
        "h2": ("kg m", -1e2),
        **DAMPINGS,
    },
    LINEAR: {"m1": ("kg", 1e-3), "m2": ("kg", 1e-3), **DAMPINGS},
}
"""Unit and lower bound of each declared parameter, by the kind of model."""
MOST = 1e3
"""Upper bound of all of them, in their units."""


def pendulum_machine(log: Log, model: str | Path) -> Machine:
    """A log of the double pendulum with an MJCF or URDF file. Raises BadInput where that is not of
    two joints.
    """
    mechanism = read_mechanism(model)
    names = mechanism.tree.joint_names
    if len(names) != 2:
        raise BadInput(
            f"{model}: has {len(names)} joints, but {log.path} is of a double pendulum; give "
            "one of 2"
        )
    theirs: dict[str, str] = dict(zip(JOINTS, names, strict=True))
    inputs = tuple(theirs[n] for n in log.input_names)
    driven = tuple(theirs[n] for n in log.driven)
    return machine(mechanism, replace(log, joint_names=names, input_names=inputs, driven=driven))


def own_keys(rig: Rig) -> dict[str, object]:
    """What a rig's `model.toml` says beside what any mechanism's does."""
    geometry = {k: float(v) for k, v in rig.geometry.items()}
    return {"angle_zero": rig.angle_zero, "geometry": geometry}


def check_rig(rig: Rig) -> None:
    """BadInput where the mended model that a rig's `meta.toml` names is of another rig."""
    assert rig.model_file is not None  # of a rig that names one
    given, here = read_model_table(rig.model_file), {"angle_zero": rig.angle_zero, **rig.geometry}
    there = {"angle_zero": given.get("angle_zero", rig.angle_zero), **given.get("geometry", {})}
    for key, value in there.items():
        if value != here.get(key, value):
            raise BadInput(
                f"{rig.model_file}: {key} = {value!r}, but meta.toml of the recording says "
                f"{here[key]!r}; a mended model is of one rig: mend one of them"
            )


def rig_of(log: Log) -> Rig:
    """The rig of a log of the double pendulum, which has one."""
    assert log.meta.rig is not None
    return log.meta.rig


def declared_machine(log: Log, theta: np.ndarray, path: Path) -> Machine:
    """A log of a rig with the declared model at parameters theta, which is written to `path`.

    theta: p1, p3, h1, h2, b1, b2 of a rigid body, m1, m2, b1, b2 of a linearized one.
    """
    rig = rig_of(log)
    linear = rig.model == LINEAR
    base = _of_point_masses(theta) if linear else theta
    write_bytes(path, double_pendulum_mjcf(base, rig.geometry, rig.angle_zero).encode())
    mechanism = read_mechanism(path)
    return machine(replace(mechanism, tree=replace(mechanism.tree, linear=linear)), log)


def _of_point_masses(theta: np.ndarray) -> np.ndarray:
    """Base parameters [6] of point masses m1, m2 at the ends of links of 1 m, with dampings b1,
    b2.
    """
    m1, m2, b1, b2 = (float(z) for z in theta)
    return np.array([m1 + 2.0 * m2, m2, m1 + m2, m2, b1, b2])


def in_the_plane(vector: Vector) -> Vector:
    """The vector without what `p1, p3, h1, h2, b1, b2` do not say: a centre of mass beside the
    link.
    """
    return vector.without(
        [e.key for e in vector.entries if e.owner == INERTIA and e.name not in LINK]
    )


def doubted(known: Mapping[str, float], values: Mapping[str, Value]) -> list[str]:
    """A sentence for each declared parameter that `[known]` gives otherwise than the motion: beyond
    its interval, by a fiftieth.
    """
    lines = []
    for k, x in known.items():
        v = values.get(k)
        if v is None or v.low is None or v.high is None:
            continue
        if not v.low <= x <= v.high and abs(v.value - x) > 0.02 * abs(x):
            lines.append(
                f"[known] {k} = {x:.4g}, but the motion says {v.value:.4g} [{v.low:.4g}, "
                f"{v.high:.4g}] {v.unit}: mend it or take it out"
            )
    return lines


def base_parameters(inertial: np.ndarray, l1: float, down: float) -> np.ndarray:
    """p1, p3, h1, h2 of two links' inertial parameters [2, 10] in their joints' frames, whose y
    axes lie along the links.
    """
    (m1y, i1), (m2y, i2), m2 = inertial[0, [2, 9]], inertial[1, [2, 9]], inertial[1, 0]
    return np.array([i1 + m2 * l1**2 + i2, i2, down * m1y + m2 * l1, down * m2y])


def declared_values(rig: Rig, problem: TreeProblem, model: FittedTree) -> dict[str, Value]:
    """Declared parameters of a fitted model under their names in `model.toml`, with 90 % intervals
    from its folds (jackknife).
    """
    (group,) = problem.groups
    vector, l1 = model.fit.vector, float(rig.geometry["l1"])
    down = -1.0 if rig.angle_zero == "upright" else 1.0

    def base(z):
        return base_parameters(values_of(problem, group, vector.at(z)).inertial[..., 0], l1, down)

    of = _masses if rig.model == LINEAR else np.asarray
    own, folds = of(base(vector.values)), np.array([of(base(z)) for z in model.held.vectors])
    wide = deviates(len(folds)) * jackknife(folds)
    rows = [*zip(own, wide, strict=True), *(_damping(rig, model, k) for k in range(2))]
    return {
        name: _number(*row, unit)
        for (name, (unit, _)), row in zip(PARAMETERS[rig.model].items(), rows, strict=True)
    }


def _masses(base: np.ndarray) -> np.ndarray:
    """m1, m2 of base parameters [4]: gravity has the least to do with how bodies are shaped."""
    return np.array([base[2] - base[3], base[3]])


def _damping(rig: Rig, model: FittedTree, joint: int) -> tuple[float, float]:
    """Viscous damping at a joint and half of its 90 % interval, as known where it is not fitted."""
    rows = zip(model.fit.vector.pairs(), model.half_width, strict=True)
    for (entry, value), half in rows:
        if entry.owner == VISCOUS.name and joint in entry.joints:
            return value, half
    return rig.known.get(f"b{joint + 1}", 0.0), 0.0


def _number(value: float, half: float, unit: str) -> Value:
    return Value(float(value), float(value - half), float(value + half), unit)
