"""`model.toml` of a mechanism: the model file beside it and every effect that is named, also those that MJCF cannot hold.

schema = 1
task = "mechanism"
model = "model.xml"
[[effects]]                      # name, joint (of a base: "base"), in_model: whether model.xml holds it already
name = "load_friction"
joint = "elbow"
in_model = false
[effects.parameters.share]       # value, unit
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.attribution.catalogue import MACHINE
from adaptsim_jax.attribution.parameters import INERTIA
from adaptsim_jax.attribution.problem import TILT, Problem
from adaptsim_jax.attribution.select import Model
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput

FILE = "model.toml"


def text_of(problem: Problem, model: Model, held: frozenset[tuple[str, int]], told: Mapping[str, Any]) -> str:
    """The TOML text. held: effects and joints that the model file has; told: of its provenance."""
    parts = ["# Effects named by `adaptsim diagnose`; `adaptsim replay model.toml DATA` simulates all of them."]
    parts.append(config.dumps({"schema": 1, "task": "mechanism", "model": "model.xml"}))
    by: dict[tuple[str, int], dict[str, Any]] = {}
    for e, value in zip(model.fit.vector.entries, model.fit.vector.values, strict=True):
        if e.owner not in (INERTIA, "viscous"):
            for j in [-1] if e.owner == TILT else e.joints:
                by.setdefault((e.owner, j), {})[e.name] = {"value": float(value), "unit": e.unit}
    for (name, j), parameters in by.items():
        joint = "base" if j < 0 else problem.joint_names[j]
        parts.append("[[effects]]\n" + config.dumps({"name": name, "joint": joint, "in_model": (name, j) in held}))
        parts += [f"[effects.parameters.{k}]\n" + config.dumps(v) for k, v in parameters.items()]
    parts.append(config.dumps({"provenance": dict(told)}))
    return "\n".join(parts)


def read(path: Path, joints: tuple[str, ...]) -> dict[tuple[str, str], np.ndarray]:
    """What the file adds to its model, {(effect, parameter): [n]}. Raises BadInput that names the key."""
    known = {e.name: e for e in MACHINE}
    out: dict[tuple[str, str], np.ndarray] = {}
    for k, row in enumerate(config.read(path).get("effects", [])):
        name, joint = row.get("name"), row.get("joint")
        if row.get("in_model", False):
            continue
        if name not in known:
            raise BadInput(
                f"{path}: effects[{k}].name = {name!r} is no effect of a mechanism; {config.suggest(str(name), known)}"
            )
        if joint not in joints:
            raise BadInput(
                f"{path}: effects[{k}].joint = {joint!r} is no joint of its model; {config.suggest(str(joint), joints)}"
            )
        for p in known[name].parameters:
            given = row.get("parameters", {}).get(p.name, {}).get("value")
            rest = p.default if p.off is None else p.off
            out.setdefault((name, p.name), np.full(len(joints), rest))
            if given is not None:
                out[name, p.name][joints.index(joint)] = float(given)
    return out
