"""Measured data read from a folder: `meta.toml` and one `.csv` or `.npz` a trial, checked and in SI
units.

Section 4 of the design fixes the names. Nothing here imports JAX, so that bad input is reported at
once.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.beside import copies, instead, unread
from adaptsim_jax.logs.meta import Meta, read_meta
from adaptsim_jax.logs.table import read_table
from adaptsim_jax.logs.table_checks import (
    LIMIT,
    check_clock,
    check_size,
    check_time_unit,
    from_zero,
)
from adaptsim_jax.logs.tables import table_files
from adaptsim_jax.logs.types import Recording, Trial
from adaptsim_jax.logs.units import check_units

__all__ = ["Recording", "Trial", "read_recording"]

COMMANDED = ("tau1_commanded", "tau2_commanded")
MOST_TIME = 1e11  # s, beyond which a time is damage
COLUMNS = ("time", "q1", "q2", "v1", "v2", "tau1", "tau2", *COMMANDED)


def read_recording(
    folder: str | Path, *, trials: Sequence[str] | None = None, without: Sequence[str] = ()
) -> Recording:
    """Read a folder of measured data. `trials` picks some by name (file name with or without its
    ending); the files of those `without` are not looked at.

    Raises `BadInput`, one line that names the file, the line or key, and the mend.
    """
    folder = Path(folder)
    if not folder.is_dir():
        if folder.exists():
            what = "is a file, not a folder"
        else:
            what = "does not exist"
        raise BadInput(f"{folder}: {what}; give a folder with meta.toml and one CSV a trial")
    meta = read_meta(folder / "meta.toml")
    picked = _pick(folder, _files(folder), trials)
    kept = _kept(str(folder), [name for name, _ in picked], without)
    read = [_read_trial(path, name, meta) for name, path in picked if name in kept]
    sources = {source for _, source, _ in read}
    recording = Recording(
        path=str(folder),
        task=meta.task,
        model=meta.model,
        angle_zero=meta.angle_zero,
        geometry=meta.geometry,
        known=meta.known,
        noise=meta.noise,
        trials=tuple(trial for trial, _, _ in read),
        torque_source=sources.pop() if len(sources) == 1 else "mixed",
        notes=meta.notes
        + _notes(read)
        + copies([(t.name, t.q) for t, _, _ in read])
        + unread(folder),
        model_file=meta.model_file,
        left_out=tuple(without),
    )
    check_units(recording, angle_stated=meta.angle_stated)
    return recording


def _files(folder: Path) -> list[Path]:
    if not (found := table_files(folder)):
        raise BadInput(
            f"{folder}: holds no .csv or .npz file; put one file a trial beside "
            f"meta.toml{instead(folder)}"
        )
    return found


def _pick(folder: Path, files: list[Path], trials: Sequence[str] | None) -> list[tuple[str, Path]]:
    stems = [p.stem for p in files]
    named = [(p.name if stems.count(p.stem) > 1 else p.stem, p) for p in files]
    if trials is None:
        return named
    if isinstance(trials, str) or not trials:
        raise BadInput(
            f"{folder}: trials must be a list of at least one trial name, not {trials!r}"
        )
    picked = []
    for want in trials:
        match = [(name, p) for name, p in named if want in (name, p.name)]
        if not match:
            raise BadInput(
                f"{folder}: has no trial {want!r}; {suggest(want, tuple(n for n, _ in named))}"
            )
        picked += [m for m in match if m not in picked]
    return picked


def _read_trial(path: Path, trial_name: str, meta: Meta) -> tuple[Trial, str, tuple[str, ...]]:
    table = read_table(path, COLUMNS)
    for need in ("time", "q1", "q2"):
        if need not in table.columns:
            near = suggest(need, table.ignored)
            hint = f"{near} " if near.startswith("did") else ""
            one = need == "q2" and "q1" in table.columns
            if one:
                mend = "record both joints, one cannot be diagnosed"
            else:
                mend = "needed are time, q1, q2, tau1, tau2"
            raise BadInput(f"{path}: column {need!r} is missing; {hint}{mend}")
    columns = {key: values * meta.scale[key] for key, values in table.columns.items()}
    check_clock(path, table.columns["time"], table.lines, table.row_word)
    check_time_unit(path, columns["time"], meta.scale["time"])
    for name, values in columns.items():
        check_size(
            path, name, values, table.lines, table.row_word, MOST_TIME if name == "time" else LIMIT
        )
    torque, commanded, source = _torques(path, columns, meta)
    trial = Trial(
        name=trial_name,
        path=str(path),
        time=from_zero(columns["time"]),
        q=np.stack([columns["q1"], columns["q2"]], axis=1),
        v=_velocities(path, columns),
        torque=torque,
        commanded=commanded,
        ignored=table.ignored,
    )
    return trial, source, table.notes


def _velocities(path: Path, columns: dict[str, np.ndarray]) -> np.ndarray | None:
    have = [c for c in ("v1", "v2") if c in columns]
    if len(have) == 1:
        raise BadInput(
            f"{path}: has {have[0]} but not the other velocity; give both v1 and v2, or neither"
        )
    if have:
        return np.stack([columns["v1"], columns["v2"]], axis=1)
    return None


def _torques(
    path: Path, columns: dict[str, np.ndarray], meta: Meta
) -> tuple[np.ndarray, np.ndarray | None, str]:
    """The applied torque `[T, 2]`, the commanded one where both are there, and where the first
    comes from.
    """
    measured = _pair(columns, ("tau1", "tau2"), meta.unactuated)
    commanded = _pair(columns, COMMANDED, meta.unactuated)
    if measured is not None:
        return measured, commanded, meta.torque or "measured"
    if commanded is not None and not {"tau1", "tau2"} & set(columns):
        return commanded, None, "commanded"
    joint = next((i for i in (1, 2) if f"tau{i}" not in columns and i not in meta.unactuated), 1)
    mend = (
        f"add it (N m), or write unactuated = [{joint}] in meta.toml where that joint has no motor"
    )
    raise BadInput(f"{path}: column 'tau{joint}' is missing; {mend}")


def _pair(
    columns: dict[str, np.ndarray], names: tuple[str, str], unactuated: tuple[int, ...]
) -> np.ndarray | None:
    """`[T, 2]` of both columns, zero for a joint without a motor; None where one is missing."""
    zero = np.zeros_like(columns["time"])
    pair = [columns.get(c, zero if i in unactuated else None) for i, c in enumerate(names, start=1)]
    none_given = not any(c in columns for c in names)
    if any(column is None for column in pair) or (none_given and len(unactuated) < 2):
        return None
    return np.stack([column for column in pair if column is not None], axis=1)


def _notes(read: list[tuple[Trial, str, tuple[str, ...]]]) -> tuple[str, ...]:
    notes = list(dict.fromkeys(note for _, _, told in read for note in told))
    commanded = [trial.name for trial, source, _ in read if source == "commanded"]
    if commanded:
        notes.append(
            f"torques are commands, not measured, in {len(commanded)} trial(s), first "
            f"{commanded[0]}"
        )
    ignored = sorted({column for trial, _, _ in read for column in trial.ignored if column.strip()})
    if ignored:
        notes.append(f"columns ignored: {', '.join(ignored)}")
    if any(trial.v is None for trial, _, _ in read):
        notes.append("some trials have no velocities: v1, v2 are estimated from the angles")
    return tuple(notes)


def without_trials(recording: Recording, names: Sequence[str]) -> Recording:
    """The recording without these trials. BadInput where one of them is not there, or none would be
    left.
    """
    rest = [name for name in names if name not in recording.left_out]
    kept = _kept(recording.path, [t.name for t in recording.trials], rest)
    return recording.replace(trials=tuple(t for t in recording.trials if t.name in kept))


def _kept(path: str, known: list[str], names: Sequence[str]) -> set[str]:
    if unknown := [name for name in names if name not in known]:
        raise BadInput(
            f"{path}: no trial is named {unknown[0]!r}; --without takes of {', '.join(known)}"
        )
    if not (kept := set(known) - set(names)):
        raise BadInput("--without: names every trial; leave some")
    return kept
