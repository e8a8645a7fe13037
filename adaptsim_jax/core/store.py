"""Run folders and checkpoints: written under a temporary name, renamed, checked in full, never
executed.

A checkpoint folder holds `manifest.json` and the payload that it names (`state-<step>-<hash>.npz`).
The payload is written and renamed first, the manifest after it, the old payload removed last:
whenever the process dies, the manifest on disk names a whole payload. It also records how long
`metrics.jsonl` was.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import secrets
import shutil
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from adaptsim_jax import __version__
from adaptsim_jax.core import config
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import (
    atomic_file,
    output_errors,
    output_folder,
    without_nan,
    write_bytes,
    write_json,
)


class Torn(BadInput):
    """A checkpoint that was cut or changed since it was written."""


SCHEMA = 1
MANIFEST = "manifest.json"
CONFIG = "config.toml"
METRICS = "metrics.jsonl"
CHECKPOINT = "checkpoint"
BEFORE = "before"  # within it, the checkpoint before


def save_checkpoint(
    folder: str | os.PathLike,
    tree: Any,
    *,
    task: str,
    step: int,
    config_hash: str,
    extra: dict[str, Any] | None = None,
) -> None:
    """Replace the checkpoint in `folder` by `tree`, a pytree of arrays, numbers and JAX PRNG keys,
    at `step`.

    At every moment one whole checkpoint is there, the old or the new. `extra` (JSON) travels in the
    manifest. Raises BadInput where the folder cannot be written, TypeError for a leaf that is not
    an array.
    """
    from adaptsim_jax.core import tree_store

    folder = output_folder(folder)
    leaves, arrays = tree_store.described(tree)
    unnamed = folder / f"state-{step}-{secrets.token_hex(6)}.npz"
    with atomic_file(unnamed) as file:
        payload = tree_store.Hashed(file)
        tree_store.write(payload, arrays)
    digest = payload.sha256.hexdigest()
    name = f"state-{step}-{digest[:12]}.npz"
    os.replace(unnamed, folder / name)
    manifest = {
        "schema": SCHEMA,
        "package": "adaptsim_jax",
        "version": __version__,
        "task": task,
        "step": int(step),
        "config_hash": config_hash,
        "payload": name,
        "bytes": payload.length,
        "sha256": digest,
        "leaves": leaves,
        "extra": extra or {},
    }
    manifest["seal"] = _seal(manifest)
    write_json(folder / MANIFEST, manifest)
    _sweep(folder, keep=name)


def _sweep(folder: Path, keep: str) -> None:
    """Remove older payloads and what a killed process left half-written."""
    for pattern in ("state-*.npz", ".state-*.tmp", f".{MANIFEST}.*.tmp"):
        for old in folder.glob(pattern):
            if old.name != keep:
                with contextlib.suppress(OSError):
                    old.unlink()


class Kept:
    """A checkpoint of long work, written every `every` s: it is found again where it is of the same
    `config_hash`.
    """

    def __init__(self, folder: Path, task: str, config_hash: str, every: float = 30.0):
        self.folder, self.task, self.config_hash, self.every = folder, task, config_hash, every
        self.saved = time.monotonic()

    def restore(self, like: Any) -> tuple[Any, int]:
        """`(tree, step)` to go on from; `(like, 0)` where there is none that is whole and of the
        same.
        """
        with contextlib.suppress(BadInput):
            if read_manifest(self.folder)["config_hash"] == self.config_hash:
                return load_checkpoint(self.folder, like, task=self.task)
        return like, 0

    def save(self, tree: Any, step: int) -> None:
        """Write `tree` at `step` where the last one is old enough."""
        if time.monotonic() - self.saved < self.every:
            return
        with contextlib.suppress(BadInput):  # the work is worth more than its checkpoint
            save_checkpoint(
                self.folder, tree, task=self.task, step=step, config_hash=self.config_hash
            )
        self.saved = time.monotonic()

    def clear(self) -> None:
        """Remove it: the work is done."""
        shutil.rmtree(self.folder, ignore_errors=True)


def _copy_checkpoint(folder: Path, into: Path) -> None:
    """`folder`'s checkpoint in `into` too, by another link to the same payload. One whose manifest
    is torn is left out.
    """
    try:
        name = read_manifest(folder)["payload"]
    except Torn:
        return
    output_folder(into)
    if not (into / name).exists():
        try:
            os.link(folder / name, into / name)
        except OSError:  # a file system without links
            shutil.copyfile(folder / name, into / name)
    write_bytes(into / MANIFEST, (folder / MANIFEST).read_bytes())
    _sweep(into, keep=name)


def load_checkpoint(folder: str | os.PathLike, like: Any, *, task: str) -> tuple[Any, int]:
    """`(tree, step)` from `folder`; `like` (arrays or ShapeDtypeStructs) has the structure and
    shapes wanted.

    Raises BadInput for a missing, torn or foreign checkpoint, another version, task, structure or
    shape.
    """
    from adaptsim_jax.core import tree_store

    folder = Path(folder)
    manifest = read_manifest(folder)
    if manifest["task"] != task:
        raise BadInput(
            f"{folder}: this checkpoint is of task '{manifest['task']}', not '{task}'; name the "
            "task it was made for, or another run folder"
        )
    path = folder / manifest["payload"]
    try:
        payload = path.read_bytes()
    except OSError as error:
        raise Torn(f"{path}: the checkpoint is torn ({error.strerror}); {_RENEW}") from None
    if (
        len(payload) != manifest["bytes"]
        or hashlib.sha256(payload).hexdigest() != manifest["sha256"]
    ):
        raise Torn(f"{path}: the checkpoint is torn (it does not match its manifest); {_RENEW}")
    return tree_store.unpack(payload, manifest["leaves"], like, where=str(path)), manifest["step"]


_RENEW = "restore it from a copy, or start the run anew in another folder"
_FIELDS = {
    "version": str,
    "task": str,
    "step": int,
    "config_hash": str,
    "payload": str,
    "bytes": int,
    "sha256": str,
    "leaves": list,
    "extra": dict,
}


def read_manifest(folder: str | os.PathLike) -> dict[str, Any]:
    """The manifest of the checkpoint in `folder`, checked: ours, whole, and of a version read
    here.
    """
    path = Path(folder) / MANIFEST
    try:
        manifest = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise BadInput(f"{folder}: no checkpoint here; name a run that was trained") from None
    except OSError as error:
        raise BadInput(
            f"{path}: cannot be read ({error.strerror}); name a run that was trained"
        ) from None
    except (ValueError, RecursionError):
        raise Torn(f"{path}: the checkpoint is torn (not JSON); {_RENEW}") from None
    if not isinstance(manifest, dict) or manifest.get("package") != "adaptsim_jax":
        raise BadInput(f"{path}: not a checkpoint of adaptsim_jax; name a run of `adaptsim train`")
    check_version(path, manifest)
    whole = all(type(manifest.get(name)) is kind for name, kind in _FIELDS.items())
    if not whole or manifest.get("seal") != _seal(manifest):
        raise Torn(f"{path}: the checkpoint is torn (its manifest was changed or cut); {_RENEW}")
    return manifest


def check_version(path: Path, table: dict[str, Any]) -> None:
    """BadInput where a file of ours, which says `schema` and `version`, is of another minor
    version: within one it keeps its meaning.
    """
    version = table.get("version", "0.1" if table.get("schema") == SCHEMA else None)
    same = isinstance(version, str) and version.split(".")[:2] == __version__.split(".")[:2]
    if table.get("schema") != SCHEMA or not same:
        raise BadInput(
            f"{path}: written by adaptsim_jax {version} (schema {table.get('schema')}), this is "
            f"{__version__} (schema {SCHEMA}); install that version to use it, or start anew"
        )


def _seal(manifest: dict[str, Any]) -> str:
    body = {name: value for name, value in manifest.items() if name != "seal"}
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


# ---------------------------------------------------------------- run folders


_FILE = re.compile(r"(.+\.py):(\w+)")


def _with_files(table: Any, renamed: Callable[[str], str]) -> Any:
    """`table` with each `file.py:function` in it as `renamed(file.py)` has its file."""
    if isinstance(table, dict):
        return {key: _with_files(value, renamed) for key, value in table.items()}
    if isinstance(table, list | tuple):
        return [_with_files(value, renamed) for value in table]
    match = _FILE.fullmatch(table) if isinstance(table, str) else None
    return table if match is None else f"{os.path.normpath(renamed(match[1]))}:{match[2]}"


def config_in(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The config in the `config.toml` of a run, read from `folder`, with whole names of files."""
    return _with_files(table["config"], partial(os.path.join, folder.resolve()))


