"""Mechanisms from MJCF and URDF, read by MuJoCo's own parser and compiler, and checked for what `dynamics.py` can simulate."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.actuators import NO_RANGE, Actuator
from adaptsim_jax.mechanisms.inertia_frames import frame_along, inertial_about, moved
from adaptsim_jax.mechanisms.tree import MOST_JOINTS, Tree, make_tree
from adaptsim_jax.mechanisms.urdf import is_urdf, urdf_for_mujoco

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
OFF = {
    name: int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name.upper()}"))
    for name in ("gravity", "frictionloss", "spring", "damper", "limit", "clampctrl")
}


@dataclass(frozen=True)
class Frames:
    """Where MJCF's own bodies are: `carrier` is the joint whose body each is part of (-1: the base), and `place [3]`,
    `rotation [3, 3]` its frame in that joint's frame (in the world at the base)."""

    carrier: dict[str, int]
    place: dict[str, np.ndarray]
    rotation: dict[str, np.ndarray]


@dataclass(frozen=True)
class Mechanism:
    """What a file says. `source` is mjcf or urdf; `notes` are sentences on what the file has and the dynamics leave out;
    `force_limits [n, 2]` bound what all actuators of a joint together do (nan: nothing does)."""

    tree: Tree
    actuators: tuple[Actuator, ...]
    path: str
    source: str
    notes: tuple[str, ...]
    force_limits: np.ndarray
    frames: Frames

    def point(self, body: str, at: Any = (0.0, 0.0, 0.0)) -> tuple[int, np.ndarray]:
        """Joint and point as `dynamics.body_position` takes them, of a point in the frame of a body of the file.

        Raises BadInput where no moving body has that name.
        """
        joint = self.frames.carrier.get(body, -1)
        if joint < 0:
            names = ", ".join(sorted(name for name, c in self.frames.carrier.items() if c >= 0))
            raise BadInput(f"{self.path}: no moving body is named {body!r}; it has {names}")
        return joint, self.frames.place[body] + self.frames.rotation[body] @ np.asarray(at, float)


def read_mechanism(path: str | os.PathLike) -> Mechanism:
    """Read an MJCF or URDF file: a fixed base and 1 to 12 hinge or slide joints.

    Raises BadInput, naming the file, the joint or element, and the mend.
    """
    spec, source = read_spec(path)
    notes = _check_spec(str(path), spec)
    without_shapes(spec)
    model = compiled(str(path), spec)
    return _mechanism(str(path), source, model, notes)


def read_spec(path: str | os.PathLike) -> tuple[mujoco.MjSpec, str]:
    """The file as MuJoCo's parser has it, not compiled; and `mjcf` or `urdf`. Links of a URDF stay bodies of their own."""
    where = Path(path)
    try:
        text = where.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BadInput(f"{where}: there is no such model file; give the path of an MJCF (.xml) or URDF file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{where}: cannot be read ({_line(error)}); give the path of an MJCF or URDF file") from None
    urdf = is_urdf(str(where), text)
    try:
        spec = (
            mujoco.MjSpec.from_string(urdf_for_mujoco(str(where), text))
            if urdf
            else mujoco.MjSpec.from_file(str(where))
        )
    except BadInput:
        raise
    except Exception as error:  # MuJoCo raises ValueError and RuntimeError, with the line in the text
        raise BadInput(f"{where}: MuJoCo cannot read it: {_line(error)}; mend the file") from None
    spec.compiler.fusestatic = False
    _named(spec)
    return spec, "urdf" if urdf else "mjcf"


