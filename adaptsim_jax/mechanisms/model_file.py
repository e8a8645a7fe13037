"""`model.toml`: a model as a file, declared parameters and the effects that were added to it. Read
and checked here.

schema = 1
task = "pendulum"
model = "rigid_body"            # or "linearized"
angle_zero = "hanging"          # or "upright"
[geometry]                      # l1, l2 in m, g in m/s^2
[known]                         # parameters that were not fitted
[declared.NAME]                 # value, low, high, unit, fitted: one table for each parameter of
the model [[effects]]                     # name, where, then [effects.parameters.NAME] with value,
low, high, unit [trial_clock]                   # s by trial's name: shifts of the clock of what
goes on between trials [covariance]                    # names, matrix: of all that was fitted
[provenance]                    # free: what made it
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.given import brief, finite
from adaptsim_jax.effects.base import Effect, Parameter, Sharp
from adaptsim_jax.effects.layout import Layout
from adaptsim_jax.effects.registry import catalogue, effect_named
from adaptsim_jax.mechanisms.plant import Plant
from adaptsim_jax.mechanisms.registry import make_plant

SCHEMA = 1
KEYS = (
    "schema",
    "task",
    "model",
    "angle_zero",
    "geometry",
    "known",
    "declared",
    "effects",
    "trial_clock",
    "covariance",
    "provenance",
)
NEEDED = ("schema", "task", "model", "angle_zero", "geometry", "declared")
RENEW = "take the file that `adaptsim diagnose` wrote"
NARROW = 0.02  # rad/s of friction: nothing beside the speeds of a task


@dataclass(frozen=True)
class Value:
    """A fitted number with its 90 % interval."""

    value: float
    low: float
    high: float
    unit: str
    fitted: bool = True


@dataclass(frozen=True)
class AddedEffect:
    """An effect of the model: which, where, and every parameter of it."""

    name: str
    where: str
    parameters: dict[str, Value]


@dataclass(frozen=True)
class ModelFile:
    """A model as `model.toml` holds it; `path` is where it was read from, `library` the catalogue
    that its effects are taken from (the task's where empty).
    """

    task: str
    model: str
    angle_zero: str
    geometry: dict[str, float]
    declared: dict[str, Value]
    effects: tuple[AddedEffect, ...] = ()
    known: dict[str, float] = field(default_factory=dict)
    names: tuple[str, ...] = ()  # of the rows of `covariance`
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    provenance: dict[str, Any] = field(default_factory=dict)
    path: str = "model.toml"
    trial_clock: dict[str, float] = field(default_factory=dict)
    library: tuple[Effect, ...] = ()

    def effect(self, name: str) -> Effect:
        """What an effect's name stands for; raises BadInput where neither library nor catalogue has
        it.
        """
        return effect_named(name, self.library or catalogue(self.task))

    def fixed_effect(self, name: str) -> Effect:
        """The same for a task, which varies nothing but amplitudes: friction of the model that is
        all but sharp is `Sharp`.
        """
        effect = self.effect(name)
        known = any(p.name == "width" and p.late for p in effect.parameters)
        widths = [
            e.parameters["width"].value
            for e in self.effects
            if e.name == name and "width" in e.parameters
        ]
        if known and max(widths, default=0.0) <= NARROW:
            return replace(effect, apply=Sharp(effect.apply))
        return effect

    @property
    def active(self) -> tuple[tuple[str, str], ...]:
        """(effect, where) of every effect."""
        return tuple((e.name, e.where) for e in self.effects)

    def plant(self) -> Plant:
        """The declared model without its effects."""
        return make_plant(self.model, self.angle_zero, self.geometry, self.known)

    def theta(self, plant: Plant) -> np.ndarray:
        """Declared parameters `[P]` in the plant's order."""
        return np.array([self.declared[name].value for name in plant.theta_names])

    def effect_vector(self, layout: Layout) -> np.ndarray:
        """Flat effect parameters `[E]`: everything off but this model's own effects."""
        out = layout.off()
        for e in self.effects:
            instance = layout.instances[layout.index(e.name, e.where)]
            given = {name: value.value for name, value in e.parameters.items()}
            out[instance.at] = [given.get(p.name, p.default) for p in instance.effect.parameters]
        return out


def read_model(path: str | Path, effects: Sequence[Effect] | None = None) -> ModelFile:
    """Read and check a `model.toml`. effects: the catalogue that its effects are taken from (the
    task's where None).

    Raises BadInput that names the file, the key and the mend.
    """
    return model_of(config.read(path), str(path), effects)


def model_of(
    table: Mapping[str, Any], where: str, effects: Sequence[Effect] | None = None
) -> ModelFile:
    """The same from a table that was read already; `where` names it in errors."""
    for key in table:
        if key not in KEYS:
            raise BadInput(f"{where}: unknown key '{key}'; {config.suggest(key, KEYS)}")
    for key in NEEDED:
        if key not in table:
            raise BadInput(f"{where}: key '{key}' is missing; {RENEW}")
    if table["schema"] != SCHEMA:
        raise BadInput(
            f"{where}: schema = {table['schema']!r}, this version reads {SCHEMA}; {RENEW}"
        )
    task, model = _text(where, table, "task"), _text(where, table, "model")
    if task != "pendulum":
        raise BadInput(
            f"{where}: task = {task!r} has no models to mend in this version; known: pendulum"
        )
    geometry, known = _numbers(where, table, "geometry"), _numbers(where, table, "known")
    try:
        plant = make_plant(model, _text(where, table, "angle_zero"), geometry, known)
    except BadInput as error:
        raise BadInput(f"{where}: {str(error).removeprefix('meta.toml: ')}") from None
    names, covariance = _covariance(where, _table(where, table, "covariance"))
    return ModelFile(
        task,
        model,
        table["angle_zero"],
        geometry,
        _declared(where, _table(where, table, "declared"), plant),
        _effects(where, table.get("effects", []), plant, tuple(effects or catalogue(task))),
        known,
        names,
        covariance,
        _table(where, table, "provenance"),
        where,
        _numbers(where, table, "trial_clock"),
        tuple(effects or ()),
    )


def _table(where: str, table: Mapping, key: str) -> dict[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise BadInput(f"{where}: '{key}' must be a table; write [{key}] and a line for each entry")
    return value


def _text(where: str, table: Mapping, key: str) -> str:
    value = table.get(key)
    if not isinstance(value, str):
        raise BadInput(f"{where}: {key} = {value!r} must be text in quotes; {RENEW}")
    return value


def _number(where: str, key: str, value: Any) -> float:
    number = finite(value)
    if number is None:
        raise BadInput(
            f"{where}: {key} = {brief(value)} must be a finite number; give one in its unit"
        )
    return number


def _numbers(where: str, table: Mapping, key: str) -> dict[str, float]:
    return {k: _number(where, f"{key}.{k}", v) for k, v in _table(where, table, key).items()}


def _value(where: str, key: str, table: Any, unit: str) -> Value:
    """One parameter: a table, or a bare number from a person's hand. Its unit must be the
    model's.
    """
    if not isinstance(table, dict):
        table = {"value": table}
    for name in table:
        if name not in ("value", "low", "high", "unit", "fitted"):
            raise BadInput(
                f"{where}: unknown key '{key}.{name}'; use value, low, high, unit, fitted"
            )
    if "value" not in table:
        raise BadInput(f"{where}: key '{key}.value' is missing; add it in {unit}")
    value = _number(where, f"{key}.value", table["value"])
    low, high = (_number(where, f"{key}.{end}", table.get(end, value)) for end in ("low", "high"))
    if not low <= value <= high:
        raise BadInput(
            f"{where}: {key} = {value:g} is outside its own interval [{low:g}, {high:g}]; mend one "
            f"of them"
        )
    if table.get("unit", unit) != unit:
        raise BadInput(
            f"{where}: {key}.unit = {table['unit']!r}, but it is in {unit!r}; convert the value"
        )
    if not isinstance(table.get("fitted", True), bool):
        raise BadInput(f"{where}: {key}.fitted must be true or false")
    return Value(value, low, high, unit, table.get("fitted", True))


def _declared(where: str, table: Mapping, plant: Plant) -> dict[str, Value]:
    for name in table:
        if name not in plant.theta_names:
            raise BadInput(
                f"{where}: unknown parameter 'declared.{name}'; the model has "
                f"{', '.join(plant.theta_names)}"
            )
    out = {}
    for name, unit, low, high in zip(
        plant.theta_names, plant.theta_units, plant.low, plant.high, strict=True
    ):
        if name not in table:
            raise BadInput(f"{where}: key 'declared.{name}' is missing; add it in {unit}")
        out[name] = value = _value(where, f"declared.{name}", table[name], unit)
        if not low <= value.value <= high:
            raise BadInput(
                f"{where}: declared.{name} = {value.value:g} {unit} is not within [{low:g}, "
                f"{high:g}]; mend it"
            )
    return out


def _effects(
    where: str, rows: Any, plant: Plant, known: tuple[Effect, ...]
) -> tuple[AddedEffect, ...]:
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise BadInput(
            f"{where}: 'effects' must be a list of tables; write [[effects]] before each"
        )
    out: list[AddedEffect] = []
    for i, row in enumerate(rows):
        new = _effect(where, f"effects[{i}]", row, plant, {e.name: e for e in known})
        if (new.name, new.where) in {(e.name, e.where) for e in out}:
            raise BadInput(
                f"{where}: effects[{i}] names {new.name} at {new.where} again; keep one of them"
            )
        out.append(new)
    return tuple(out)


def _effect(
    where: str, key: str, row: Mapping, plant: Plant, known: Mapping[str, Effect]
) -> AddedEffect:
    for name in row:
        if name not in ("name", "where", "parameters"):
            raise BadInput(f"{where}: unknown key '{key}.{name}'; use name, where, parameters")
    name = str(row.get("name"))
    if name not in known:
        raise BadInput(
            f"{where}: {key}.name = {name!r} is not in the catalogue; "
            f"{config.suggest(str(name), known)}"
        )
    effect = known[name]
    places = plant.joints if effect.scope == "joint" else ("base",)
    if row.get("where") not in places:
        raise BadInput(
            f"{where}: {key}.where = {row.get('where')!r}; {name} acts at {' or '.join(places)}"
        )
    table = _table(where, row, "parameters")
    for parameter in table:
        if parameter not in {p.name for p in effect.parameters}:
            wanted = ", ".join(p.name for p in effect.parameters)
            raise BadInput(
                f"{where}: unknown parameter '{key}.parameters.{parameter}'; {name} has {wanted}"
            )
    stated = [p for p in effect.parameters if p.name in table or not p.optional]
    values = {p.name: _parameter(where, f"{key}.parameters.{p.name}", table, p) for p in stated}
    return AddedEffect(name, row["where"], values)


def _parameter(where: str, key: str, table: Mapping, p: Parameter) -> Value:
    if p.name not in table:
        raise BadInput(f"{where}: key '{key}' is missing; add its value in {p.unit}")
    value = _value(where, key, table[p.name], p.unit)
    if p.sign > 0 and value.value < 0:
        raise BadInput(
            f"{where}: {key} = {value.value:g} {p.unit} is negative, which this effect cannot be; "
            f"mend it"
        )
    return value


def _covariance(where: str, table: Mapping) -> tuple[tuple[str, ...], np.ndarray]:
    names = table.get("names", [])
    try:
        matrix = np.asarray(table.get("matrix", []), float).reshape(len(names), len(names))
    except (TypeError, ValueError, OverflowError):
        raise BadInput(
            f"{where}: [covariance] must have a row and a column for each of its names; {RENEW}"
        ) from None
    if not np.all(np.isfinite(matrix)) or not all(isinstance(n, str) for n in names):
        raise BadInput(f"{where}: [covariance] must hold finite numbers under names; {RENEW}")
    return tuple(names), matrix
