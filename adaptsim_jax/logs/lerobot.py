"""LeRobot data sets: `meta/info.json` and Parquet files, each episode a raw trial.

`observation.state` gives angles, `action` position targets, `observation.velocity` and
`observation.effort` speeds and torques; names come from info.json's features. Read by pyarrow
(extra `lerobot`). Both layouts are read: one file an episode (up to v2.1) and many episodes a file
(v3).
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.bag import need
from adaptsim_jax.logs.readers import Reader, Wanted
from adaptsim_jax.logs.table_checks import check_clock
from adaptsim_jax.logs.tables import RawTrial

STEMS = {
    "observation.state": "q",
    "observation.velocity": "v",
    "observation.effort": "tau",
    "action": "target",
}
ENDS = {".pos": "q", ".vel": "v", ".torque": "tau", ".effort": "tau"}
"""What ends the names of one vector's entries, where it holds more than positions."""


def is_lerobot(folder: Path) -> bool:
    """Whether a folder is a LeRobot data set."""
    return (folder / "meta" / "info.json").is_file()


def read_lerobot(folder: Path, wanted: Wanted) -> list[RawTrial]:
    """Every episode; of those that are left out, no more than that. Raises `BadInput`:
    no such features, damaged files, pyarrow missing.
    """
    info = _info(folder)
    features = info["features"]
    if "observation.state" not in features:
        raise BadInput(
            f"{folder}/meta/info.json: has no feature 'observation.state' (joint angles); convert "
            "the data to CSV"
        )
    parquet = need(folder, "pyarrow.parquet", "lerobot")
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise BadInput(f"{folder}: holds no data/**/*.parquet; download the data set whole")
    wanted_names = (*STEMS, "timestamp", "frame_index", "episode_index")
    columns = [name for name in wanted_names if name in features]
    parts: dict[int, list[tuple[Path, dict[str, np.ndarray]]]] = {}
    for path in files:
        for episode, table in _episodes(path, parquet, columns):
            parts.setdefault(episode, []).append((path, table))
    fps = info.get("fps")

    def empty_trial(e):
        return RawTrial(_name(e), str(parts[e][0][0]), {}, np.zeros(0, np.int64))

    return [
        empty_trial(episode)
        if wanted.out(_name(episode))
        else _trial(folder, episode, parts[episode], features, fps)
        for episode in sorted(parts)
    ]


def _name(episode: int) -> str:
    return f"episode_{episode}"


def check_named(path: Path, trial: RawTrial, joints: Sequence[str]) -> None:
    """BadInput where numbers of a trial have no names that fit, and `[columns]` gives none either.

    Args:
        joints: The model's.
    """
    for vector, stem in STEMS.items():
        columns = [name for name in trial.columns if name.startswith(f"{stem}_")]
        numbered = [name for name in columns if re.fullmatch(rf"{stem}_\d+", name)]
        count = sum(name[len(stem) + 1 :] not in joints for name in numbered)
        has_names = len(columns) > len(numbered)
        if joints and count not in (0, len(joints)) and not has_names:
            raise BadInput(
                f"{path}/meta/info.json: {vector} has {count} numbers without names, the model "
                f"{len(joints)} joint(s); write names "
                f"there, in the order of the numbers, or say in meta.toml which number is which: "
                f"[columns] and {stem}_{joints[0]} = "
                f'"{stem}_K", K from 1 to {count}, and ignore the others'
            )
    for vector in trial.name_problems:
        place_columns = [name for name in trial.columns if name.startswith(f"{vector}[")]
        width = int(place_columns[-1].rpartition("[")[2][:-1]) + 1 if place_columns else 0
        stem = STEMS[vector]
        if not place_columns or any(name.startswith(f"{stem}_") for name in trial.columns):
            continue  # some have been given by [columns]: the others are left
        first = next(iter(joints), "JOINT")
        raise BadInput(
            f"{path}/meta/info.json: {trial.name_problems[vector]}; write all {width} names there, "
            f"in the order of the numbers, or say in "
            f'meta.toml which number is which: [columns] and {stem}_{first} = "{vector}[K]", K '
            f"from 0 to {width - 1}"
        )


def _info(folder: Path) -> dict[str, Any]:
    path = folder / "meta" / "info.json"
    try:
        info = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(info, dict) and isinstance(info.get("features"), dict):
            return info
        why = "it has no features"
    except (OSError, ValueError, RecursionError) as error:
        why = " ".join(str(error).split())[:120]
    raise BadInput(
        f"{path}: is no description of a LeRobot data set ({why}); download the data set again"
    ) from None


