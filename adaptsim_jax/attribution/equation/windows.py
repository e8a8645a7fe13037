"""A measured motion on an even grid, and the smooth windows that its balance of forces is averaged
over.

Both sides of the equations of motion are weighed with the same window, so that what a filter would
round off (dry friction) is rounded off on both. An acceleration is a difference of speeds. Summed
by parts it is the window's own slope times the speed, so no second derivative of a noisy angle is
taken by itself (the weak form; Bortz, Messenger and Dukic, 2023; DIDIM's parallel filters: Gautier,
Janot and Vandanjon, 2013).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse

from adaptsim_jax.attribution.criteria import WINDOW
from adaptsim_jax.attribution.stretches import JointTrack, mean_command
from adaptsim_jax.logs.stretch_rows import broken


@dataclass(frozen=True)
class EvenTrial:
    """A trial on an even grid: time [T] s, q, v, a [n, T], u [n, T] the mean command over a row,
    smooth [n, T] a speed with less noise, width [n] below
    which that is not told from zero, clear [n, T] 0 to 1:
    whether it moves; mean [K, T] averages over windows; at [K] s, their middles.
    """

    trial: int
    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray
    smooth: np.ndarray
    width: np.ndarray
    clear: np.ndarray
    mean: scipy.sparse.csr_matrix
    at: np.ndarray

    def averaged(self, z: np.ndarray) -> np.ndarray:
        """Of something on the grid [..., T] its mean over each window [..., K]."""
        flat = np.asarray(z, float).reshape(-1, z.shape[-1])
        return (self.mean @ flat.T).T.reshape(*z.shape[:-1], -1)


def runs_of(
    tracks: Sequence[JointTrack], noise: np.ndarray, span: float = WINDOW.span
) -> tuple[EvenTrial, ...]:
    """Trials on grids, with their windows. noise [n] of the angles; span: s of a window.

    Windows that lie over a gap in time, or over rows without an angle, are left out.
    """
    made = [(k, *_even(t)) for k, t in enumerate(tracks) if len(t.time) > WINDOW.min_rows]
    if not made:
        return ()
    speeds = np.concatenate([np.abs(m[3]) for m in made], 1)
    usual = np.quantile(speeds, 0.95, axis=1)
    out = []
    total = sum(time[-1] - time[0] for _, time, *_ in made)
    hop = max(WINDOW.hop * span, total / WINDOW.max_windows)
    for k, time, q, v, speed, u, mask in made:
        dt = time[1] - time[0]
        mean, at = _windows(time, mask, max(span, WINDOW.min_rows * dt), hop)
        if not len(at):
            continue
        rough = noise / dt * np.sqrt(12.0 / _rows(dt) ** 3)  # of a slope through so many rows
        width = np.maximum(np.maximum(WINDOW.creep * usual, WINDOW.speed_noises * rough), 1e-9)
        moves = np.square(np.tanh(v / np.maximum(WINDOW.clear * usual, width)[:, None]))
        out.append(
            EvenTrial(
                k,
                time,
                q,
                speed,
                np.gradient(v, dt, axis=1),
                u,
                v,
                width,
                moves,
                mean,
                at,
            )
        )
    return tuple(out)


def _rows(dt: float) -> int:
    """Rows of the local fit that a speed is read from: a fifth of a window, at least five."""
    return max(5, 2 * round(0.1 * WINDOW.span / dt) + 1)


def _even(track: JointTrack) -> tuple[np.ndarray, ...]:
    """time, q, v, speed, u on an even grid, and where rows were read (1) or not (0); v is
    smooth, and speed is true.
    """
    dt = track.dt
    time = np.arange(track.time[0], track.time[-1], dt)
    nearest = np.clip(np.searchsorted(track.time, time), 1, len(track.time) - 1)
    mask = 1.0 - broken(track.time)[nearest - 1]
    columns = []
    for z in track.q.T:
        there = np.isfinite(z)
        if there.sum() < 2:
            columns.append(np.zeros_like(time))
            mask[:] = 0.0
            continue
        columns.append(np.interp(time, track.time[there], z[there]))
        mask *= np.interp(time, track.time, there.astype(float)) > 0.5
    q, v, speed = _local(np.stack(columns), dt, _rows(dt))
    u = np.where(np.isfinite(track.u), track.u, 0.0)
    middle = mean_command(track.time, u, np.append(time - 0.5 * dt, time[-1] + 0.5 * dt))
    some = slice(None, None, max(1, round(WINDOW.grid / dt)))
    return (
        time[some],
        q[:, some],
        v[:, some],
        speed[:, some],
        middle.T[:, some],
        mask[some],
    )


def _local(q: np.ndarray, dt: float, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles and speeds [n, T] by local quadratics over `rows` neighbours (Savitzky and Golay,
    1964), and speeds by local quartics: the slope of a quadratic is too small by a share (0.2 % at
    1.2 Hz, by 7 rows of 5 ms) that a stiff controller's damping shows. Five rows, which a quartic
    would go through, have no other speed.
    """
    from scipy.signal import savgol_filter

    rows = min(rows, (q.shape[1] - 1) // 2 * 2 + 1)

    def by(degree, deriv):
        return np.asarray(savgol_filter(q, rows, degree, deriv=deriv, delta=dt, axis=1))

    return by(2, 0), by(2, 1), by(4 if rows > 5 else 2, 1)


def _windows(
    time: np.ndarray, mask: np.ndarray, span: float, hop: float
) -> tuple[scipy.sparse.csr_matrix, np.ndarray]:
    """Means over windows [K, T] of (1 + cos)^2's shape, and their middles [K]."""
    dt = time[1] - time[0]
    wide, hop = max(4, round(span / dt)), max(1, round(hop / dt))
    shape = np.square(1.0 + np.cos(2.0 * np.pi * (np.arange(1, wide) / wide - 0.5)))
    shape /= shape.sum()
    begins = np.arange(0, len(time) - wide, hop)
    whole = np.concatenate([[0.0], np.cumsum(mask)])
    if len(begins):
        begins = begins[whole[begins + wide] - whole[begins] > wide - 0.5]
    rows = np.repeat(np.arange(len(begins)), wide - 1)
    columns = (begins[:, None] + np.arange(1, wide)).ravel()
    table = scipy.sparse.csr_matrix(
        (np.tile(shape, len(begins)), (rows, columns)), shape=(len(begins), len(time))
    )
    return table, time[begins] + 0.5 * wide * dt
