"""The double pendulum of `task = "pendulum"` as one mechanism among others, and its `model.toml`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from adaptsim_jax.attribution.machine import Machine, machine
from adaptsim_jax.attribution.model_toml import DECLARED
from adaptsim_jax.attribution.parameters import INERTIA, TILT, Vector
from adaptsim_jax.attribution.problem import Problem, values_of
from adaptsim_jax.attribution.select import Selection
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import write_bytes
from adaptsim_jax.effects.base import NINETY
from adaptsim_jax.effects.registry import catalogue, effect_named
from adaptsim_jax.logs.pendulum_log import log_of
from adaptsim_jax.logs.types import Recording
from adaptsim_jax.mechanisms.double_pendulum.mjcf import JOINTS, double_pendulum_mjcf
from adaptsim_jax.mechanisms.mjcf import read_mechanism
from adaptsim_jax.mechanisms.model_file import AddedEffect, ModelFile, Value

SAME = {
    "quadratic_drag": ("drag",), "spring": ("stiffness", "preload"), "bias": ("torque",),
    "cogging": ("sine", "cosine", "order"), "hard_stop": ("stiffness", "angle", "side", "loss", "damping", "exponent"),
    "load_friction": ("share",), "torque_gain": ("gain",), "saturation": ("cut", "peak"), "dead_zone": ("width",),
    "delay": ("delay", "before"), "actuator_lag": ("lag", "before"), "encoder_offset": ("offset",), "sensor_lag": ("lag",),
    "backlash": ("gap",), "coulomb": ("level",),
}  # fmt: skip
"""Effects of the pendulum's catalogue that mechanisms have under the same name, with the parameters that both know."""
LINK = ("size", "stretch_y", "shift_y")


def pendulum_machine(recording: Recording, model: str | Path) -> Machine:
    """A recording of the double pendulum with a model: an MJCF or URDF file, or a `model.toml`.

    Raises BadInput where the model is not of two joints, or has an effect that mechanisms do not know.
    """
    if Path(model).suffix.lower() != ".toml":
        mechanism = read_mechanism(model)
        if mechanism.tree.n != 2:
            raise BadInput(
                f"{model}: has {mechanism.tree.n} joints, but {recording.path} is of a double pendulum; give one of 2"
            )
        log = log_of(recording)
        names: dict[str, str] = dict(zip(JOINTS, mechanism.tree.joint_names, strict=True))
        told = tuple(names[n] for n in log.driven)
        return machine(mechanism, replace(log, joint_names=mechanism.tree.joint_names, input_names=told, driven=told))
    from adaptsim_jax.mechanisms.model_file import read_model

    given = read_model(model)
    if given.model != "rigid_body":
        raise BadInput(f'{model}: model = "{given.model}" has no mechanism; replay takes model = "rigid_body"')
    with TemporaryDirectory() as folder:
        made = declared_machine(recording, given.theta(given.plant()), Path(folder) / DECLARED)
    notes = (*made.log.notes, *left_out(given))
    return replace(made, declared=made.declared | _declared_effects(given), log=replace(made.log, notes=notes))


def left_out(given: ModelFile) -> list[str]:
    """What of the file's effects a mechanism does not simulate: `diagnose` simulated it, so that its error was less."""
    out = []
    for e in given.effects:
        rest = [k for k in e.parameters if k not in SAME.get(e.name, e.parameters)]
        if rest:
            out.append(f"{e.name} at {e.where} is simulated without its {' and '.join(rest)}, which diagnose has")
    return out


def declared_machine(recording: Recording, theta: np.ndarray, path: Path) -> Machine:
    """A recording with the declared model at base parameters p1, p3, h1, h2, b1, b2 [6], which is written to `path` as MJCF."""
    write_bytes(path, double_pendulum_mjcf(theta, recording.geometry, recording.angle_zero).encode())
    return machine(read_mechanism(path), log_of(recording))


def _declared_effects(given: ModelFile) -> dict[tuple[str, str], np.ndarray]:
    out: dict[tuple[str, str], np.ndarray] = {}

    def put(effect: str, parameter: str, where: str, value: float) -> None:
        if where not in JOINTS:
            raise BadInput(
                f"{given.path}: {effect} at {where} has no counterpart in a mechanism; take it out to replay the rest"
            )
        out.setdefault((effect, parameter), np.zeros(2))[JOINTS.index(where)] = value

    for e in given.effects:
        numbers = {k: v.value for k, v in e.parameters.items()}
        if e.name == "rotor_inertia":
            put("armature", "inertia", e.where, numbers["inertia"])
        elif e.name == "stribeck":
            put("coulomb", "level", e.where, numbers["level"])
            for k in ("excess", "speed"):
                put("stribeck", k, e.where, numbers[k])
        elif e.name in SAME:
            for k in SAME[e.name]:
                put(e.name, k, e.where, numbers[k])
        else:
            raise BadInput(f"{given.path}: {e.name} is no effect of a mechanism; take it out to replay the rest")
    return out