def _episodes(
    path: Path, parquet: Any, wanted: list[str]
) -> list[tuple[int, dict[str, np.ndarray]]]:
    try:
        table = parquet.read_table(path, columns=wanted)
        arrays = {
            name: np.array(table.column(name).to_pylist(), dtype=np.float64)
            for name in table.column_names
        }
    except Exception as error:  # pyarrow's own errors, and ragged or textual columns
        why = " ".join(str(error).split())[:120] or type(error).__name__
        raise BadInput(
            f"{path}: is no readable Parquet file of joint vectors ({why}); download it again"
        ) from None
    if "observation.state" not in arrays:
        raise BadInput(
            f"{path}: column 'observation.state' is missing; download the data set again"
        )
    index = arrays.get("episode_index", np.zeros(len(table))).astype(int).ravel()
    return [(int(e), {name: a[index == e] for name, a in arrays.items()}) for e in np.unique(index)]


def _trial(folder: Path, episode: int, parts: list, features: dict, fps: Any) -> RawTrial:
    path = parts[0][0]
    arrays = {name: np.concatenate([table[name] for _, table in parts]) for name in parts[0][1]}
    count = len(arrays["observation.state"])
    notes: tuple[str, ...] = ()
    if "timestamp" in arrays:
        time = arrays["timestamp"].ravel()
    else:
        if not isinstance(fps, int | float) or not fps > 0:
            raise BadInput(
                f"{folder}/meta/info.json: has no fps, and the data no timestamp; add one of them"
            )
        time = np.arange(count) / fps
        notes = (f"no timestamps: rows taken {fps:g} times a second, as info.json says",)
    rows, word = np.arange(1, count + 1), f"episode {episode}, row"
    if (not_finite := np.flatnonzero(~np.isfinite(time))).size:
        raise BadInput(
            f"{path}: {word} {rows[not_finite[0]]}: timestamp is {time[not_finite[0]]:g}; remove "
            "such rows"
        )
    check_clock(path, time, rows, word)
    columns = {"time": time}
    if "frame_index" in arrays:
        columns["frame_index"] = arrays["frame_index"].ravel()
    name_problems: dict[str, str] = {}
    for name, stem in STEMS.items():
        if name in arrays:
            values = arrays[name].reshape(count, -1)
            feature, width = features.get(name, {}), values.shape[1]
            if (names := _names(feature, width)) is not None:
                columns |= _named_columns(stem, names, values)
                continue
            names_in_info = _names_in_info(feature)
            # numbers of joints; where info.json names others, names that only [columns] makes
            # joints of
            columns |= {
                f"{name}[{k}]" if names_in_info else f"{stem}_{k + 1}": values[:, k]
                for k in range(width)
            }
            if not names_in_info:
                notes = (*notes, f"{name} has no names: taken in the model's order of joints")
            else:
                names_text = ", ".join(dict.fromkeys(map(str, names_in_info)))
                name_problems[name] = (
                    f"names {len(names_in_info)} of the {width} numbers of {name} ({names_text})"
                )
    return RawTrial(
        _name(episode),
        str(path),
        columns,
        np.arange(1, count + 1),
        "row",
        notes=notes,
        name_problems=name_problems,
    )


def _names(feature: Any, width: int) -> list[str] | None:
    """The names of a vector's entries; None where info.json has none, or where they are not the
    entries' (another number of them, or twice the same).
    """
    names = _names_in_info(feature)
    if len(names) == width == len({name for name in names if isinstance(name, str)}):
        return names
    return None


def _names_in_info(feature: Any) -> list[Any]:
    """The names that info.json has, fit or not, in the order of the entries: a list of them, lists
    of groups, or each with its place.
    """
    names = feature.get("names") if isinstance(feature, dict) else None
    if not isinstance(names, dict):
        return _leaves(names) if isinstance(names, list) else []
    if names and all(isinstance(k, int) and not isinstance(k, bool) for k in names.values()):
        return sorted(names, key=names.__getitem__)
    return [n for key, group in names.items() for n in (_leaves(group) if group else [key])]


def _leaves(names: Any) -> list[Any]:
    if isinstance(names, list):
        return [leaf for name in names for leaf in _leaves(name)]
    return [names]


def _named_columns(stem: str, names: list[str], values: np.ndarray) -> dict[str, np.ndarray]:
    out = {}
    for j, name in enumerate(names):
        end = next((e for e in ENDS if name.endswith(e)), "")
        quantity = ENDS.get(end, "q")
        if stem == "target":  # what an action says of speeds and torques is no position target
            key = {"q": "target", "v": "ctrl", "tau": "tau"}[quantity]
            suffix = "_commanded" if quantity == "tau" else ""
        else:
            key, suffix = (quantity if end and stem == "q" else stem), ""
        out[f"{key}_{name.removesuffix(end)}{suffix}"] = values[:, j]
    return out


READER = Reader(
    read_lerobot,
    find=lambda data: [data] if is_lerobot(data) else [],
    check=check_named,
)
