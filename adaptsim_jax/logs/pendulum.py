"""Recordings of the double pendulum (`task = "pendulum"`) translated into the log of a mechanism.

Its `meta.toml` declares a rig instead of a model file. From here on it is a log like any other,
of the joints `joint1` and `joint2`. Nothing here imports JAX.
"""

import glob
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.config import read, suggest
from adaptsim_jax.core.constants import GRAVITY
from adaptsim_jax.core.errors import BadInput, brief
from adaptsim_jax.logs.assemble import assemble
from adaptsim_jax.logs.columns import roles_of
from adaptsim_jax.logs.criteria import UNIT
from adaptsim_jax.logs.declared import (
    MISSING,
    SHORT_TRIALS,
    TASKS,
    TEXT_KEYS,
    check_keys,
    choice,
    not_negative,
    number,
    tables,
)
from adaptsim_jax.logs.log import Log, LogTrial, ModelNames, check_excluded
from adaptsim_jax.logs.log_meta import LogMeta, Rig
from adaptsim_jax.logs.log_units import check_unit
from adaptsim_jax.logs.read import read_raw
from adaptsim_jax.logs.tables import RawTrial

JOINTS = ("joint1", "joint2")
NAMES = ModelNames(JOINTS)
STEMS = ("time", "nanos", "trial", "q", "v", "tau", "tau_commanded")
"""Stems of columns that a rig has; the others are left out."""
CHANNELS = ("q1", "q2", "v1", "v2", "tau1", "tau2")
GROUPS = {"q": "angle", "v": "velocity", "tau": "torque"}
"""Column stem -> the word for it in `[units]`."""
MODELS = ("rigid_body", "linearized")
REQUIRED = {
    "task": '"pendulum"',
    "model": '"rigid_body" or "linearized"',
    "angle_zero": '"hanging" or "upright"',
}
TABLES = ("geometry", "known", "noise", "units")
KEYS = (*REQUIRED, *TABLES, "model_file", "torque", "unactuated", *TEXT_KEYS)


def read_pendulum(folder: str | Path, *, without: Sequence[str] = ()) -> Log:
    """Read a folder of a double pendulum's trials.

    Args:
        folder: holds `meta.toml` and a file for each trial.
        without: trials that are left out. Their files are not looked at.

    Returns:
        The log, with `meta.rig`. Raises `BadInput` naming file, row or key, and the mend.
    """
    folder = Path(folder)
    if not folder.is_dir():
        what = "is a file, not a folder" if folder.exists() else "does not exist"
        raise BadInput(f"{folder}: {what}; give a folder with meta.toml and one CSV a trial")
    meta, notes = read_pendulum_meta(folder / "meta.toml")
    meta = replace(meta, exclude=tuple(map(glob.escape, without)))
    raw = read_raw(folder, meta, NAMES)
    check_excluded(str(folder), [trial.name for trial in raw], without)
    raw = [_rig_trial(trial, meta) for trial in raw if trial.name not in without]
    log = assemble(str(folder), raw, NAMES, replace(meta, exclude=()))
    _check_degrees(log)
    driven_names = {
        name for k, name in enumerate(log.input_names) if any(t.u[:, k].any() for t in log.trials)
    }
    driven = tuple(name for name in log.driven if name in driven_names)
    return replace(log, driven=driven, notes=notes + log.notes)


def _rig_trial(trial: RawTrial, meta: LogMeta) -> RawTrial:
    """The columns of a rig. BadInput where an angle or a torque is missing."""
    assert meta.rig is not None  # of `read_pendulum_meta`
    roles = roles_of(trial.columns, JOINTS)
    rig_columns = {name: r for name, r in roles.items() if r.stem in STEMS}
    joints_there = {
        (r.stem, JOINTS[r.joint - 1] if r.joint in (1, 2) else r.joint)
        for r in rig_columns.values()
    }
    for j, joint in enumerate(JOINTS, 1):
        if ("q", joint) not in joints_there:
            raise _missing(trial, f"q{j}", ("q", JOINTS[0]) in joints_there)
    stem = "tau" if any(s == "tau" for s, _ in joints_there) else "tau_commanded"
    for j, joint in enumerate(JOINTS, 1):
        if (stem, joint) not in joints_there and j not in meta.rig.unactuated:
            raise BadInput(
                f"{trial.path}: column 'tau{j}' is missing; add it (N m), or write unactuated = "
                f"[{j}] in meta.toml where that joint has no motor"
            )
    others = tuple(name for name in trial.columns if name not in rig_columns)
    columns = {name: trial.columns[name] for name in rig_columns}
    return replace(trial, columns=columns, ignored=(*trial.ignored, *others))


def _missing(trial: RawTrial, column: str, has_first_angle: bool) -> BadInput:
    suggestion = suggest(column, trial.ignored)
    hint = f"{suggestion} " if suggestion.startswith("did") else ""
    mend = "record both joints, one cannot be diagnosed"
    if not has_first_angle:
        mend = "needed are time, q1, q2, tau1, tau2"
    return BadInput(f"{trial.path}: column {column!r} is missing; {hint}{mend}")


