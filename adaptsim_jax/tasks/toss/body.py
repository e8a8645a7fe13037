"""The declared model of a tossed body: an MJCF file with one free body over one plane, and that
file with other numbers in it.
"""

import copy
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.mjcf import rotation_of
from adaptsim_jax.mechanisms.spec import compiled, read_spec
from adaptsim_jax.mend.mjcf import edited, put_inertia

SIZED = ("BOX", "SPHERE", "CAPSULE", "CYLINDER", "ELLIPSOID")
LONGEST_STEP = 0.004  # s; an impact lasts some ms
MIN_FRICTION = 1e-5  # MuJoCo takes none that is smaller


@dataclass(frozen=True)
class TossedBody:
    """model: compiled, contacts taken from the body's own geoms. at: Its number. geoms: Its geoms'
    numbers; friction, contact_time (s), damping: as the file declares them. sized: Whether all of
    its shapes have a size that can be scaled.
    """

    model: mujoco.MjModel
    path: str
    at: int
    geoms: np.ndarray
    friction: float
    contact_time: float
    damping: float
    sized: bool

    @property
    def step(self) -> float:
        """Step of the simulation in s."""
        return float(self.model.opt.timestep)

    @property
    def gravity(self) -> float:
        """Declared gravity in m/s^2, downwards positive."""
        return -float(self.model.opt.gravity[2])

    @property
    def size(self) -> float:
        """Radius in m of a ball about the body's origin that holds it."""
        m = self.model
        return float(
            np.max(np.linalg.norm(m.geom_pos[self.geoms], axis=1) + m.geom_rbound[self.geoms])
        )

    def corners(self) -> np.ndarray:
        """Points `[C, 3]` m of the body's frame that stand out furthest: corners, rims,
        vertices.
        """
        return np.concatenate([_outer(self.model, g) for g in self.geoms])


def _outer(m: mujoco.MjModel, g: int) -> np.ndarray:
    """Points `[C, 3]` on the outside of a geom, in its body's frame."""
    grid = np.array([z for z in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(z)])
    ball = grid / np.linalg.norm(grid, axis=1, keepdims=True)
    size, kind = m.geom_size[g], mujoco.mjtGeom(int(m.geom_type[g])).name.removeprefix("mjGEOM_")
    up = np.array([0.0, 0.0, size[1]])
    if kind == "BOX":
        points = grid[np.abs(grid).sum(1) == 3] * size
    elif kind == "ELLIPSOID":
        points = ball * size
    elif kind == "CAPSULE":
        points = np.concatenate([ball * size[0] + up, ball * size[0] - up])
    elif kind == "CYLINDER":
        turn = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
        rim = size[0] * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], 1)
        points = np.concatenate([rim + up, rim - up])
    elif kind == "MESH":
        mesh = m.geom_dataid[g]
        first = m.mesh_vertadr[mesh]
        points = np.array(m.mesh_vert[first : first + m.mesh_vertnum[mesh]], float)
    else:
        points = ball * (size[0] if kind == "SPHERE" else m.geom_rbound[g])
    return m.geom_pos[g] + points @ rotation_of(m.geom_quat[g]).T


def read_body(path: str | Path) -> TossedBody:
    """The declared body of a file. Raises BadInput that names the file and what to write."""
    spec, source = read_spec(path)
    if source != "mjcf":
        raise BadInput(
            f"{path}: a tossed body is declared in MJCF (a free joint and a plane); write it as "
            "MJCF"
        )
    model = compiled(str(path), spec)
    _check(path, model)
    at = int(model.jnt_bodyid[0])
    model = _general(str(path), spec, model, at)
    geoms = np.flatnonzero(model.geom_bodyid == at)
    touching = geoms[(model.geom_contype[geoms] | model.geom_conaffinity[geoms]) > 0]
    if not len(touching):
        raise BadInput(
            f"{path}: no geom of the body can touch anything; give one contype and conaffinity"
        )
    solref = np.array(model.geom_solref[touching[0]])
    if solref[0] <= 0:
        raise BadInput(
            f"{path}: solref is given as stiffness and damping; write time constant (s) and "
            f"damping ratio, as "
            'solref="0.004 0.5"'
        )
    # what a contact takes from either geom is taken from the body's, so that one set of numbers is
    # what acts
    model.geom_priority[geoms] = int(model.geom_priority.max()) + 1
    model.body_sameframe[:] = 0  # shortcuts that hold only for the numbers of the file
    model.geom_sameframe[:] = 0
    kinds = {mujoco.mjtGeom(int(t)).name.removeprefix("mjGEOM_") for t in model.geom_type[geoms]}
    friction = float(model.geom_friction[touching[0], 0])
    return TossedBody(
        model,
        str(path),
        at,
        geoms,
        friction,
        float(solref[0]),
        float(solref[1]),
        kinds <= set(SIZED),
    )


