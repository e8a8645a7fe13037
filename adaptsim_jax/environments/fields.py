"""Numbers of a MuJoCo model by name: `body:pole.mass`, `geom:floor.friction[0]`,
`option.gravity[2]`; of the interface: `delay`.

A field is an edit of arrays that an `mjx.Model` and an `mujoco.MjModel` share, so that one name
serves a simulation in a compiled program and a target in MuJoCo C. Nominal values are the file's.
"""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.given import brief, finite
from adaptsim_jax.space import Parameter, Space


class Kind(NamedTuple):
    """An attribute: the array it stands in, what its rows are (`body`, `dof`, ...), its unit and
    the least that makes sense.
    """

    array: str
    rows: str
    unit: str
    least: float = -np.inf


KINDS: dict[str, dict[str, Kind]] = {
    "body": {
        "mass": Kind("body_mass", "body", "kg", 1e-9),
        "inertia": Kind("body_inertia", "body", "kg m2", 1e-12),
        "ipos": Kind("body_ipos", "body", "m"),
        "pos": Kind("body_pos", "body", "m"),
    },
    "joint": {
        "damping": Kind("dof_damping", "dof", "N s/m or N m s/rad", 0.0),
        "frictionloss": Kind("dof_frictionloss", "dof", "N or N m", 0.0),
        "armature": Kind("dof_armature", "dof", "kg or kg m2", 0.0),
        "stiffness": Kind("jnt_stiffness", "joint", "N/m or N m/rad", 0.0),
        "springref": Kind("qpos_spring", "qpos", "m or rad"),
    },
    "geom": {
        "friction": Kind("geom_friction", "geom", "1", 0.0),
        "solref": Kind("geom_solref", "geom", "s, 1"),
    },
    "actuator": {
        "gain": Kind("actuator_gainprm", "actuator", "of the actuator"),
        "bias": Kind("actuator_biasprm", "actuator", "of the actuator"),
        "gear": Kind("actuator_gear", "actuator", "1"),
    },
    "tendon": {
        "damping": Kind("tendon_damping", "tendon", "N s/m", 0.0),
        "stiffness": Kind("tendon_stiffness", "tendon", "N/m", 0.0),
        "frictionloss": Kind("tendon_frictionloss", "tendon", "N", 0.0),
    },
    "option": {
        "gravity": Kind("opt.gravity", "option", "m/s2"),
        "wind": Kind("opt.wind", "option", "m/s"),
        "density": Kind("opt.density", "option", "kg/m3", 0.0),
        "viscosity": Kind("opt.viscosity", "option", "Pa s", 0.0),
    },
}
INTERFACE = {  # what lies between policy and model: unit, least, nominal
    "delay": ("s", 0.0, 0.0),
    "action_scale": ("1", 0.0, 1.0),
    "observation_noise": ("of the observation", 0.0, 0.0),
}
LEAST_FRICTION = (
    1e-6  # N or N m: MJX takes a row of friction 0 for one that holds whatever the load
)
_OBJECTS = {
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "geom": mujoco.mjtObj.mjOBJ_GEOM,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "tendon": mujoco.mjtObj.mjOBJ_TENDON,
}
_COUNTS = {"body": "nbody", "joint": "njnt", "geom": "ngeom", "actuator": "nu", "tendon": "ntendon"}
_FORM = re.compile(r"(?P<kind>\w+)(?::(?P<name>[^.\[\]]+))?\.(?P<attr>\w+)(?:\[(?P<index>\d+)\])?")


class Edit(NamedTuple):
    """`array[index] = factor * value`."""

    array: str
    index: tuple[int, ...]
    factor: float


@dataclass(frozen=True)
class Field:
    """One number: its name, the value in the file, unit, the least that makes sense, and what it
    edits (nothing: the interface).
    """

    name: str
    nominal: float
    unit: str
    least: float
    edits: tuple[Edit, ...] = ()


