"""Model files as MuJoCo's own parser and compiler have them: MJCF, and URDF made ready by
`urdf.py`.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.urdf import Follower, is_urdf, urdf_for_mujoco


@dataclass(frozen=True)
class Source:
    """A model file, compiled.

    - `kind`: The one of mjcf and urdf.
    - `mimics`: Joints of a URDF that follow others.
    - `weightless`: Links of a URDF without any inertia.
    - `notes`: What was done to read it, a sentence each.
    """

    path: str
    kind: str
    model: mujoco.MjModel
    mimics: tuple[Follower, ...] = ()
    weightless: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def read_source(path: str | os.PathLike) -> Source:
    """Read and compile a file without what only drawing and contact need.

    Raises BadInput, naming the file, the element, and the mend.
    """
    spec, kind, urdf = _parsed(path)
    where = str(path)
    without_shapes(spec)
    model = compiled(where, spec)
    if not model.njnt:
        raise BadInput(
            f"{where}: has no joint, so that nothing moves; give a model with hinges or slides"
        )
    if spec.flexes:
        raise BadInput(
            f"{where}: flex '{_name(spec.flexes[0])}' is a soft body, which is not modelled; "
            "remove it"
        )
    if urdf is None:
        return Source(where, kind, model)
    return Source(where, kind, model, urdf.mimics, urdf.weightless, urdf.notes)


def read_spec(path: str | os.PathLike) -> tuple[mujoco.MjSpec, str]:
    """The file as MuJoCo's parser has it, not compiled; and `mjcf` or `urdf`. Links of a URDF stay
    bodies of their own.
    """
    return _parsed(path)[:2]


def _parsed(path: str | os.PathLike):
    where = Path(path)
    try:
        text = where.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BadInput(
            f"{where}: there is no such model file; give the path of an MJCF (.xml) or URDF file"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(
            f"{where}: cannot be read ({_line(error)}); give the path of an MJCF or URDF file"
        ) from None
    if is_urdf(str(where), text):
        urdf = urdf_for_mujoco(str(where), text)
    else:
        urdf = None
    try:
        if urdf is None:
            spec = mujoco.MjSpec.from_file(str(where))
        else:
            spec = mujoco.MjSpec.from_string(urdf.text)
    except (
        Exception
    ) as error:  # MuJoCo raises ValueError and RuntimeError, with the line in the text
        raise BadInput(f"{where}: MuJoCo cannot read it: {_line(error)}; mend the file") from None
    spec.compiler.fusestatic = False
    _named(spec)
    return spec, "mjcf" if urdf is None else "urdf", urdf


def compiled(where: str, spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The model of a spec. Raises BadInput where MuJoCo refuses it."""
    try:
        return spec.compile()
    except Exception as error:
        text = _line(error)
        if "Error opening file" in text or "mesh" in text.lower():
            raise BadInput(
                f"{where}: MuJoCo cannot compile it: {text}; give the bodies an <inertial>, then "
                "no mesh is needed"
            ) from None
        raise BadInput(f"{where}: MuJoCo cannot compile it: {text}; mend the file") from None


def shapeless(where: str, spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The model of a spec without meshes, as where their files are missing. Raises BadInput where
    MuJoCo refuses it.
    """
    for kind in (spec.materials, spec.textures, spec.skins):
        for item in list(kind):
            spec.delete(item)
    for geom in list(spec.geoms):
        geom.material = ""
        if (
            geom.type in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD)
            and geom.parent.explicitinertial
        ):
            spec.delete(geom)
    needed = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in needed:
            spec.delete(mesh)
    return compiled(where, spec)


def _line(error: Exception) -> str:
    return " ".join(str(error).removeprefix("Error: ").split()).rstrip(".")


def _named(spec: mujoco.MjSpec) -> None:
    """Every body, joint, actuator and tendon gets a name that is not taken yet."""
    kinds = (
        ("body", spec.bodies),
        ("joint", spec.joints),
        ("actuator", spec.actuators),
        ("tendon", spec.tendons),
    )
    for kind, items in kinds:
        taken = {item.name for item in items}
        for i, item in enumerate(items):
            if not item.name:
                name = f"{kind}{i + (kind != 'body')}"
                while name in taken:
                    name += "_"
                taken.add(name)
                item.name = name


def _name(element: Any) -> str:
    return element.name or f"number {element.id + 1}"


def without_shapes(spec: mujoco.MjSpec) -> None:
    """Remove what only contact and drawing need, with the files it would be read from."""
    from_geoms = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    wrapped = bool(spec.tendons)  # a tendon may run over geoms
    for kind in (spec.sensors, spec.pairs, spec.excludes, spec.skins):
        for item in list(kind):
            spec.delete(item)
    for body in spec.bodies:
        weighs = body.name != "world" and (not body.explicitinertial or from_geoms)
        for geom in list(body.geoms):
            primitive = geom.type not in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD)
            if weighs or (wrapped and primitive):
                geom.material = ""
            else:
                spec.delete(geom)
    needed = {geom.meshname for geom in spec.geoms}
    for kind in (spec.materials, spec.textures):
        for item in list(kind):
            spec.delete(item)
    for mesh in list(spec.meshes):
        if mesh.name not in needed:
            spec.delete(mesh)
