"""How well values of a model simulate the stretches of a recording, from starts fitted to each by
plain least squares.

No weighting of an estimator enters: the start of a stretch is the one from which the simulated
angles come nearest to the measured ones, each radian (or metre) counting alike. Beside it, what a
straight line through the stretch leaves, and holding still: a model that does no better predicts
nothing, whatever it gains over another.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from adaptsim_jax.attribution.estimate import Linear, linear, refitted_start, usual
from adaptsim_jax.attribution.parameters import TreeFit, Vector, Weights
from adaptsim_jax.attribution.paths import ready, residuals, simulated, starts_of, widened
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.simulate import Path
from adaptsim_jax.diagnosis.steps import StretchLanes, fit_starts
from adaptsim_jax.diagnosis.straight import doing_nothing, straight_lines

MAX_START_ROUNDS = 6  # rounds of steps of the starts, at most
ROUGH_ROUNDS = 2  # the same without derivatives: the first gains most
LINEARISATIONS = 2  # at most, of all stretches by their starts: each is dear
LENGTHS = np.array([1.0, 0.3, 0.09])  # of a step, tried in turn
Move = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Change of starts [B, S] by what is left of the angles [B, L+1, n], of the stretches [B]."""


@dataclass(frozen=True)
class Forecast:
    """error [W, n] root mean square of each stretch, rad or m; measured, simulated, seen [W, L+1,
    n]; starts and paths by group.
    """

    error: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    seen: np.ndarray
    starts: tuple[np.ndarray, ...]
    paths: tuple[Path, ...]


def forecast(problem: TreeProblem, vector: Vector, roughly: bool = False) -> Forecast:
    """Simulate all stretches at a vector. roughly: as of `fitted_starts`."""
    rounds = ROUGH_ROUNDS if roughly else MAX_START_ROUNDS
    starts, paths = fitted_starts(problem, vector, rounds=rounds, roughly=roughly)
    measured, mask = observed(problem)
    out = np.clip(np.nan_to_num(angles_of(problem, paths), nan=1e6), -1e6, 1e6)
    return Forecast(rms(measured - out, mask), measured, out, mask, starts, tuple(paths))


def observed(problem: TreeProblem) -> tuple[np.ndarray, np.ndarray]:
    """Measured angles of the stretches [W, L+1, n], and where they were read (1) or not (0)."""
    parts = [g.stretches for g in problem.groups]
    return _by_joint(problem, [s.q for s in parts]), _by_joint(problem, [s.seen for s in parts])


def angles_of(problem: TreeProblem, paths: Sequence[Path]) -> np.ndarray:
    """Angles of the stretches [W, L+1, n] as paths by group have them."""
    return _by_joint(problem, [p.sensed for p in paths])


def _by_joint(problem: TreeProblem, parts: Sequence[np.ndarray]) -> np.ndarray:
    """[W, L+1, n] of angles, and what may follow them, by group [L+1, n_g ..., W]."""
    count = len(problem.fold)
    out = np.zeros((count, len(parts[0]), problem.joints))
    for group, part in zip(problem.groups, parts, strict=True):
        own = list(group.joints)
        out[..., own] = part[:, : len(own)].transpose(2, 0, 1)[:count]
    return out


