"""What a `model.toml` changes in the file that it was declared by, as far as MJCF holds it."""

from collections.abc import Mapping, Sequence

import numpy as np

from adaptsim_jax.attribution.machine import Machine
from adaptsim_jax.attribution.model_toml import of_form
from adaptsim_jax.attribution.problem import numbers_of
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.effects.joints.actuator import (
    ACTUATOR_LAG,
    DELAY,
    POSITION_GAIN,
    SATURATION,
    TORQUE_GAIN,
)
from adaptsim_jax.effects.joints.catalogue import MACHINE
from adaptsim_jax.effects.joints.forces import HARD_STOP
from adaptsim_jax.mend.mjcf import Changes
from adaptsim_jax.mend.model_toml import Form

Columns = Mapping[tuple[str, str], np.ndarray]
DRIVES = tuple(e.name for e in MACHINE if e.place == "drive")
OF_JOINTS = (
    *("damping", "drag", "frictionloss", "armature"),
    *("stiffness", "preload", "torque", "ref"),
)
"""What of joints a file holds, by names of `Quantity.mjcf`."""
SOFT = 1e-4  # 1/rad: stiffness over torque of the spring that stands for a constant torque
STOPS = ("stiffness", "angle", "side")


def columns_of(one: Machine) -> dict[tuple[str, str], np.ndarray]:
    """Numbers of effects [n], by effect and parameter."""
    return numbers_of(one.tree) | one.declared


def giving_joints(columns: Columns, n: int) -> np.ndarray:
    """[n], whether the drive of a joint winds up under torque."""
    some = [columns[e, "compliance"] > 0.0 for e in DRIVES if (e, "compliance") in columns]
    return np.any([np.zeros(n, bool), *some], axis=0)


def of_joints(one: Machine, effects: Sequence[Effect] = MACHINE) -> dict[str, np.ndarray]:
    """What the joints of a file have [n] of `effects`; of those whose drive gives, what is left to
    the link.
    """
    columns, n = columns_of(one), one.tree.n
    table = {key: np.zeros(n) for key in OF_JOINTS}
    for e in effects:
        for p in e.parameters:
            if p.mjcf in table and (e.name, p.name) in columns:
                table[p.mjcf] += np.asarray(columns[e.name, p.name])
    stiffness, torque = table["stiffness"], table.pop("torque")
    stiffness += np.where(stiffness == 0.0, SOFT * np.abs(torque), 0.0)
    rest = (table.pop("preload") + torque) / np.where(stiffness != 0.0, stiffness, 1.0)
    springref = np.where(stiffness != 0.0, rest, np.asarray(one.tree.springref))
    rigid = ~giving_joints(columns, n)
    return {key: rigid * z for key, z in table.items()} | {"springref": springref}


def changes_of(was: Machine, form: Form, effects: Sequence[Effect] = MACHINE) -> Changes:
    """The changes of the file of `was` that make it the model of `form`, which has nothing that
    MJCF does not hold.
    """
    now = of_form(form, was, effects)
    gravity = np.asarray(now.tree.gravity)
    actuators = _actuators(was, now, form)
    return Changes(
        inertial=np.asarray(now.tree.inertial),
        joints=other_joints(was, now, effects),
        gravity=gravity if np.any(gravity != was.tree.gravity) else None,
        actuators=actuators,
        motors=_motors(was, now, form),
        lift=form.own.get("lift"),
        stops=_stops(now),
    )


def other_joints(
    was: Machine, now: Machine, effects: Sequence[Effect]
) -> dict[str, dict[str, float]]:
    """Numbers of joints that differ, by name."""
    before, after = of_joints(was, effects), of_joints(now, effects)
    return {
        key: {
            name: float(new)
            for name, new, old in zip(was.tree.joint_names, after[key], before[key], strict=True)
            if new != old
        }
        for key in after
    }


def _number(one: Machine, effect: Effect, name: str, joint: int) -> float:
    """Of an effect at a joint, its default where it is not there."""
    default = next(p.default for p in effect.parameters if p.name == name)
    column = columns_of(one).get((effect.name, name))
    return default if column is None else float(column[joint])


def _stops(now: Machine) -> dict[str, tuple[float, ...]]:
    """Stiffness, angle and side of ends that were found, by joint."""
    every = [
        (name, tuple(_number(now, HARD_STOP, key, j) for key in STOPS))
        for j, name in enumerate(now.tree.joint_names)
    ]
    return {name: stop for name, stop in every if stop[0]}


def _gain(now: Machine, joint: int) -> float:
    return 1.0 + _number(now, TORQUE_GAIN, "gain", joint)


def _limit(now: Machine, joint: int) -> float | None:
    """N m that the drive of a joint gives at most; None where nothing cuts it."""
    cut = _number(now, SATURATION, "cut", joint)
    return (1.0 - cut) * _number(now, SATURATION, "peak", joint) if cut else None


def _motors(was: Machine, now: Machine, form: Form) -> dict[str, float]:
    """Motors [N m per V or A] where the file has none and the gain had to be found."""
    driven = {was.tree.joint_names[a.joint] for a in was.mechanism.actuators}
    gains = form.own.get("gain", {}).items()
    joints = was.tree.joint_names
    return {n: g * _gain(now, joints.index(n)) for n, g in gains if n not in driven}


def _actuators(was: Machine, now: Machine, form: Form) -> dict[str, dict[str, float]]:
    """Changes of actuators, by name of the change and of the actuator, in the order in which they
    are made.
    """
    keys = ("gain", "kp", "speed", "kv", "bias", "limit", "delay", "lag")
    out: dict[str, dict[str, float]] = {key: {} for key in keys}
    for a in was.mechanism.actuators:
        joint = was.tree.joint_names[a.joint]
        gain = _gain(now, a.joint)
        found = form.own.get("gain", {}).get(joint)
        more = gain if found is None else gain * found / (a.gear * a.gain)
        numbers = {"gain": more, "kp": 1.0 + _number(now, POSITION_GAIN, "gain", a.joint)}
        if joint in form.own.get("servo", {}):
            given = form.own["servo"][joint]
            law = _law(was.actuator[:, a.joint], now.actuator[:, a.joint], given)
            numbers |= law | {"kp": numbers["kp"] * law.get("kp", 1.0)}
        if (limit := _limit(now, a.joint)) is not None:
            numbers["limit"] = limit / abs(a.gear)
        for key, effect in (("delay", DELAY), ("lag", ACTUATOR_LAG)):
            value = _number(now, effect, key, a.joint)
            if value >= 0.0 and value != _number(was, effect, key, a.joint):
                numbers[key] = value
        for key, value in numbers.items():
            if key not in ("gain", "kp", "speed") or value != 1.0:
                out[key][a.name] = float(value)
    for joint in _motors(was, now, form):
        limit = _limit(now, was.tree.joint_names.index(joint))
        if limit is not None:
            out["limit"][joint] = limit
    return out


def _law(was: np.ndarray, now: np.ndarray, given: Mapping[str, float]) -> dict[str, float]:
    """Changes that make the law [6] of a servo another; given: what its table says."""
    out = {}
    factor = now[2] / was[2] if was[2] else 1.0
    if was[2]:
        out["kp"] = factor
    elif was[0]:
        out["speed"] = now[0] / was[0]
    if "kv" in given:
        out["kv"] = -now[3]
    if "offset" in given:
        out["bias"] = now[1] - factor * was[1]
    if "limit" in given:
        out["limit"] = now[5]
    return out
