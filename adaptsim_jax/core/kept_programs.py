"""Programs traced once: `kept` in the place of `jax.jit`, for large ones that every process would trace again.

JAX's compile cache spares what XLA does, not the tracing in Python before it, which for the largest programs here takes four
times as long as reading the compiled one. Where that cache is on and in a folder, what a trace came to is written there too
(StableHLO, by `jax.export`), and later processes call that. The file's name is a digest of everything a trace depends on: the
sources of this package, JAX's version and settings, the function, the shapes of its arguments and what is fixed in their
structure. What another package brought into that structure (a user's effect or model) has no such digest: then it is traced.
"""

import functools
import hashlib
import logging
import threading
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from types import FunctionType, MappingProxyType
from typing import Any

import jax
from jax.core import Tracer

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.core.files import write_bytes

PACKAGE = __name__.partition(".")[0]
FOLDER = "traced"  # in that of the compile cache
DIGEST = hashlib.sha256().digest_size
SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision", "jax_numpy_rank_promotion", "jax_numpy_dtype_promotion")
PLAIN = (tuple, list, dict, type(None))
logger = logging.getLogger(__name__)


class Unnamed(TypeError):
    """Something that no text describes in full."""


def kept(*records: type) -> Callable[[Callable], "Kept"]:
    """Decorator: compiled as by `jax.jit`, all arguments traced; records: the NamedTuples among what the function returns."""
    from jax import export

    for record in records:
        export.register_namedtuple_serialization(record, serialized_name=f"{record.__module__}.{record.__qualname__}")
    return Kept


class Kept:
    """A function compiled as by `jax.jit`, whose traces later processes find again."""

    def __init__(self, function: Callable):
        functools.update_wrapper(self, function)
        self.function, self.plain = function, jax.jit(function)
        self.programs: dict[Any, Callable] = {}
        self._lock = threading.Lock()

    def __call__(self, *args):
        folder, leaves = cache_folder(), jax.tree.leaves(args)
        if folder is None or any(isinstance(leaf, Tracer) for leaf in leaves):
            return self.plain(*args)
        tree = jax.tree.structure(args)
        like = tree, tuple(jax.typeof(leaf) for leaf in leaves), settings()
        with self._lock:
            if like not in self.programs:
                self.programs[like] = self._program(folder, tree, leaves, repr(like[1:]))
        return self.programs[like](*leaves)

    def _program(self, folder: Path, tree, leaves: list, like: str) -> Callable:
        """A compiled function of the leaves of such arguments."""
        flat = jax.jit(lambda *leaves: self.plain(*jax.tree.unflatten(tree, leaves)))
        try:
            name = hashlib.sha256("\n".join((origin(), spelled(self.function), structure(tree), like)).encode())
        except Unnamed:
            return flat
        path = folder / f"{self.function.__name__.strip('_')}-{name.hexdigest()}"
        return jax.jit((_read(path) or _traced(path, flat, leaves)).call)


def _traced(path: Path, flat: Any, leaves: list):
    """What tracing comes to, written to `path` behind its own digest, if that can be."""
    from jax import export

    traced = export.export(flat)(*leaves)
    data = bytes(traced.serialize())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, hashlib.sha256(data).digest() + data)
    except (OSError, BadInput) as error:  # a full disk is no reason to compute nothing
        logger.debug("%s is not kept: %s", path, error)
    return traced


def _read(path: Path):
    """What an earlier process traced; None where there is nothing, or nothing whole."""
    from jax import export

    try:
        data = path.read_bytes()
    except OSError:
        return None
    whole = hashlib.sha256(data[DIGEST:]).digest() == data[:DIGEST]
    return export.deserialize(bytearray(data[DIGEST:])) if whole else None


def cache_folder() -> Path | None:
    """Where traces are kept: in the folder of JAX's compile cache, where one is on. On processors alone: how well traces for
    others can be kept was not tried."""
    folder, on, eager = map(_setting, ("jax_compilation_cache_dir", "jax_enable_compilation_cache", "jax_disable_jit"))
    usable = folder and on and not eager and "://" not in folder and jax.default_backend() == "cpu"
    return Path(folder) / FOLDER if usable else None


def settings() -> tuple:
    """JAX's settings that a trace depends on."""
    return jax.default_backend(), *map(_setting, SETTINGS)


def _setting(name: str) -> Any:
    return getattr(jax.config, name)


@functools.cache
def origin() -> str:
    """Digest of what traces: this package's sources and JAX."""
    root, digest = Path(__file__).parents[1], hashlib.sha256(f"{version('jax')} {version('jaxlib')}".encode())
    for path in sorted(root.rglob("*.py")):
        digest.update(f"\n{path.relative_to(root)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def structure(tree) -> str:
    """A tree of arguments in words, with what is fixed in its nodes. Raises `Unnamed`."""
    data = tree.node_data()
    if data is None:
        return "*" if tree.num_leaves else "-"
    return f"{spelled(data)}[{' '.join(structure(child) for child in tree.children())}]"


def spelled(value: Any) -> str:
    """A fixed value in words, the same in every process and for no other value. Raises `Unnamed` where there are none."""
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return repr(value)
    if isinstance(value, type) and (value in PLAIN or _digested(value)):
        return f"{value.__module__}.{value.__qualname__}"
    if isinstance(value, FunctionType) and _digested(value):
        bound = [cell.cell_contents for cell in value.__closure__ or ()]
        where = repr(
            (value.__code__.co_code, list(value.__code__.co_positions()))
        )  # in sources whose digest is `origin`
        place = hashlib.sha256(where.encode()).hexdigest()
        return f"{value.__module__}.{value.__qualname__}@{place}{spelled([bound, value.__defaults__, value.__kwdefaults__])}"
    if isinstance(value, slice):
        return f"slice{spelled([value.start, value.stop, value.step])}"
    if isinstance(value, functools.partial):
        return f"partial{spelled([value.func, value.args, value.keywords])}"
    if type(value) in (dict, MappingProxyType):
        return f"{{{', '.join(f'{spelled(k)}: {spelled(v)}' for k, v in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"{spelled(type(value))}({', '.join(spelled(item) for item in value)})"
    if is_dataclass(value) and not isinstance(value, type):
        return f"{spelled(type(value))}{spelled({f.name: getattr(value, f.name) for f in fields(value)})}"
    raise Unnamed(f"{value!r} has no text of its own")


def _digested(value: Any) -> bool:
    """Whether the sources of a function or class are among those of `origin`: else it may change, and its name would not."""
    return (value.__module__ or "").partition(".")[0] == PACKAGE
