"""Actuators of a compiled model as laws on the coordinates of a tree, and what springs and dampers
of tendons and actuators add.

All kinds of actuators are one law, MuJoCo's with affine bias: with `length = gear q` and
`speed = gear v`,

    force = gain ctrl + offset - kp length - kv speed

and the joint gets gear times the force within forcerange. A motor has gain 1, kp = kv = 0. A
position servo gain = kp, a velocity servo gain = kv. A dcmotor (volts) gain = K / R and
kv = K^2 / R; `general` is any other. Ranges are nan where there is none.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np

from adaptsim_jax.mechanisms.roles import JOINT_TRANSMISSIONS, WRAP_JOINT
from adaptsim_jax.mechanisms.switches import is_off

NO_RANGE = (float("nan"), float("nan"))


@dataclass(frozen=True)
class Actuator:
    """One actuator.

    - `joint`: An index into the tree.
    - `delay`, `lag`: Of the command, s. The lag is a first-order filter's.
    - `more`: Other joints that it pulls by a tendon, each with its own gear.
    """

    name: str
    joint: int
    kind: str
    gear: float = 1.0
    gain: float = 1.0
    offset: float = 0.0
    kp: float = 0.0
    kv: float = 0.0
    forcerange: tuple[float, float] = NO_RANGE
    ctrlrange: tuple[float, float] = NO_RANGE
    delay: float = 0.0
    lag: float = 0.0
    more: tuple[tuple[int, float], ...] = ()


TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
SINGLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
FIXED, AFFINE = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE)


@dataclass(frozen=True)
class CoordinateMap:
    """Where the joints of the file are in the tree. coordinate, factor, offset by joint of the
    file: it is at offset + factor * q[coordinate]; coordinate -1: held at its offset.
    """

    coordinate: np.ndarray
    factor: np.ndarray
    offset: np.ndarray


@dataclass
class PassiveElements:
    """Rotors, dampers, friction and springs of tendons and actuators, on the coordinates.

    - `armature`, `damping`, `frictionloss`, `stiffness`: `[n]`.
    - `pull [n]`: The force of these springs at zero.
    - `unsupported`: Features that a tree lacks, a sentence each.
    """

    armature: np.ndarray
    damping: np.ndarray
    frictionloss: np.ndarray
    stiffness: np.ndarray
    pull: np.ndarray
    unsupported: list[str] = field(default_factory=list)


def length(
    model: mujoco.MjModel, coordinates: CoordinateMap, joint: int = -1, tendon: int = -1
) -> tuple[dict[int, float], float] | None:
    """A joint's or fixed tendon's length as (slope by coordinate, length at zero); None where it is
    no such sum.
    """
    terms = [(joint, 1.0)] if joint >= 0 else []
    if tendon >= 0:
        rows = range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
        if any(model.wrap_type[w] != WRAP_JOINT for w in rows):
            return None
        terms = [(int(model.wrap_objid[w]), float(model.wrap_prm[w])) for w in rows]
    slope: dict[int, float] = {}
    zero_length = 0.0
    for k, c in terms:
        if model.jnt_type[k] not in SINGLE:
            return None
        zero_length += c * coordinates.offset[k]
        if (j := int(coordinates.coordinate[k])) >= 0:
            slope[j] = slope.get(j, 0.0) + c * coordinates.factor[k]
    return {j: c for j, c in slope.items() if c != 0.0}, zero_length


def read_actuators(
    model: mujoco.MjModel, coordinates: CoordinateMap, passive: PassiveElements
) -> tuple[tuple[Actuator, ...], tuple[str, ...]]:
    """The actuators that move coordinates of the tree, in the file's order; and the names of those
    that move held joints only, or that the file switches off.
    """
    actuators, idle = [], []
    for k in range(model.nu):
        name = model.actuator(k).name
        kind = int(model.actuator_trntype[k])
        target = int(model.actuator_trnid[k, 0])
        affine_length = None
        if kind in JOINT_TRANSMISSIONS:
            affine_length = length(model, coordinates, joint=target)
        elif kind == TENDON:
            affine_length = length(model, coordinates, tendon=target)
        if affine_length is None:
            where = {TENDON: "a tendon over sites"}.get(
                kind, f"a {mujoco.mjtTrn(kind).name[6:].lower()}"
            )
            passive.unsupported.append(
                f"actuator '{name}' on "
                f"{where if kind not in JOINT_TRANSMISSIONS else 'a ball or free joint'}"
            )
            continue
        slope, zero_length = affine_length
        gear = float(model.actuator_gear[k, 0])
        for j, c in slope.items():
            passive.armature[j] += (gear * c) ** 2 * model.actuator_armature[k]
            passive.damping[j] += (gear * c) ** 2 * model.actuator_damping[k]
        if not slope or is_off(model, k):
            idle.append(name)
            continue
        law, why = _affine_law(model, k)
        if why:
            passive.unsupported.append(f"actuator '{name}' {why}")
        main_coordinate = max(slope, key=lambda j: (abs(slope[j]), -j))
        offset = law.offset - law.kp * gear * zero_length
        others = tuple((j, gear * c) for j, c in slope.items() if j != main_coordinate)
        law = replace(
            law,
            name=name,
            joint=main_coordinate,
            gear=gear * slope[main_coordinate],
            offset=offset,
            more=others,
        )
        actuators.append(law)
    return tuple(actuators), tuple(idle)


def _kind(gain: float, offset: float, kp: float, kv: float) -> str:
    """What MJCF calls an actuator with this affine law."""
    if offset == 0 and kp == 0 and kv == 0:
        return "motor"
    if offset == 0 and kp == gain:
        return "position"
    if offset == 0 and kp == 0 and kv == gain:
        return "velocity"
    return "general"


def _motor_law(model: mujoco.MjModel, k: int, shared: dict[str, Any]) -> tuple[Actuator, str]:
    """The law of a DC motor; see `_affine_law`."""
    gain, bias, dyn = model.actuator_gainprm[k], model.actuator_biasprm[k], model.actuator_dynprm[k]
    why = ""
    if np.any(gain[2:]) or np.any(bias) or np.any(dyn):
        why = f"is a dcmotor with more than motorconst and resistance ({_dcmotor(model, k)})"
    if not gain[0] > 0:
        return Actuator("", 0, "dcmotor", **shared), why
    law = {"gain": gain[1] / gain[0], "kv": gain[1] ** 2 / gain[0]}
    return Actuator("", 0, "dcmotor", **law, **shared), why


def _affine_law(model: mujoco.MjModel, k: int) -> tuple[Actuator, str]:
    """The law of an actuator without where it acts, and what of it a tree has not ('' where it has
    all).
    """
    gain, bias, dyn = model.actuator_gainprm[k], model.actuator_biasprm[k], model.actuator_dynprm[k]
    gaintype, biastype, dyntype = (
        int(x[k])
        for x in (model.actuator_gaintype, model.actuator_biastype, model.actuator_dyntype)
    )

    def range_where(limited, values):
        if limited:
            return tuple(map(float, values))
        return NO_RANGE

    shared: dict[str, Any] = {
        "forcerange": range_where(model.actuator_forcelimited[k], model.actuator_forcerange[k]),
        "ctrlrange": range_where(model.actuator_ctrllimited[k], model.actuator_ctrlrange[k]),
        "delay": float(model.actuator_delay[k]),
    }
    if gaintype == int(mujoco.mjtGain.mjGAIN_DCMOTOR):
        return _motor_law(model, k, shared)
    why = ["is a plugin's"] if model.actuator_plugin[k] >= 0 else []
    is_filtered = dyntype in (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
    if not is_filtered and dyntype != int(mujoco.mjtDyn.mjDYN_NONE):
        why.append(f"has a memory ({mujoco.mjtDyn(dyntype).name[6:].lower()})")
    if gaintype not in (FIXED, AFFINE) or (gaintype == AFFINE and np.any(gain[1:3])):
        why.append("has a gain that is not one number")
    is_affine = biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
    if not is_affine and biastype != int(mujoco.mjtBias.mjBIAS_NONE):
        why.append("has a bias that is not affine")
    if is_affine:
        offset, kp, kv = (float(bias[0]), float(-bias[1]), float(-bias[2]))
    else:
        offset, kp, kv = (0.0, 0.0, 0.0)
    kind = _kind(gain[0], offset, kp, kv)
    lag = float(dyn[0]) if is_filtered else 0.0
    return Actuator(
        "", 0, kind, gain=float(gain[0]), offset=offset, kp=kp, kv=kv, lag=lag, **shared
    ), " and ".join(why)


def _dcmotor(model: mujoco.MjModel, k: int) -> str:
    """What a dcmotor has besides, in words; LuGre's bristles are its friction."""
    if np.any(model.actuator_dynprm[k]):
        return "winding, cogging, heat, a controller or LuGre's friction"
    return "cogging or friction"


