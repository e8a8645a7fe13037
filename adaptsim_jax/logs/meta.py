"""The schema of `meta.toml`: what a person declares about a recording, checked key by key."""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from adaptsim_jax.core.config import read, suggest
from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.given import brief
from adaptsim_jax.logs.declared import TEXT_KEYS, choice, known, not_negative, number, tables, text
from adaptsim_jax.logs.log_units import (
    ANGLE_UNITS,
    SPELT,
    TIME_UNITS,
    TORQUE_UNITS,
    VELOCITY_UNITS,
    column_unit,
)
from adaptsim_jax.mechanisms.registry import MECHANISMS

ANGLE_ZEROS = ("upright", "hanging")
TORQUE_SOURCES = ("measured", "commanded", "applied")
CHANNELS = ("q1", "q2", "v1", "v2", "tau1", "tau2")
GROUPS = {"q": "angle", "v": "velocity", "tau": "torque"}
"""Column stem -> the unit group that it belongs to."""

UNITS = {
    "time": TIME_UNITS,
    "angle": ANGLE_UNITS,
    "velocity": VELOCITY_UNITS,
    "torque": TORQUE_UNITS,
}

TASKS = ("pendulum", "mechanism", "pushing", "scooping", "toss")
MISSING = "missing; `adaptsim init DATA --model FILE` writes one of a mechanism, that of a double pendulum has task, model, angle_zero"
SHORT_TRIALS = (
    "missing; with an actions.csv these look like measured pushes or scoops: "
    'it needs one line, task = "pushing" or task = "scooping"'
)
REQUIRED = ("task", "model", "angle_zero")
TABLES = ("geometry", "known", "noise", "units")
KEYS = (*REQUIRED, *TABLES, "model_file", "torque", "unactuated", *TEXT_KEYS)


@dataclass(frozen=True)
class Meta:
    """What `meta.toml` declares; `scale` turns each column into SI: `si = scale[column] * read`."""

    task: str
    model: str
    angle_zero: str
    model_file: str | None = None
    torque: str | None = None
    unactuated: tuple[int, ...] = ()
    geometry: dict[str, float] = field(default_factory=dict)
    known: dict[str, float] = field(default_factory=dict)
    noise: dict[str, float] = field(default_factory=dict)
    scale: dict[str, float] = field(default_factory=dict)
    angle_stated: bool = False
    notes: tuple[str, ...] = ()


def declared_task(folder: str | Path) -> str | None:
    """The task that a folder's meta.toml declares; None where there is none, or none that can be
    read (its own reader says why).
    """
    try:
        task = tomllib.loads((Path(folder) / "meta.toml").read_text(encoding="utf-8")).get("task")
    except (OSError, ValueError):
        return None
    if isinstance(task, str):
        return task
    return None


def read_meta(path: str | Path) -> Meta:
    """Read and check a `meta.toml`. Raises `BadInput` naming the file and the key."""
    path = Path(path)
    raw = read(path, SHORT_TRIALS if (path.parent / "actions.csv").exists() else MISSING)
    if raw.get("task") not in ("pendulum", None):
        choice(path, raw, "task", TASKS)
    known(path, raw, KEYS)
    for key in REQUIRED:
        if key not in raw:
            raise BadInput(f"{path}: key {key!r} is missing; add {key} = {_example(key)}")
    told = tables(path, raw, TABLES)
    model, model_file = _model(path, raw)
    given = read(model_file).get("geometry", {}) if model_file else {}
    geometry, notes = _geometry(
        path, given | told["geometry"] if isinstance(given, dict) else {}, model
    )
    return Meta(
        task=choice(path, raw, "task", ("pendulum",)) or "",
        model=model,
        angle_zero=choice(path, raw, "angle_zero", ANGLE_ZEROS) or "",
        model_file=model_file,
        torque=choice(path, raw, "torque", TORQUE_SOURCES),
        unactuated=_joints(path, raw.get("unactuated", [])),
        geometry=geometry,
        known={k: number(path, f"known.{k}", v) for k, v in told["known"].items()},
        noise=_noise(path, told["noise"]),
        scale=_scales(path, told["units"]),
        angle_stated=not {"angle", "q", "q1", "q2"}.isdisjoint(told["units"]),
        notes=notes,
    )


def check_known(path: str, known: dict[str, float], names: tuple[str, ...]) -> None:
    """Raise `BadInput` where `[known]` names a parameter that the model has not ."""
    for key in known:
        if key not in names:
            raise BadInput(
                f"{path}/meta.toml: [known] {key!r} is no parameter of the model; "
                f"{suggest(key, names)}"
            )


