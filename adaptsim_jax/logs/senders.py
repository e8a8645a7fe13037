"""Messages of a topic on which two senders speak of the same joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import CLOCK, SIGNAL

Message = tuple[Any, tuple[str, ...], Mapping[str, Any]]
"""Time (ns or s), names of joints, and their values by stem."""


def one_sender(topic: str, rows: Sequence[Message]) -> tuple[list[Message], tuple[str, ...]]:
    """The messages without those of another sender that contradict them, and notes on these.

    A sender is known by the order of its names and by what it gives. BadInput where two that
    contradict each other cannot be told apart.
    """
    senders: dict[tuple[str, ...], dict[tuple, list[int]]] = {}
    for k, (_, names, values) in enumerate(rows):
        stems = tuple(stem for stem, x in values.items() if len(x) == len(names))
        messages_of = senders.setdefault(tuple(sorted(names)), {})
        messages_of.setdefault((names, stems), []).append(k)
    excluded: set[int] = set()
    notes = []
    for joints, messages_of in senders.items():
        main, *others = sorted(messages_of.values(), key=len, reverse=True)
        time, q = _angles(rows, main, joints)
        for other in others:
            if _contradict(time, q, *_angles(rows, other, joints)):
                excluded |= set(other)
                notes.append(
                    f"topic {topic}: {len(other)} messages of another sender contradict the "
                    f"{len(main)} that speak of the same joints ({', '.join(joints)}): left out"
                )
        if _leaps(q):
            raise BadInput(
                f"{topic}: two senders seem to speak of the same joints ({', '.join(joints)}): "
                "angles leap to and fro; record it with one of them stopped ('ros2 topic info -v' "
                "lists them)"
            )
    return [row for k, row in enumerate(rows) if k not in excluded], tuple(notes)


def one_commander(topic: str, rows: list[Message]) -> tuple[list[Message], tuple[str, ...]]:
    """Commands without those of another sender that lie between the others in time and leap from
    them and back, and a note on these.
    """
    shapes = {(names, *((stem, len(x)) for stem, x in values.items())) for _, names, values in rows}
    if len(shapes) != 1 or len(rows) < CLOCK.min_stamps:
        return rows, ()
    time = np.array([row[0] for row in rows])
    u = np.nan_to_num([np.concatenate([*row[2].values()]) for row in rows])
    is_other = np.zeros(len(rows), bool)
    is_other[1:-1] = np.any(_leaps_back(u, CLOCK.min_leap_share * np.ptp(u, axis=0)), axis=1)
    if (
        not CLOCK.min_leaping_share < np.mean(is_other) < CLOCK.max_sender_share
        or np.ptp(u) < SIGNAL.min_motion
    ):
        return rows, ()
    between = time[2:] - time[:-2] < CLOCK.min_density * np.median(np.diff(time[~is_other]))
    if np.mean(between[is_other[1:-1]]) < CLOCK.usual_quantile:
        return rows, ()
    steps = np.quantile(np.abs(np.diff(u[~is_other], axis=0)), CLOCK.usual_quantile, axis=0)
    is_other[1:-1] = between & np.any(_leaps_back(u, CLOCK.min_contradiction_steps * steps), axis=1)
    note = (
        f"topic {topic}: {is_other.sum()} messages of another sender lie between the "
        f"{np.sum(~is_other)} others and contradict them: left out"
    )
    return [row for row, is_excluded in zip(rows, is_other, strict=True) if not is_excluded], (
        note,
    )


def _angles(
    rows: Sequence[Message], indices: Sequence[int], joints: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Times `[K]` and angles `[K, n]` of some messages, as they came."""
    time = np.array([rows[k][0] for k in indices])
    order = [rows[indices[0]][1].index(name) for name in joints]
    return time, np.array([rows[k][2]["q"] for k in indices])[:, order]


def _contradict(time: np.ndarray, q: np.ndarray, other_time: np.ndarray, other: np.ndarray) -> bool:
    """Whether angles of another sender are farther from those `q [K, n]` at its times than these
    go from message to message.
    """
    if len(time) < CLOCK.min_stamps:
        return False
    order = np.argsort(time, kind="stable")
    distances = [
        np.median(np.abs(x - np.interp(other_time, time[order], y[order])))
        for x, y in zip(other.T, q.T, strict=True)
    ]
    steps = np.quantile(np.abs(np.diff(q, axis=0)), CLOCK.usual_quantile, axis=0)
    return bool(np.any(np.array(distances) > CLOCK.min_contradiction_steps * steps))


def _leaps(q: np.ndarray) -> bool:
    """Whether an angle `[K, n]` leaps over much of its range, and back at once, again and again."""
    if len(q) < CLOCK.min_stamps:
        return False
    span = np.ptp(q, axis=0)
    leaps_often = (
        np.mean(_leaps_back(q, CLOCK.min_leap_share * span), axis=0) > CLOCK.min_leaping_share
    )
    return bool(np.any(leaps_often & (span > SIGNAL.min_motion)))


def _leaps_back(q: np.ndarray, min_leap: np.ndarray) -> np.ndarray:
    """Find where values `[K, n]` leap by more than `min_leap [n]`, and back at once `[K - 2,
    n]`.
    """
    step = np.diff(q, axis=0)
    is_leap = np.abs(step) > min_leap
    return is_leap[:-1] & is_leap[1:] & (step[:-1] * step[1:] < 0)
