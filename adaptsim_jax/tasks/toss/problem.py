"""Tosses as a `TrialProblem`: windows simulated from starts that are fitted inside, less what was seen, over its noise.

The start of each window is its own twelve numbers. They are eliminated: `residuals` are those of the best start (steps with the
Jacobian at an anchor, the start that fits the declared model), `columns` are without what a start would take up (Kaufman's variable
projection). Derivatives are differences, since MuJoCo in C has no others.

No declared contact follows strikes to the sensor's noise, and flights are followed to it: windows are weighed by what the fitted
declared model leaves of each, or else its strikes alone would speak. What a window leaves beyond that counts by its root: a
strike of an edge that goes another way does not lead the fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from adaptsim_jax.attribution.trials.fit import declared_fit
from adaptsim_jax.attribution.trials.problem import TrialEffect, TrialProblem
from adaptsim_jax.tasks.toss import turns
from adaptsim_jax.tasks.toss.catalogue import DECLARED, effects, quantities
from adaptsim_jax.tasks.toss.read import Tossed
from adaptsim_jax.tasks.toss.simulate import poses
from adaptsim_jax.tasks.toss.windows import Windows, cut, moved

ASIDE = 0.2  # of a quantity's scale, to either side of where a column is taken
STEPS = np.repeat([1e-4, 1e-3, 3e-3, 3e-2], 3)  # m, rad, m/s, rad/s of a start: where its columns are taken
PRIOR = np.repeat([0.02, 0.2, 0.5, 5.0], 3)  # widths that keep finite what a window does not show
ROUNDS, AGAIN = 4, 2  # of the anchor's fit; with its Jacobian at other values
SHORTER = 0.3  # of a step that does not help
SETTLED = 6  # rounds of the fit that windows are weighed by
USUAL = 4.0  # of what the declared model leaves of a window (mean square), from where on more of it counts by its root
GRID = ((0.1, 0.2, 0.5), (0.3, 1.0))  # friction and damping from which the declared fit may begin, beside the file's


@dataclass(frozen=True)
class Anchor:
    """Starts `[W, 13]` that fit the declared model, and the inverse `[W, 12, R 6]` that turns residuals into steps of them."""

    start: np.ndarray
    inverse: np.ndarray


def seen_less(tossed: Tossed, windows: Windows, names, at: np.ndarray, values, start) -> np.ndarray:
    """Measured minus simulated over the noise `[N, R, 6]` of windows `at [N]`; values `[N, P]`, start `[N, 13]`. Turns by the vector
    from the simulated to the measured, in the body's axes."""
    place, turn = poses(tossed.body, names, values, start, windows.time[at])
    off = (windows.place[at] - place) / tossed.noise
    angle = turns.log(turns.times(turns.inverse(turn), windows.turn[at])) / tossed.noise_turn
    return windows.mask[at][..., None] * np.concatenate([off, angle], -1)


