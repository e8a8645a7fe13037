"""Numbers of a MuJoCo model by name: `body:pole.mass`, `geom:floor.friction[0]`,
`option.gravity[2]`; of the interface: `delay`.

A field is an edit of arrays that an `mjx.Model` and an `mujoco.MjModel` share, so that one name
serves a simulation in a compiled program and a target in MuJoCo C. Nominal values are the file's.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array

from adaptsim_jax.core.config import Table, read, suggest
from adaptsim_jax.core.errors import BadInput, brief, finite
from adaptsim_jax.mechanisms.model_numbers import (
    NumberName,
    array_and_row,
    array_at,
    element_names,
    element_number,
    parse,
)
from adaptsim_jax.space import Parameter, Space


class Attribute(NamedTuple):
    """A number that may be adapted: the name of its array in MuJoCo, where that is another, its
    unit and the minimum that makes sense.
    """

    unit: str
    minimum: float = -np.inf
    array: str = ""


ATTRIBUTES: dict[str, dict[str, Attribute]] = {
    kind: {name: Attribute(**row) for name, row in rows.items()}
    for kind, rows in read(Path(__file__).with_name("attributes.toml")).items()
}
INTERFACE = {  # what lies between policy and model: unit, minimum, nominal
    "delay": ("s", 0.0, 0.0),
    "action_scale": ("1", 0.0, 1.0),
    "observation_noise": ("of the observation", 0.0, 0.0),
}
DOFS = {int(mujoco.mjtJoint.mjJNT_FREE): 6, int(mujoco.mjtJoint.mjJNT_BALL): 3}
OF_LAWS = "laws/"  # arrays that are numbers of laws, not of the model
MIN_FRICTION = 1e-6
"""N or N m: MJX takes a row of friction 0 for one that holds whatever the load."""


class Edit(NamedTuple):
    """`array[index] = factor * value`."""

    array: str
    index: tuple[int, ...]
    factor: float


@dataclass(frozen=True)
class ModelField:
    """One number: its name, the value in the file, unit, the minimum that makes sense, and what it
    edits (nothing: the interface).
    """

    name: str
    nominal: float
    unit: str
    minimum: float
    edits: tuple[Edit, ...] = ()


class Lawed(NamedTuple):
    """A model with what acts beside MJX: fields of its laws by name."""

    native: mujoco.MjModel
    own: Mapping[str, ModelField]


def of_law(field: ModelField) -> bool:
    """Whether a field is a number of a law that a diagnosis found."""
    return field.name.startswith("effect:")


def field_of(model: Any, name: str, where: str = "fields") -> ModelField:
    """The field called `name` of `model`, an MjModel or gymnax's parameters. BadInput with the
    nearest names where the model has none.

    A mass takes its inertia along in proportion, the gain of a servo its bias, and a ball or free
    joint has a number for all its degrees of freedom, as in MJCF. `actuator:*.gain` is that of all
    actuators: the first one's, the others in proportion.
    """
    if name in INTERFACE:
        unit, minimum, nominal = INTERFACE[name]
        return ModelField(name, nominal, unit, minimum)
    if isinstance(model, Lawed):
        if name in model.own:
            return model.own[name]
        if name.startswith("effect:"):
            raise BadInput(f"{where}: '{name}' is no field; {suggest(name, list(model.own))}")
        model = model.native
    if not isinstance(model, mujoco.MjModel):
        return _of_params(model, name, where)
    form = parse(name)
    if form is None or form.kind not in ATTRIBUTES:
        raise BadInput(f"{where}: '{name}' is no field; {suggest(name, known_fields(model))}")
    there = ATTRIBUTES[form.kind]
    if form.attribute not in there:
        raise BadInput(f"{where}: '{name}': a {form.kind} has {', '.join(there)}; name one of them")
    if form.element == "*":
        return _of_all(model, form.kind, name, where)
    attribute = there[form.attribute]
    element = _element(model, form, name, where)
    array, row = array_and_row(model, form.kind, attribute.array or form.attribute, element)
    numbers = np.asarray(array_at(model, array))
    lead = () if form.element is None else (row,)
    index = (*lead, *_column(numbers[lead], form.index, name, where))
    value = float(numbers[index])
    edits = _edits(model, array, index, value)
    if form.kind == "joint" and array.startswith("dof_"):
        count = DOFS.get(int(model.jnt_type[element]), 1)
        edits = tuple(Edit(array, (row + i,), 1.0) for i in range(count))
    if array == "actuator_gainprm" and form.index is None:
        value, edits = _gain(model, row)
    return ModelField(name, value, attribute.unit, attribute.minimum, edits)


def _of_all(model: mujoco.MjModel, kind: str, name: str, where: str) -> ModelField:
    every = [field_of(model, name.replace(":*.", f":{one}."), where) for one in _names(model, kind)]
    if not every:
        raise BadInput(
            f"{where}: '{name}': the model has no {kind} with a name; name them in the MJCF"
        )
    first = every[0]

    def ratio(f):
        if first.nominal:
            return f.nominal / first.nominal
        return 1.0

    if not all(np.isfinite(ratio(f)) and (first.nominal or not f.nominal) for f in every):
        raise BadInput(
            f"{where}: '{name}': the first is 0 and another is not, so there is no proportion; "
            "name them one by one"
        )
    edits = tuple(e._replace(factor=e.factor * ratio(f)) for f in every for e in f.edits)
    return replace(first, name=name, edits=edits)


def _of_params(params: Any, name: str, where: str) -> ModelField:
    """A number of gymnax's parameters, `params.g`."""
    head, _, last = name.partition(".")
    value = finite(getattr(params, last, None)) if head == "params" else None
    if value is None:
        raise BadInput(
            f"{where}: '{name}' is no field of this environment; "
            f"{suggest(name, known_fields(params))}"
        )
    return ModelField(name, value, "of the environment", -np.inf, (Edit(last, (), 1.0),))


