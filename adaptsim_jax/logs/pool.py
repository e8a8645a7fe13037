"""Several logs of one machine as one: who may be pooled, and what their trials are called.

A log is a folder of trials, or one file. Trials of several go by the log's label and their own
name, `day1/trial_03`. All else is read as of one folder, so trials may differ in rate and length.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from adaptsim_jax.core.errors import BadInput, brief
from adaptsim_jax.logs.log_meta import LogMeta
from adaptsim_jax.logs.tables import RawTrial

Data = str | Path | Sequence[str | Path]
"""One log, or several of one machine."""
OWN = ("path", "data", "model", "exclude", "commands")
"""Keys of meta.toml that are each log's own; model files are compared by what they hold."""
KEYS = {
    "exclude": "trials.exclude",
    "convention": "angles.convention",
    "zero": "angles.zero",
    "reversed": "angles.reversed",
    "rate": "commands.rate",
    "within": "commands.within",
    "targets": "commands.targets",
}
"""What keys of meta.toml are called there, where not as they are here."""


def paths_of(data: Data) -> tuple[Path, ...]:
    """The paths of the logs, one or several."""
    return tuple(map(Path, (data,) if isinstance(data, (str, Path)) else data))


def logs_of(data: Data) -> tuple[Path, ...]:
    """The same. Raises BadInput where one is not there, or is given twice."""
    paths = paths_of(data)
    whole = [path.resolve() for path in paths]
    for k, path in enumerate(paths):
        if not path.exists():
            raise BadInput(
                f"{path}: does not exist; give a folder with meta.toml, or a file (.csv, .npz, "
                ".mcap, .bag)"
            )
        if whole[k] in whole[:k]:
            raise BadInput(f"{path}: is given twice; name each log once")
    return paths


def labels_of(paths: Sequence[Path]) -> tuple[str, ...]:
    """What logs are called: by their paths, without what these have in common."""
    whole = [path.resolve() for path in paths]
    common = os.path.commonpath([path.parent for path in whole])
    return tuple(path.relative_to(common).as_posix() for path in whole)


def agreed(metas: Sequence[LogMeta], names: Sequence[str], same_model: bool) -> LogMeta:
    """What all logs declare, with trials that are left out by the names that they have here.

    Args:
        metas: Of each log.
        names: Labels of the logs.
        same_model: Whether a model file is given, whatever these name.

    Raises BadInput at the first key that differs.
    """
    first = metas[0]
    for meta in metas[1:]:
        for key in (f.name for f in fields(LogMeta) if f.name not in OWN):
            _check_same(first, meta, KEYS.get(key, key), getattr(first, key), getattr(meta, key))
        if not same_model:
            files = [m.model and Path(m.model).read_bytes() for m in (first, meta)]
            if files[0] != files[1]:
                _check_same(first, meta, "model", first.model, meta.model)
    exclude = [f"{name}/{p}" for name, m in zip(names, metas, strict=True) for p in m.exclude]
    return replace(first, exclude=tuple(exclude), data=None, commands={})


def _check_same(first: LogMeta, other: LogMeta, key: str, one: Any, two: Any) -> None:
    """Raise BadInput where a key has two values."""
    if one != two or key == "model":
        raise BadInput(
            f"{other.path}: {key} {_told(two)} is not that of {first.path}, {_told(one)}; logs of "
            "one machine declare the same: mend one, or diagnose them apart"
        )


def _told(value: Any) -> str:
    if isinstance(value, Mapping):
        value = {k: getattr(v, "name", v) for k, v in value.items()}
    return "(not there)" if value is None or value in ({}, ()) else brief(value)


def labelled(trials: Sequence[RawTrial], label: str) -> list[RawTrial]:
    """The trials of a log by its label and their names."""
    return [replace(trial, name=f"{label}/{trial.name}") for trial in trials]