def compiled(where: str, spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        return spec.compile()
    except Exception as error:
        text = _line(error)
        if "Error opening file" in text or "mesh" in text.lower():
            raise BadInput(
                f"{where}: MuJoCo cannot compile it: {text}; give the bodies an <inertial>, then no mesh is needed"
            ) from None
        raise BadInput(f"{where}: MuJoCo cannot compile it: {text}; mend the file") from None


def _line(error: Exception) -> str:
    return " ".join(str(error).removeprefix("Error: ").split()).rstrip(".")


def _named(spec: mujoco.MjSpec) -> None:
    """Every body, joint and actuator gets a name that is not taken yet."""
    for kind, items in (("body", spec.bodies), ("joint", spec.joints), ("actuator", spec.actuators)):
        taken = {item.name for item in items}
        for i, item in enumerate(items):
            if not item.name:
                name = f"{kind}{i + (kind != 'body')}"
                while name in taken:
                    name += "_"
                taken.add(name)
                item.name = name


def _check_spec(where: str, spec: mujoco.MjSpec) -> tuple[str, ...]:
    for joint in spec.joints:
        if joint.type not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            kind = "free" if joint.type == mujoco.mjtJoint.mjJNT_FREE else "ball"
            mend = (
                "remove it, so that the base is fixed as it hung in the experiment"
                if kind == "free"
                else "write three hinges in its place"
            )
            raise BadInput(f"{where}: joint '{joint.name}' is a {kind} joint; {mend}")
    count = len(spec.joints)
    if not count:
        raise BadInput(
            f"{where}: has no joint, so that nothing moves; give a model with 1 to {MOST_JOINTS} hinges or slides"
        )
    if count > MOST_JOINTS:
        raise BadInput(
            f"{where}: has {count} joints, '{spec.joints[MOST_JOINTS].name}' is one too many; remove joints that were held, "
            f"down to {MOST_JOINTS}"
        )
    if spec.tendons:
        raise BadInput(
            f"{where}: tendon '{_name(spec.tendons[0])}' is not modelled; remove it, or give a model without tendons"
        )
    for equality in spec.equalities:
        if equality.active:
            raise BadInput(
                f"{where}: equality '{_name(equality)}' closes a loop ({equality.name1} with {equality.name2 or 'a value'}), "
                "which is not modelled; remove it, or give one that is a tree"
            )
    if spec.flexes:
        raise BadInput(f"{where}: flex '{_name(spec.flexes[0])}' is not modelled; remove it")
    for body in spec.bodies:
        if body.gravcomp:
            raise BadInput(
                f"{where}: body '{body.name}' has gravcomp = {body.gravcomp:g}, which is not modelled; remove it, and give the "
                "torques with what the controller adds against gravity"
            )
    notes = []
    off = int(spec.option.disableflags)
    if (
        not off & int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        and len([g for g in spec.geoms if g.contype or g.conaffinity]) > 1
    ):
        notes.append("contacts between bodies are not simulated")
    if spec.option.density or spec.option.viscosity:
        notes.append("density and viscosity of the medium are not simulated")
    if spec.equalities:
        notes.append("equality constraints that are not active are left out")
    return tuple(notes)


def _name(element: Any) -> str:
    return element.name or f"number {element.id + 1}"


def without_shapes(spec: mujoco.MjSpec) -> None:
    """Remove what only contact and drawing need, with the files it would be read from."""
    from_geoms = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    for kind in (spec.sensors, spec.keys, spec.pairs, spec.excludes, spec.skins, spec.equalities):
        for item in list(kind):
            spec.delete(item)
    for body in spec.bodies:
        static = body.name == "world"
        for geom in list(body.geoms):
            if static or (body.explicitinertial and not from_geoms):
                spec.delete(geom)
            else:
                geom.material = ""
    needed = {geom.meshname for geom in spec.geoms}
    for kind in (spec.materials, spec.textures):
        for item in list(kind):
            spec.delete(item)
    for mesh in list(spec.meshes):
        if mesh.name not in needed:
            spec.delete(mesh)


def _mechanism(where: str, source: str, model: mujoco.MjModel, notes: tuple[str, ...]) -> Mechanism:
    off = int(model.opt.disableflags)
    n = model.njnt
    kinds, parent, body_names, place, rotation = [], [], [], [], []
    inertial = np.zeros((n, 10))
    carrier: list[int] = [-1]
    frames: list[tuple[np.ndarray, np.ndarray]] = [(np.zeros(3), np.eye(3))]  # of each body, in its carrier's frame
    for b in range(1, model.nbody):
        name = model.body(b).name
        at, turn = moved(frames[model.body_parentid[b]], (model.body_pos[b], rotation_of(model.body_quat[b])))
        on = carrier[model.body_parentid[b]]
        first = model.body_jntadr[b]
        for k in range(first, first + model.body_jntnum[b]):
            start = model.qpos0[k]
            along = frame_along(model.jnt_axis[k])
            hinge = model.jnt_type[k] == HINGE
            kinds.append("hinge" if hinge else "slide")
            parent.append(on)
            anchor = at + turn @ model.jnt_pos[k]
            place.append(anchor if hinge else anchor - turn @ model.jnt_axis[k] * start)
            rotation.append(turn @ along @ (_about_z(-start) if hinge else np.eye(3)))
            last = k == first + model.body_jntnum[b] - 1
            body_names.append(name if last else f"{name}:{model.joint(k).name}")
            at, turn, on = -along.T @ model.jnt_pos[k], along.T, k
        carrier.append(on)
        frames.append((at, turn))
        if on >= 0:
            inertial[on] += inertial_about(
                model.body_mass[b],
                at + turn @ model.body_ipos[b],
                turn @ rotation_of(model.body_iquat[b]),
                model.body_inertia[b],
            )
    actuators, armature, damping = _actuators(where, model)
    keep = lambda name: 0.0 if off & OFF[name] else 1.0
    tree = make_tree(
        kinds, parent, np.array(place), np.array(rotation), inertial,
        gravity=model.opt.gravity * keep("gravity"),
        joint_names=[model.joint(k).name for k in range(n)], body_names=body_names,
        limited=[bool(x) and not off & OFF["limit"] for x in model.jnt_limited],
        damping=model.dof_damping * keep("damper") + damping, damping_poly=model.dof_dampingpoly * keep("damper"),
        armature=model.dof_armature + armature, frictionloss=model.dof_frictionloss * keep("frictionloss"),
        stiffness=model.jnt_stiffness * keep("spring"), stiffness_poly=model.jnt_stiffnesspoly * keep("spring"),
        springref=model.qpos_spring.copy(), range=model.jnt_range.copy(),
    )  # fmt: skip
    names = [model.body(b).name for b in range(model.nbody)]
    limits = np.where(model.jnt_actfrclimited[:, None] != 0, model.jnt_actfrcrange, np.nan)
    where_bodies = Frames(
        dict(zip(names, carrier, strict=True)),
        {name: frame[0] for name, frame in zip(names, frames, strict=True)},
        {name: frame[1] for name, frame in zip(names, frames, strict=True)},
    )
    return Mechanism(tree, actuators, where, source, notes, limits, where_bodies)


def _actuators(where: str, model: mujoco.MjModel) -> tuple[tuple[Actuator, ...], np.ndarray, np.ndarray]:
    """Also what actuators add to the joints' armature and damping."""
    out, armature, damping = [], np.zeros(model.njnt), np.zeros(model.njnt)
    for k in range(model.nu):
        actuator = _actuator(where, model, k)
        out.append(actuator)
        armature[actuator.joint] += actuator.gear**2 * model.actuator_armature[k]
        damping[actuator.joint] += actuator.gear**2 * model.actuator_damping[k]
    return tuple(out), armature, damping


def _actuator(where: str, model: mujoco.MjModel, k: int) -> Actuator:
    name = model.actuator(k).name
    refuse = lambda what: BadInput(
        f"{where}: actuator '{name}' {what}; write it as motor, position, velocity, or general with fixed gain and affine bias"
    )
    if model.actuator_trntype[k] not in (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)):
        raise refuse("does not act on a joint")
    gain, bias, dyn = model.actuator_gainprm[k], model.actuator_biasprm[k], model.actuator_dynprm[k]
    gaintype, biastype, dyntype = model.actuator_gaintype[k], model.actuator_biastype[k], model.actuator_dyntype[k]
    limited = lambda on, values: tuple(map(float, values)) if on else NO_RANGE
    shared: dict[str, Any] = {
        "gear": float(model.actuator_gear[k, 0]),
        "forcerange": limited(model.actuator_forcelimited[k], model.actuator_forcerange[k]),
        "ctrlrange": limited(
            model.actuator_ctrllimited[k] and not int(model.opt.disableflags) & OFF["clampctrl"],
            model.actuator_ctrlrange[k],
        ),
        "delay": float(model.actuator_delay[k]),
    }
    joint = int(model.actuator_trnid[k, 0])
    if gaintype == int(mujoco.mjtGain.mjGAIN_DCMOTOR):
        if np.any(gain[2:]) or np.any(bias) or np.any(dyn):
            raise refuse("is a dcmotor with more than motorconst and resistance")
        return Actuator(name, joint, "dcmotor", gain=gain[1] / gain[0], kv=gain[1] ** 2 / gain[0], **shared)
    lagged = dyntype in (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
    if not lagged and dyntype != int(mujoco.mjtDyn.mjDYN_NONE):
        raise refuse("has a memory other than a first-order filter")
    affine = gaintype == int(mujoco.mjtGain.mjGAIN_AFFINE)
    if not (gaintype == int(mujoco.mjtGain.mjGAIN_FIXED) or (affine and not np.any(gain[1:3]))):
        raise refuse("has a gain that is not one number")
    if biastype not in (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)):
        raise refuse("has a bias that is not affine")
    offset, kp, kv = (bias[0], -bias[1], -bias[2]) if biastype == int(mujoco.mjtBias.mjBIAS_AFFINE) else (0.0, 0.0, 0.0)
    plain = offset == 0
    kind = (
        "motor" if plain and kp == 0 and kv == 0
        else "position" if plain and kp == gain[0]
        else "velocity" if plain and kp == 0 and kv == gain[0]
        else "general"
    )  # fmt: skip
    return Actuator(
        name, joint, kind, gain=float(gain[0]), offset=float(offset), kp=float(kp), kv=float(kv),
        lag=float(dyn[0]) if lagged else 0.0, **shared,
    )  # fmt: skip


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """[3, 3] of a unit quaternion [4], the scalar first."""
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
