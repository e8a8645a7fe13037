"""`model.toml` of a mechanism: the declared model beside it with fitted numbers, and every effect
that is named.

    schema = 1
    task = "mechanism"
    model = "declared.xml"
    friction = "gives"               # where dry friction does, as MuJoCo's: in a simulator's log
    [inertial]                       # by joint, in its frame: m, m cx, m cy, m cz, Ixx, Ixy, Ixz,
    Iyy, Iyz, Izz (kg, kg m, kg m^2) elbow = [1.0, 0.1, ...]
    [[effects]]                      # name and joint (of a base: "base")
    name = "load_friction"
    joint = "elbow"
    [effects.parameters.share]       # value, unit

`model.xml` says the same as far as MJCF can.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from adaptsim_jax.attribution.catalogue import MACHINE
from adaptsim_jax.attribution.held_out import Model
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.parameters import INERTIA, TILT, TILTS
from adaptsim_jax.attribution.problem import Problem, numbers_of, tilted, values_of
from adaptsim_jax.attribution.stops import with_inertial
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput

FILE, DECLARED = "model.toml", "declared.xml"
GIVES = "gives"


def text_of(
    problem: Problem,
    model: Model,
    told: Mapping[str, Any],
    gains: Mapping[str, float] | None = None,
    servos: Mapping[str, float] | None = None,
) -> str:
    """The TOML text. told: of its provenance; gains: torque over volts or amperes by joint, where
    that had to be found; servos: factors on
    the file's kp by joint, likewise (the damping of such a servo is the joint's own).
    """
    parts = [
        "# A model fitted by `adaptsim diagnose`; `adaptsim replay model.toml DATA` simulates all "
        "of it."
    ]
    if any(np.any(g.model.tree.rub) for g in problem.groups):
        rubs = {"friction": GIVES}
    else:
        rubs = {}
    parts.append(config.dumps({"schema": 1, "task": "mechanism", "model": DECLARED} | rubs))
    inertial = {}
    for g in problem.groups:
        values = values_of(problem, g, model.fit.vector).inertial[..., 0]
        inertial |= {
            problem.joint_names[j]: [float(z) for z in values[k]] for k, j in enumerate(g.joints)
        }
    found = ({"gain": dict(gains)} if gains else {}) | ({"servo": dict(servos)} if servos else {})
    parts.append(config.dumps({"inertial": inertial} | found))
    by: dict[tuple[str, int], dict[str, Any]] = {}
    for e, value in zip(model.fit.vector.entries, model.fit.vector.values, strict=True):
        if e.owner != INERTIA:
            for j in [-1] if e.owner == TILT else e.joints:
                by.setdefault((e.owner, j), {})[e.name] = {"value": float(value), "unit": e.unit}
    for (name, j), parameters in by.items():
        joint = "base" if j < 0 else problem.joint_names[j]
        parts.append("[[effects]]\n" + config.dumps({"name": name, "joint": joint}))
        parts += [f"[effects.parameters.{k}]\n" + config.dumps(v) for k, v in parameters.items()]
    parts.append(config.dumps({"provenance": dict(told)}))
    return "\n".join(parts)


def applied(given: Mapping[str, Any], path: str, machine: Machine) -> Machine:
    """The machine of the declared model with what the table of the file at `path` says. Raises
    BadInput that names the key.
    """
    tree = machine.tree
    joints, known = tree.joint_names, {e.name: e for e in MACHINE}
    inertial = np.array(tree.inertial, float)
    for name, row in given.get("inertial", {}).items():
        if name not in joints or np.shape(row) != (10,):
            raise BadInput(
                f"{path}: inertial.{name} must be 10 numbers of a joint of its model; "
                f"{config.suggest(name, joints)}"
            )
        inertial[joints.index(name)] = row
    law = machine.actuator.copy()
    for name, value in given.get("gain", {}).items():
        if name not in joints or not isinstance(value, (int, float)):
            raise BadInput(
                f"{path}: gain.{name} must be a number of a joint of its model; "
                f"{config.suggest(name, joints)}"
            )
        law[0, joints.index(name)] = value
    for name, times in given.get("servo", {}).items():
        if name not in joints or not isinstance(times, (int, float)):
            raise BadInput(
                f"{path}: servo.{name} must be a factor on the kp of a joint; "
                f"{config.suggest(name, joints)}"
            )
        law[:3, joints.index(name)] *= times
        law[3, joints.index(name)] = 0.0
    filed = numbers_of(tree) | machine.declared
    out, gravity = dict(machine.declared), np.asarray(tree.gravity, float)
    for k, row in enumerate(given.get("effects", [])):
        name, joint = row.get("name"), row.get("joint")
        numbers = {p: float(z["value"]) for p, z in row.get("parameters", {}).items()}
        if name == TILT:
            gravity = tilted(gravity, *(numbers.get(t, 0.0) for t in TILTS))
            continue
        if name not in known:
            raise BadInput(
                f"{path}: effects[{k}].name = {name!r} is no effect of a mechanism; "
                f"{config.suggest(str(name), known)}, "
                "or install the package whose effect it is"
            )
        if joint not in joints:
            raise BadInput(
                f"{path}: effects[{k}].joint = {joint!r} is no joint of its model; "
                f"{config.suggest(str(joint), joints)}"
            )
        for p in (p for p in known[name].parameters if p.name in numbers):
            rest = p.default if p.off is None else p.off
            start = filed.get((name, p.name), np.full(len(joints), rest))
            column = np.array(out.get((name, p.name), start), float)
            column[joints.index(joint)] = numbers[p.name]
            out[name, p.name] = column
    tree = replace(with_inertial(tree, inertial), gravity=gravity)
    mechanism = replace(machine.mechanism, tree=tree)
    gives = given.get("friction") == GIVES
    return replace(machine, mechanism=mechanism, declared=out, actuator=law, gives=gives)