def in_the_plane(vector: Vector, known: Sequence[str] = ()) -> Vector:
    """The vector without what `p1, p3, h1, h2, b1, b2` do not say (a centre of mass beside the link), and without the dampings that
    are known."""
    gone = [e.key for e in vector.entries if e.owner == INERTIA and e.name not in LINK]
    held = [e.key for e in vector.entries if e.owner == "viscous" and f"b{e.joints[0] + 1}" in known]
    return vector.without([*gone, *held])


def base_parameters(inertial: np.ndarray, l1: float, down: float) -> np.ndarray:
    """p1, p3, h1, h2 of two links' inertial parameters [2, 10] in their joints' frames, whose y axes lie along the links."""
    (m1y, i1), (m2y, i2), m2 = inertial[0, [2, 9]], inertial[1, [2, 9]], inertial[1, 0]
    return np.array([i1 + m2 * l1**2 + i2, i2, down * m1y + m2 * l1, down * m2y])


def model_file(
    recording: Recording, problem: Problem, found: Selection, told: Mapping[str, object]
) -> tuple[ModelFile, list[str]]:
    """The final model as `model.toml` holds it, and a line for each effect that it cannot hold. told: of its provenance."""
    model = found.final
    vector, spread = model.fit.vector, model.spread
    (group,) = problem.groups
    values = values_of(problem, group, vector)
    l1, down = float(recording.geometry["l1"]), -1.0 if recording.angle_zero == "upright" else 1.0
    own = base_parameters(values.inertial[..., 0], l1, down)
    folds = np.array([
        base_parameters(values_of(problem, group, vector.at(z)).inertial[..., 0], l1, down) for z in model.held.vectors
    ])  # fmt: skip
    wide = np.sqrt((len(folds) - 1) / len(folds) * np.square(folds - folds.mean(0)).sum(0))
    number = lambda v, s, unit: Value(float(v), float(v - NINETY * s), float(v + NINETY * s), unit)
    units = ("kg m^2", "kg m^2", "kg m", "kg m")
    declared = {
        k: number(*z) for k, z in zip(("p1", "p3", "h1", "h2"), zip(own, wide, units, strict=True), strict=True)
    }
    by = {(e.owner, e.name, j): (float(v), float(s), e.unit)
          for e, v, s in zip(vector.entries, vector.values, spread, strict=True) for j in e.joints}  # fmt: skip
    for k in range(2):
        v = by.get(("viscous", "damping", k)) or (recording.known.get(f"b{k + 1}", 0.0), 0.0, "N m s/rad")
        declared[f"b{k + 1}"] = number(*v)
    effects, lost = [], []

    def put(name: str, where: str, mine: Mapping[str, Value]) -> None:
        parameters = effect_named(name, catalogue(recording.task)).parameters
        effects.append(
            AddedEffect(name, where, {p.name: mine.get(p.name, number(p.default, 0.0, p.unit)) for p in parameters})
        )

    for name, k in sorted({(owner, k) for owner, _, k in by if owner not in (INERTIA, "viscous")}):
        mine = {p: number(*v) for (owner, p, j), v in by.items() if owner == name and j == k}
        where = JOINTS[k]
        if name == "armature":
            put("rotor_inertia", where, mine)
        elif name == "stribeck":
            put(name, where, mine | {"level": number(*by.get(("coulomb", "level", k), (0.0, 0.0, "N m")))})
        elif name == TILT:
            if k == 0:
                put("tilt", "base", {"angle": mine["about_y"]})
        elif name in SAME and not (name == "coulomb" and ("stribeck", "excess", k) in by):
            put(name, where, mine)
        elif name not in SAME:
            lost.append(f"model.toml cannot hold {name} at {where}; model.xml says what of it MJCF can hold")
    given = {k: float(v) for k, v in recording.geometry.items()}
    file = ModelFile(recording.task, recording.model, recording.angle_zero, given, declared, tuple(effects),
                     {k: float(v) for k, v in recording.known.items()}, provenance=dict(told))  # fmt: skip
    return file, lost