def field_of(model: Any, name: str, where: str = "fields") -> Field:
    """The field called `name` of `model`, an MjModel or gymnax's parameters. BadInput with the
    nearest names where the model has none.

    A mass takes its inertia along in proportion, and the gain of a position actuator its bias, as
    they do in MJCF. `actuator:*.gain` is that of all actuators: the first one's, the others in
    proportion.
    """
    if name in INTERFACE:
        unit, least, nominal = INTERFACE[name]
        return Field(name, nominal, unit, least)
    if not isinstance(model, mujoco.MjModel):
        return _of_params(model, name, where)
    form = _FORM.fullmatch(name)
    if (
        form is None
        or form["kind"] not in KINDS
        or (form["name"] is None) != (form["kind"] == "option")
    ):
        raise BadInput(f"{where}: '{name}' is no field; {suggest(name, known_fields(model))}")
    kinds = KINDS[form["kind"]]
    if form["attr"] not in kinds:
        raise BadInput(
            f"{where}: '{name}': a {form['kind']} has {', '.join(kinds)}; name one of them"
        )
    kind = kinds[form["attr"]]
    if form["name"] == "*":
        return _of_all(model, form, name, where)
    row = _row(model, form["kind"], form["name"], kind.rows, name, where)
    array = _array(model, kind.array)
    index = (*row, *_column(array, row, form["index"], name, where))
    value = float(array[index])
    return Field(name, value, kind.unit, kind.least, _edits(model, kind.array, index, value))


def _of_all(model: mujoco.MjModel, form: re.Match, name: str, where: str) -> Field:
    every = [
        field_of(model, name.replace(":*.", f":{one}."), where)
        for one in _names(model, form["kind"])
    ]
    if not every:
        raise BadInput(
            f"{where}: '{name}': the model has no {form['kind']} with a name; name them in the MJCF"
        )
    first = every[0]

    def ratio(f):
        if first.nominal:
            return f.nominal / first.nominal
        return 1.0

    if not all(np.isfinite(ratio(f)) and (first.nominal or not f.nominal) for f in every):
        raise BadInput(
            f"{where}: '{name}': the first is 0 and another is not, so there is no proportion; "
            f"name them one by one"
        )
    edits = tuple(e._replace(factor=e.factor * ratio(f)) for f in every for e in f.edits)
    return replace(first, name=name, edits=edits)


def _of_params(params: Any, name: str, where: str) -> Field:
    """A number of gymnax's parameters, `params.g`."""
    head, _, last = name.partition(".")
    value = finite(getattr(params, last, None)) if head == "params" else None
    if value is None:
        raise BadInput(
            f"{where}: '{name}' is no field of this environment; "
            f"{suggest(name, known_fields(params))}"
        )
    return Field(name, value, "of the environment", -np.inf, (Edit(last, (), 1.0),))


def _edits(
    model: mujoco.MjModel, array: str, index: tuple[int, ...], value: float
) -> tuple[Edit, ...]:
    edits = [Edit(array, index, 1.0)]
    if array == "body_mass" and value > 0:
        inertia = model.body_inertia[index[0]]
        edits += [Edit("body_inertia", (index[0], i), float(inertia[i]) / value) for i in range(3)]
    if (
        array == "actuator_gainprm"
        and index[1] == 0
        and value
        and model.actuator_biasprm[index[0], 1] == -value
    ):
        edits.append(Edit("actuator_biasprm", (index[0], 1), -1.0))
    return tuple(edits)


def _array(model: Any, array: str) -> Any:
    for part in array.split("."):
        model = getattr(model, part)
    return np.asarray(model)


def _row(model, kind: str, name: str | None, rows: str, field: str, where: str) -> tuple[int, ...]:
    if kind == "option":
        return ()
    found = mujoco.mj_name2id(model, _OBJECTS[kind], name)
    if found < 0:
        near = suggest(f"{kind}:{name}", [f"{kind}:{other}" for other in _names(model, kind)])
        raise BadInput(f"{where}: '{field}': the model has no {kind} '{name}'; {near}")
    if rows == "dof":
        return (int(model.jnt_dofadr[found]),)
    if rows == "qpos":
        return (int(model.jnt_qposadr[found]),)
    return (found,)


def _column(
    array: np.ndarray, row: tuple[int, ...], index: str | None, name: str, where: str
) -> tuple[int, ...]:
    rest = array.shape[len(row) :]
    if not rest:
        if index is not None:
            raise BadInput(f"{where}: '{name}' is one number; leave '[{index}]' out")
        return ()
    number = int(index or 0)
    if number >= rest[0]:
        raise BadInput(f"{where}: '{name}': there are {rest[0]} of it; give [0] to [{rest[0] - 1}]")
    if index is None and not ("gain" in name or "friction" in name or "gear" in name):
        raise BadInput(
            f"{where}: '{name}': there are {rest[0]} of it; write '{name}[0]' to "
            f"'{name}[{rest[0] - 1}]'"
        )
    return (number,)


