"""Recordings cut into short stretches with a free start each (multiple shooting; Bock, 1981).

Stretches lie along the last axis of every array and have equal numbers of rows. A shorter one is
padded with rows of no duration. A row is one sample of the log, or the mean over several where the
log is faster than needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from adaptsim_jax.attribution.criteria import STRETCH
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.noise import local_motion


@dataclass(frozen=True)
class JointTrack:
    """One recorded trial of `n` joints: time [T] s, q [T, n] rad or m (NaN: missing), v [T, n] or
    None, u [T, n] (torque in N m, or what the joint's actuator was told), group: trials of one kind
    (a payload, a zero).
    """

    name: str
    time: np.ndarray
    q: np.ndarray
    v: np.ndarray | None
    u: np.ndarray
    group: str = ""


@dataclass(frozen=True)
class JointStretches:
    """W stretches of L rows. trial [W]; time [L+1, W] s since the trial began; q, v [L+1, n, W] as
    measured, with `seen` and `seen_v` 1 or 0; start [2n, W] smoothed state; command [H+L+F, n, W]
    with `stamp` [H+L+F, W] s; past H rows.
    """

    trial: np.ndarray
    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    seen: np.ndarray
    seen_v: np.ndarray
    start: np.ndarray
    stamp: np.ndarray
    command: np.ndarray
    past: int
    names: tuple[str, ...]

    @property
    def joints(self) -> int:
        return self.q.shape[1]

    @property
    def rows(self) -> int:
        return len(self.time) - 1

    @property
    def count(self) -> int:
        return len(self.trial)

    def pick(self, keep: np.ndarray) -> "JointStretches":
        """Those stretches alone."""
        lanes = {
            k: getattr(self, k)[..., keep]
            for k in ("trial", "time", "q", "v", "seen", "seen_v", "start", "stamp", "command")
        }
        return JointStretches(**lanes, past=self.past, names=self.names)

    def of(self, joints: Sequence[int]) -> "JointStretches":
        """The same stretches of some joints alone."""
        j = list(joints)
        n = self.joints
        return JointStretches(
            self.trial,
            self.time,
            self.q[:, j],
            self.v[:, j],
            self.seen[:, j],
            self.seen_v[:, j],
            self.start[[*j, *(n + k for k in j)]],
            self.stamp,
            self.command[:, j],
            self.past,
            self.names,
        )


def cut(
    tracks: Sequence[JointTrack], horizon: float = 0.5, most: int = 10_000, row: float = STRETCH.row
) -> JointStretches:
    """Stretches of `horizon` s of all tracks, side by side; none over a gap in time. At most about
    `most`, evenly spread.

    Raises BadInput where no trial holds a whole stretch.
    """
    pieces, length, width = [], 0, 0.0
    for k, track in enumerate(tracks):
        dt = float(np.median(np.diff(track.time)))
        stride = max(1, round(row / dt))
        rows = max(STRETCH.min_rows, round(horizon / (stride * dt)))
        length, width = max(length, rows), max(width, stride * dt)
        pieces.append((k, stride, rows, _whole(track, stride, rows, dt)))
    total = sum(len(begins) for *_, begins in pieces)
    if not total:
        raise BadInput(
            f"no trial has an unbroken stretch of {horizon:g} s; give a shorter --horizon or "
            "longer trials"
        )
    share = min(1.0, most / total)
    fine = min(stride * float(np.median(np.diff(tracks[k].time))) for k, stride, *_ in pieces)
    past, future = int(np.ceil(STRETCH.past / fine)), int(np.ceil(STRETCH.future / fine))
    lanes = []
    for k, stride, rows, begins in pieces:
        keep = np.unique(
            np.linspace(0, len(begins) - 1, max(1, round(share * len(begins)))).round().astype(int)
        )
        trial = _Trial(
            k,
            tracks[k],
            local_motion(tracks[k].time, tracks[k].q, tracks[k].v),
            _integral(tracks[k].time, tracks[k].u),
        )
        size = _Size(stride, rows, length, past, future)
        chosen = [begins[i] for i in keep] if len(begins) else []
        lanes += [_lane(trial, b, size) for b in chosen]

    def stack(key):
        return np.stack([lane[key] for lane in lanes], -1)

    keys = ("trial", "time", "q", "v", "seen", "seen_v", "start", "stamp", "command")
    return JointStretches(
        **{key: stack(key) for key in keys}, past=past, names=tuple(t.name for t in tracks)
    )


def _whole(track: JointTrack, stride: int, rows: int, dt: float) -> list[int]:
    """First samples of consecutive stretches without a gap in time, in which at least half of the
    angles were read.
    """
    span = stride * rows
    begins, at = [], 0
    broken = np.flatnonzero(np.diff(track.time) > max(5.0 * dt, 0.05))
    observed = np.isfinite(track.q).mean(1)
    while at + span < len(track.time):
        inside = broken[(broken >= at) & (broken < at + span)]
        if len(inside):
            at = int(inside[-1]) + 1
            continue
        if observed[at : at + span + 1].mean() > 0.5:
            begins.append(at)
        at += span
    return begins


def without_first_rows(stretches: JointStretches, span: float) -> JointStretches:
    """The same with the readings of the first `span` s unseen, where rows are short enough: a late
    sensor tells there of what came before the start, which is not simulated.
    """
    since = stretches.time - stretches.time[:1]
    dt = np.median(np.diff(stretches.time, axis=0), axis=0)
    mask = ((since > span - 0.5 * dt) | (dt > 0.5 * span))[:, None]
    return replace(stretches, seen=stretches.seen * mask, seen_v=stretches.seen_v * mask)


def _integral(time: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Running integral [T, n] of a command held from its row to the next."""
    u = np.where(np.isfinite(u), u, 0.0)
    return np.concatenate(
        [np.zeros((1, u.shape[1])), np.cumsum(u[:-1] * np.diff(time)[:, None], 0)]
    )


class _Trial(NamedTuple):
    """A trial by its number, with its smoothed motion (angles and speeds [T, n]) and the running
    integral of its command [T, n].
    """

    number: int
    track: JointTrack
    motion: tuple[np.ndarray, np.ndarray]
    integral: np.ndarray


class _Size(NamedTuple):
    """Samples from row to row of a stretch, its own rows, those of the longest one, and the rows of
    its command before it and after it.
    """

    stride: int
    rows: int
    length: int
    past: int
    future: int


def _lane(trial: _Trial, begin: int, size: _Size) -> dict[str, np.ndarray | int]:
    """The arrays of a stretch that begins at a sample of a trial."""
    (k, track, motion, integral), (stride, rows, length, past, future) = trial, size
    at = begin + stride * np.minimum(np.arange(length + 1), rows)
    time = track.time[at]
    live = (np.arange(length + 1) <= rows)[:, None]
    dt = float(np.median(np.diff(time[: rows + 1])))
    before = time[0] - dt * np.arange(past, 0, -1)
    after = time[-1] + dt * np.arange(1, future + 1)
    edges = np.concatenate([before, time, after])
    command = _means(track.time, np.where(np.isfinite(track.u), track.u, 0.0), integral, edges)
    q = track.q[at]
    v = np.full_like(q, np.nan) if track.v is None else track.v[at]
    q0, v0 = motion
    return {
        "trial": k,
        "time": time - track.time[0],
        "q": np.where(np.isfinite(q), q, 0.0),
        "v": np.where(np.isfinite(v), v, 0.0),
        "seen": np.isfinite(q) * live,
        "seen_v": np.isfinite(v) * live,
        "start": np.concatenate([q0[begin], v0[begin]]),
        "stamp": edges[:-1] - track.time[0],
        "command": command,
    }


def _means(time, u, integral, edges) -> np.ndarray:
    """Mean command [rows, n] between edges; before the first row and after the last it stays as it
    was there.
    """
    out = np.empty((len(edges) - 1, u.shape[1]))
    span = np.diff(edges)
    for j in range(u.shape[1]):
        area = np.interp(edges, time, integral[:, j])
        area = (
            area
            + np.minimum(edges - time[0], 0.0) * u[0, j]
            + np.maximum(edges - time[-1], 0.0) * u[-1, j]
        )
        row = np.clip(np.searchsorted(time, edges[:-1], side="right") - 1, 0, len(time) - 1)
        out[:, j] = np.where(span > 0, np.diff(area) / np.where(span > 0, span, 1.0), u[row, j])
    return out