def _check_degrees(log: Log) -> None:
    """BadInput where angles are too large and too fast for radians, and no unit is stated.

    Sizes are those of the median trial: one may have run away.
    """
    if not {"angle", "q", "q1", "q2"}.isdisjoint(log.meta.units):
        return
    assert log.meta.rig is not None  # of `read_pendulum_meta`
    geometry = log.meta.rig.geometry
    length = min(geometry.get("l1", 0.3), geometry.get("l2", 0.3))
    max_speed = UNIT.max_swing_speed_ratio * math.sqrt(
        max(geometry.get("g", GRAVITY), 1.0) / length
    )
    reach = np.array([np.nanmax(np.abs(t.q), axis=0) for t in log.trials])
    speed = np.array([_top_speed(t) for t in log.trials])
    least_reach, most_reach = np.median(reach.min(1)), np.median(reach.max(1))
    if (
        least_reach < UNIT.min_other_angle
        or most_reach < UNIT.max_bench_angle
        or np.median(speed) < max_speed
    ):
        return
    worst = int(np.argmax(speed))
    raise BadInput(
        f"{log.trials[worst].path}: angles reach {reach[worst].max():.3g} and speeds "
        f'{speed[worst]:.3g}: degrees are suspected instead of radians; write angle = "deg", or '
        f'"rad" if they are, under [units] in meta.toml, or convert the file'
    )


def _top_speed(trial: LogTrial) -> float:
    """A speed that the faster joint exceeds in one row of a hundred."""
    v = trial.v
    if v is None:
        v = np.diff(trial.q, axis=0) / np.diff(trial.time)[:, None]
    return float(np.max(np.nanquantile(np.abs(v), 0.99, axis=0)))


def read_pendulum_meta(path: str | Path) -> tuple[LogMeta, tuple[str, ...]]:
    """Read and check the `meta.toml` of a rig; with a note on what is assumed."""
    path = Path(path)
    raw = read(path, SHORT_TRIALS if (path.parent / "actions.csv").exists() else MISSING)
    if raw.get("task") not in ("pendulum", None):
        choice(path, raw, "task", TASKS)
    check_keys(path, raw, KEYS)
    for key, example in REQUIRED.items():
        if key not in raw:
            raise BadInput(f"{path}: key {key!r} is missing; add {key} = {example}")
    table = tables(path, raw, TABLES)
    choice(path, raw, "task", ("pendulum",))
    choice(path, raw, "torque", ("measured", "commanded", "applied"))
    model, model_file = _model(path, raw)
    model_geometry = read(Path(model_file)).get("geometry", {}) if model_file else {}
    if not isinstance(model_geometry, dict):
        model_geometry = {}
    geometry, notes = _geometry(path, model_geometry | table["geometry"], model)
    rig = Rig(
        model=model,
        angle_zero=choice(path, raw, "angle_zero", ("upright", "hanging")) or "",
        geometry=geometry,
        known={k: number(path, f"known.{k}", v) for k, v in table["known"].items()},
        model_file=model_file,
        unactuated=_joints(path, raw.get("unactuated", [])),
    )
    units = check_keys(
        path, table["units"], ("time", *GROUPS.values(), *GROUPS, *CHANNELS), "units"
    )
    units = {key: check_unit(path, key, value) for key, value in units.items()}
    noise = check_keys(path, table["noise"], (*GROUPS.values(), *GROUPS, *CHANNELS), "noise")
    noise = {key: not_negative(path, f"noise.{key}", std) for key, std in noise.items()}
    return LogMeta(path=str(path), units=units, noise=noise, rig=rig), notes


def check_known(path: str, given: dict[str, float], names: Sequence[str]) -> None:
    """BadInput where `[known]` names a parameter that the model has not."""
    for key in given:
        if key not in names:
            raise BadInput(
                f"{path}/meta.toml: [known] {key!r} is no parameter of the model; "
                f"{suggest(key, names)}"
            )


def _model(path: Path, raw: dict) -> tuple[str, str | None]:
    """The base model, and the path of a mended model where one is named."""
    value = choice(path, raw, "model") or ""
    file = choice(path, raw, "model_file")
    if value.endswith(".toml"):
        file, value = value, ""
    if file is None:
        return choice(path, raw, "model", MODELS) or "", None
    where = (path.parent / file).resolve()
    if not where.is_file():
        raise BadInput(
            f"{path}: model file {file!r} does not exist beside it; give its path relative to the "
            "folder"
        )
    return MODELS[bool(read(where).get("linear"))], str(where)


def _geometry(path: Path, raw: dict, model: str) -> tuple[dict[str, float], tuple[str, ...]]:
    """Lengths in m and gravity in m/s^2; with a note on what is assumed."""
    check_keys(path, raw, ("l1", "l2", "g"), "geometry")
    declared = {k: number(path, f"geometry.{k}", v) for k, v in raw.items()}
    for key, value in declared.items():
        if not (value > 0 or (key == "g" and value == 0)) or value > 1e3:
            unit = "m/s^2" if key == "g" else "m"
            raise BadInput(
                f"{path}: geometry.{key} = {value:g} is not physical; give it in {unit}, above 0"
            )
    defaults = {"g": GRAVITY}
    if model == "linearized":
        defaults = {"l1": 1.0, "l2": 1.0, "g": GRAVITY}
    assumed = ", ".join(f"{k} = {v:g}" for k, v in defaults.items() if k not in declared)
    if assumed:
        return defaults | declared, (f"geometry not declared, assumed: {assumed}",)
    return defaults | declared, ()


def _joints(path: Path, raw: Any) -> tuple[int, ...]:
    if not isinstance(raw, list) or any(isinstance(j, bool) or j not in (1, 2) for j in raw):
        raise BadInput(
            f"{path}: unactuated must be a list of joint numbers such as [1], not {brief(raw)}"
        )
    return tuple(sorted(set(raw)))
