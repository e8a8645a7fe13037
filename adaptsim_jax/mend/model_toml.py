"""`model.toml`: a declared model with fitted numbers and added effects, one form for every task.

    schema = 2
    task = "mechanism"              # or pendulum, pushing, scooping, toss, simulator
    model = "declared.xml"          # what was declared: a file beside this one, or a name
    KEY = ...                       # keys and tables of the task's own
    [declared.NAME]                 # value, low, high, unit, fitted
    [[effects]]                     # name, where: a joint, "base", "camera" ...
    [effects.parameters.NAME]       # value, low, high, unit
    [provenance]                    # free: what made it

Intervals (90 %) stand where they are known. A bare number may stand for a table with its value.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from adaptsim_jax import __version__
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput, brief, finite

FILE = "model.toml"
SCHEMA = 2
COMMON = ("schema", "task", "model", "declared", "effects", "provenance")
RENEW = "take the file that `adaptsim diagnose` wrote"


@dataclass(frozen=True)
class Value:
    """A number of a model, where known with its 90 % interval."""

    value: float
    low: float | None = None
    high: float | None = None
    unit: str = ""
    fitted: bool = True

    def table(self) -> dict[str, Any]:
        """As the file has it."""
        out = asdict(self)
        if self.low is None:
            del out["fitted"]
        return out


@dataclass(frozen=True)
class AddedEffect:
    """An effect of the model: which, where, and its parameters."""

    name: str
    where: str
    parameters: dict[str, Value]


@dataclass(frozen=True)
class Form:
    """What a `model.toml` holds; own: keys of the task's own; path: where it was read from."""

    task: str
    model: str
    declared: dict[str, Value] = field(default_factory=dict)
    effects: tuple[AddedEffect, ...] = ()
    own: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    path: str = FILE

    def text(self, use: str = "") -> str:
        """The TOML text. use: what the file may be given to, for its heading."""
        effects = [
            {
                "name": effect.name,
                "where": effect.where,
                "parameters": {k: v.table() for k, v in effect.parameters.items()},
            }
            for effect in self.effects
        ]
        table = {"schema": SCHEMA, "task": self.task, "model": self.model, **self.own}
        if self.declared:
            table["declared"] = {name: value.table() for name, value in self.declared.items()}
        if effects:
            table["effects"] = effects
        package = {"package": f"adaptsim_jax {__version__}"}
        table["provenance"] = package | self.provenance
        heading = "A model fitted by `adaptsim diagnose`"
        return config.dumps(table, f"{heading}; {use}." if use else f"{heading}.")


def added_effects(effects: Iterable[Any], values: Mapping[str, float]) -> tuple[AddedEffect, ...]:
    """Effects (`effects.base.Effect`) with `values` of their parameters by name."""
    added = []
    for e in effects:
        numbers = {p.name: Value(values[p.name], unit=p.unit) for p in e.parameters}
        added.append(AddedEffect(e.name, e.place, numbers))
    return tuple(added)


def check_schema(table: Mapping[str, Any], where: str) -> None:
    """BadInput where a model file is of another version's form."""
    schema = table.get("schema")
    if schema == SCHEMA:
        return
    if schema == 1:
        raise BadInput(
            f"{where}: schema = 1 was written by adaptsim_jax 0.1, this version reads {SCHEMA}; "
            "run `adaptsim diagnose` again"
        )
    if "schema" not in table:
        raise BadInput(f"{where}: key 'schema' is missing; {RENEW}")
    raise BadInput(f"{where}: schema = {schema!r}, this version reads {SCHEMA}; {RENEW}")