def _identity(table: dict[str, Any]) -> dict[str, Any]:
    """What of a config makes a run what it is: not where files lie, nor what it is adapted to."""
    named = _with_files(table, os.path.basename)
    if isinstance(named.get("task"), dict):
        named["task"] = {key: x for key, x in named["task"].items() if key != "targets"}
    return named


class RunFolder:
    """A run on disk: `config.toml`, `metrics.jsonl`, `checkpoint/`. Made by `create`, `open`,
    `resume`.
    """

    def __init__(self, path: Path, task: str, table: dict[str, Any]):
        self.path = path
        self.task = task
        self.config = table
        self._older = ""  # what versions before called the hash of its config

    @classmethod
    def create(cls, path: str | os.PathLike, table: dict[str, Any], *, task: str) -> RunFolder:
        """A new run in an empty or new folder; `table` is the config, everything needed to run
        again.
        """
        path = Path(path)
        with contextlib.suppress(OSError):
            if (path / CONFIG).exists() or (path / CHECKPOINT).exists():
                raise BadInput(f"{path}: holds a run already; add --resume, or name another folder")
        output_folder(path)
        run = cls(path, task, table)
        run._write_config()
        return run

    @classmethod
    def open(cls, path: str | os.PathLike, *, task: str | None = None) -> RunFolder:
        """An existing run, to read; BadInput where it is torn, foreign, of another version or
        task.
        """
        path = Path(path)
        if not path.is_dir():
            raise BadInput(
                f"{path}: no such run folder; make one with `adaptsim train TASK --run {path}`"
            )
        where = path / CONFIG
        if not where.exists():
            raise BadInput(
                f"{path}: not a run folder (no {CONFIG}); name one that `adaptsim train` made"
            )
        table = config.read(where)
        check_version(where, table)
        if not isinstance(table.get("config"), dict) or not isinstance(table.get("task"), str):
            raise BadInput(f"{where}: 'task' or [config] is missing; {_RENEW}")
        if task is not None and table["task"] != task:
            raise BadInput(
                f"{path}: this run is of task '{table['task']}', not '{task}'; name another"
            )
        run = cls(path, table["task"], config_in(table, path))
        run._older = config.digest(table["config"])
        return run

    def _write_config(self) -> None:
        """Files of a person's own are named as they lie from here, so that both may move."""
        head = {"schema": SCHEMA, "version": __version__, "task": self.task}
        table = _with_files(self.config, partial(os.path.relpath, start=self.path.resolve()))
        config.write(self.path / CONFIG, {**head, "config": table})

    @classmethod
    def resume(cls, path: str | os.PathLike, table: dict[str, Any], *, task: str) -> RunFolder:
        """An existing run, to continue with the same config; BadInput names every key that
        differs.
        """
        run = cls.open(path, task=task)
        changed = config.differences(_identity(run.config), _identity(table))
        if changed:
            raise BadInput(
                f"{run.path / CONFIG}: this run was started otherwise ({'; '.join(changed)}); ask "
                "for the same, or name another folder"
            )
        output_folder(path)
        if config.differences(run.config, table):
            run.config = table
            run._write_config()
        return run

    @property
    def config_hash(self) -> str:
        return config.digest(_identity(self.config))

    @property
    def checkpoint(self) -> Path:
        return self.path / CHECKPOINT

    @property
    def metrics(self) -> Path:
        return self.path / METRICS

    def has_checkpoint(self) -> bool:
        return (self.checkpoint / MANIFEST).exists()

    def append_metrics(self, rows: list[dict[str, Any]]) -> None:
        """Append one JSON line a row, null for what is not finite, and sync them. Call it before
        `save`, which records the length.
        """
        text = "".join(json.dumps(without_nan(row), allow_nan=False) + "\n" for row in rows)
        with output_errors(self.metrics), open(self.metrics, "ab") as file:
            file.write(text.encode())
            file.flush()
            os.fsync(file.fileno())

    def save(self, tree: Any, step: int) -> None:
        """Checkpoint `tree` at `step` together with the length of the metrics written so far."""
        length = self.metrics.stat().st_size if self.metrics.exists() else 0
        extra = {"metrics_bytes": length}
        if self.has_checkpoint():
            _copy_checkpoint(self.checkpoint, self.checkpoint / BEFORE)
        save_checkpoint(
            self.checkpoint,
            tree,
            task=self.task,
            step=step,
            config_hash=self.config_hash,
            extra=extra,
        )

    def load(self, like: Any) -> tuple[Any, int]:
        """`(tree, step)` of the checkpoint, of the one before where the last is torn; BadInput also
        where it was made under another config.
        """
        return self._last_whole(like)[1]

    def _last_whole(self, like: Any) -> tuple[Path, tuple[Any, int]]:
        """The folder of the last whole checkpoint, and its `(tree, step)`."""
        before = self.checkpoint / BEFORE
        try:
            return self.checkpoint, self._load(self.checkpoint, like)
        except Torn as torn:
            if not (before / MANIFEST).exists():
                raise
            found = self._load(before, like)
            why = str(torn).removesuffix(f"; {_RENEW}")
            print(f"{why}; the one before it is taken, of step {found[1]}", file=sys.stderr)
            return before, found

    def _load(self, folder: Path, like: Any) -> tuple[Any, int]:
        if read_manifest(folder)["config_hash"] not in (self.config_hash, self._older):
            raise BadInput(
                f"{self.path}: {CONFIG} was changed since the checkpoint was written; restore it"
            )
        return load_checkpoint(folder, like, task=self.task)

    def restore(self, like: Any) -> tuple[Any, int]:
        """Load as `load` does, to continue: metrics written after the checkpoint are cut off, for
        they will come again.

        Without a checkpoint (killed before the first one) the metrics are emptied and `(like, 0)`
        comes back.
        """
        if not self.has_checkpoint():
            self._cut_metrics(0)
            return like, 0
        folder, (tree, step) = self._last_whole(like)
        if folder != self.checkpoint:
            _copy_checkpoint(folder, self.checkpoint)
        self._cut_metrics(int(read_manifest(folder)["extra"].get("metrics_bytes", 0)))
        return tree, step

    def read_metrics(self) -> list[dict[str, Any]]:
        """The rows of `metrics.jsonl`; a last line that was cut by a kill is left out."""
        if not self.metrics.exists():
            return []
        lines = self.metrics.read_text().split("\n")[:-1]
        try:
            return [json.loads(line) for line in lines]
        except ValueError as error:
            raise BadInput(f"{self.metrics}: a row is not JSON ({error}); {_RENEW}") from None

    def _cut_metrics(self, length: int) -> None:
        have = self.metrics.stat().st_size if self.metrics.exists() else 0
        if have < length:
            raise BadInput(f"{self.metrics}: {have} bytes, {length} at the checkpoint; {_RENEW}")
        if have > length:
            with output_errors(self.metrics):
                os.truncate(self.metrics, length)
