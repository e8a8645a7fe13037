"""A log read from what people have: a folder with `meta.toml`, CSV or NPZ files, bags, LeRobot data sets.

Each source gives raw trials of named columns; here they become joints of a model, in SI units. Nothing here imports
JAX, so that bad input is reported at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from adaptsim_jax.errors import BadInput
from adaptsim_jax.sysid.io.assemble import assemble
from adaptsim_jax.sysid.io.log import Log, ModelNames
from adaptsim_jax.sysid.io.log_meta import LogMeta, read_log_meta
from adaptsim_jax.sysid.io.tables import ENDINGS, RawTrial, read_files, table_files

META = "meta.toml"


def read_log(
    source: str | Path, model: Sequence[str] | ModelNames | None = None, meta: LogMeta | str | Path | None = None
) -> Log:
    """Read a log.

    `source`: a folder (with `meta.toml`, else SI units and the usual names are assumed; one CSV or NPZ a trial), or one
    file (CSV, NPZ). `model`: the joints of the model by name and in order, with `ModelNames` also those that slide and
    the actuators; None: the data's own joints. `meta`: what stands in place of the folder's `meta.toml`, or its path.

    Raises `BadInput`, one line that names the file, the row, column or key, and the mend.
    """
    source = Path(source)
    if not source.exists():
        raise BadInput(f"{source}: does not exist; give a folder with meta.toml, or a file (.csv, .npz)")
    meta, notes = _meta(source, meta)
    data = Path(meta.data) if meta.data else source
    trials = read_raw(data, meta)
    names = model if isinstance(model, ModelNames) or model is None else ModelNames(tuple(model))
    log = assemble(str(source), trials, names, meta)
    return replace(log, notes=notes + log.notes)


def _meta(source: Path, given: LogMeta | str | Path | None) -> tuple[LogMeta, tuple[str, ...]]:
    if isinstance(given, LogMeta):
        return given, ()
    path = Path(given) if given is not None else source / META
    if given is not None or (source.is_dir() and path.exists()):
        return read_log_meta(path), ()
    return LogMeta(path=str(path) if source.is_dir() else ""), (
        "no meta.toml: columns taken by their names, in SI units; 'adaptsim init' writes one",
    )


def read_raw(data: Path, meta: LogMeta) -> list[RawTrial]:
    """The raw trials of a file or folder, by what kind it is."""
    if data.is_dir():
        files = table_files(data)
        if not files:
            raise BadInput(f"{data}: holds no .csv or .npz file; put one file a trial there")
        return read_files(files, meta.columns)
    if data.suffix.lower() in ENDINGS:
        return read_files([data], meta.columns)
    raise BadInput(f"{data}: a log ends in {', '.join(ENDINGS)}; convert this file, or give its folder")