def read_form(table: Mapping[str, Any], where: str, own: Sequence[str]) -> Form:
    """A checked `model.toml`; names, units and ranges are the task's to check.

    Args:
        table: as it was read. where: names the file in errors.
        own: keys that the task has besides those that every file has.

    Raises BadInput that names the file, the key and the mend.
    """
    check_schema(table, where)
    known = (*COMMON, *own)
    for key in table:
        if key not in known:
            raise BadInput(f"{where}: unknown key '{key}'; {config.suggest(key, known)}")
    for key in ("task", "model"):
        if key not in table:
            raise BadInput(f"{where}: key '{key}' is missing; {RENEW}")
    declared = table_at(where, table, "declared")
    task, model = text_at(where, table, "task"), text_at(where, table, "model")
    values = {name: _value(where, f"declared.{name}", value) for name, value in declared.items()}
    return Form(
        task,
        model,
        values,
        _effects(where, table.get("effects", [])),
        {key: table[key] for key in own if key in table},
        table_at(where, table, "provenance"),
        where,
    )


def read_model_table(path: str | Path) -> dict[str, Any]:
    """The table of a model file, of this version's form."""
    table = config.read(path)
    check_schema(table, str(path))
    return table


def table_at(where: str, table: Mapping[str, Any], key: str) -> dict[str, Any]:
    """A table of a file, empty where it is not there."""
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise BadInput(f"{where}: '{key}' must be a table; write [{key}] and a line for each entry")
    return value


def text_at(where: str, table: Mapping[str, Any], key: str) -> str:
    """A text of a file."""
    value = table.get(key)
    if not isinstance(value, str):
        raise BadInput(f"{where}: {key} = {brief(value)} must be text in quotes; {RENEW}")
    return value


def number_at(where: str, key: str, value: Any) -> float:
    """A finite number of a file."""
    number = finite(value)
    if number is None:
        raise BadInput(
            f"{where}: {key} = {brief(value)} must be a finite number; give one in its unit"
        )
    return number


def numbers_at(where: str, table: Mapping[str, Any], key: str) -> dict[str, float]:
    """A table of numbers of a file."""
    rows = table_at(where, table, key)
    return {name: number_at(where, f"{key}.{name}", value) for name, value in rows.items()}


def _value(where: str, key: str, given: Any) -> Value:
    table = given if isinstance(given, dict) else {"value": given}
    for name in table:
        if name not in ("value", "low", "high", "unit", "fitted"):
            raise BadInput(
                f"{where}: unknown key '{key}.{name}'; use value, low, high, unit, fitted"
            )
    if "value" not in table:
        raise BadInput(f"{where}: key '{key}.value' is missing; add it")
    value = number_at(where, f"{key}.value", table["value"])
    ends = [table.get(end) for end in ("low", "high")]
    if ends != [None, None]:
        low, high = (
            number_at(where, f"{key}.{end}", table.get(end, value)) for end in ("low", "high")
        )
        if not low <= value <= high:
            raise BadInput(
                f"{where}: {key} = {value:g} is outside its own interval [{low:g}, {high:g}]; mend "
                "one of them"
            )
        ends = [low, high]
    if not isinstance(table.get("unit", ""), str):
        raise BadInput(f"{where}: {key}.unit must be text in quotes")
    if not isinstance(table.get("fitted", True), bool):
        raise BadInput(f"{where}: {key}.fitted must be true or false")
    return Value(value, *ends, unit=table.get("unit", ""), fitted=table.get("fitted", True))


def _effects(where: str, rows: Any) -> tuple[AddedEffect, ...]:
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise BadInput(
            f"{where}: 'effects' must be a list of tables; write [[effects]] before each"
        )
    out: list[AddedEffect] = []
    for i, row in enumerate(rows):
        key = f"effects[{i}]"
        for name in row:
            if name not in ("name", "where", "parameters"):
                raise BadInput(f"{where}: unknown key '{key}.{name}'; use name, where, parameters")
        name, place = (str(row.get(key)) for key in ("name", "where"))
        if (name, place) in {(e.name, e.where) for e in out}:
            raise BadInput(f"{where}: {key} names {name} at {place} again; keep one of them")
        given = table_at(where, row, "parameters")
        values = {p: _value(where, f"{key}.parameters.{p}", v) for p, v in given.items()}
        out.append(AddedEffect(name, place, values))
    return tuple(out)
