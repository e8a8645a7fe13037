"""The double pendulum of `task = "pendulum"` as one mechanism among others, and its
`model.toml`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from adaptsim_jax.attribution.fitted import FittedTree
from adaptsim_jax.attribution.machine import Machine, machine
from adaptsim_jax.attribution.model_toml import DECLARED
from adaptsim_jax.attribution.parameters import INERTIA, TILT, Vector
from adaptsim_jax.attribution.problem import TreeProblem, values_of
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.diagnosis.testing import deviates, jackknife
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.actuator import PENDULUM_ROTOR_INERTIA
from adaptsim_jax.effects.joints.catalogue import OWN
from adaptsim_jax.effects.joints.forces import ARMATURE
from adaptsim_jax.effects.joints.friction import COULOMB, PRESLIDING, STRIBECK, VISCOUS
from adaptsim_jax.effects.registry import catalogue
from adaptsim_jax.logs.log import Log
from adaptsim_jax.logs.log_meta import Rig
from adaptsim_jax.mechanisms.double_pendulum.plant import JOINTS, double_pendulum_mjcf
from adaptsim_jax.mechanisms.mjcf import read_mechanism
from adaptsim_jax.mend.model_toml import AddedEffect, Value
from adaptsim_jax.mend.pendulum_model import ModelFile, read_model


def _common() -> frozenset[str]:
    """Effects that both catalogues know by the same name and amplitudes."""
    of_joints = {e.name: {p.name for p in e.amplitudes} for e in OWN}
    return frozenset(
        e.name
        for e in catalogue("pendulum")
        if {p.name for p in e.amplitudes} == of_joints.get(e.name)
    )


SAME = _common()
LINK = ("size", "stretch_y", "shift_y")
Fitted = Mapping[tuple[str, str, int], tuple[float, float, str]]
"""Value, standard deviation and unit of each fitted number by owner, name and joint."""
RIGID, LINEAR = "rigid_body", "linearized"


def pendulum_machine(log: Log, model: str | Path, effects: Sequence[Effect] = ()) -> Machine:
    """A log of the double pendulum with a model: an MJCF or URDF file, or a `model.toml`, which may
    hold `effects` besides ours.

    Raises BadInput where the model is not of two joints, or has an effect that mechanisms do not
    know.
    """
    if Path(model).suffix.lower() != ".toml":
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
        return machine(
            mechanism, replace(log, joint_names=names, input_names=inputs, driven=driven)
        )
    given = read_model(model, own_catalogue("pendulum", effects))
    with TemporaryDirectory() as folder:
        made = declared_machine(log, given.theta(given.plant()), Path(folder) / DECLARED)
    return replace(made, declared=made.declared | _declared_effects(given))


def declared_model(rig: Rig, effects: Sequence[Effect] | None = None) -> ModelFile | None:
    """The mended model that a rig's `meta.toml` names, or None.

    Raises BadInput where the file is bad or is of another rig than the recording says.
    """
    if rig.model_file is None:
        return None
    given = read_model(rig.model_file, effects)
    for key in ("task", "model", "angle_zero"):
        there, here = getattr(given, key), getattr(rig, key)
        if there != here:
            raise BadInput(
                f"{given.path}: {key} = {there!r}, but meta.toml of the recording says {here!r}; "
                "mend one"
            )
    for key in set(given.geometry) & set(rig.geometry):
        if abs(given.geometry[key] - rig.geometry[key]) > 1e-9 * abs(given.geometry[key]):
            raise BadInput(
                f"{given.path}: geometry.{key} = {given.geometry[key]:g}, but the recording has "
                f"{rig.geometry[key]:g}; a mended model is of one rig: mend one of them"
            )
    return given


def own_catalogue(task: str, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """What a `model.toml` may hold: the task's effects, and those of `effects` that have other
    names.
    """
    known = catalogue(task)
    names = {e.name for e in (*known, *OWN)}
    return (*known, *(e for e in effects if e.name not in names))


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


def _declared_effects(given: ModelFile) -> dict[tuple[str, str], np.ndarray]:
    out: dict[tuple[str, str], np.ndarray] = {}

    def put(effect: str, parameter: str, where: str, value: float) -> None:
        if where not in JOINTS:
            raise BadInput(
                f"{given.path}: {effect} at {where} has no counterpart in a mechanism; take it out "
                "to replay the rest"
            )
        out.setdefault((effect, parameter), np.zeros(2))[JOINTS.index(where)] = value

    for e in given.effects:
        numbers = {k: v.value for k, v in e.parameters.items()}
        if e.name == PENDULUM_ROTOR_INERTIA.name:
            put(ARMATURE.name, "inertia", e.where, numbers["inertia"])
        elif e.name == STRIBECK.name:
            put(COULOMB.name, "level", e.where, numbers["level"])
            for k in ("excess", "speed"):
                put(STRIBECK.name, k, e.where, numbers[k])
        elif e.name == PRESLIDING.name:
            put(COULOMB.name, "level", e.where, numbers["level"])
            put(e.name, "compliance", e.where, numbers["deflection"] / max(numbers["level"], 1e-9))
        elif e.name in SAME or e.name not in {x.name for x in catalogue(given.task)}:
            for k, value in numbers.items():
                put(e.name, k, e.where, value)
        else:
            raise BadInput(
                f"{given.path}: {e.name} is no effect of a mechanism; take it out to replay the "
                "rest"
            )
    return out


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

    names, units, of = ("p1", "p3", "h1", "h2"), ("kg m^2", "kg m^2", "kg m", "kg m"), lambda z: z
    if rig.model == LINEAR:  # gravity has the least to do with how bodies are shaped
        names, units, of = ("m1", "m2"), ("kg", "kg"), lambda z: np.array([z[2] - z[3], z[3]])
    own, folds = of(base(vector.values)), np.array([of(base(z)) for z in model.held.vectors])
    wide = deviates(len(folds)) * jackknife(folds)
    out = {k: _number(*z) for k, z in zip(names, zip(own, wide, units, strict=True), strict=True)}
    by = _fitted(model)
    for k in range(2):
        held = (float(rig.known.get(f"b{k + 1}", 0.0)), 0.0, "N m s/rad")
        out[f"b{k + 1}"] = _number(*by.get((VISCOUS.name, "damping", k), held))
    return out


def _number(value: float, half: float, unit: str) -> Value:
    return Value(float(value), float(value - half), float(value + half), unit)


def _fitted(model: FittedTree) -> Fitted:
    """Value, half of its 90 % interval and unit of each fitted number by owner, name and joint."""
    rows = zip(model.fit.vector.entries, model.fit.vector.values, model.half_width, strict=True)
    return {
        (e.owner, e.name, j): (float(v), float(s), e.unit) for e, v, s in rows for j in e.joints
    }


def _in_the_file(name: str, k: int, by: Fitted) -> tuple[str, str, dict[str, Value]]:
    """Name, place and numbers that an effect at a joint has in `model.toml`."""
    mine = {p: _number(*v) for (owner, p, j), v in by.items() if owner == name and j == k}
    where = JOINTS[k]
    if name == ARMATURE.name:
        return PENDULUM_ROTOR_INERTIA.name, where, mine
    if name == STRIBECK.name:
        level = _number(*by.get((COULOMB.name, "level", k), (0.0, 0.0, "N m")))
        return name, where, mine | {"level": level}
    if name == TILT:
        return name, "base", {"angle": mine["about_y"]}
    if name == PRESLIDING.name and (COULOMB.name, "level", k) in by:  # of all dry friction there
        level, compliance = by[COULOMB.name, "level", k], mine["compliance"]
        bent = {x: level[0] * getattr(compliance, x) for x in ("value", "low", "high")}
        return name, where, {"level": _number(*level), "deflection": Value(**bent, unit="rad")}
    return name, where, mine


def _in_another(name: str, k: int, by: Fitted) -> bool:
    """Whether the numbers of an effect at a joint stand in the file with another effect's."""
    if name == TILT:
        return k > 0
    friction = {(STRIBECK.name, "excess", k), (PRESLIDING.name, "compliance", k)}
    return name == COULOMB.name and not friction.isdisjoint(by)


