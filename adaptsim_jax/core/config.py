"""Config files: frozen dataclasses to and from TOML, with every key checked and the nearest name
offered.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import json
import tomllib
import types
import typing
from pathlib import Path
from typing import Any, TypeVar

from adaptsim_jax.core.errors import BadInput, brief, finite

T = TypeVar("T")
Table = dict[str, Any]
"""What a table of TOML, or an object of JSON, holds."""


def nearest(name: str, valid: typing.Iterable[str]) -> str | None:
    """The known name that `name` is most like, upper and lower case alike, or the one that ends in
    it; None where none is.
    """
    by_case = {other.lower(): other for other in valid}
    inside = [other for low, other in by_case.items() if low.endswith(f".{name.lower()}")]
    if len(inside) == 1:
        return inside[0]
    matches = difflib.get_close_matches(name.lower(), by_case, n=1, cutoff=0.6)
    if matches:
        return by_case[matches[0]]
    return None


def suggest(name: str, valid: typing.Iterable[str]) -> str:
    """'did you mean ...?' or 'known: ...': the mend for a name that is not known."""
    valid = list(valid)
    similar = nearest(name, valid)
    if similar:
        return f"did you mean '{similar}'?"
    return f"known: {', '.join(valid) or 'none'}"


def pick(kind: str, name: str, valid: typing.Iterable[str]) -> str:
    """`name` if it is known, else BadInput with the nearest name."""
    valid = list(valid)
    if name not in valid:
        raise BadInput(f"unknown {kind} '{name}'; {suggest(name, valid)}")
    return name


# ---------------------------------------------------------------- TOML


def read(path: str | Path, missing: str = "no such file; check the name") -> dict[str, Any]:
    """The table in a TOML file; BadInput with the line where it is not TOML. missing: What is said
    where there is no file.
    """
    try:
        return tomllib.loads(
            Path(path).read_bytes().decode("utf-8-sig")
        )  # editors on Windows put a mark before the text
    except FileNotFoundError:
        raise BadInput(f"{path}: {missing}") from None
    except OSError as error:
        raise BadInput(
            f"{path}: cannot be read ({error.strerror}); name a readable TOML file"
        ) from None
    except UnicodeDecodeError as error:
        raise BadInput(
            f"{path}: not text in UTF-8 (byte {error.start}); save it as UTF-8"
        ) from None
    except (
        ValueError,
        RecursionError,
    ) as error:  # not only TOMLDecodeError: dates and digits fail in Python's own words
        raise BadInput(
            f"{path}: not TOML ({' '.join(str(error).split())[:160]}); mend that line: in a path "
            "write / in place of a backslash"
        ) from None


def write(path: str | Path, table: dict[str, Any]) -> None:
    """`table` as a TOML file, whole or not at all."""
    from adaptsim_jax.core import files

    files.write_bytes(path, dumps(table).encode())


def dumps(table: dict[str, Any], heading: str = "") -> str:
    """TOML text of nested tables of numbers, strings, booleans and lists; None is left out.

    Args:
        table: Lists of tables become `[[arrays of tables]]`; paths become strings.
        heading: What stands above it, a comment for each line.
    """
    import tomlkit  # a command that writes no TOML does not wait for it

    comments = [f"# {line}" for line in heading.splitlines()]
    return "\n".join([*comments, tomlkit.dumps(_writable(table)).strip(), ""])


def _writable(value: Any) -> Any:
    """`value` in types that TOML has."""
    if isinstance(value, dict):
        return {str(k): _writable(v) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [_writable(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return value


# ---------------------------------------------------------------- dataclasses


def to_table(config: Any) -> Any:
    """A (nested) dataclass or named tuple as the table that `from_table` reads back."""
    if _is_record(type(config)):
        return {name: to_table(getattr(config, name)) for name in _fields(type(config))}
    if isinstance(config, tuple | list):
        return [to_table(item) for item in config]
    if isinstance(config, dict):
        return {name: to_table(value) for name, value in config.items()}
    return config


def _is_record(kind: Any) -> bool:
    return dataclasses.is_dataclass(kind) or (
        isinstance(kind, type) and hasattr(kind, "_field_defaults")
    )


def _fields(kind: Any) -> dict[str, bool]:
    """The fields of a dataclass or named tuple, and whether each must be given."""
    if not dataclasses.is_dataclass(kind):
        return {name: name not in kind._field_defaults for name in kind._fields}
    missing = dataclasses.MISSING
    return {
        field.name: field.default is missing and field.default_factory is missing
        for field in dataclasses.fields(kind)
        if field.init
    }


def _deeper(kind: Any, name: str, prefix: str) -> str | None:
    """The dotted key of that very name in a table within `kind`: people leave out the table."""
    for field, hint in typing.get_type_hints(kind).items():
        if _is_record(hint):
            path = f"{prefix}{field}."
            if found := f"{path}{name}" if name in _fields(hint) else _deeper(hint, name, path):
                return found
    return None


def from_table(kind: type[T], table: dict[str, Any], where: str, prefix: str = "") -> T:
    """A dataclass of type `kind` from a table; BadInput names an unknown, missing or ill-typed key.
    What a nested table leaves out is as it is in that field's default.
    """
    hints = typing.get_type_hints(kind)
    fields = _fields(kind)
    for name in table:
        if name not in fields:
            deeper = _deeper(kind, name, prefix)
            if deeper:
                mend = f"did you mean '{deeper}'?"
            else:
                mend = suggest(name, fields)
            raise BadInput(f"{where}: unknown key '{prefix}{name}'; {mend}")
    values = {}
    for name, needed in fields.items():
        if name in table:
            value = table[name]
            if _is_record(hints[name]) and isinstance(value, dict) and not needed:
                value = over(_default(kind, name), value)
            values[name] = _typed(hints[name], value, where, f"{prefix}{name}")
        elif needed:
            raise BadInput(f"{where}: key '{prefix}{name}' is missing; add it")
    return kind(**values)


def over(base: dict[str, Any], table: dict[str, Any]) -> dict[str, Any]:
    """`table` over `base`, key by key in nested tables."""

    def nested(name):
        return isinstance(base.get(name), dict) and isinstance(table[name], dict)

    return base | {
        name: over(base[name], table[name]) if nested(name) else table[name] for name in table
    }


def _default(kind: Any, name: str) -> dict[str, Any]:
    """The default of a field that is a record, as a table."""
    if not dataclasses.is_dataclass(kind):
        return to_table(kind._field_defaults[name])
    field = next(f for f in dataclasses.fields(kind) if f.name == name)
    if field.default_factory is dataclasses.MISSING:
        default = field.default
    else:
        default = field.default_factory()
    return to_table(default)


def _typed(hint: Any, value: Any, where: str, key: str) -> Any:
    origin = typing.get_origin(hint)
    if _is_record(hint) and isinstance(value, dict):
        return from_table(hint, value, where, f"{key}.")
    if origin is typing.Literal:
        if value in typing.get_args(hint):
            return value
        raise BadInput(
            f"{where}: key '{key}' is {brief(value)}; one of {list(typing.get_args(hint))} is "
            "wanted"
        )
    if origin in (types.UnionType, typing.Union):
        return _first_fit(typing.get_args(hint), value, where, key)
    if origin in (tuple, list) and isinstance(value, list | tuple):
        return _sequence(hint, value, where, key)
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        if (number := finite(value)) is None:
            raise BadInput(f"{where}: key '{key}' is {brief(value)}; a finite number is wanted")
        return number
    if hint is Any or (isinstance(hint, type) and type(value) is hint):
        return value
    if origin is dict and isinstance(value, dict):
        return value
    name = getattr(hint, "__name__", str(hint))
    raise BadInput(f"{where}: key '{key}' is {brief(value)}; a value of type {name} is wanted")


def _first_fit(hints: tuple[Any, ...], value: Any, where: str, key: str) -> Any:
    error: BadInput | None = None
    for hint in hints:
        if hint is type(None):
            if value is None:
                return None
            continue
        try:
            return _typed(hint, value, where, key)
        except BadInput as this:
            error = this
    raise error or BadInput(f"{where}: key '{key}' is {brief(value)}; leave it out")


def _sequence(hint: Any, value: Any, where: str, key: str) -> Any:
    arguments = typing.get_args(hint)
    if typing.get_origin(hint) is list or (len(arguments) == 2 and arguments[1] is Ellipsis):
        kinds = [arguments[0]] * len(value)
    else:
        kinds = list(arguments)
    if len(kinds) != len(value):
        raise BadInput(f"{where}: key '{key}' has {len(value)} entries; {len(kinds)} are wanted")
    items = [
        _typed(kind, item, where, f"{key}[{i}]")
        for i, (kind, item) in enumerate(zip(kinds, value, strict=True))
    ]
    if typing.get_origin(hint) is tuple:
        return tuple(items)
    return items


def with_settings(config: T, settings: typing.Sequence[str]) -> T:
    """`config` with `key=value` strings applied (dotted keys reach into nested tables; values are
    TOML).
    """
    table = to_table(config)
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals:
            raise BadInput(f"--set {setting}: no '='; write --set key=value")
        *parents, last = key.strip().split(".")
        _level(table, type(config), parents, f"--set {setting}")[last] = _parsed(text)
    return from_table(type(config), table, "--set")


def _parsed(text: str) -> Any:
    try:
        return tomllib.loads(f"v = {text}")["v"]
    except (ValueError, RecursionError):
        return text  # a bare word is a string


def _level(
    table: dict[str, Any], hint: Any, parents: typing.Sequence[str], where: str
) -> dict[str, Any]:
    """The nested table that `parents` lead to. In a field of any keys (`dict`) it is made where it
    is missing. Whoever reads that field checks the keys.
    """
    path = ""
    for name in parents:
        path += name
        if _is_record(hint):
            if name not in table:
                raise BadInput(f"{where}: unknown key '{path}'; {suggest(name, table)}")
            hint = typing.get_type_hints(hint)[name]
        elif typing.get_origin(hint) is dict:
            table.setdefault(name, {})
        table, path = table[name], f"{path}."
        if not isinstance(table, dict):
            raise BadInput(f"{where}: '{path[:-1]}' is no table; write --set {path[:-1]}=VALUE")
    return table


# ---------------------------------------------------------------- comparing


def flatten(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one with dotted keys; None is the same as absent, a tuple as a list."""
    flat: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, dict):
            flat |= flatten(value, f"{prefix}{name}.")
        elif value is not None:
            if isinstance(value, tuple):
                flat[f"{prefix}{name}"] = list(value)
            else:
                flat[f"{prefix}{name}"] = value
    return flat


def differences(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """'key: 3 there, 4 asked' for every key in which two config tables differ."""
    flat_old, flat_new = flatten(old), flatten(new)
    keys = sorted(flat_old.keys() | flat_new.keys())
    return [
        f"{key}: {flat_old.get(key, 'unset')} there, {flat_new.get(key, 'unset')} asked"
        for key in keys
        if flat_old.get(key) != flat_new.get(key)
    ]


def digest(table: dict[str, Any]) -> str:
    """A hash of a config table that does not depend on the order of its keys."""
    return hashlib.sha256(json.dumps(flatten(table), sort_keys=True).encode()).hexdigest()
