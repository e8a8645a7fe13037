"""What every `meta.toml` is checked for, key by key; `BadInput` names the file, the key and the
mend.
"""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput, brief, finite

TEXT_KEYS = ("name", "description", "note", "source", "license")
"""What a person may write about any recording."""
TASKS = ("pendulum", "mechanism", "pushing", "scooping", "toss")
MISSING = (
    "missing; `adaptsim init DATA --model FILE` writes one of a mechanism, that of a double "
    "pendulum has task, model, angle_zero"
)
SHORT_TRIALS = (
    "missing; with an actions.csv these look like measured pushes or scoops: "
    'it needs one line, task = "pushing" or task = "scooping"'
)


def declared_task(folder: str | Path) -> str | None:
    """The task that a folder's meta.toml declares; None where there is none that can be read."""
    try:
        text = (Path(folder) / "meta.toml").read_text(encoding="utf-8")
        task = tomllib.loads(text).get("task")
    except (OSError, ValueError):
        return None
    if isinstance(task, str):
        return task
    return None


def check_keys(
    path: Path, table: Mapping[str, Any], keys: Sequence[str], name: str = ""
) -> Mapping[str, Any]:
    """The table [name] (none: all of the file), of which every key is one of `keys`."""
    for key in table:
        if key not in keys:
            where = f" in [{name}]" if name else ""
            raise BadInput(f"{path}: unknown key {key!r}{where}; {suggest(key, keys)}")
    return table


def tables(path: Path, raw: Mapping[str, Any], names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """The tables of these names, empty where they are not there; TEXT_KEYS are looked at, too."""
    for key in TEXT_KEYS:
        text(path, key, raw.get(key, ""), empty=True)
    for name in names:
        if not isinstance(raw.get(name, {}), dict):
            raise BadInput(
                f"{path}: {name} must be a table; write [{name}] with a key = value line each"
            )
    return {name: raw.get(name, {}) for name in names}


def text(
    path: Path, key: str, value: Any, valid: Sequence[str] | None = None, empty: bool = False
) -> str:
    """A text, one of `valid` where these are given."""
    if not isinstance(value, str) or not (value or empty):
        raise BadInput(f"{path}: {key} must be text in quotes, not {brief(value)}")
    if valid is not None and value not in valid:
        raise BadInput(f"{path}: {key} = {brief(value)} is unknown; {suggest(value, valid)}")
    return value


def choice(
    path: Path, raw: Mapping[str, Any], key: str, valid: Sequence[str] | None = None
) -> str | None:
    """The text of a key, one of `valid` where these are given; None where there is no such key."""
    if key in raw:
        return text(path, key, raw[key], valid, empty=True)
    return None


def number(path: Path, key: str, value: Any) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadInput(f"{path}: {key} must be a number, not {brief(value)}")
    if (found := finite(value)) is None:
        raise BadInput(f"{path}: {key} = {brief(value)} is not finite; give the value in SI units")
    return found


def not_negative(
    path: Path, key: str, value: Any, what: str = "a standard deviation in SI units"
) -> float:
    """A number that is not below 0.

    Args:
        what: What is to be given.
    """
    if (found := number(path, key, value)) < 0:
        raise BadInput(f"{path}: {key} = {found:g} is negative; give {what}")
    return found
