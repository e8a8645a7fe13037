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

from adaptsim_jax.mechanisms.roles import JOINTS, WRAPPED
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
class Place:
    """Where the joints of the file are in the tree. coordinate, factor, offset by joint of the
    file: it is at offset + factor * q[coordinate]; coordinate -1: held at its offset.
    """

    coordinate: np.ndarray
    factor: np.ndarray
    offset: np.ndarray


@dataclass
class Added:
    """What acts on the coordinates besides the joints' own.

    - `armature`, `damping`, `frictionloss`, `stiffness`: `[n]`.
    - `pull [n]`: The force of these springs at zero.
    - `beyond`: What a tree has not, a sentence each.
    """

    armature: np.ndarray
    damping: np.ndarray
    frictionloss: np.ndarray
    stiffness: np.ndarray
    pull: np.ndarray
    beyond: list[str] = field(default_factory=list)


def length(
    model: mujoco.MjModel, place: Place, joint: int = -1, tendon: int = -1
) -> tuple[dict[int, float], float] | None:
    """A joint's or fixed tendon's length as (slope by coordinate, length at zero); None where it is
    no such sum.
    """
    parts = [(joint, 1.0)] if joint >= 0 else []
    if tendon >= 0:
        rows = range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
        if any(model.wrap_type[w] != WRAPPED for w in rows):
            return None
        parts = [(int(model.wrap_objid[w]), float(model.wrap_prm[w])) for w in rows]
    slope: dict[int, float] = {}
    start = 0.0
    for k, c in parts:
        if model.jnt_type[k] not in SINGLE:
            return None
        start += c * place.offset[k]
        if (j := int(place.coordinate[k])) >= 0:
            slope[j] = slope.get(j, 0.0) + c * place.factor[k]
    return {j: c for j, c in slope.items() if c != 0.0}, start


def read_actuators(
    model: mujoco.MjModel, place: Place, added: Added
) -> tuple[tuple[Actuator, ...], tuple[str, ...]]:
    """The actuators that move coordinates of the tree, in the file's order; and the names of those
    that move held joints only, or that the file switches off.
    """
    out, idle = [], []
    for k in range(model.nu):
        name = model.actuator(k).name
        kind = int(model.actuator_trntype[k])
        target = int(model.actuator_trnid[k, 0])
        found = None
        if kind in JOINTS:
            found = length(model, place, joint=target)
        elif kind == TENDON:
            found = length(model, place, tendon=target)
        if found is None:
            where = {TENDON: "a tendon over sites"}.get(
                kind, f"a {mujoco.mjtTrn(kind).name[6:].lower()}"
            )
            added.beyond.append(
                f"actuator '{name}' on {where if kind not in JOINTS else 'a ball or free joint'}"
            )
            continue
        slope, start = found
        gear = float(model.actuator_gear[k, 0])
        for j, c in slope.items():
            added.armature[j] += (gear * c) ** 2 * model.actuator_armature[k]
            added.damping[j] += (gear * c) ** 2 * model.actuator_damping[k]
        if not slope or is_off(model, k):
            idle.append(name)
            continue
        law, why = _law(model, k)
        if why:
            added.beyond.append(f"actuator '{name}' {why}")
        home = max(slope, key=lambda j: (abs(slope[j]), -j))
        offset = law.offset - law.kp * gear * start
        more = tuple((j, gear * c) for j, c in slope.items() if j != home)
        law = replace(law, name=name, joint=home, gear=gear * slope[home], offset=offset, more=more)
        out.append(law)
    return tuple(out), tuple(idle)


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
    """The law of a DC motor; see `_law`."""
    gain, bias, dyn = model.actuator_gainprm[k], model.actuator_biasprm[k], model.actuator_dynprm[k]
    why = ""
    if np.any(gain[2:]) or np.any(bias) or np.any(dyn):
        why = f"is a dcmotor with more than motorconst and resistance ({_dcmotor(model, k)})"
    if not gain[0] > 0:
        return Actuator("", 0, "dcmotor", **shared), why
    law = {"gain": gain[1] / gain[0], "kv": gain[1] ** 2 / gain[0]}
    return Actuator("", 0, "dcmotor", **law, **shared), why


