"""Commands that lie in a file of their own beside the states: which file that is, and both brought
onto the states' clock.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.clock import Series, merge
from adaptsim_jax.logs.columns import SPELLINGS, TIME, role
from adaptsim_jax.logs.log_meta import LogMeta, of_trial
from adaptsim_jax.logs.table_clocks import COMMANDS, LINE
from adaptsim_jax.logs.tables import RawTrial, column_names, read_file

WORDS, STATE_WORDS = (set(SPELLINGS["words"][key]) for key in ("commands", "states"))
"""In the names of files of commands, and of states."""


def suspected(files: Sequence[Path]) -> dict[str, Path]:
    """Trials (stems of files) whose commands seem to lie in another of these files, by its name:
    `run_state.csv`, `run_control.csv`.
    """
    commands = [path for path in files if _tokens(path) & WORDS]
    states = [path for path in files if path not in commands]
    found = {}
    for path in commands:
        rest = _tokens(path) - WORDS
        alike = [s for s in states if _tokens(s) - STATE_WORDS == rest]
        if len(alike) == 1 or (len(states) == len(commands) == 1):
            found[(alike or states)[0].stem] = path
    return found


def _tokens(path: Path) -> set[str]:
    return {token for token in re.split(r"[^a-z0-9]+", path.stem.lower()) if token}


def check_suspected(files: Sequence[Path]) -> None:
    """BadInput where a file of a folder seems to hold the commands of another, and nobody said
    so.
    """
    for trial, path in suspected(files).items():
        raise BadInput(
            f"{path}: looks like the commands of {trial}; write [trials] and commands = "
            f'{{{_key(trial)} = "{path.name}"}} in '
            "meta.toml, or rename it if it is a trial of its own"
        )


def _key(trial: str) -> str:
    if re.fullmatch(r"[A-Za-z0-9_-]+", trial):
        return trial
    return f'"{trial}"'


def likely_commands(path: Path, files: Sequence[Path]) -> tuple[str, ...]:
    """A note where a single file is read and another one beside it seems to hold its commands."""
    found = suspected(files).get(path.stem)
    if found is None:
        return ()
    return (
        f"{found.name} beside it looks like its commands: write [trials] and commands = "
        f'{{{_key(path.stem)} = "{found.name}"}} in '
        "meta.toml to take them",
    )


def declared(commands: Mapping[str, str], folder: Path, meta: str) -> dict[str, Path]:
    """Trial (or pattern) -> its file of commands, which lies in the data's folder. BadInput where
    there is none.
    """
    out = {}
    for trial, name in commands.items():
        out[trial] = folder / name
        if not out[trial].is_file():
            raise BadInput(
                f"{meta}: trials.commands: {name!r} does not exist in {folder}; give a file's name "
                "there"
            )
    return out


def with_commands(trial: RawTrial, files: Mapping[str, Path], meta: LogMeta) -> RawTrial:
    """A trial with the commands of its file, held from when they came: its angles there are
    targets.
    """
    path = of_trial(dict[str, Path | None](files), trial.name, None)
    if path is None:
        return trial
    header = column_names(path)
    here = {ours: theirs for ours, theirs in meta.columns.items() if theirs in header}
    reported, *others = read_file(path, path.stem, replace(meta, columns=here))
    if others:
        raise BadInput(
            f"{path}: holds commands of {1 + len(others)} trials, as its clock or its column of "
            "trials tells; write each a file"
        )
    commands = {}
    for name, values in reported.columns.items():
        found = role(name)
        if found is None or found.stem not in ("q", *COMMANDS):
            continue
        rest = re.sub(r"^[A-Za-z]+", "", name)
        commands[f"target{rest}" if found.stem == "q" else name] = values
    if not commands:
        raise BadInput(
            f"{path}: holds no commands; name its columns by [columns] in meta.toml, as target1 or "
            "target_JOINT"
        )
    time = next(name for name in trial.columns if name in TIME)
    other = next(name for name in reported.columns if name in TIME)
    own = {n: x for n, x in trial.columns.items() if n != time and n not in commands}
    own[LINE] = trial.lines.astype(float)
    states = Series(trial.columns[time], own)
    commanded = Series(reported.columns[other], commands)
    out, notes = merge(str(trial.path), [states], [commanded])
    lines = np.round(out.pop(LINE)).astype(np.int64)
    note = f"commands of {trial.name} taken from {path.name}, held from when they came"
    return replace(
        trial,
        columns={time: out.pop("time"), **out},
        lines=lines,
        notes=(*trial.notes, note, *notes),
    )
