"""Numbers of a MuJoCo model by name: `joint:elbow.frictionloss`, `body:torso.mass`,
`geom:FL.friction[0]`, `actuator:x.kp`, `option.gravity[2]`; and `command.delay`, by which all
commands act late.

A name is KIND:ELEMENT.FIELD with MuJoCo's own names of the fields of its model, `[i]` where a field
has several numbers; ELEMENT may be a pattern (`geom:*foot*.friction[0]`), which gives one number to
all that it names.
"""

import copy
import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.effects.base import Quantity
from adaptsim_jax.mechanisms.model_numbers import (
    KINDS,
    OF_DOF,
    OPTION,
    array_and_row,
    array_at,
    attributes,
    element_names,
    parse,
)
from adaptsim_jax.simulators.mujoco.criteria import CANDIDATE

DELAY = "command.delay"
TILTS = ("world.tilt_x", "world.tilt_y")
"""rad: gravity turned about the world's x and y."""
GROUND = ("ground.tilt_x", "ground.tilt_y", "ground.height")
"""rad, m: all that the world touches with, turned about the world's x and y, and lifted."""
CONTACT = "contact."
"""Of all that touches: by as many times as what decides (its `default`), so that nothing jumps
where it hardly changes.
"""
STRENGTH = "strength"
"""Of an actuator: what it gives of what it should, all its gains alike, but for the damping of a
position servo.
"""
RELATIVE_STEP = 0.01  # of a number, for its derivative: wide enough to see past single contacts
TYPICAL = {
    "armature": 0.01,
    "stiffness": 1.0,
}  # sizes of numbers that the model has at zero, of others 0.1
POSITIVE = (
    "mass",
    "inertia",
    "friction",
    "damping",
    "armature",
    "frictionloss",
    "stiffness",
    "kp",
    "kv",
    STRENGTH,
)
UNITS = {
    "frictionloss": "N m",
    "damping": "N m s/rad",
    "armature": "kg m^2",
    "mass": "kg",
    "solref": "s",
    "kp": "N m/rad",
    "ipos": "m",
    "offset": "rad",
    "wind": "N",
    "delay": "s",
}
"""Units of fields, of others 1."""
CONSTANTS = ("mass", "inertia", "ipos", "armature", "pos", "quat", "gear")
"""Fields from which MuJoCo derives others, which then are made anew."""


@dataclass(frozen=True)
class ModelNumber(Quantity):
    """One number of a model, at all elements that its name stands for; `default` is what the model
    has.

    Args:
        field: What it is, KIND.FIELD.
        elements: Which of that kind have it.
        index: Its place, where a field has several numbers.
    """

    field: str = ""
    elements: tuple[int, ...] = ()
    index: int = 0

    @property
    def step(self) -> float:
        """One that shows in the motion and leaves it what it is."""
        return self.scale / CANDIDATE.size

    def by(self, step: float) -> "ModelNumber":
        """Return a copy with another step."""
        return replace(self, prior=CANDIDATE.prior_width * step, scale=CANDIDATE.size * step)


def make_number(
    name: str,
    what: str,
    elements: tuple[int, ...],
    index: int,
    default: float,
    ends: tuple[float, float],
    step: float,
) -> ModelNumber:
    """Make a number with its unit; ends: its bounds."""
    stem = name.split("[")[0].split(".")
    angle = "rad" if name in (*TILTS, *GROUND[:2]) else "1"
    unit = UNITS.get(stem[-1], UNITS.get(stem[0], angle))
    return ModelNumber(name, unit, *ends, default, field=what, elements=elements, index=index).by(
        step
    )


def model_number(model: mujoco.MjModel, name: str) -> ModelNumber:
    """Find the number of that name. Raises BadInput where the model has none, with what is near."""
    if name == DELAY:
        ends = -CANDIDATE.max_delay, CANDIDATE.max_delay
        return make_number(name, DELAY, (), 0, 0.0, ends, max(float(model.opt.timestep), 1e-3))
    if name == GROUND[2]:
        return make_number(name, name, (), 0, 0.0, (-1.0, 1.0), 5e-4)
    if name in (*TILTS, *GROUND):
        return make_number(name, name, (), 0, 0.0, (-0.5, 0.5), 0.002)
    form = parse(name)
    if form is None:
        raise BadInput(
            f"quantity {name!r}: write KIND:ELEMENT.FIELD, such as joint:elbow.damping, "
            "body:torso.mass or option.gravity[2]"
        )
    kind, element, what, index = form
    if element is None:
        elements = (0,)
    else:
        elements = tuple(_elements(model, name, kind, element))
    low = 0.0 if what in POSITIVE else -np.inf
    number = make_number(name, f"{kind}.{what}", elements, index or 0, 0.0, (low, np.inf), 1.0)
    default = float(np.mean([_get(model, number, e) for e in elements]))
    size = abs(default) or TYPICAL.get(what, 0.1)
    return replace(number, default=default).by(RELATIVE_STEP * size)


def _elements(model: mujoco.MjModel, name: str, kind: str, pattern: str) -> list[int]:
    if kind not in KINDS:
        raise BadInput(f"quantity {name!r}: {suggest(kind, KINDS)}")
    names = [n or f"{kind}{i}" for i, n in enumerate(element_names(model, kind))]
    matches = [i for i, n in enumerate(names) if n == pattern]
    if not matches:
        matches = [i for i, n in enumerate(names) if fnmatch.fnmatchcase(n, pattern)]
    if not matches:
        raise BadInput(
            f"quantity {name!r}: the model has no {kind} {pattern!r}; {suggest(pattern, names)}"
        )
    return matches


