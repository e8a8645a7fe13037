"""A user's model file with the numbers in it that were found where MuJoCo simulates: MJCF text."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.spec import compiled, shapeless
from adaptsim_jax.mend.mjcf import edited, put_delay, put_field, put_inertia
from adaptsim_jax.simulators.mujoco.acting import OUTSIDE
from adaptsim_jax.simulators.mujoco.build import Stepped
from adaptsim_jax.simulators.mujoco.fields import DELAY, GROUND, TILTS, Field, grounds, with_values

INERTIA = ("mass", "ipos", "iquat", "inertia")
ACTUATOR = ("gainprm", "biasprm")
"""What a number of a body or an actuator may change besides itself; of a joint or a geom it is that
field alone.
"""
SHAPED = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD)  # are placed by their own files


def mended_mjcf(made: Stepped, fields: Sequence[Field], values: Mapping[str, float]) -> str:
    """The file of `made` with `values` by a field's name in it; what no model file holds stands in
    comments above.

    Args:
        made: What was simulated. Its file is read anew, so that nothing is held or welded that was
            not.
        fields: Of `made`.
        values: Those that differ from the file's are put in.

    Raises BadInput where MuJoCo refuses the result.
    """
    changed = [f for f in fields if values.get(f.name, f.default) != f.default]
    held = [f for f in changed if f.field not in OUTSIDE]

    def edit(spec: mujoco.MjSpec) -> list[str]:
        comments = []
        try:
            model = compiled(made.path, spec)
        except BadInput:
            model = shapeless(made.path, spec)
            comments.append(
                "written without shapes: the meshes that this file names could not be read"
            )
        own = [_own(made.model, model, f) for f in held]
        there = with_values(model, own, [values[f.name] for f in held])
        for f in own:
            _put(spec, there, f)
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

    return edited(made.path, edit)


def _own(stepped: mujoco.MjModel, model: mujoco.MjModel, f: Field) -> Field:
    """A field of the model that was stepped as one of the file's own: joints may have other numbers
    there.
    """
    if not f.field.startswith("joint."):
        return f
    at = tuple(model.joint(stepped.joint(e).name).id for e in f.elements)
    return replace(f, elements=at)


def _put(spec: mujoco.MjSpec, there: mujoco.MjModel, f: Field) -> None:
    """What a field changed, from the model that has it into the file."""
    if f.name in TILTS:
        spec.option.gravity = there.opt.gravity
        return
    if f.name in GROUND:
        for geom in (g for g in spec.geoms if g.id in grounds(there)):
            if geom.type in SHAPED:
                raise BadInput(
                    f"{f.name}: the ground '{geom.name}' is a mesh or a height field; move it by "
                    "hand"
                )
            geom.pos, geom.quat = there.geom_pos[geom.id], there.geom_quat[geom.id]
            geom.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        return
    kind, what = f.field.split(".")
    if kind == "option":
        setattr(spec.option, what, getattr(there.opt, what))
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
            numbers = (getattr(there, f"body_{n}")[element.id] for n in INERTIA)
            put_inertia(element, *numbers)
        for name in names:
            put_field(element, name, _number(there, element, kind, name))


def _number(there: mujoco.MjModel, element, kind: str, name: str):
    if kind != "joint":
        return getattr(there, f"{kind}_{name}")[element.id]
    if hasattr(there, f"dof_{name}"):
        return getattr(there, f"dof_{name}")[int(there.jnt_dofadr[element.id])]
    return _of_joint(there, element, name)


def _of_joint(there: mujoco.MjModel, joint, name: str) -> float:
    if name == "springref":
        return float(there.qpos_spring[there.jnt_qposadr[joint.id]])
    return float(np.ravel(getattr(there, f"jnt_{name}")[joint.id])[0])
