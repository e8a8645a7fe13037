"""Model files as MuJoCo's own parser and compiler have them: MJCF, and URDF made ready by
`urdf.py`.
"""

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import is_pointer
from adaptsim_jax.mechanisms.switches import switch_off
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
    """Read and compile a file without what only drawing and contact need, nor what it disables.

    Raises BadInput, naming the file, the element, and the mend.
    """
    spec, kind, urdf = _parse(path)
    where = str(path)
    without_shapes(spec)
    model = compiled(where, spec)
    switch_off(model)
    if not model.njnt:
        raise BadInput(
            f"{where}: has no joint, so that nothing moves; give a model with hinges or slides"
        )
    if spec.flexes:
        raise BadInput(
            f"{where}: flex '{_element_name(spec.flexes[0])}' is a soft body, which is not "
            "modelled; remove it"
        )
    if urdf is None:
        return Source(where, kind, model)
    return Source(where, kind, model, urdf.mimics, urdf.weightless, urdf.notes)


def read_spec(path: str | os.PathLike) -> tuple[mujoco.MjSpec, str]:
    """The file as MuJoCo's parser has it, not compiled; and `mjcf` or `urdf`. Links of a URDF stay
    bodies of their own.
    """
    return _parse(path)[:2]


def _parse(path: str | os.PathLike):
    where = Path(path)
    try:
        text = where.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BadInput(
            f"{where}: there is no such model file; give the path of an MJCF (.xml) or URDF file"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(
            f"{where}: cannot be read ({_error_line(error)}); give the path of an MJCF or URDF file"
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
        raise BadInput(
            f"{where}: MuJoCo cannot read it: {_error_line(error)}; mend the file"
        ) from None
    spec.compiler.fusestatic = False
    _name_elements(spec)
    return spec, "mjcf" if urdf is None else "urdf", urdf


def compiled(where: str, spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The model of a spec. Raises BadInput where MuJoCo refuses it."""
    try:
        return spec.compile()
    except Exception as error:
        text = _error_line(error)
        if pointer := _pointer(spec):
            raise BadInput(
                f"{where}: {pointer} is a pointer of Git LFS, no mesh; fetch it by 'git lfs pull', "
                "or give the bodies an <inertial>, then no mesh is needed"
            ) from None
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
    for geom in list(spec.geoms):
        if geom.type in SHAPES and not _has_mass(spec, geom):
            spec.delete(geom)
    _without_files(spec)
    return compiled(where, spec)


def _error_line(error: Exception) -> str:
    return " ".join(str(error).removeprefix("Error: ").split()).rstrip(".")


def _name_elements(spec: mujoco.MjSpec) -> None:
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


def _element_name(element: Any) -> str:
    return element.name or f"number {element.id + 1}"


def without_shapes(spec: mujoco.MjSpec) -> None:
    """Remove what only contact and drawing need, with the files it would be read from."""
    wrapped = bool(spec.tendons)  # a tendon may run over geoms
    for kind in (spec.sensors, spec.pairs, spec.excludes):
        for item in list(kind):
            spec.delete(item)
    for geom in list(spec.geoms):
        if not (_has_mass(spec, geom) or (wrapped and geom.type not in SHAPES)):
            spec.delete(geom)
    _without_files(spec)


SHAPES = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD)
"""Geoms that are read from files."""


def _has_mass(spec: mujoco.MjSpec, geom: Any) -> bool:
    """Whether a geom is part of its body's mass."""
    body, compiler = geom.parent, spec.compiler
    uses_geoms = compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    is_massless = geom.mass == 0 or (math.isnan(geom.mass) and geom.density == 0)
    low, high = compiler.inertiagrouprange
    is_counted = not is_massless and low <= geom.group <= high
    return body.name != "world" and is_counted and (uses_geoms or not body.explicitinertial)


def _without_files(spec: mujoco.MjSpec) -> None:
    """Remove materials, textures, skins, and meshes that no geom needs."""
    for geom in spec.geoms:
        geom.material = ""
    needed = {geom.meshname for geom in spec.geoms}
    unused = [mesh for mesh in spec.meshes if mesh.name not in needed]
    for item in (*spec.materials, *spec.textures, *spec.skins, *unused):
        spec.delete(item)


def _pointer(spec: mujoco.MjSpec) -> str:
    """A file of a mesh that is a pointer of Git LFS; '' for none."""
    for mesh in spec.meshes:
        path = Path(spec.modelfiledir, spec.meshdir, mesh.file)
        if path.is_file() and is_pointer(path):
            return str(path)
    return ""