def _edits(
    model: mujoco.MjModel, array: str, index: tuple[int, ...], value: float
) -> tuple[Edit, ...]:
    edits = [Edit(array, index, 1.0)]
    if array == "body_mass" and value > 0:
        inertia = model.body_inertia[index[0]]
        edits += [Edit("body_inertia", (index[0], i), float(inertia[i]) / value) for i in range(3)]
    return tuple(edits)


def _gain(model: mujoco.MjModel, actuator: int) -> tuple[float, tuple[Edit, ...]]:
    """The gain of an actuator as MJCF writes it, and its edits: a servo's error is multiplied by
    it, so its bias goes along; a damper's is by speed, and negative.
    """
    gain, bias = (getattr(model, f"actuator_{x}prm")[actuator] for x in ("gain", "bias"))
    if gain[0] == 0.0 and gain[2] < 0.0:
        return -float(gain[2]), (Edit("actuator_gainprm", (actuator, 2), -1.0),)
    edits = [Edit("actuator_gainprm", (actuator, 0), 1.0)]
    opposed = [i for i in (1, 2) if gain[0] and bias[i] == -gain[0]]
    edits += [Edit("actuator_biasprm", (actuator, i), -1.0) for i in opposed[:1]]
    return float(gain[0]), tuple(edits)


def _element(model: mujoco.MjModel, form: NumberName, name: str, where: str) -> int:
    if form.element is None:
        return 0
    found = element_number(model, form.kind, form.element)
    if found < 0:
        there = [f"{form.kind}:{other}" for other in _names(model, form.kind)]
        near = suggest(f"{form.kind}:{form.element}", there)
        raise BadInput(f"{where}: '{name}': the model has no {form.kind} '{form.element}'; {near}")
    return found


def _column(numbers: np.ndarray, index: int | None, name: str, where: str) -> tuple[int, ...]:
    if not numbers.ndim:
        if index is not None:
            raise BadInput(f"{where}: '{name}' is one number; leave '[{index}]' out")
        return ()
    count = len(numbers)
    if (index or 0) >= count:
        raise BadInput(f"{where}: '{name}': there are {count} of it; give [0] to [{count - 1}]")
    if index is None and not ("gain" in name or "friction" in name or "gear" in name):
        raise BadInput(
            f"{where}: '{name}': there are {count} of it; write '{name}[0]' to "
            f"'{name}[{count - 1}]'"
        )
    return (index or 0,)


def _names(model: mujoco.MjModel, kind: str) -> list[str]:
    return [name for name in element_names(model, kind) if name]


