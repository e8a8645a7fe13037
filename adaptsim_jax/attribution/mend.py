"""What a fitted model changes in the user's model file, and what the file cannot hold."""

import numpy as np

from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.problem import TILT, Problem, values_of
from adaptsim_jax.attribution.select import Selection
from adaptsim_jax.mechanisms.mjcf_write import Changes

HELD = (
    "viscous",
    "coulomb",
    "armature",
    "spring",
    TILT,
)  # effects that any MJCF holds; those of an actuator where there is one


def changes(machine: Machine, problem: Problem, found: Selection) -> tuple[Changes, frozenset[tuple[str, int]]]:
    """The changes that `model.xml` gets: everything that is fitted, and each effect that MJCF can hold, with comments on the others;
    and the effects and joints that it holds then (joint -1: the base)."""
    vector, tree = found.final.fit.vector, machine.tree
    n = problem.joints
    inertial = np.array(tree.inertial, float)
    gravity = None
    table = {k: np.zeros(n) for k in ("damping", "frictionloss", "armature", "stiffness", "preload")}
    for g in problem.groups:
        values = values_of(problem, g, vector)
        own = list(g.joints)
        inertial[own] = values.inertial[..., 0]
        if any(e.owner == TILT for e in vector.entries):
            gravity = values.gravity[:, 0]
        for key, (effect, name) in {
            "damping": ("viscous", "damping"), "frictionloss": ("coulomb", "level"), "armature": ("armature", "inertia"),
            "stiffness": ("spring", "stiffness"), "preload": ("spring", "preload"),
        }.items():  # fmt: skip
            if effect in values.effects:
                table[key][own] = values.effects[effect][name][:, 0]
    joint_names = tree.joint_names
    by_joint = lambda z: {name: float(v) for name, v in zip(joint_names, z, strict=True)}
    joints = {k: by_joint(table[k]) for k in ("damping", "frictionloss", "armature", "stiffness")}
    stiff = table["stiffness"] != 0.0
    rest = np.where(stiff, table["preload"] / np.where(stiff, table["stiffness"], 1.0), np.asarray(tree.springref))
    joints["springref"] = by_joint(rest)
    actuators, lost, held = _actuators(machine, problem, found)
    comments = [f"written by adaptsim from {machine.mechanism.path.rsplit('/', 1)[-1]}"]
    own = {(e.owner, -1 if e.owner == TILT else j) for e in vector.entries if e.owner in HELD for j in e.joints}
    return Changes(inertial, joints, gravity, actuators, (*comments, *lost)), frozenset(own | held)


def _actuators(machine: Machine, problem: Problem, found: Selection):
    """Changes of actuators by name, and a line for each effect that the file cannot hold."""
    by_joint = {a.joint: a.name for a in machine.mechanism.actuators}
    commanded = machine.log.input_kind in ("command", "voltage", "current")
    filed = {a.name: a.gear * a.gain for a in machine.mechanism.actuators}
    out: dict[str, dict[str, float]] = {"gain": {}, "kp": {}, "delay": {}, "lag": {}, "limit": {}}
    lost, there = [], set()
    key = {"torque_gain": "gain", "position_gain": "kp", "delay": "delay", "actuator_lag": "lag", "saturation": "limit"}
    for e, value in zip(found.final.fit.vector.entries, found.final.fit.vector.values, strict=True):
        if e.owner in (*HELD, "inertia"):
            continue
        for j in e.joints:
            actuator = by_joint.get(j) if commanded else None
            kind = key.get(e.owner)
            if actuator is None or kind is None or (kind in ("delay", "lag") and value < 0.0):
                continue
            if kind in ("gain", "kp"):
                out[kind][actuator] = (1.0 + float(value)) * (
                    machine.actuator[0, j] / filed[actuator] if machine.gain_unknown else 1.0
                )
            elif kind == "limit":
                if e.name == "cut":
                    out[kind][actuator] = (1.0 - float(value)) * float(problem.reach.peak[j])
            else:
                out[kind][actuator] = float(value)
            there.add((e.owner, j))
        held = commanded and e.owner in key and all(j in by_joint for j in e.joints) and value >= 0.0
        if not held or e.owner not in key:
            where = ", ".join(problem.joint_names[j] for j in e.joints)
            lost.append(f"not held by this file: {e.owner} at {where}, {e.name} = {value:.6g} {e.unit}")
    return out, lost, there