def _place(model: mujoco.MjModel, number: ModelNumber, element: int) -> tuple[np.ndarray, int, int]:
    """Array, row and column of a number. Raises BadInput where the model has no such field."""
    kind, what = number.field.split(".")
    name, row = array_and_row(model, kind, what, element)
    array = array_at(model, name)
    if array is None and kind == OPTION:
        raise BadInput(f"quantity {number.name!r}: MuJoCo's option has no {what!r}")
    if array is None:
        raise BadInput(
            f"quantity {number.name!r}: a {kind} has no {what!r}; "
            f"{suggest(what, [*attributes(model, kind), *OF_DOF, 'kp', 'kv'])}"
        )
    if kind == OPTION:
        return np.atleast_1d(array), number.index, -1
    if array.ndim > 1 and number.index >= array.shape[1]:
        raise BadInput(
            f"quantity {number.name!r}: {what} has {array.shape[1]} numbers, counted from 0"
        )
    return array, row, number.index if array.ndim > 1 else -1


def _get(model: mujoco.MjModel, number: ModelNumber, element: int) -> float:
    if number.field == f"actuator.{STRENGTH}":
        return 1.0
    if number.field == "actuator.kp":
        return float(-model.actuator_biasprm[element, 1])
    if number.field == "actuator.kv":
        return float(-model.actuator_biasprm[element, 2])
    array, row, column = _place(model, number, element)
    return float(array[row] if column < 0 else array[row, column])


def _set(model: mujoco.MjModel, number: ModelNumber, element: int, value: float) -> None:
    if number.field == f"actuator.{STRENGTH}":
        model.actuator_gainprm[element, :3] *= value
        model.actuator_biasprm[element, : 2 if model.actuator_biasprm[element, 1] else 3] *= value
    elif number.field == "actuator.kp":
        old_value = -model.actuator_biasprm[element, 1]
        model.actuator_gainprm[element, 0] *= value / old_value if old_value else 1.0
        model.actuator_biasprm[element, 1] = -value
    elif number.field == "actuator.kv":
        bias = model.actuator_biasprm[element]
        is_speed_servo = bias[1] == 0 and model.actuator_gainprm[element, 0] == -bias[2]
        model.actuator_biasprm[element, 2] = -value
        if is_speed_servo:
            model.actuator_gainprm[element, 0] = value
    elif number.field.startswith(f"{OPTION}."):
        what = number.field.removeprefix(f"{OPTION}.")
        old_value = getattr(model.opt, what)
        array = np.array(np.atleast_1d(old_value), float)
        array[number.index] = value
        setattr(model.opt, what, array if np.ndim(old_value) else float(array[0]))
    else:
        array, row, column = _place(model, number, element)
        array[row if column < 0 else (row, column)] = value


def with_values(
    model: mujoco.MjModel, fields: Sequence[ModelNumber], values: Sequence[float]
) -> mujoco.MjModel:
    """Copy the model with these numbers; a mass keeps its shape, so that its moments go with it."""
    out = copy.copy(model)
    recompute = False
    for number, value in zip(fields, values, strict=True):
        if (
            value == number.default
        ):  # a number for several elements has their mean, which is not what each of them has
            continue
        if number.name in TILTS:
            gravity = np.zeros(3)
            half = np.eye(3)[TILTS.index(number.name)] * np.sin(0.5 * value)
            mujoco.mju_rotVecQuat(gravity, out.opt.gravity, np.array([np.cos(0.5 * value), *half]))
            out.opt.gravity = gravity
            continue
        if number.name in GROUND:
            _move_ground(out, number.name, value)
            recompute = True  # else a geom that lay in its body's frame is taken to lie there still
            continue
        for element in number.elements:
            if number.field == "body.mass" and out.body_mass[element] > 0:
                out.body_inertia[element] *= value / out.body_mass[element]
            element_value = float(value)
            if number.name.startswith(CONTACT):
                element_value = min(
                    _get(model, number, element) * value / number.default, number.high
                )
            _set(out, number, element, element_value)
        recompute |= number.field.split(".")[-1] in CONSTANTS
    if recompute:
        mujoco.mj_setConst(out, mujoco.MjData(out))
    return out


def grounds(model: mujoco.MjModel) -> list[int]:
    """Geoms of the world that others may touch."""
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return [int(g) for g in np.flatnonzero((model.geom_bodyid == 0) & solid)]


def _move_ground(model: mujoco.MjModel, name: str, value: float) -> None:
    """In place: turn (rad) or lift (m) what the world touches with."""
    for g in grounds(model):
        if name == GROUND[2]:
            model.geom_pos[g, 2] += value
            continue
        axis = np.eye(3)[GROUND.index(name)]
        turn = np.array([np.cos(0.5 * value), *axis * np.sin(0.5 * value)])
        position, quaternion = np.zeros(3), np.zeros(4)
        mujoco.mju_rotVecQuat(position, model.geom_pos[g], turn)
        mujoco.mju_mulQuat(quaternion, turn, model.geom_quat[g])
        model.geom_pos[g], model.geom_quat[g] = position, quaternion