def _law(model: mujoco.MjModel, k: int) -> tuple[Actuator, str]:
    """The law of an actuator without where it acts, and what of it a tree has not ('' where it has
    all).
    """
    gain, bias, dyn = model.actuator_gainprm[k], model.actuator_biasprm[k], model.actuator_dynprm[k]
    gaintype, biastype, dyntype = (
        int(x[k])
        for x in (model.actuator_gaintype, model.actuator_biastype, model.actuator_dyntype)
    )

    def limited(on, values):
        if on:
            return tuple(map(float, values))
        return NO_RANGE

    shared: dict[str, Any] = {
        "forcerange": limited(model.actuator_forcelimited[k], model.actuator_forcerange[k]),
        "ctrlrange": limited(model.actuator_ctrllimited[k], model.actuator_ctrlrange[k]),
        "delay": float(model.actuator_delay[k]),
    }
    if gaintype == int(mujoco.mjtGain.mjGAIN_DCMOTOR):
        return _motor_law(model, k, shared)
    why = ["is a plugin's"] if model.actuator_plugin[k] >= 0 else []
    lagged = dyntype in (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
    if not lagged and dyntype != int(mujoco.mjtDyn.mjDYN_NONE):
        why.append(f"has a memory ({mujoco.mjtDyn(dyntype).name[6:].lower()})")
    if gaintype not in (FIXED, AFFINE) or (gaintype == AFFINE and np.any(gain[1:3])):
        why.append("has a gain that is not one number")
    straight = biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
    if not straight and biastype != int(mujoco.mjtBias.mjBIAS_NONE):
        why.append("has a bias that is not affine")
    if straight:
        offset, kp, kv = (float(bias[0]), float(-bias[1]), float(-bias[2]))
    else:
        offset, kp, kv = (0.0, 0.0, 0.0)
    kind = _kind(gain[0], offset, kp, kv)
    lag = float(dyn[0]) if lagged else 0.0
    return Actuator(
        "", 0, kind, gain=float(gain[0]), offset=offset, kp=kp, kv=kv, lag=lag, **shared
    ), " and ".join(why)


def _dcmotor(model: mujoco.MjModel, k: int) -> str:
    """What a dcmotor has besides, in words; LuGre's bristles are its friction."""
    if np.any(model.actuator_dynprm[k]):
        return "winding, cogging, heat, a controller or LuGre's friction"
    return "cogging or friction"


def add_tendons(model: mujoco.MjModel, place: Place, added: Added) -> None:
    """Springs, dampers, friction and rotors of fixed tendons, on the coordinate that each is of."""
    for t in range(model.ntendon):
        name = model.tendon(t).name
        d, k = float(model.tendon_damping[t]), float(model.tendon_stiffness[t])
        curved = np.any(model.tendon_dampingpoly[t]) or np.any(model.tendon_stiffnesspoly[t])
        rub, arm = float(model.tendon_frictionloss[t]), float(model.tendon_armature[t])
        limited = bool(model.tendon_limited[t])
        if not (d or k or curved or rub or arm or limited):
            continue
        found = length(model, place, tendon=t)
        slack = model.tendon_lengthspring[t]
        bare = slack[0] == slack[1] and not curved and not limited
        if found is not None and not found[0]:
            continue
        if found is None or len(found[0]) > 1 or not bare:
            added.beyond.append(
                f"what tendon '{name}' does by itself (spring, damper, friction or limit)"
            )
            if found is None or len(found[0]) > 1:
                continue
        ((j, c),), start = found[0].items(), found[1]
        added.damping[j] += c * c * d
        added.armature[j] += c * c * arm
        added.frictionloss[j] += abs(c) * rub
        added.stiffness[j] += c * c * k
        added.pull[j] += c * k * (float(slack.mean()) - start)
    for e in range(model.neq):
        if model.eq_active0[e] and model.eq_type[e] == int(mujoco.mjtEq.mjEQ_TENDON):
            added.beyond.append(f"an equality of tendon '{model.tendon(model.eq_obj1id[e]).name}'")
