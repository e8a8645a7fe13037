"""The `model.toml` of a mechanism: the declared model beside it with fitted numbers, and every
effect that is named.

    model = "declared.xml"
    friction = "gives"             # where dry friction does, as MuJoCo's: in a simulator's log
    [inertial]                     # by joint, in its frame: m, m cx, m cy, m cz, Ixx .. Izz (kg, m)
    elbow = [1.0, 0.1, ...]
    [gain]                         # torque over volts or amperes by joint, where it had to be found
    lift = 0.7                     # share of gravity that controllers feed forward
    [servo.elbow]                  # of a joint's servo: kp, kv, limit and offset of its target
    kp = 1400.0                    # (N m/rad, N m s/rad, N m, rad), damping before the limit
    linear = true                  # equations linearised about angles of zero
    angle_zero = "hanging"         # of a double pendulum, with its [geometry]

The rest is as every `model.toml` has it (`mend/model_toml.py`); an effect's `where` is a joint, or
"base". `model.xml` says the same as far as MJCF can.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from adaptsim_jax.attribution.fitted import FittedTree
from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.parameters import OF_BODIES, TILT
from adaptsim_jax.attribution.problem import TreeProblem, numbers_of, tilted, values_of
from adaptsim_jax.attribution.stops import with_inertial
from adaptsim_jax.core import config
from adaptsim_jax.core.config import Table
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.catalogue import MACHINE, TILTS
from adaptsim_jax.mechanisms.tree import with_compensation
from adaptsim_jax.mend.model_toml import (
    AddedEffect,
    Form,
    Value,
    number_at,
    numbers_at,
    read_form,
    table_at,
)

DECLARED = "declared.xml"
GIVES = "gives"
OWN = ("friction", "inertial", "gain", "servo", "lift", "linear", "angle_zero", "geometry")


def text_of(
    problem: TreeProblem,
    model: FittedTree,
    summary: Mapping[str, Any],
    gains: Mapping[str, float] | None = None,
    more: Mapping[str, Any] | None = None,
) -> str:
    """The TOML text. summary: of its provenance; gains, more: as of `form_of`."""
    form = form_of(problem, model, gains or {}, summary, more)
    return form.text("`adaptsim replay model.toml DATA` simulates all of it")


def form_of(
    problem: TreeProblem,
    model: FittedTree,
    gains: Mapping[str, float],
    summary: Mapping[str, Any] | None = None,
    more: Mapping[str, Any] | None = None,
) -> Form:
    """What the file holds of a model. gains: torque over volts or amperes by joint, where that had
    to be found; summary: of its provenance; more: keys of the rig's
    own.
    """
    own: Table = dict(more or {})
    if any(g.model.tree.linear for g in problem.groups):
        own["linear"] = True
    if any(np.any(g.model.tree.friction_softness) for g in problem.groups):
        own["friction"] = GIVES
    own["inertial"] = {}
    for g in problem.groups:
        values = values_of(problem, g, model.fit.vector).inertial[..., 0]
        own["inertial"] |= {
            problem.joint_names[j]: [float(z) for z in values[k]] for k, j in enumerate(g.joints)
        }
    if gains:
        own["gain"] = dict(gains)
    return Form("mechanism", DECLARED, {}, _effects(problem, model), own, dict(summary or {}))


def _effects(problem: TreeProblem, model: FittedTree) -> tuple[AddedEffect, ...]:
    by: dict[tuple[str, str], dict[str, Value]] = {}
    for e, value in model.fit.vector.pairs():
        if e.owner in OF_BODIES:
            continue
        if e.owner == TILT:
            places = ["base"]
        else:
            places = [problem.joint_names[j] for j in e.joints]
        for place in places:
            by.setdefault((e.owner, place), {})[e.name] = Value(float(value), unit=e.unit)
    return tuple(AddedEffect(name, place, values) for (name, place), values in by.items())


def applied(
    given: Mapping[str, Any], path: str, machine: Machine, effects: Sequence[Effect] = MACHINE
) -> Machine:
    """The machine of the declared model with what the table of the file at `path` says, of which
    the effects are some of `effects`. Raises BadInput that names the key.
    """
    return of_form(read_form(given, path, OWN), machine, effects)


def of_form(form: Form, machine: Machine, effects: Sequence[Effect] = MACHINE) -> Machine:
    """The same of a form that was read. effects: those that it may name."""
    tree, path = machine.tree, form.path
    joints, known = tree.joint_names, {e.name: e for e in effects}
    inertial = np.array(tree.inertial, float)
    for name, row in table_at(path, form.own, "inertial").items():
        if name not in joints or np.shape(row) != (10,):
            raise BadInput(
                f"{path}: inertial.{name} must be 10 numbers of a joint of its model; "
                f"{config.suggest(name, joints)}"
            )
        inertial[joints.index(name)] = row
    law = machine.actuator.copy()
    for name, value in numbers_at(path, form.own, "gain").items():
        if name not in joints:
            raise BadInput(
                f"{path}: gain.{name} must be a number of a joint of its model; "
                f"{config.suggest(name, joints)}"
            )
        law[0, joints.index(name)] = value
    law = _with_servos(machine, law, form, path)
    declared = numbers_of(tree) | machine.declared
    out, gravity = dict(machine.declared), np.asarray(tree.gravity, float)
    for k, effect in enumerate(form.effects):
        name, joint = effect.name, effect.where
        numbers = {p: value.value for p, value in effect.parameters.items()}
        if name == TILT:
            gravity = tilted(gravity, *(numbers.get(t, 0.0) for t in TILTS))
            continue
        if name not in known:
            raise BadInput(
                f"{path}: effects[{k}].name = {name!r} is no effect of a mechanism; "
                f"{config.suggest(name, known)}, or install the package whose effect it is"
            )
        if joint not in joints:
            raise BadInput(
                f"{path}: effects[{k}].where = {joint!r} is no joint of its model; "
                f"{config.suggest(joint, joints)}"
            )
        for p in (p for p in known[name].parameters if p.name in numbers):
            start = declared.get((name, p.name), np.full(len(joints), p.default))
            column = np.array(out.get((name, p.name), start), float)
            column[joints.index(joint)] = numbers[p.name]
            out[name, p.name] = column
    if "lift" in form.own:
        tree = with_compensation(tree, number_at(path, "lift", form.own["lift"]))
    linear = bool(form.own.get("linear", tree.linear))
    tree = replace(with_inertial(tree, inertial), gravity=gravity, linear=linear)
    mechanism = replace(machine.mechanism, tree=tree)
    gives = form.own.get("friction") == GIVES
    return replace(machine, mechanism=mechanism, declared=out, actuator=law, gives=gives)


def _with_servos(machine: Machine, law: np.ndarray, form: Form, path: str) -> np.ndarray:
    """The laws [6, n] of actuators with the numbers of the file's servos."""
    new, joints = law.copy(), machine.tree.joint_names
    for name in table_at(path, form.own, "servo"):
        if name not in joints:
            raise BadInput(
                f"{path}: servo.{name} must be a table of a joint; {config.suggest(name, joints)}"
            )
        numbers = numbers_at(path, form.own["servo"], name)
        j = joints.index(name)
        new[:, j] = _with_servo(law[:, j], float(machine.gear[j]), numbers)
    return new


def _with_servo(law: np.ndarray, gear: float, numbers: Mapping[str, float]) -> np.ndarray:
    """The law [6] of an actuator with other numbers of its servo, as of the joint."""
    new = law.copy()
    if law[2] and "kp" in numbers:
        new[:3] *= -numbers["kp"] / (law[2] * gear**2)
    if "kv" in numbers:
        new[3] = -numbers["kv"] / gear**2
        if not law[2] and law[3]:  # a speed servo's command is a speed
            new[0] *= new[3] / law[3]
    if "offset" in numbers:
        new[1] += -new[2] * gear * numbers["offset"]
    if "limit" in numbers:
        limit = numbers["limit"] / abs(gear)
        new[4:] = -limit, limit
    return new