def add_tendons(
    model: mujoco.MjModel, coordinates: CoordinateMap, passive: PassiveElements
) -> None:
    """Springs, dampers, friction and rotors of fixed tendons, on the coordinate that each is of."""
    for t in range(model.ntendon):
        name = model.tendon(t).name
        damping, stiffness = float(model.tendon_damping[t]), float(model.tendon_stiffness[t])
        has_polynomial = np.any(model.tendon_dampingpoly[t]) or np.any(
            model.tendon_stiffnesspoly[t]
        )
        frictionloss, armature = (
            float(model.tendon_frictionloss[t]),
            float(model.tendon_armature[t]),
        )
        limited = bool(model.tendon_limited[t])
        if not (damping or stiffness or has_polynomial or frictionloss or armature or limited):
            continue
        affine_length = length(model, coordinates, tendon=t)
        rest_range = model.tendon_lengthspring[t]
        is_linear_spring = rest_range[0] == rest_range[1] and not has_polynomial and not limited
        if affine_length is not None and not affine_length[0]:
            continue
        if affine_length is None or len(affine_length[0]) > 1 or not is_linear_spring:
            passive.unsupported.append(
                f"what tendon '{name}' does by itself (spring, damper, friction or limit)"
            )
            if affine_length is None or len(affine_length[0]) > 1:
                continue
        ((j, c),), zero_length = affine_length[0].items(), affine_length[1]
        passive.damping[j] += c * c * damping
        passive.armature[j] += c * c * armature
        passive.frictionloss[j] += abs(c) * frictionloss
        passive.stiffness[j] += c * c * stiffness
        passive.pull[j] += c * stiffness * (float(rest_range.mean()) - zero_length)
    for e in range(model.neq):
        if model.eq_active0[e] and model.eq_type[e] == int(mujoco.mjtEq.mjEQ_TENDON):
            passive.unsupported.append(
                f"an equality of tendon '{model.tendon(model.eq_obj1id[e]).name}'"
            )
