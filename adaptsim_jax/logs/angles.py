"""Joint positions of the model from logged angles: whole turns, zeros, absolute angles, joints
counted the other way round.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from adaptsim_jax.logs.log import ModelNames
from adaptsim_jax.logs.log_meta import LogMeta
from adaptsim_jax.logs.quality.turns import Turns, without_turns

V = TypeVar("V")


def model_angles(
    logged: np.ndarray, names: ModelNames, meta: LogMeta, *, rates: bool = False
) -> np.ndarray:
    """The model's joint positions `[T, n]` (or their rates) from logged ones in SI units.

    A zero is taken off first, then an absolute angle less that of the joint before it, then a
    reversed joint turned.
    """
    zero = np.array([_declared(meta.zero, i, j, 0.0) for i, j in enumerate(names.joints)])
    shown = logged if rates else logged - zero
    out = shown.copy()
    for i, (joint, parent) in enumerate(zip(names.joints, names.parent_of, strict=True)):
        if (
            _declared(meta.convention, i, joint, meta.convention.get("", "relative")) == "absolute"
            and parent >= 0
        ):
            out[:, i] = shown[:, i] - shown[:, parent]
    out[:, flipped_joints(names, meta)] *= -1.0
    return out


def flipped_joints(names: ModelNames, meta: LogMeta) -> list[bool]:
    """`[n]`: joints that the log counts the other way round."""
    return [
        _declared(dict.fromkeys(meta.reversed, True), i, joint, False)
        for i, joint in enumerate(names.joints)
    ]


def turns_of(time: np.ndarray, q: np.ndarray) -> Turns:
    """An angle `[T]` (rad, NaN where missing) at `time [T]` s without the jumps of an encoder that
    counts within one period.
    """
    here = np.flatnonzero(np.isfinite(q))
    found = without_turns(time[here], q[here])
    out = q.copy()
    out[here] = found.q
    return replace(found, q=out, unsure=tuple(int(here[k]) for k in found.unsure))


def _declared(table: Mapping[str, V], index: int, joint: str, default: V) -> V:
    """What `[angles]` gives a joint, by its name or by that of its column."""
    words = (joint, f"q_{joint}", f"q{index + 1}", *(("q",) if index == 0 else ()))
    return next((table[word] for word in words if word in table), default)
