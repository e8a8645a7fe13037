"""Tosses cut into windows that begin anew: over a few impacts a toss can no longer be told, over
one it can.

Where a corner strikes, a turn by a milliradian more decides over which edge the body goes. After
two or three impacts simulations from starts that no camera could tell apart lie centimetres apart.
So each toss is cut into windows of some tenth of a second, each with a start of its own that is
fitted beside everything else. What the parameters say is judged over windows, never through such a
fork.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.quaternions import between, from_rotvec, rotated, times
from adaptsim_jax.tasks.toss.read import Tossed, lowest

LENGTH = 0.12  # s
FLAT, LIES = 0.026, 2e-3  # rad, m: how near to its last pose a body that slides on a face lies
SETTLED = 2  # rows after it first does
SLIDES = 0.1  # m/s; slower is rest
MIN_ROWS = 8  # rows of a window
BEGIN = 5  # rows from which a start is guessed
STILL = (
    0.02  # m/s; rows after the last that is faster say nothing more than one second of them does
)
REST = 5  # rows kept after it
BEFORE = 4  # rows of flight left to the window of the first strike, from which its start is guessed
ASIDE = 4  # rows by which a window may begin earlier or later, where it jolts less
CLEAR = 0.05  # of the body's size, above the plane: free flight


@dataclass(frozen=True)
class Windows:
    """W windows of at most R rows.

    Args:
        toss: `[W]` whose.
        first: `[W]` its row there; time `[W, R]` s from its first row; place `[W, R, 3]`, turn
            `[W, R, 4]`, mask `[W, R]`.
        start: `[W, 13]` guessed (`simulate`).
    """

    toss: np.ndarray
    first: np.ndarray
    time: np.ndarray
    place: np.ndarray
    turn: np.ndarray
    mask: np.ndarray
    start: np.ndarray

    @property
    def free(self) -> np.ndarray:
        """Measured numbers `[W]` less those of the start."""
        return 6.0 * self.mask.sum(1) - 12.0


def cut(tossed: Tossed, length: float = LENGTH) -> Windows:
    """Windows of about `length` s up to where each toss lies still. What can be told for longer is
    a window of its own: the free flight (less `BEFORE` rows), and the last slide on a face. Raises
    BadInput where a toss has too few rows of motion for one.
    """
    spans, corners = [], tossed.body.corners()
    for t, (time, place, turn) in enumerate(
        zip(tossed.time, tossed.place, tossed.turn, strict=True)
    ):
        speed = np.linalg.norm(np.diff(place, axis=0), axis=1) / np.diff(time)
        moving = np.flatnonzero(speed > STILL)
        stop = min(len(time), (int(moving[-1]) if len(moving) else 0) + 2 + REST)
        begin = min(flight(place, turn, corners, CLEAR * tossed.body.size) - BEFORE, stop)
        if begin >= MIN_ROWS:
            spans.append((t, 0, begin))
        else:
            begin = 0
        last = slide(time, place, turn)
        if last is not None and stop - last >= MIN_ROWS and last - begin >= MIN_ROWS:
            spans.append((t, last, stop))
            stop = last
        if stop - begin >= MIN_ROWS:
            count = max(1, round((time[stop - 1] - time[begin]) / length))
        else:
            count = 0
        smooth = jolts(time, place, turn, tossed.body.size)
        edges = [begin]
        for edge in np.round(np.linspace(begin, stop, count + 1)[1:-1]).astype(int):
            earliest = max(edge - ASIDE, edges[-1] + MIN_ROWS)
            latest = min(edge + ASIDE, stop - MIN_ROWS)
            near = np.arange(earliest, latest + 1)
            if len(near):
                edges.append(int(near[np.argmin(smooth[near])]))
        spans += [(t, a, b) for a, b in itertools.pairwise([*edges, stop]) if b - a >= MIN_ROWS]
    moving = {span[0] for span in spans}
    if idle := [name for t, name in enumerate(tossed.names) if t not in moving]:
        raise BadInput(
            f"toss {idle[0]}: the body moves in fewer than {MIN_ROWS} rows; leave it out "
            f"(--without {' '.join(idle)})"
        )
    return gathered(tossed, sorted(spans))


def slide(time: np.ndarray, place: np.ndarray, turn: np.ndarray) -> int | None:
    """The row from which the body lies as it does at the end, but for a turn about z, and slides;
    None where it does not.
    """
    w, x, y, z = turn.T
    up = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1)
    tilt = np.arccos(np.clip(up @ up[-1], -1.0, 1.0))
    height = np.abs(place[:, 2] - place[-1, 2])
    lies = (tilt < FLAT) & (height < LIES)
    away = np.flatnonzero(~lies)
    begin = (int(away[-1]) + 1 if len(away) else 0) + SETTLED
    if len(place) - begin < 2 * MIN_ROWS:
        return None
    ahead = begin + MIN_ROWS - 1
    speed = np.linalg.norm(place[ahead, :2] - place[begin, :2]) / (time[ahead] - time[begin])
    if speed > SLIDES:
        return begin
    return None


def jolts(time: np.ndarray, place: np.ndarray, turn: np.ndarray, size: float) -> np.ndarray:
    """The largest change of velocity `[R]` m/s over the rows from which a start at each row would
    be guessed. Turning at `size` m.
    """
    gaps = np.diff(time)[:, None]
    speed = np.diff(place, axis=0) / gaps
    spin = rotated(turn[:-1], between(turn[:-1], turn[1:])) / gaps
    jump = np.linalg.norm(np.diff(speed, axis=0), axis=1) + size * np.linalg.norm(
        np.diff(spin, axis=0), axis=1
    )
    padded = np.concatenate([jump, np.full(BEGIN + 2, jump[-1])])
    return np.array([padded[max(r - 2, 0) : r + BEGIN - 1].max() for r in range(len(time))])


def flight(place: np.ndarray, turn: np.ndarray, corners: np.ndarray, clear: float) -> int:
    """Rows before the body first comes nearer than `clear` m to the plane; place `[R, 3]`, turn
    `[R, 4]`, corners `[C, 3]` m.
    """
    near = np.flatnonzero(lowest(place, turn, corners) < clear)
    if len(near):
        return int(near[0])
    return len(place)


def gathered(tossed: Tossed, spans: list[tuple[int, int, int]]) -> Windows:
    """Windows of rows a to b of tosses t, `spans` of (t, a, b)."""
    longest = max(b - a for _, a, b in spans)

    def pad(z, n):
        return np.pad(z, ((0, n), *[(0, 0)] * (z.ndim - 1)), "edge")

    def rows(name):
        return np.stack(
            [pad(getattr(tossed, name)[t][a:b], longest - (b - a)) for t, a, b in spans]
        )

    time, place, turn = rows("time"), rows("place"), rows("turn")
    time = time - time[:, :1]
    mask = np.stack([np.arange(longest) < b - a for _, a, b in spans]).astype(float)
    toss, first = np.array([s[0] for s in spans]), np.array([s[1] for s in spans])
    start = np.stack([guessed(time[w], place[w], turn[w]) for w in range(len(spans))])
    return Windows(toss, first, time, place, turn, mask, start)


def guessed(time: np.ndarray, place: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """The start `[13]` by parabolas and lines through a window's first rows."""
    t = time[:BEGIN]
    fit = np.polynomial.polynomial.polyfit(t, place[:BEGIN], 2)
    angle = between(turn[:1], turn[:BEGIN])
    spin = np.polynomial.polynomial.polyfit(t, angle, 1)
    begin = times(turn[0], from_rotvec(spin[0]))
    return np.concatenate([fit[0], begin, fit[1], spin[1]])


def moved(start: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Starts `[..., 13]` moved by `[..., 12]`: m, rad in the body's axes, m/s, rad/s."""
    turn = times(start[..., 3:7], from_rotvec(by[..., 3:6]))
    return np.concatenate([start[..., :3] + by[..., :3], turn, start[..., 7:] + by[..., 6:]], -1)