def model_file(
    rig: Rig, problem: TreeProblem, model: FittedTree, summary: Mapping[str, object]
) -> tuple[ModelFile, list[str]]:
    """A fitted model as `model.toml` holds it, and a line for each effect that it cannot hold.
    summary: of its provenance.
    """
    declared, by = declared_values(rig, problem, model), _fitted(model)
    effects, lost = [], []
    library = {e.name: e for e in own_catalogue(rig.task, problem.effects)}
    own = set(library) - {e.name for e in catalogue(rig.task)}
    translated = {ARMATURE.name, STRIBECK.name, TILT, *SAME, *own}
    found = {(owner, k) for owner, _, k in by if owner not in (INERTIA, VISCOUS.name)}
    for name, k in sorted(found):
        if _in_another(name, k, by):
            continue
        dry = (COULOMB.name, "level", k) in by
        if name in translated or (name == PRESLIDING.name and dry):
            held_by, where, mine = _in_the_file(name, k, by)
            parameters = library[held_by].parameters
            numbers = {
                p.name: mine.get(p.name, _number(p.default, 0.0, p.unit)) for p in parameters
            }
            effects.append(AddedEffect(held_by, where, numbers))
        else:
            lost.append(
                f"model.toml cannot hold {name} at {JOINTS[k]}; model.xml says what of it MJCF can "
                "hold"
            )
    geometry = {k: float(v) for k, v in rig.geometry.items()}
    known = {k: float(v) for k, v in rig.known.items()}
    file = ModelFile(
        rig.task,
        rig.model,
        rig.angle_zero,
        geometry,
        declared,
        tuple(effects),
        known,
        provenance=dict(summary),
        library=tuple(library.values()) if own else (),
    )
    return file, lost
