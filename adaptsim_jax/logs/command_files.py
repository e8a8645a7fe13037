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


def find_command_files(files: Sequence[Path]) -> dict[str, Path]:
    """Trials (stems of files) whose commands seem to lie in another of these files, by its name:
    `run_state.csv`, `run_control.csv`.
    """
    commands = [path for path in files if _tokens(path) & WORDS]
    states = [path for path in files if path not in commands]
    command_files = {}
    for path in commands:
        words = _tokens(path) - WORDS
        matching = [s for s in states if _tokens(s) - STATE_WORDS == words]
        if len(matching) == 1 or (len(states) == len(commands) == 1):
            command_files[(matching or states)[0].stem] = path
    return command_files


def _tokens(path: Path) -> set[str]:
    return {token for token in re.split(r"[^a-z0-9]+", path.stem.lower()) if token}


def check_command_files(files: Sequence[Path]) -> None:
    """BadInput where a file of a folder seems to hold the commands of another, and nobody said
    so.
    """
    for trial, path in find_command_files(files).items():
        raise BadInput(
            f"{path}: looks like the commands of {trial}; write [trials] and commands = "
            f'{{{_key(trial)} = "{path.name}"}} in '
            "meta.toml, or rename it if it is a trial of its own"
        )


def _key(trial: str) -> str:
    if re.fullmatch(r"[A-Za-z0-9_-]+", trial):
        return trial
    return f'"{trial}"'


def command_file_note(path: Path, files: Sequence[Path]) -> tuple[str, ...]:
    """A note where a single file is read and another one beside it seems to hold its commands."""
    file = find_command_files(files).get(path.stem)
    if file is None:
        return ()
    return (
        f"{file.name} beside it looks like its commands: write [trials] and commands = "
        f'{{{_key(path.stem)} = "{file.name}"}} in '
        "meta.toml to take them",
    )


def command_paths(commands: Mapping[str, str], folder: Path, meta: str) -> dict[str, Path]:
    """Trial (or pattern) -> its file of commands, which lies in the data's folder. BadInput where
    there is none.
    """
    paths = {}
    for trial, name in commands.items():
        paths[trial] = folder / name
        if not paths[trial].is_file():
            raise BadInput(
                f"{meta}: trials.commands: {name!r} does not exist in {folder}; give a file's name "
                "there"
            )
    return paths


def with_commands(trial: RawTrial, files: Mapping[str, Path], meta: LogMeta) -> RawTrial:
    """A trial with the commands of its file, held from when they came: its angles there are
    targets.
    """
    file = of_trial(dict[str, Path | None](files), trial.name, None)
    if file is None:
        return trial
    header = column_names(file)
    here = {ours: theirs for ours, theirs in meta.columns.items() if theirs in header}
    table, *further = read_file(file, file.stem, replace(meta, columns=here))
    if further:
        raise BadInput(
            f"{file}: holds commands of {1 + len(further)} trials, as its clock or its column of "
            "trials tells; write each a file"
        )
    commands = {}
    for name, values in table.columns.items():
        column_role = role(name)
        if column_role is None or column_role.stem not in ("q", *COMMANDS):
            continue
        suffix = re.sub(r"^[A-Za-z]+", "", name)
        commands[f"target{suffix}" if column_role.stem == "q" else name] = values
    if not commands:
        raise BadInput(
            f"{file}: holds no commands; name its columns by [columns] in meta.toml, as target1 or "
            "target_JOINT"
        )
    state_time = next(name for name in trial.columns if name in TIME)
    command_time = next(name for name in table.columns if name in TIME)
    state_columns = {
        n: x for n, x in trial.columns.items() if n != state_time and n not in commands
    }
    state_columns[LINE] = trial.lines.astype(float)
    states = Series(trial.columns[state_time], state_columns)
    command_series = Series(table.columns[command_time], commands)
    columns, notes = merge(str(trial.path), [states], [command_series])
    lines = np.round(columns.pop(LINE)).astype(np.int64)
    note = f"commands of {trial.name} taken from {file.name}, held from when they came"
    return replace(
        trial,
        columns={state_time: columns.pop("time"), **columns},
        lines=lines,
        notes=(*trial.notes, note, *notes),
    )