def _general(path: str, spec: mujoco.MjSpec, model: mujoco.MjModel, at: int) -> mujoco.MjModel:
    """The model compiled for a centre of mass beside the body's origin. Where they coincide MuJoCo
    leaves out what couples motion and turning. A centre that is moved later would then be pulled
    about the origin.
    """
    centre = np.array(model.body_ipos[at])
    _weigh(spec, model, at, centre + 1e-3)
    general = compiled(path, spec)
    general.body_ipos[at] = centre
    return general


def _weigh(spec: mujoco.MjSpec, m: mujoco.MjModel, at: int, centre: np.ndarray) -> Any:
    """Declare the inertia that body `at` has in a model, about `centre [3]` m; the body."""
    part = next(p for p in spec.bodies if p.name == m.body(at).name)
    put_inertia(part, float(m.body_mass[at]), centre, m.body_iquat[at], m.body_inertia[at])
    return part


def _check(path: str | Path, model: mujoco.MjModel) -> None:
    if model.njnt != 1 or model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
        raise BadInput(
            f"{path}: has {model.njnt} joints that move it; a toss needs one body with a "
            "<freejoint/>"
        )
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    if len(planes) != 1 or model.geom_bodyid[planes[0]] != 0:
        raise BadInput(f"{path}: has {len(planes)} planes; a toss needs one, in the worldbody")
    level = abs(abs(model.geom_quat[planes[0], 0]) - 1.0) < 1e-9 and not np.any(
        model.geom_pos[planes[0]]
    )
    if not level:
        raise BadInput(
            f"{path}: the plane is not z = 0; give poses and the plane in one frame with z upwards "
            "from it"
        )
    gravity = np.array(model.opt.gravity)
    if np.any(gravity[:2]) and abs(gravity[2]) < 1.0:
        raise BadInput(f'{path}: gravity {gravity} does not point down; write gravity="0 0 -9.81"')
    if gravity[2] > -1.0:
        raise BadInput(
            f'{path}: gravity is {-gravity[2]:g} m/s^2 downwards; write gravity="0 0 -9.81"'
        )
    if model.opt.timestep > LONGEST_STEP:
        raise BadInput(
            f"{path}: a step of {model.opt.timestep:g} s is longer than an impact; write <option "
            f'timestep="0.001"/>'
        )
    if model.nu or model.neq or model.ntendon:
        raise BadInput(
            f"{path}: has actuators, equalities or tendons; a tossed body has none: take them out"
        )


def with_values(body: TossedBody, values: Mapping[str, float]) -> mujoco.MjModel:
    """A model with these values of the catalogue's quantities that are the model's own (what they
    are: `catalogue`).
    """
    m = copy.copy(body.model)
    g, b = body.geoms, body.at
    m.geom_friction[g, 0] = max(values["friction"], MIN_FRICTION)
    m.geom_solref[g, 0] = 10.0 ** values["log_time"]
    m.geom_solref[g, 1] = values["damping"]
    grown = 1.0 + values["size"]
    m.geom_size[g] *= grown
    m.geom_pos[g] *= grown
    m.geom_rbound[g] *= grown
    m.geom_aabb[g] *= grown
    m.body_ipos[b] += [values["com_x"], values["com_y"], values["com_z"]]
    m.body_inertia[b] *= 1.0 + values["inertia"]
    m.dof_damping[:3] = m.body_mass[b] * values["drag"]
    m.opt.gravity[:] = gravity(body, values)
    mujoco.mj_setConst(m, mujoco.MjData(m))
    return m


def gravity(body: TossedBody, values: Mapping[str, float]) -> np.ndarray:
    """Gravity `[3]` m/s^2 on a table that is not level: its direction in the plane's frame."""
    x, y = np.sin(values["tilt_x"]), np.sin(values["tilt_y"])
    return body.gravity * np.array([x, y, -np.sqrt(1.0 - x * x - y * y)])


def mended_xml(body: TossedBody, values: Mapping[str, float], comments: Sequence[str] = ()) -> str:
    """The file as MJCF text with what MJCF can hold of `values`; comments say the rest. Raises
    BadInput where MuJoCo refuses it.
    """
    m = with_values(body, values)

    def edit(spec: mujoco.MjSpec) -> Sequence[str]:
        part = _weigh(spec, m, body.at, m.body_ipos[body.at])
        for geom, at in zip(part.geoms, body.geoms, strict=True):
            geom.friction, geom.solref = m.geom_friction[at], m.geom_solref[at]
            geom.priority = int(m.geom_priority[at])
            if body.sized:
                geom.size, geom.pos = m.geom_size[at], m.geom_pos[at]
        spec.option.gravity = m.opt.gravity
        return comments

    return edited(body.path, edit)