def start_columns(less, values: np.ndarray, start: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Derivatives `[W, R 6, 12]` of what is simulated by the start."""
    count = len(start)
    at = np.tile(np.arange(count), 12)
    by = np.repeat(np.diag(STEPS), count, 0)
    out = less(at, values[at], moved(start[at], by)).reshape(12, count, -1)
    return np.moveaxis((residual.reshape(1, count, -1) - out) / STEPS[:, None, None], 0, 2)


def inverse_of(columns: np.ndarray) -> np.ndarray:
    """`[W, 12, R 6]`: residuals to the step of a start, with the weak prior `PRIOR`."""
    gram = np.einsum("wri,wrj->wij", columns, columns) + np.diag(PRIOR**-2.0)
    return np.linalg.solve(gram, columns.transpose(0, 2, 1))


def better(less, values, start, residual, step) -> tuple[np.ndarray, np.ndarray]:
    """Starts and residuals after `step [W, 12]`, or a shorter one, where that helps; as they were elsewhere."""
    start, residual = start.copy(), residual.copy()
    size = np.square(residual).sum((1, 2))
    left = np.arange(len(start))
    for share in (1.0, SHORTER):
        tried = moved(start[left], share * step[left])
        now = less(left, values[left], tried)
        good = np.square(now).sum((1, 2)) < size[left]
        start[left[good]], residual[left[good]] = tried[good], now[good]
        left = left[~good]
        if not len(left):
            break
    return start, residual


def anchored(less, values: np.ndarray, start: np.ndarray) -> Anchor:
    """Starts that fit `values [W, P]`, from guesses."""
    residual = less(np.arange(len(start)), values, start)
    for _ in range(ROUNDS):
        inverse = inverse_of(start_columns(less, values, start, residual))
        start, residual = better(less, values, start, residual, np.einsum("wir,wr->wi", inverse, flat(residual)))
    return Anchor(start, inverse_of(start_columns(less, values, start, residual)))


def flat(z: np.ndarray) -> np.ndarray:
    return z.reshape(len(z), -1)


def prepare(tossed: Tossed, considered: Sequence[TrialEffect] | None = None) -> tuple[TrialProblem, "Follow"]:
    """The problem of a recording, weighed by what its declared model leaves, and how its windows are followed."""
    windows, q = cut(tossed), quantities(tossed.body)
    first = follower(tossed, windows, np.array([z.neutral for z in q]))
    known = effects(tossed.body) if considered is None else tuple(considered)
    values = declared_fit(posed(first, known, np.maximum(first.left(), 1.0)), SETTLED).values
    second = follower(tossed, windows, values)
    return posed(second, known, np.maximum(second.left(), 1.0)), second


def posed(follow: "Follow", known: tuple[TrialEffect, ...], weight: np.ndarray) -> TrialProblem:
    """The problem with windows' mean squares in units of `weight [W]`."""
    tossed, windows, names = follow.tossed, follow.windows, follow.names
    toss, count, trials = windows.toss, len(windows.toss), len(tossed.names)
    place = np.array([int((toss[:w] == toss[w]).sum()) for w in range(count)])
    most, wide = int(place.max()) + 1, windows.mask.shape[1] * 6
    scale = 1.0 / np.sqrt(weight)

    def by_toss(z: np.ndarray) -> np.ndarray:
        """`[W, R 6, ...]` as `[T, windows R 6, ...]`."""
        out = np.zeros((trials, most, *z.shape[1:]))
        out[toss, place] = z
        return out.reshape(trials, most * z.shape[1], *z.shape[2:])

    def softened(residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Factors `[W]` of residuals, so that their squares add up to the loss, and of columns, so that its slope is theirs."""
        size = np.maximum(np.square(residual).sum((1, 2)) / windows.free / weight / USUAL, 1e-12)
        loss = 2.0 * (np.sqrt(1.0 + size) - 1.0)
        share = np.sqrt(loss / size)
        return scale * share, scale / np.sqrt(1.0 + size) / share

    def residuals(values: np.ndarray) -> np.ndarray:
        residual = follow.of(values)[1]
        return by_toss(flat(residual) * softened(residual)[0][:, None])

    @lru_cache(maxsize=2)
    def around(key: bytes):
        values = np.tile(np.frombuffer(key), (trials, 1))
        start, residual = follow.of(values)
        own, _ = np.linalg.qr(start_columns(follow.less, values[toss], start, residual))
        return start, own, softened(residual)[1]

    def columns(values: np.ndarray, basis: np.ndarray) -> np.ndarray:
        start, own, factor = around(np.ascontiguousarray(values, float).tobytes())
        moves = np.concatenate([basis, -basis]) * ASIDE
        rows = np.repeat(values + moves, count, 0)
        at = np.tile(np.arange(count), len(moves))
        out = follow.less(at, rows, start[at]).reshape(2, len(basis), count, wide)
        c = np.moveaxis(out[1] - out[0], 0, -1) / (2 * ASIDE)
        c = c - own @ (own.transpose(0, 2, 1) @ c)
        return by_toss(c * factor[:, None, None])

    counts = np.zeros(trials)
    np.add.at(counts, toss, windows.free)
    scanned = np.flatnonzero(toss % 3 == 0)

    def scan(rows: np.ndarray) -> np.ndarray:
        at = np.tile(scanned, len(rows))
        r = follow.less(at, np.repeat(rows, len(scanned), 0), follow.anchor.start[at])
        return np.sqrt(np.square(r).sum((1, 2)) / weight[at]).reshape(len(rows), -1).sum(1)

    return TrialProblem(
        quantities(tossed.body), DECLARED, known, residuals, columns, counts, tossed.names, begins(names, follow.values), scan,
        channels=6, begun=1,
    )  # fmt: skip


def begins(names, neutral: np.ndarray) -> np.ndarray:
    """Points `[S, P]` from which the declared fit may begin."""
    points = [neutral]
    for friction in GRID[0]:
        for damping in GRID[1]:
            point = neutral.copy()
            point[names.index("friction")], point[names.index("damping")] = friction, damping
            points.append(point)
    return np.array(points)


@dataclass(frozen=True)
class Follow:
    """Windows followed from fitted starts; values `[P]`: those at which the anchors are."""

    tossed: Tossed
    windows: Windows
    names: tuple[str, ...]
    values: np.ndarray
    anchor: Anchor

    def less(self, at, values, start) -> np.ndarray:
        """`seen_less` of windows `at [N]`."""
        return seen_less(self.tossed, self.windows, self.names, at, values, start)

    def of(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Starts `[W, 13]` that fit `values [T, P]`, and residuals `[W, R, 6]` from them."""
        own, start = values[self.windows.toss], self.anchor.start
        residual = self.less(np.arange(len(start)), own, start)
        for _ in range(AGAIN):
            step = np.einsum("wir,wr->wi", self.anchor.inverse, flat(residual))
            start, residual = better(self.less, own, start, residual, step)
        return start, residual

    def left(self) -> np.ndarray:
        """Mean squares `[W]` of what the anchors leave, over the noise."""
        residual = self.of(np.tile(self.values, (len(self.tossed.names), 1)))[1]
        return np.square(residual).sum((1, 2)) / self.windows.free

    def simulated(self, values: np.ndarray) -> np.ndarray:
        """Places `[W, R, 3]` m of windows with values `[T, P]`, each from its best start."""
        return self.windows.place - self.of(values)[1][..., :3] * self.tossed.noise


def follower(tossed: Tossed, windows: Windows, values: np.ndarray) -> Follow:
    """The windows of a recording and the starts that fit `values [P]`."""
    names = tuple(z.name for z in quantities(tossed.body))
    less = lambda at, v, start: seen_less(tossed, windows, names, at, v, start)
    return Follow(
        tossed, windows, names, values, anchored(less, np.tile(values, (len(windows.toss), 1)), windows.start)
    )
