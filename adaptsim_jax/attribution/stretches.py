"""Recordings cut into short stretches with a free start each (multiple shooting; Bock, 1981).

Stretches lie along the last axis of every array and have equal numbers of rows. A shorter one is
padded with rows of no duration. A row is one sample of the log, or the mean over several where the
log is faster than needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.attribution.criteria import STRETCH
from adaptsim_jax.logs.noise import local_motion
from adaptsim_jax.logs.stretch_rows import TrialSpans, stretch_rows

LANES = ("trial", "time", "q", "v", "seen", "seen_v", "start", "stamp", "command")


@dataclass(frozen=True)
class JointTrack:
    """One recorded trial of `n` joints: time [T] s, q [T, n] rad or m (NaN: missing), v [T, n] or
    None, u [T, n] (torque in N m, or what the joint's actuator was told).
    """

    name: str
    time: np.ndarray
    q: np.ndarray
    v: np.ndarray | None
    u: np.ndarray

    @property
    def span(self) -> float:
        """s."""
        return float(self.time[-1] - self.time[0])

    @property
    def dt(self) -> float:
        """Median row, s."""
        return float(np.median(np.diff(self.time)))

    def between(self, begin: float, end: float) -> "JointTrack":
        """The rows from `begin` to `end`, s."""
        own = (self.time >= begin) & (self.time <= end)
        v = self.v if self.v is None else self.v[own]
        return JointTrack(self.name, self.time[own], self.q[own], v, self.u[own])


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
        lanes = {k: getattr(self, k)[..., keep] for k in LANES}
        return JointStretches(**lanes, past=self.past, names=self.names)

    def of(self, joints: Sequence[int]) -> "JointStretches":
        """The same stretches of some joints alone."""
        j = list(joints)
        both = [*j, *(self.joints + k for k in j)]  # angles, then speeds
        return JointStretches(
            self.trial,
            self.time,
            self.q[:, j],
            self.v[:, j],
            self.seen[:, j],
            self.seen_v[:, j],
            self.start[both],
            self.stamp,
            self.command[:, j],
            self.past,
            self.names,
        )


def cut(
    tracks: Sequence[JointTrack], horizon: float = 0.5, most: int = 10_000, row: float = STRETCH.row
) -> JointStretches:
    """Stretches of `horizon` s of all tracks, side by side; see `stretch_rows`.

    Raises BadInput where no trial holds a whole stretch.
    """
    spans, steps = [], []
    for track in tracks:
        stride = max(1, round(row / track.dt))
        span = stride * max(STRETCH.min_rows, round(horizon / (stride * track.dt)))
        last = np.arange(len(track.time)) + span
        spans.append(TrialSpans(track.time, track.q, last, stride))
        steps.append(stride * track.dt)
    chosen = stretch_rows(spans, horizon, most)
    rows, own = chosen.compared()
    past, future = (int(np.ceil(z / min(steps))) for z in (STRETCH.past, STRETCH.future))
    parts = []
    for k in np.unique(chosen.trial):
        mine = chosen.trial == k
        part = _of_trial(tracks[k], rows[mine], own[mine], past, future)
        parts.append({"trial": np.full(mine.sum(), k), **part})
    lanes = {key: np.concatenate([part[key] for part in parts], -1) for key in LANES}
    return JointStretches(**lanes, past=past, names=tuple(t.name for t in tracks))


def without_first_rows(stretches: JointStretches, span: float) -> JointStretches:
    """The same with the readings of the first `span` s unseen, where rows are short enough: a late
    sensor tells there of what came before the start, which is not simulated.
    """
    since = stretches.time - stretches.time[:1]
    dt = np.median(np.diff(stretches.time, axis=0), axis=0)
    mask = ((since > span - 0.5 * dt) | (dt > 0.5 * span))[:, None]
    return replace(stretches, seen=stretches.seen * mask, seen_v=stretches.seen_v * mask)


def _of_trial(
    track: JointTrack, rows: np.ndarray, own: np.ndarray, past: int, future: int
) -> dict[str, np.ndarray]:
    """The arrays of the stretches of a trial, whose rows are `rows` [W, L + 1], `own` or again the
    last; past, future: rows of command before and after.
    """
    time = track.time[rows].T
    dt = np.median(np.diff(time[: own[0].sum()], axis=0), axis=0)
    before = time[0] - dt * np.arange(past, 0, -1)[:, None]
    after = time[-1] + dt * np.arange(1, future + 1)[:, None]
    edges = np.concatenate([before, time, after])
    q = np.moveaxis(track.q[rows], 0, -1)
    v = np.full_like(q, np.nan) if track.v is None else np.moveaxis(track.v[rows], 0, -1)
    live = own.T[:, None]
    motion = np.concatenate(local_motion(track.time, track.q, track.v), 1)
    command = mean_command(track.time, track.u, edges)
    return {
        "time": time - track.time[0],
        "q": np.where(np.isfinite(q), q, 0.0),
        "v": np.where(np.isfinite(v), v, 0.0),
        "seen": np.isfinite(q) * live,
        "seen_v": np.isfinite(v) * live,
        "start": motion[rows[:, 0]].T,
        "stamp": edges[:-1] - track.time[0],
        "command": np.moveaxis(command, 1, -1),
    }


def mean_command(time: np.ndarray, u: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Mean [E, ..., n] of a command between `edges` [E + 1, ...] s, where it is held from its row
    to the next, the first and the last one for ever; time [T] s, u [T, n], NaN: nothing.
    """
    u = np.where(np.isfinite(u), u, 0.0)
    area = np.cumsum(u[:-1] * np.diff(time)[:, None], 0)
    area = np.concatenate([np.zeros((1, u.shape[1])), area])
    span = np.diff(edges, axis=0)
    row = np.clip(np.searchsorted(time, edges[:-1], side="right") - 1, 0, len(time) - 1)
    early, late = np.minimum(edges - time[0], 0.0), np.maximum(edges - time[-1], 0.0)
    out = np.empty((*span.shape, u.shape[1]))
    for j, (held, whole) in enumerate(zip(u.T, area.T, strict=True)):
        sums = np.interp(edges, time, whole) + early * held[0] + late * held[-1]
        means = np.diff(sums, axis=0) / np.where(span > 0, span, 1.0)
        out[..., j] = np.where(span > 0, means, held[row])
    return out
