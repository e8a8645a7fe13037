"""Digests of what a function computes: of its jaxpr with all constants, not of its text.

A comment or another name of a variable changes nothing. Another constant does, in the function
itself or in any that it calls.
"""

import hashlib
import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

ADDRESS = re.compile(r" at 0x[0-9a-f]+")
HIDDEN = ("name", "debug_info", "source_info", "ctx_mesh")
"""Parameters of a primitive that change nothing of what it computes."""


def digest_of(function: Callable, *args: Any) -> str:
    """A hash of what `function` computes for arguments of these shapes and types.

    It is the same in another process. Arrays that are closed over count by their values.
    """
    closed = jax.make_jaxpr(lambda *own: function(*own))(*args)  # a function traced before is not
    return _Traced().closed(closed).hex()


def digest_of_arrays(tree: Any) -> str:
    """A hash of the values, shapes and types of all arrays and numbers of a pytree."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(tree):
        digest.update(_array(leaf))
    return digest.hexdigest()


class _Traced:
    """Digests of jaxprs. One that is called in several places is walked once."""

    def __init__(self):
        self._walked: dict[int, tuple[Any, bytes]] = {}

    def closed(self, closed: core.ClosedJaxpr) -> bytes:
        found = hashlib.sha256(self.jaxpr(closed.jaxpr))
        for constant in closed.consts:
            found.update(_array(constant))
        return found.digest()

    def jaxpr(self, jaxpr: core.Jaxpr) -> bytes:
        if id(jaxpr) not in self._walked:
            self._walked[id(jaxpr)] = (jaxpr, self._equations(jaxpr))
        return self._walked[id(jaxpr)][1]

    def _equations(self, jaxpr: core.Jaxpr) -> bytes:
        found, numbers = hashlib.sha256(), {}

        def atom(x):
            if isinstance(x, core.Literal):
                found.update(_array(x.val))
            else:
                number = numbers.setdefault(x, len(numbers))
                found.update(f"{number}:{x.aval.str_short()};".encode())

        for x in (*jaxpr.constvars, *jaxpr.invars):
            atom(x)
        for equation in jaxpr.eqns:
            found.update(f"{equation.primitive.name}(".encode())
            for x in (*equation.invars, *equation.outvars):
                atom(x)
            for name in sorted(equation.params.keys() - set(HIDDEN)):
                found.update(f"{name}=".encode() + self._parameter(equation.params[name]))
        for x in jaxpr.outvars:
            atom(x)
        return found.digest()

    def _parameter(self, value: Any) -> bytes:
        if isinstance(value, core.ClosedJaxpr):
            return self.closed(value)
        if isinstance(value, core.Jaxpr):
            return self.jaxpr(value)
        if isinstance(value, (np.ndarray, np.generic, jax.Array)):
            return _array(value)
        if isinstance(value, dict):
            return b"".join(sorted(_text(k) + self._parameter(v) for k, v in value.items()))
        if isinstance(value, (set, frozenset)):
            return b"".join(sorted(map(self._parameter, value)))
        if isinstance(value, (tuple, list)) and type(value) in (tuple, list):
            return b"".join((b"[", *map(self._parameter, value), b"]"))
        return _text(value)


def _text(value: Any) -> bytes:
    """What a parameter is called, without where it lies in memory."""
    if callable(value) and hasattr(value, "__qualname__"):
        return f"{value.__module__}.{value.__qualname__}".encode()
    return ADDRESS.sub("", repr(value)).encode()


def _array(value: Any) -> bytes:
    if hasattr(value, "dtype") and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        value = jax.random.key_data(value)
    array = np.asarray(value)
    if array.dtype == object:
        return _text(value)
    return f"{array.dtype}{array.shape}".encode() + np.ascontiguousarray(array).tobytes()