def rms(off: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """[W, n] of what is off [W, L+1, n] where it was seen."""
    return np.sqrt(np.square(off * mask).sum(1) / np.maximum(mask.sum(1), 1))


def without_a_model(problem: TreeProblem) -> tuple[np.ndarray, np.ndarray]:
    """What a straight line through each stretch leaves of its angles [W, n], and holding still at
    their mean.
    """
    measured, mask = observed(problem)
    return doing_nothing(problem.groups[0].stretches.time.T[: len(measured)], measured, mask)


def fitted_starts(
    problem: TreeProblem,
    vector: Vector,
    rows: np.ndarray | None = None,
    rounds: int = MAX_START_ROUNDS,
    roughly: bool = False,
    starts: Sequence[np.ndarray] | None = None,
) -> tuple[tuple[np.ndarray, ...], Sequence[Path]]:
    """Starts by plain least squares on the angles, from the smoothed ones or those given, and the
    paths from there.

    Args:
        rows: [W, P] other values for each stretch.
        roughly: A path is taken to follow its start as one that nothing acts on, which needs no
            derivatives. No step is taken that does not gain.
    """
    made = ready(problem, vector, rows)
    begun = widened(made, starts_of(problem) if starts is None else starts)
    ends = np.cumsum([len(x) for x in begun])[:-1]
    every = np.concatenate(begun).T  # [W, S]

    def by_group(some: np.ndarray, lanes: np.ndarray) -> list[np.ndarray]:
        """Starts by group, those of some stretches as given."""
        full = every.copy()
        full[lanes] = some
        return np.split(full.T, ends)

    def evaluate(some: np.ndarray, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        paths = simulated(made, by_group(some, lanes))
        parts = zip(problem.groups, paths, strict=True)
        left = np.concatenate([residuals(g, p)[..., : len(g.joints)] for g, p in parts], 2)[lanes]
        # over all rows: a sum over some of them does not show a start that flings a joint away
        return left, np.square(left).sum((1, 2))

    def fitted(begin: StretchLanes, move: Move) -> StretchLanes:
        def propose(some: np.ndarray, left: np.ndarray, lanes: np.ndarray) -> np.ndarray:
            return some + LENGTHS[:, None, None] * move(left, lanes)

        return fit_starts(begin, propose, evaluate, rounds)

    found = StretchLanes(every, *evaluate(every, np.arange(len(every))))
    if roughly:
        found = fitted(found, partial(_along_a_line, problem, sizes=[len(x) for x in begun]))
    else:
        for _ in range(LINEARISATIONS):
            lin = _linearised(problem, vector, np.split(found.starts.T, ends))
            found = fitted(found, partial(_by_derivatives, problem, lin))
    starts = tuple(np.split(found.starts.T, ends))
    return starts, simulated(made, starts)


def _linearised(problem: TreeProblem, vector: Vector, starts: Sequence[np.ndarray]) -> Linear:
    """Angles by the starts, each radian (or metre) counting alike."""
    n, width = problem.joints, problem.groups[0].stretches.count
    weights = Weights(np.concatenate([np.ones(n), np.zeros(n)]), np.ones(width))
    return linear(
        problem, TreeFit(vector, tuple(starts), weights, np.zeros(width), "", 0), entries=()
    )


def _by_derivatives(
    problem: TreeProblem, lin: Linear, left: np.ndarray, lanes: np.ndarray
) -> np.ndarray:
    """Change of starts [B, S] by least squares on what is left of the angles [B, L+1, n], with the
    derivatives of `lin`, at starts near by.
    """
    out, at = [], 0
    for group, by_start, mine in zip(problem.groups, lin.start, lin.counted, strict=True):
        n, s = len(group.joints), group.stretches
        off = np.zeros((s.count, s.rows + 1, 2 * n))
        off[lanes, :, :n] = left[..., at : at + n]
        at += n
        out.append(refitted_start(by_start[lanes], mine.flat(off)[lanes], usual(problem, group)).T)
    return np.concatenate(out, 1)


def _along_a_line(
    problem: TreeProblem, left: np.ndarray, lanes: np.ndarray, sizes: Sequence[int]
) -> np.ndarray:
    """Change of starts [B, S] by the straight line through what is left of the angles [B, L+1, n].

    lanes: the stretches; sizes: of each group's start.
    """
    out, at = [], 0
    for group, size in zip(problem.groups, sizes, strict=True):
        n, s = len(group.joints), group.stretches
        own = left[..., at : at + n]
        at += n
        mask = s.seen.transpose(2, 0, 1)[lanes]
        time = (s.time - s.time[:1]).T[lanes]
        first, slope = straight_lines(time, own, mask)
        moved = np.zeros((len(lanes), size))
        moved[:, :n], moved[:, n : 2 * n] = first, slope
        out.append(moved)
    return np.concatenate(out, 1)