def _names(model: mujoco.MjModel, kind: str) -> list[str]:
    count = getattr(model, _COUNTS[kind])
    found = [mujoco.mj_id2name(model, _OBJECTS[kind], i) for i in range(count)]
    return [name for name in found if name]


def known_fields(model: Any) -> list[str]:
    """All names that a field of `model` (an MjModel, or gymnax's parameters) may have, vectors
    without their index.
    """
    names = list(INTERFACE)
    if not isinstance(model, mujoco.MjModel):
        if dataclasses.is_dataclass(model):
            own = [f.name for f in dataclasses.fields(model)]
        else:
            own = []
        return names + [
            f"params.{name}" for name in own if finite(getattr(model, name)) is not None
        ]
    for kind, attrs in KINDS.items():
        if kind == "option":
            things = [""]
        else:
            things = [f":{name}" for name in _names(model, kind)]
        names += [f"{kind}{thing}.{attr}" for thing in things for attr in attrs]
    return names


def values_of(fields: Sequence[Field]) -> np.ndarray:
    """Nominal values `[F]`."""
    return np.array([field.nominal for field in fields], np.float32)


def edited(model: Any, fields: Sequence[Field], values: jax.Array) -> Any:
    """`model`, an `mjx.Model`, with `values [F]` of `fields` in their places; pure, of one
    sample.
    """
    changed: dict[str, Any] = {}
    for i, field in enumerate(fields):
        for edit in field.edits:
            if edit.array in changed:
                array = changed[edit.array]
            else:
                array = jnp.asarray(_leaf(model, edit.array))
            value = (edit.factor * values[i]).astype(array.dtype)
            if "frictionloss" in edit.array:
                value = jnp.maximum(value, LEAST_FRICTION)
            if edit.index:
                changed[edit.array] = array.at[edit.index].set(value)
            else:
                changed[edit.array] = value
    if changed:
        return model.tree_replace(changed)
    return model


def _leaf(model: Any, array: str) -> Any:
    for part in array.split("."):
        model = getattr(model, part)
    return model


def edit_native(model: mujoco.MjModel, fields: Sequence[Field], values: Any) -> mujoco.MjModel:
    """`model` itself with `values [F]` in their places, and what MuJoCo derives of them made
    anew.
    """
    for field, value in zip(fields, values, strict=True):
        for edit in field.edits:
            place, _, last = edit.array.rpartition(".")
            holder = getattr(model, place) if place else model
            if edit.index:
                getattr(holder, last)[edit.index] = edit.factor * value
            else:
                setattr(holder, last, edit.factor * value)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def space_of(
    model: Any, ranges: Mapping[str, Any], where: str = "fields"
) -> tuple[Space, tuple[Field, ...]]:
    """Omega over `ranges` (name: `[low, high]`, or `[low, high, "log"]`), and its fields. BadInput
    names the field and the mend.
    """
    if not ranges:
        raise BadInput(
            f"{where}: there is no field, so nothing to adapt; name one, such as "
            f"{known_fields(model)[-1]}"
        )
    parameters, fields = [], []
    for name, given in ranges.items():
        field = field_of(model, name, where)
        items = list(given) if isinstance(given, (list, tuple)) else [given]
        scale = items.pop() if len(items) == 3 else "linear"
        ends = [finite(x) for x in items]
        if len(ends) != 2 or None in ends or scale not in ("linear", "log"):
            raise BadInput(
                f"{where}: '{name}' = {brief(given)}; give [low, high] or [low, high, \"log\"]"
            )
        if ends[0] < field.least:  # type: ignore[operator]
            raise BadInput(
                f"{where}: '{name}' begins at {ends[0]} {field.unit}; its least is {field.least:g}"
            )
        parameters.append(Parameter(name, *ends, field.unit, scale, field.least))  # type: ignore[arg-type]
        fields.append(field)
    return Space(tuple(parameters)), tuple(fields)
