"""The schema of a mechanism's `meta.toml`: what a person declares about a log, checked key by
key.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from adaptsim_jax.core.config import read, suggest
from adaptsim_jax.core.errors import BadInput, brief
from adaptsim_jax.logs.columns import CHANNEL, NANOS, TIME
from adaptsim_jax.logs.declared import (
    TEXT_KEYS,
    check_keys,
    choice,
    not_negative,
    number,
    tables,
    text,
)
from adaptsim_jax.logs.log_units import Unit, check_unit

V = TypeVar("V")
INPUTS = ("torque", "command", "voltage", "current", "none")
CONVENTIONS = ("relative", "absolute")
TABLES = (
    "columns",
    "channels",
    "units",
    "angles",
    "hold",
    "commands",
    "known",
    "fit",
    "noise",
    "trials",
    "ros",
)
KEYS = (
    "task",
    "model",
    "data",
    "input",
    "ignore",
    "rows_per_second",
    "simulator",
    *TABLES,
    *TEXT_KEYS,
)
SIMULATORS = ("tree", "mujoco")
ANGLE_KEYS = ("convention", "zero", "reversed")
COMMAND_KEYS = ("rate", "within", "targets")
TARGETS = ("absolute", "relative")
TRIAL_KEYS = ("exclude", "group", "payload", "commands")
"""Groups and payloads are for people."""
ROS_KEYS = ("state_topic", "command_topic", "trajectory")
TRAJECTORY = ("ramp", "hold")


@dataclass(frozen=True)
class Rig:
    """A double pendulum that its `meta.toml` declares in place of a model file.

    - `model`: The base model, rigid_body or linearized.
    - `angle_zero`: Where both angles are 0, hanging or upright.
    - `geometry`: l1, l2 in m and g in m/s^2.
    - `known`: Declared parameters.
    - `model_file`: Path of a mended model.
    - `unactuated`: Joints without a motor, counted from 1.
    """

    model: str
    angle_zero: str
    geometry: dict[str, float]
    known: dict[str, float]
    model_file: str | None = None
    unactuated: tuple[int, ...] = ()
    task: str = "pendulum"


@dataclass(frozen=True)
class LogMeta:
    """What `meta.toml` declares of a log.

    - `model`, `data`: Whole paths, None where not named.
    - `input`: Which columns drive the model. None: the columns decide.
    - `ignore`: Columns, or joints with all their columns, that are left out.
    - `columns`: Our name -> the file's name.
    - `units`: Column, stem or quantity -> unit.
    - `convention`: Joint or column -> "relative" or "absolute", "" for all.
    - `zero`: Joint or column -> what the log shows (rad or m) where the model's joint is at 0.
    - `reversed`: Joints that the log counts the other way round.
    - `known`, `fit`: As written, names of the MJCF.
    - `noise`: Column, joint, stem (`q`, `v`) or quantity -> standard deviation in SI units: the
      least that readings count as.
    - `exclude`: Trials left out.
    - `rate`, `within`: Joint -> what a target is cut to before it is sent, by a rate (rad/s, m/s)
      or to within a distance of the angle (rad, m).
    - `targets`: What they are: angles, or how far from the angle of their row. None: angles, unless
      these tell that they are none.
    - `commands`: Trial -> the file beside the data that holds its commands (patterns like `kp100_*`
      may stand for several trials).
    - `hold`: Joint -> rad or m that it is held at (None: where the log or the file has it).
    - `rows_per_second`: Of tables without a time.
    - `simulator`: The one of tree and mujoco, None: by what the model needs.
    - `channels`: A sensor of the model, `gyro[0]` -> the column that it is compared with (among
      `columns`, too).
    - `rig`: Of a double pendulum, whose `meta.toml` is another (`logs/pendulum.py`).
    """

    path: str = ""
    model: str | None = None
    data: str | None = None
    input: str | None = None
    ignore: tuple[str, ...] = ()
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, Unit] = field(default_factory=dict)
    convention: Mapping[str, str] = field(default_factory=dict)
    zero: Mapping[str, float] = field(default_factory=dict)
    reversed: tuple[str, ...] = ()
    known: Mapping[str, Any] = field(default_factory=dict)
    fit: Mapping[str, Any] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    exclude: tuple[str, ...] = ()
    ros: Mapping[str, str | Sequence[str]] = field(default_factory=dict)
    hold: Mapping[str, float | None] = field(default_factory=dict)
    rows_per_second: float | None = None
    simulator: str | None = None
    rate: Mapping[str, float] = field(default_factory=dict)
    within: Mapping[str, float] = field(default_factory=dict)
    targets: str | None = None
    commands: Mapping[str, str] = field(default_factory=dict)
    channels: Mapping[str, str] = field(default_factory=dict)
    rig: Rig | None = None

    def least_noise(self, stem: str, joints: Sequence[str]) -> np.ndarray:
        """Declared standard deviations [n] of readings of a stem (`q`, `v`); 0: none is."""
        quantity, out = {"q": "angle", "v": "velocity"}[stem], np.zeros(len(joints))
        for j, name in enumerate(joints):
            keys = (quantity, stem, f"{stem}{j + 1}", name if stem == "q" else "", f"{stem}_{name}")
            out[j] = next((self.noise[k] for k in reversed(keys) if k in self.noise), 0.0)
        return out


def read_log_meta(path: str | Path) -> LogMeta:
    """Read and check a `meta.toml` with `task = "mechanism"`. Raises `BadInput` naming the file and
    the key.
    """
    path = Path(path)
    raw = read(
        path,
        'missing; write one with task = "mechanism" and model = "robot.xml", or run adaptsim init',
    )
    check_keys(path, raw, KEYS)
    if raw.get("task") != "mechanism":
        what = f"is {brief(raw['task'])}" if "task" in raw else "is missing"
        raise BadInput(f'{path}: task {what}; write task = "mechanism" for a log of any mechanism')
    table = tables(path, raw, TABLES)
    angles = check_keys(path, table["angles"], ANGLE_KEYS, "angles")
    commands = check_keys(path, table["commands"], COMMAND_KEYS, "commands")
    trials = check_keys(path, table["trials"], TRIAL_KEYS, "trials")
    convention = angles.get("convention", {})
    if isinstance(convention, str):
        convention = {"": convention}
    channels = _channels(path, table["channels"])
    renamed = {CHANNEL + ours: theirs for ours, theirs in channels.items()}
    return LogMeta(
        path=str(path),
        model=_in_folder(path, raw, "model", 'write model = "robot.xml", relative to the folder'),
        data=_in_folder(
            path, raw, "data", "give the file or folder of the data, relative to meta.toml"
        ),
        input=choice(path, raw, "input", INPUTS),
        ignore=_texts(path, "ignore", raw.get("ignore", [])),
        columns=_columns(path, table["columns"]) | renamed,
        units={key: check_unit(path, key, value) for key, value in table["units"].items()},
        convention=_conventions(path, convention),
        zero=_numbers(
            path, "angles.zero", angles.get("zero", {}), "zero = {elbow = 3.14159}, in rad or m"
        ),
        reversed=_texts(path, "angles.reversed", angles.get("reversed", [])),
        known=table["known"],
        fit=table["fit"],
        noise={key: not_negative(path, f"noise.{key}", std) for key, std in table["noise"].items()},
        exclude=_texts(path, "trials.exclude", trials.get("exclude", [])),
        commands=_commands(path, trials.get("commands", {})),
        ros=_ros(path, table["ros"]),
        rate=_sizes(path, "rate", commands, "rate = {elbow = 3.0}, in rad/s or m/s"),
        within=_sizes(path, "within", commands, "within = {elbow = 0.1}, in rad or m"),
        targets=choice(path, commands, "targets", TARGETS),
        hold={
            key: None if value is True else number(path, f"hold.{key}", value)
            for key, value in table["hold"].items()
        },
        rows_per_second=_positive(path, "rows_per_second", raw.get("rows_per_second"), "100.0"),
        simulator=choice(path, raw, "simulator", SIMULATORS),
        channels=channels,
    )


def _sizes(path: Path, key: str, table: Mapping[str, Any], example: str) -> dict[str, float]:
    out = _numbers(path, f"commands.{key}", table.get(key, {}), example)
    for name, size in out.items():
        _positive(path, f"commands.{key}.{name}", size, example)
    return out


def _positive(path: Path, key: str, value: Any, example: str) -> float | None:
    """A number above 0, None where none is given."""
    if value is not None and not number(path, key, value) > 0:
        raise BadInput(f"{path}: {key} = {value:g} is not above 0; write {example}")
    return value


def _ros(path: Path, table: dict) -> dict[str, str | Sequence[str]]:
    check_keys(path, table, ROS_KEYS, "ros")
    choice(path, table, "trajectory", TRAJECTORY)
    return {
        key: _texts(path, f"ros.{key}", value)
        if isinstance(value, list)
        else text(path, f"ros.{key}", value)
        for key, value in table.items()
    }


def _texts(path: Path, key: str, value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or any(not isinstance(item, str) for item in value):
        raise BadInput(
            f'{path}: {key} must be a list of names such as ["elbow"], not {brief(value)}'
        )
    return tuple(value)


def _numbers(path: Path, key: str, value: Any, example: str) -> dict[str, float]:
    if not isinstance(value, dict):
        raise BadInput(f"{path}: {key} must be a table, not {brief(value)}; write {example}")
    return {name: number(path, f"{key}.{name}", given) for name, given in value.items()}


def _in_folder(path: Path, raw: dict, key: str, mend: str) -> str | None:
    if key not in raw:
        return None
    named = text(path, key, raw[key])
    where = (path.parent / named).resolve()
    if not where.exists() or (key == "model" and not where.is_file()):
        what = "does not exist" if not where.exists() else "is a folder"
        if "\\" in named or not named.isprintable():
            mend = "write / in place of a backslash, which between double quotes is an escape"
        raise BadInput(f"{path}: {key} {brief(named)} {what}; {mend}")
    return str(where)


def _columns(path: Path, table: dict) -> dict[str, str]:
    """Our name -> the file's. A list under a stem (`q = ["a", "b"]`) names the joints' columns in
    order, of time its two parts.
    """
    out: dict[str, str] = {}
    for key, value in table.items():
        if isinstance(value, list):
            names = _texts(path, f"columns.{key}", value)
            if key in TIME:
                if len(names) != 2:
                    raise BadInput(
                        f"{path}: columns.{key} names {len(names)} columns; name one, or two: "
                        "whole seconds, and nanoseconds"
                    )
                out |= {key: names[0], NANOS: names[1]}
                continue
            out |= {f"{key}{i}": name for i, name in enumerate(names, start=1)}
        else:
            out[key] = text(path, f"columns.{key}", value)
    for name in out.values():
        if list(out.values()).count(name) > 1:
            keys = ", ".join(key for key, value in out.items() if value == name)
            raise BadInput(
                f"{path}: [columns] gives column {brief(name)} to {keys}; give it to one of them"
            )
    return out


def _channels(path: Path, table: dict) -> dict[str, str]:
    """A sensor of the model -> the file's column. Two columns cannot be one sensor's."""
    out: dict[str, str] = {}
    for column, value in table.items():
        sensor = text(path, f"channels.{column}", value)
        if sensor in out:
            raise BadInput(
                f"{path}: [channels] gives {out[sensor]} and {column} to {sensor}; write "
                f"{sensor}[0], {sensor}[1], ..."
            )
        out[sensor] = column
    return out


def _conventions(path: Path, value: Any) -> dict[str, str]:
    if not isinstance(value, dict):
        raise BadInput(
            f'{path}: angles.convention must be "relative" or "absolute", not {brief(value)}'
        )
    for name, word in value.items():
        if word not in CONVENTIONS:
            key = f"angles.convention{'.' if name else ''}{name}"
            raise BadInput(
                f"{path}: {key} = {brief(word)} is unknown; {suggest(str(word), CONVENTIONS)}"
            )
    return dict(value)


def _commands(path: Path, value: Any) -> dict[str, str]:
    """Trial (or pattern) -> file, from `{trial = "file"}` or `{file = ["trial", ...]}`."""
    if not isinstance(value, dict):
        raise BadInput(
            f"{path}: trials.commands must be a table, not {brief(value)}; write commands = "
            '{run = "control.csv"}'
        )
    out: dict[str, str] = {}
    for name, item in value.items():
        if isinstance(item, list):
            out |= {trial: str(name) for trial in _texts(path, f"trials.commands.{name}", item)}
        else:
            out[name] = text(path, f"trials.commands.{name}", item)
    return out


def of_trial(table: Mapping[str, V], trial: str, default: V) -> V:
    """What a table of `[trials]` gives a trial: its own name counts before patterns."""
    if trial in table:
        return table[trial]
    return next(
        (value for pattern, value in table.items() if fnmatch.fnmatchcase(trial, pattern)), default
    )
