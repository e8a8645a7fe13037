"""A pytree of arrays to and from the bytes of an npz file, bit for bit and without pickle.

The structure is not stored as code or objects: each leaf is listed by its path, the reader brings
the rest.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from typing import Any, BinaryIO, cast

import jax
import jax.numpy as jnp
import numpy as np

from adaptsim_jax.core.errors import BadInput

_PLAIN = "biufc"


class Hashed:
    """A file that is being written: the hash and the length in bytes of what was."""

    def __init__(self, file: BinaryIO):
        self.file, self.sha256, self.length = file, hashlib.sha256(), 0

    def write(self, data: Any) -> int:
        self.sha256.update(data)
        self.length += memoryview(data).nbytes
        return self.file.write(data)

    def flush(self) -> None:
        self.file.flush()


def described(tree: Any) -> tuple[list[dict[str, Any]], list[np.ndarray]]:
    """`(leaves, arrays)`: leaves list path, kind, dtype and shape in the order of the arrays.

    Raises TypeError for a leaf that is neither an array, a number nor a PRNG key.
    """
    leaves, arrays = [], []
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        entry = _describe(leaf)
        if entry is None:
            raise TypeError(
                f"leaf {jax.tree_util.keystr(path)} is {type(leaf).__name__}, not an array"
            )
        leaves.append({"path": jax.tree_util.keystr(path), **entry})
        if entry["kind"] == "key":
            leaves[-1]["impl"] = str(jax.random.key_impl(leaf))
        arrays.append(_raw(leaf, entry))
    return leaves, arrays


def write(file: Hashed, arrays: list[np.ndarray]) -> None:
    """Write an npz of the arrays a0, a1, ... piece by piece: there is no copy of all of them."""
    archive = zipfile.ZipFile(cast(Any, file), "w")
    try:
        for index, array in enumerate(arrays):
            with archive.open(f"a{index}.npy", "w", force_zip64=True) as part:
                np.lib.format.write_array(part, array, allow_pickle=False)
        archive.close()
    except BaseException:  # Ctrl-C as a part is opened: closing would fail in its place
        archive.fp = None
        raise


def unpack(payload: bytes, leaves: list[dict[str, Any]], like: Any, *, where: str) -> Any:
    """The tree with the structure of `like` (arrays or ShapeDtypeStructs); BadInput on any
    difference.
    """
    wanted, structure = jax.tree_util.tree_flatten_with_path(like)
    _compare(wanted, leaves, where)
    try:
        with np.load(io.BytesIO(payload), allow_pickle=False) as file:
            raw = [file[f"a{index}"] for index in range(len(leaves))]
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise BadInput(f"{where}: not a checkpoint payload ({error}); start the run anew") from None
    restored = [
        _restore(array, entry, leaf, where)
        for array, entry, (_, leaf) in zip(raw, leaves, wanted, strict=True)
    ]
    return jax.tree_util.tree_unflatten(structure, restored)


def _is_key(leaf: Any) -> bool:
    return hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _describe(leaf: Any) -> dict[str, Any] | None:
    if _is_key(leaf):
        return {"kind": "key", "dtype": str(leaf.dtype), "shape": list(leaf.shape)}
    if isinstance(leaf, bool | int | float):
        return {"kind": type(leaf).__name__, "dtype": np.asarray(leaf).dtype.name, "shape": []}
    if not hasattr(leaf, "dtype") or not hasattr(leaf, "shape"):
        return None
    dtype = np.dtype(leaf.dtype)
    if dtype.kind not in _PLAIN and not jnp.issubdtype(dtype, jnp.floating):
        return None
    return {"kind": "array", "dtype": dtype.name, "shape": list(leaf.shape)}


def _raw(leaf: Any, entry: dict[str, Any]) -> np.ndarray:
    if entry["kind"] == "key":
        return np.asarray(jax.random.key_data(leaf))
    array = np.asarray(leaf)
    if array.dtype.kind in _PLAIN:
        return array
    # npz has no bfloat16 or float8: their bytes are kept, the dtype is in the manifest
    return array.view(np.dtype(f"u{array.dtype.itemsize}"))


def _compare(wanted: list[tuple[Any, Any]], leaves: list[dict[str, Any]], where: str) -> None:
    paths = [jax.tree_util.keystr(path) for path, _ in wanted]
    try:
        stored = {entry["path"]: entry for entry in leaves}
    except (TypeError, KeyError):
        raise BadInput(f"{where}: the list of arrays is damaged; start the run anew") from None
    if paths != [entry["path"] for entry in leaves]:
        unmatched = [path for path in paths if path not in stored] + [
            path for path in stored if path not in paths
        ]
        raise BadInput(
            f"{where}: holds other arrays than are needed (at {unmatched[:3]}); use the config it "
            "was made with"
        )
    for path, (_, leaf) in zip(paths, wanted, strict=True):
        entry, want = stored[path], _describe(leaf)
        if want is None:
            raise TypeError(f"leaf {path} of `like` is {type(leaf).__name__}, not an array")
        for what in ("kind", "dtype", "shape"):
            if entry.get(what) != want[what]:
                raise BadInput(
                    f"{where}: {path} has {what} {entry.get(what)}, this run needs {want[what]}; "
                    "use the config it was made with"
                )


def _restore(array: np.ndarray, entry: dict[str, Any], like: Any, where: str) -> Any:
    shape = tuple(entry["shape"])
    if entry["kind"] == "key":
        return jax.random.wrap_key_data(jnp.asarray(array), impl=entry["impl"])
    if entry["dtype"] in np.sctypeDict:
        dtype = np.dtype(entry["dtype"])
    else:
        dtype = np.dtype(like.dtype)
    if array.dtype != dtype:
        array = array.view(dtype)
    if array.shape != shape:
        raise BadInput(
            f"{where}: {entry['path']} has shape {array.shape}, not {shape}; start the run anew"
        )
    if entry["kind"] != "array":
        return array.item()
    if isinstance(like, np.ndarray | np.generic):
        return array
    restored = jnp.asarray(array)
    if restored.dtype != dtype:
        raise BadInput(
            f"{where}: {entry['path']} is {dtype}; set JAX_ENABLE_X64=1 as when it was written"
        )
    return restored
