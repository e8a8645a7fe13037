"""Tosses as a `Problem`: windows simulated from starts that are fitted inside, less what was seen,
over its noise.

The start of each window is its own twelve numbers. They are eliminated: `residuals` are those of
the best start (steps with the Jacobian at an anchor, the start that fits the declared model),
`columns` are without what a start would take up (Kaufman's variable projection). Derivatives are
differences, since MuJoCo in C has no others.

No declared contact follows strikes to the sensor's noise, and flights are followed to it: windows
are weighed by what the fitted declared model leaves of each, or else its strikes alone would speak.
What a window leaves beyond that counts by its root: a strike of an edge that goes another way does
not lead the fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from adaptsim_jax.diagnosis.fit import declared_fit
from adaptsim_jax.diagnosis.problem import Problem
from adaptsim_jax.diagnosis.steps import Evaluate, StretchLanes, fit_starts
from adaptsim_jax.effects.base import Effect
from adaptsim_jax.mechanisms.quaternions import between
from adaptsim_jax.tasks.toss.catalogue import DECLARED, effects, quantities
from adaptsim_jax.tasks.toss.read import Tossed
from adaptsim_jax.tasks.toss.simulate import poses
from adaptsim_jax.tasks.toss.windows import Windows, cut, moved

# of a quantity's scale, to either side of where a column is taken: over less, steps of the
# simulation show
ASIDE = 1.0
STEPS = np.repeat(
    [1e-4, 1e-3, 3e-3, 3e-2], 3
)  # m, rad, m/s, rad/s of a start: where its columns are taken
PRIOR = np.repeat([0.02, 0.2, 0.5, 5.0], 3)  # widths that keep finite what a window does not show
ROUNDS, ENOUGH = 12, 0.01  # of the anchor's fit; share of the square that a round must take off
DAMPING = (0.0, 0.01, 0.3, 10.0)
# lengths of steps, round by round, tried with the anchor's Jacobian elsewhere; a short one in the
# second gains a little, and rounds with a Jacobian of their own then end in a worse minimum
AGAIN = ((1.0, 0.3), (1.0,))
DISTANT, FRESH = 1.3, 3  # of the anchor's square: above it, rounds with a Jacobian of its own
SOME = 4  # tosses from which a beginning is chosen
SETTLED = 4  # rounds of the fit that windows are weighed by
# of what the declared model leaves of a window (mean square), from where on more of it counts by
# its root
USUAL = 4.0
GRID = (
    (0.12, 0.3),
    (0.4, 1.0),
)  # friction and damping from which the declared fit may begin, beside the file's


@dataclass(frozen=True)
class Anchor:
    """Starts `[W, 13]` that fit the declared model, the inverse `[W, 12, R 6]` that turns residuals
    into steps of them, and the sum of squares `[W]` that they leave.
    """

    start: np.ndarray
    inverse: np.ndarray
    square: np.ndarray


def scaled_residual(
    tossed: Tossed, windows: Windows, names, at: np.ndarray, values, start
) -> np.ndarray:
    """Measured minus simulated over the noise `[N, R, 6]` of windows `at [N]`; values `[N, P]`,
    start `[N, 13]`. Turns by the vector from the simulated to the measured, in the body's axes.
    """
    place, turn = poses(tossed.body, names, values, start, windows.time[at])
    off = (windows.place[at] - place) / tossed.noise
    angle = between(turn, windows.turn[at]) / tossed.noise_turn
    return windows.mask[at][..., None] * np.concatenate([off, angle], -1)


def start_columns(
    less, at: np.ndarray, values: np.ndarray, start: np.ndarray, residual: np.ndarray
) -> np.ndarray:
    """Derivatives `[n, R 6, 12]` of what is simulated of windows `at [n]` by their starts."""
    count = len(at)
    by = np.repeat(np.diag(STEPS), count, 0)
    starts = moved(np.tile(start, (12, 1)), by)
    out = less(np.tile(at, 12), np.tile(values, (12, 1)), starts).reshape(12, count, -1)
    return np.moveaxis((residual.reshape(1, count, -1) - out) / STEPS[:, None, None], 0, 2)


def inverse_of(columns: np.ndarray, more: float = 0.0) -> np.ndarray:
    """`[W, 12, R 6]`: residuals to the step of a start, with the weak prior `PRIOR` and `more` of
    the diagonal.
    """
    gram = np.einsum("wri,wrj->wij", columns, columns)
    at = np.arange(12)
    gram[:, at, at] += PRIOR**-2.0 + more * gram[:, at, at]
    return np.linalg.solve(gram, columns.transpose(0, 2, 1))


def evaluated(less, at: np.ndarray, values: np.ndarray) -> Evaluate:
    """What starts of windows `at [n]` leave with `values [n, P]`."""

    def evaluate(start: np.ndarray, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residual = less(at[lanes], values[lanes], start)
        return residual, np.square(residual).sum((1, 2))

    return evaluate


def improved(
    less, at: np.ndarray, values: np.ndarray, begun: StretchLanes, rounds: int
) -> tuple[StretchLanes, np.ndarray]:
    """Starts of windows `at [n]` that fit `values [n, P]`, and the inverses `[n, 12, R 6]` last
    used.
    """
    inverse = np.zeros((len(at), 12, begun.left.shape[1] * 6))

    def propose(start: np.ndarray, residual: np.ndarray, lanes: np.ndarray) -> np.ndarray:
        columns = start_columns(less, at[lanes], values[lanes], start, residual)
        inverse[lanes] = inverse_of(columns)
        steps = [
            np.einsum("wir,wr->wi", inverse_of(columns, more), flat(residual)) for more in DAMPING
        ]
        return moved(np.broadcast_to(start, (len(steps), *start.shape)), np.array(steps))

    found = fit_starts(begun, propose, evaluated(less, at, values), rounds, ENOUGH, every=True)
    return found, inverse


def anchored(
    less, at: np.ndarray, values: np.ndarray, start: np.ndarray
) -> tuple[Anchor, np.ndarray]:
    """Starts that fit `values [n, P]`, from guesses, and their residuals."""
    begun = StretchLanes(start, *evaluated(less, at, values)(start, np.arange(len(at))))
    found, inverse = improved(less, at, values, begun, ROUNDS)
    return Anchor(found.starts, inverse, found.loss), found.left


def flat(z: np.ndarray) -> np.ndarray:
    return z.reshape(len(z), -1)


def prepare(tossed: Tossed, considered: Sequence[Effect] | None = None) -> tuple[Problem, "Follow"]:
    """The problem of a recording, weighed by what its declared model leaves, and how its windows
    are followed.
    """
    windows, q = cut(tossed), quantities(tossed.body)
    known = effects(tossed.body) if considered is None else tuple(considered)
    values = begun(
        tossed, windows, begins(tuple(z.name for z in q), np.array([z.default for z in q]))
    )
    follow = follower(tossed, windows, values)
    usual = np.full(len(windows.toss), max(float(np.median(follow.left())), 1.0))
    for weight in (usual, None):
        weight = np.maximum(follow.left(), 1.0) if weight is None else weight
        follow = follower(
            tossed, windows, declared_fit(posed(follow, known, weight), SETTLED).values
        )
    return posed(follow, known, np.maximum(follow.left(), 1.0)), follow


def begun(tossed: Tossed, windows: Windows, points: np.ndarray) -> np.ndarray:
    """Of `points [S, P]` the one whose windows, of some tosses, are followed best."""
    few = np.flatnonzero(windows.toss % max(1, len(tossed.names) // SOME) == 0)
    at = np.tile(few, len(points))
    names = tuple(z.name for z in quantities(tossed.body))

    def less(w, v, start):
        return scaled_residual(tossed, windows, names, w, v, start)

    anchor, _ = anchored(less, at, np.repeat(points, len(few), 0), windows.start[at])
    left = (anchor.square / windows.free[at]).reshape(len(points), -1)
    return points[int(np.argmin(np.log1p(left).mean(1)))]


def softening(square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors `[W]` of residuals, so that their squares add up to the loss, and of columns, so that
    its slope is theirs. square `[W]`: mean squares of windows, in units of their weight.
    """
    size = np.maximum(square / USUAL, 1e-12)
    loss = 2.0 * (np.sqrt(1.0 + size) - 1.0)
    share = np.sqrt(loss / size)
    return share, 1.0 / np.sqrt(1.0 + size) / share


