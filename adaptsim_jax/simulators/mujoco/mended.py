"""A user's model file with the numbers in it that were found where MuJoCo simulates: MJCF text."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.spec import compiled, shapeless
from adaptsim_jax.mend.mjcf import edited, put_delay, put_field, put_inertia
from adaptsim_jax.simulators.mujoco.acting import OUTSIDE
from adaptsim_jax.simulators.mujoco.build import SteppedModel
from adaptsim_jax.simulators.mujoco.fields import (
    DELAY,
    GROUND,
    TILTS,
    ModelNumber,
    grounds,
    with_values,
)

INERTIA = ("mass", "ipos", "iquat", "inertia")
ACTUATOR = ("gainprm", "biasprm")
"""What a number of a body or an actuator may change besides itself; of a joint or a geom it is that
field alone.
"""
SHAPED = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD)  # are placed by their own files


def mended_mjcf(
    stepped_model: SteppedModel, fields: Sequence[ModelNumber], values: Mapping[str, float]
) -> str:
    """The file of `stepped_model` with `values` by a field's name in it; what no model file holds
    stands in comments above.

    Args: stepped_model: What was simulated. Its file is read anew, so that nothing is held or
        welded that was not. fields: Of `stepped_model`. values: Those that differ from the file's
        are put in.

    Raises BadInput where MuJoCo refuses the result.
    """
    changed = [f for f in fields if values.get(f.name, f.default) != f.default]
    in_file = [f for f in changed if f.field not in OUTSIDE]

    def edit(spec: mujoco.MjSpec) -> list[str]:
        comments = []
        try:
            model = compiled(stepped_model.path, spec)
        except BadInput:
            model = shapeless(stepped_model.path, spec)
            comments.append(
                "written without shapes: the meshes that this file names could not be read"
            )
        file_fields = [_field_of_file(stepped_model.model, model, f) for f in in_file]
        changed_model = with_values(model, file_fields, [values[f.name] for f in in_file])
        for f in file_fields:
            _put(spec, changed_model, f)
        for f in changed:
            if f.field == DELAY and values[f.name] > 0:
                for actuator in spec.actuators:
                    put_delay(actuator, values[f.name], spec.option.timestep)
            elif f.field in OUTSIDE:
                comments.append(
                    f"not in this file: {f.name} = {values[f.name]:.6g}, which is of the log or "
                    "the controller"
                )
        return comments

    return edited(stepped_model.path, edit)


def _field_of_file(stepped: mujoco.MjModel, model: mujoco.MjModel, f: ModelNumber) -> ModelNumber:
    """A field of the model that was stepped as one of the file's own: joints may have other numbers
    there.
    """
    if not f.field.startswith("joint."):
        return f
    at = tuple(model.joint(stepped.joint(e).name).id for e in f.elements)
    return replace(f, elements=at)


def _put(spec: mujoco.MjSpec, changed_model: mujoco.MjModel, f: ModelNumber) -> None:
    """What a field changed, from the model that has it into the file."""
    if f.name in TILTS:
        spec.option.gravity = changed_model.opt.gravity
        return
    if f.name in GROUND:
        for geom in (g for g in spec.geoms if g.id in grounds(changed_model)):
            if geom.type in SHAPED:
                raise BadInput(
                    f"{f.name}: the ground '{geom.name}' is a mesh or a height field; move it by "
                    "hand"
                )
            geom.pos, geom.quat = changed_model.geom_pos[geom.id], changed_model.geom_quat[geom.id]
            geom.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        return
    kind, what = f.field.split(".")
    if kind == "option":
        setattr(spec.option, what, getattr(changed_model.opt, what))
        return
    listed = {
        "body": spec.bodies,
        "geom": spec.geoms,
        "actuator": spec.actuators,
        "joint": spec.joints,
    }.get(kind)
    if listed is None:
        raise BadInput(f"{f.name}: numbers of a {kind} are not written; put {f.name} in by hand")
    names = {"body": (), "actuator": ACTUATOR}.get(kind, (what,))
    for element in (e for e in listed if e.id in f.elements):
        if kind == "body":
            numbers = (getattr(changed_model, f"body_{n}")[element.id] for n in INERTIA)
            put_inertia(element, *numbers)
        for name in names:
            put_field(element, name, _number(changed_model, element, kind, name))


def _number(changed_model: mujoco.MjModel, element, kind: str, name: str):
    if kind != "joint":
        return getattr(changed_model, f"{kind}_{name}")[element.id]
    if hasattr(changed_model, f"dof_{name}"):
        return getattr(changed_model, f"dof_{name}")[int(changed_model.jnt_dofadr[element.id])]
    return _of_joint(changed_model, element, name)


def _of_joint(changed_model: mujoco.MjModel, joint, name: str) -> float:
    if name == "springref":
        return float(changed_model.qpos_spring[changed_model.jnt_qposadr[joint.id]])
    return float(np.ravel(getattr(changed_model, f"jnt_{name}")[joint.id])[0])