def _example(key: str) -> str:
    examples = {
        "task": '"pendulum"',
        "model": '"rigid_body" or "linearized"',
        "angle_zero": '"hanging" or "upright"',
    }
    return examples[key]


def _model(path: Path, raw: dict) -> tuple[str, str | None]:
    """The base model, and the path of a mended model where one is named (parsed by its own
    reader).
    """
    value = choice(path, raw, "model") or ""
    file = choice(path, raw, "model_file")
    if value.endswith(".toml"):
        file, value = value, ""
    if file is None:
        return choice(path, raw, "model", tuple(MECHANISMS)) or "", None
    where = (path.parent / file).resolve()
    if not where.is_file():
        raise BadInput(
            f"{path}: model file {file!r} does not exist beside it; give its path relative to the "
            f"folder"
        )
    base = value or read(where).get("model")
    if not isinstance(base, str) or base not in MECHANISMS:
        raise BadInput(
            f"{where}: model = {brief(base)} is unknown; it must be one of {', '.join(MECHANISMS)}"
        )
    return base, str(where)


def _geometry(path: Path, raw: dict, model: str) -> tuple[dict[str, float], tuple[str, ...]]:
    known(path, raw, ("l1", "l2", "g"), "geometry")
    given = {k: number(path, f"geometry.{k}", v) for k, v in raw.items()}
    for key, value in given.items():
        if not (value > 0 or (key == "g" and value == 0)) or value > 1e3:
            unit = "m/s^2" if key == "g" else "m"
            raise BadInput(
                f"{path}: geometry.{key} = {value:g} is not physical; give it in {unit}, above 0"
            )
    if model == "linearized":
        defaults = {"l1": 1.0, "l2": 1.0, "g": GRAVITY}
    else:
        defaults = {"g": GRAVITY}
    assumed = {k: v for k, v in defaults.items() if k not in given}
    notes = (
        f"geometry not declared, assumed: {', '.join(f'{k} = {v:g}' for k, v in assumed.items())}",
    )
    return {**defaults, **given}, notes if assumed else ()


def _noise(path: Path, raw: dict) -> dict[str, float]:
    """Standard deviations by channel; `q` or `angle`, `v` or `velocity`, `tau` or `torque` stand
    for both joints.
    """
    out: dict[str, float] = {}
    known(path, raw, (*CHANNELS, *GROUPS, *GROUPS.values()), "noise")
    raw = {stem: raw[group] for stem, group in GROUPS.items() if group in raw} | {
        k: v for k, v in raw.items() if k not in GROUPS.values()
    }
    for key, value in raw.items():
        std = not_negative(path, f"noise.{key}", value)
        names = (key,) if key in CHANNELS else (f"{key}1", f"{key}2")
        out |= {name: std for name in names if name == key or name not in raw}
    return out


def _joints(path: Path, raw: Any) -> tuple[int, ...]:
    if not isinstance(raw, list) or any(isinstance(j, bool) or j not in (1, 2) for j in raw):
        raise BadInput(
            f"{path}: unactuated must be a list of joint numbers such as [1], not {brief(raw)}"
        )
    return tuple(sorted(set(raw)))


def _scales(path: Path, raw: dict) -> dict[str, float]:
    """SI scale of every column from `[units]`: by quantity (`angle`), by stem (`q`) or by column
    (`q1`), the closest word counts.

    The velocity follows the angle of its joint unless it is declared.
    """
    known(path, raw, (*UNITS, *GROUPS, *CHANNELS), "units")
    units = {key: _unit(path, key, value) for key, value in raw.items()}

    def of(column):
        return column_unit(
            f"{path}: {column}", units, column.rstrip("12"), (column,), slides=False
        ).scale

    scale = {column: of(column) for column in ("time", *CHANNELS)}
    return scale | {f"{c}_commanded": scale[c] for c in ("tau1", "tau2")}


def _unit(path: Path, key: str, value: Any) -> str:
    """The unit that a line of `[units]` names, by its short name."""
    words = "".join(c for c in text(path, f"units.{key}", value) if c not in " *.·").split("/")
    name = "/".join(SPELT.get(w, w) for w in words)
    table = UNITS[key if key in UNITS else GROUPS[key.rstrip("12")]]
    if name not in table:
        raise BadInput(
            f"{path}: units.{key} = {brief(value)} is unknown; {suggest(name, tuple(table))}"
        )
    return name