def posed(follow: "Follow", known: tuple[Effect, ...], weight: np.ndarray) -> Problem:
    """The problem with windows' mean squares in units of `weight [W]`."""
    tossed, windows = follow.tossed, follow.windows
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
        by_row, by_column = softening(np.square(residual).sum((1, 2)) / windows.free / weight)
        return scale * by_row, scale * by_column

    @lru_cache(maxsize=4)
    def followed(key: bytes) -> tuple[np.ndarray, np.ndarray]:
        return follow.of(np.frombuffer(key).reshape(trials, -1))

    def residuals(values: np.ndarray) -> np.ndarray:
        residual = followed(np.ascontiguousarray(values, float).tobytes())[1]
        return by_toss(flat(residual) * softened(residual)[0][:, None])

    @lru_cache(maxsize=2)
    def around(key: bytes):
        values = np.tile(np.frombuffer(key), (trials, 1))
        start, residual = followed(values.tobytes())
        own, _ = np.linalg.qr(
            start_columns(follow.less, np.arange(count), values[toss], start, residual)
        )
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
    return Problem(
        quantities(tossed.body),
        DECLARED,
        known,
        residuals,
        columns,
        counts,
        tossed.names,
        follow.values[None],
        lambda points: np.zeros(len(points)),
        channels=6,
        begun=1,
    )


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
        """`scaled_residual` of windows `at [N]`."""
        return scaled_residual(self.tossed, self.windows, self.names, at, values, start)

    def of(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Starts `[W, 13]` that fit `values [T, P]`, and residuals `[W, R, 6]` from them."""
        own, at = values[self.windows.toss], np.arange(len(self.anchor.start))
        evaluate = evaluated(self.less, at, own)

        def propose(lengths: np.ndarray, start, residual, lanes) -> np.ndarray:
            step = np.einsum("wir,wr->wi", self.anchor.inverse[lanes], flat(residual))
            tries = lengths[:, None, None] * step
            return moved(np.broadcast_to(start, (len(tries), *start.shape)), tries)

        found = StretchLanes(self.anchor.start, *evaluate(self.anchor.start, at))
        for lengths in AGAIN:
            tried = partial(propose, np.array(lengths))
            found = fit_starts(found, tried, evaluate, 1, 0.0, every=True)
        usual = np.maximum(self.anchor.square, self.windows.free)
        distant = np.flatnonzero(found.loss > DISTANT * usual)
        fresh, _ = improved(
            self.less, distant, own[distant], StretchLanes(*(z[distant] for z in found)), FRESH
        )
        found.starts[distant], found.left[distant] = fresh.starts, fresh.left
        return found.starts, found.left

    def left(self) -> np.ndarray:
        """Mean squares `[W]` of what the anchors leave, over the noise."""
        return self.anchor.square / self.windows.free

    def simulated(self, values: np.ndarray) -> np.ndarray:
        """Places `[W, R, 3]` m of windows with values `[T, P]`, each from its best start."""
        return self.windows.place - self.of(values)[1][..., :3] * self.tossed.noise


def follower(tossed: Tossed, windows: Windows, values: np.ndarray) -> Follow:
    """The windows of a recording and the starts that fit `values [P]`."""
    names = tuple(z.name for z in quantities(tossed.body))

    def less(at, v, start):
        return scaled_residual(tossed, windows, names, at, v, start)

    count = len(windows.toss)
    anchor, _ = anchored(less, np.arange(count), np.tile(values, (count, 1)), windows.start)
    return Follow(tossed, windows, names, values, anchor)