def known_fields(model: Any) -> list[str]:
    """All names that a field of `model` (an MjModel, or gymnax's parameters) may have, vectors
    without their index.
    """
    names = list(INTERFACE)
    if isinstance(model, Lawed):
        return [*known_fields(model.native), *model.own]
    if not isinstance(model, mujoco.MjModel):
        if dataclasses.is_dataclass(model):
            own = [f.name for f in dataclasses.fields(model)]
        else:
            own = []
        return names + [
            f"params.{name}" for name in own if finite(getattr(model, name)) is not None
        ]
    for kind, attrs in ATTRIBUTES.items():
        if kind == "option":
            things = [""]
        else:
            things = [f":{name}" for name in _names(model, kind)]
        names += [f"{kind}{thing}.{attr}" for thing in things for attr in attrs]
    return names


def edited(model: Any, fields: Sequence[ModelField], values: Array) -> Any:
    """`model`, an `mjx.Model`, with `values [F]` of `fields` in their places; pure, of one
    sample.
    """
    changed: Table = {}
    for i, field in enumerate(fields):
        for edit in field.edits:
            array = jnp.asarray(changed.get(edit.array, array_at(model, edit.array)))
            value = (edit.factor * values[i]).astype(array.dtype)
            if "frictionloss" in edit.array:
                value = jnp.maximum(value, MIN_FRICTION)
            changed[edit.array] = array.at[edit.index].set(value)
    if changed:
        return model.tree_replace(changed)
    return model


def edit_native(model: mujoco.MjModel, fields: Sequence[ModelField], values: Any) -> mujoco.MjModel:
    """`model` itself with `values [F]` in their places, and what MuJoCo derives of them made
    anew.
    """
    for field, value in zip(fields, values, strict=True):
        for edit in field.edits:
            array_and_row, _, last = edit.array.rpartition(".")
            holder = getattr(model, array_and_row) if array_and_row else model
            if edit.index:
                getattr(holder, last)[edit.index] = edit.factor * value
            else:
                setattr(holder, last, edit.factor * value)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def space_of(
    model: Any, ranges: Mapping[str, Any], where: str = "fields"
) -> tuple[Space, tuple[ModelField, ...]]:
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
        ends = [x for x in map(finite, items) if x is not None]
        if not len(items) == len(ends) == 2 or scale not in ("linear", "log"):
            raise BadInput(
                f"{where}: '{name}' = {brief(given)}; give [low, high] or [low, high, \"log\"]"
            )
        low, high = ends
        if low < field.minimum:
            raise BadInput(
                f"{where}: '{name}' begins at {low} {field.unit}; its least is {field.minimum:g}"
            )
        parameters.append(Parameter(name, low, high, field.unit, scale, field.minimum))
        fields.append(field)
    return Space(tuple(parameters)), tuple(fields)


def domain_randomize(
    native: mujoco.MjModel, ranges: Mapping[str, Any]
) -> Callable[[Any, Array], tuple[Any, Any]]:
    """Fields by name, each drawn from its range for every environment.

    Args:
        native: The model that `ranges` names fields of.
        ranges: For each name `[low, high]`, or `[low, high, "log"]`, as in env.toml. Not those of
                the interface, such as `delay`.

    Returns:
        `randomize(model, rng [B]) -> (models, in_axes)`: an `mjx.Model` whose edited arrays have a
        leading axis `[B]`, and the pytree that says which, as `randomization_fn` of Playground's
        and Brax's training takes it.
    """
    space, fields = space_of(native, ranges)
    for field in fields:
        if not field.edits:
            raise BadInput(
                f"domain_randomize: '{field.name}' is of the interface, not of the model; leave it "
                "out"
            )
    arrays = sorted({edit.array for field in fields for edit in field.edits})

    def randomize(model: Any, rng: Array) -> tuple[Any, Any]:
        def one(key):
            new = edited(model, fields, space.physical(space.sample(key)))
            return {array: array_at(new, array) for array in arrays}

        in_axes = jax.tree.map(lambda _: None, model).tree_replace(dict.fromkeys(arrays, 0))
        return model.tree_replace(jax.vmap(one)(rng)), in_axes

    return randomize
