"""Numbers of a MuJoCo model by name: `joint:elbow.damping`, `geom:FL.friction[0]`,
`option.gravity[2]`.

A name is KIND:ELEMENT.ATTRIBUTE with MuJoCo's own words, and `[i]` where there are several numbers.
Here is what such a name means and where the number stands. Which of them may be fitted or adapted,
and within which bounds, is for whoever asks.
"""

import re
from typing import Any, NamedTuple

import mujoco

KINDS = ("body", "joint", "geom", "actuator", "tendon", "site")
OF_DOF = ("damping", "armature", "frictionloss", "invweight0")
"""Attributes that MuJoCo keeps for the degrees of freedom of a joint."""
OPTION = "option"
FORM = re.compile(r"(?:(\w+):(.+?)|(option))\.(\w+)(?:\[(\d+)\])?")
_PREFIXES = {"joint": "jnt", OPTION: "opt"}
_COUNTS = {"joint": "njnt", "actuator": "nu"}


class NumberName(NamedTuple):
    """The parts of a name; element: None of the option, index: None where none is given."""

    kind: str
    element: str | None
    attribute: str
    index: int | None


def parse(name: str) -> NumberName | None:
    """None where `name` has not this form."""
    form = FORM.fullmatch(name)
    if form is None:
        return None
    kind, element, option, attribute, index = form.groups()
    return NumberName(option or kind, element, attribute, None if index is None else int(index))


def element_names(model: mujoco.MjModel, kind: str) -> list[str | None]:
    """Return the names of elements by number; None for one without a name."""
    count = getattr(model, _COUNTS.get(kind, f"n{kind}"))
    return [mujoco.mj_id2name(model, _object(kind), i) for i in range(count)]


def element_number(model: mujoco.MjModel, kind: str, name: str) -> int:
    """-1 where the model has none of that name."""
    return mujoco.mj_name2id(model, _object(kind), name)


def array_and_row(
    model: mujoco.MjModel, kind: str, attribute: str, element: int
) -> tuple[str, int]:
    """The array that holds the attribute, whether the model has it or not, and the element's row in
    it (of the option: 0).
    """
    if kind == "joint" and attribute in OF_DOF:
        return f"dof_{attribute}", int(model.jnt_dofadr[element])
    if kind == "joint" and attribute == "springref":
        return "qpos_spring", int(model.jnt_qposadr[element])
    if kind == OPTION:
        return f"opt.{attribute}", 0
    return f"{_PREFIXES.get(kind, kind)}_{attribute}", element


def array_at(model: Any, array: str) -> Any:
    """The array called `array`, such as `body_mass` or `opt.gravity`, of an `MjModel` or an
    `mjx.Model`; None where there is none.
    """
    for part in array.split("."):
        model = getattr(model, part, None)
    return model


def attributes(model: mujoco.MjModel, kind: str) -> list[str]:
    """All that the model holds of things of that kind."""
    prefix = f"{_PREFIXES.get(kind, kind)}_"
    return sorted(name.removeprefix(prefix) for name in dir(model) if name.startswith(prefix))


def _object(kind: str) -> Any:
    return getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
