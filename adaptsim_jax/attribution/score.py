"""Score tests of every candidate at a fit: what would it gain, at first order and without fitting
it?

For each candidate at each of its shapes the columns that it adds are freed of what the stretches'
starts and the fitted parameters explain. What is left is regressed on the residual. Stretches are
clusters: the variance of a score is taken from the scores of the stretches themselves (White, 1980;
Liang and Zeger, 1986), so that a model that is wrong otherwise gives no small p by itself.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.attribution.candidates import CandidateScore, JointCandidate
from adaptsim_jax.attribution.criteria import CONFIRMATION
from adaptsim_jax.attribution.estimate import Linear, candidate_columns, padded_fold, project, rows
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.diagnosis.steps import bounded_step
from adaptsim_jax.diagnosis.testing import best_along, best_of, score_p


def table(
    problem: TreeProblem, lin: Linear, many: Sequence[JointCandidate]
) -> list[CandidateScore]:
    """The best shape of each candidate (effect, joints, sharing), sorted by what it gains held
    out.
    """
    pairs = [(e, c.shaped()) for c in many for e in c.entries]
    where, at = [], 0
    for c in many:
        where.append(range(at, at + len(c.entries)))
        at += len(c.entries)
    sums = _Sums(problem, lin, at)
    for first in range(0, at, 64):
        sums.add(candidate_columns(problem, lin, pairs[first : first + 64]), first)
    shapes: dict[tuple, list[tuple[CandidateScore, range]]] = {}
    for c, cols in zip(many, where, strict=True):
        shapes.setdefault(c.key, []).append((sums.score(c, np.array(cols)), cols))
    scores = [_best(rows, sums.slope) for rows in shapes.values()]
    return sorted(scores, key=lambda s: -s.held_out)


def _best(rows: Sequence[tuple[CandidateScore, range]], slope: np.ndarray) -> CandidateScore:
    """The score of a candidate's best shape, with the p of the best of all; rows: of each shape the
    score and its columns of the slopes [W, K].
    """
    best = max((score for score, _ in rows), key=lambda s: s.held_out)
    columns = [k for _, cols in rows for k in cols]
    if len(columns) > len(rows):
        p = best_of(best.p, len(rows))
    else:
        p = best_along(best.p, slope[:, columns])
    return replace(best, p=p, points=len(rows))


class _Sums:
    """Scores by stretch [W, K] and curvatures by fold of blocks of columns, freed of starts and
    fitted parameters.

    Curvatures between columns are kept within a block of neighbours only, which is where a
    candidate's own columns lie.
    """

    def __init__(self, problem: TreeProblem, lin: Linear, count: int):
        self.problem, self.lin = problem, lin
        width = len(lin.residual[0])
        self.fold = padded_fold(problem, width)
        self.slope = np.zeros((width, count))
        self.cross = {}
        self.kept = []
        shared = lin.shared[0].shape[2]
        hess = np.zeros((shared, shared))
        for r, x, s in zip(lin.residual, lin.start, lin.shared, strict=True):
            live = np.flatnonzero(np.any(s, axis=(0, 1)))
            rp, sp = project(x, r[..., None], s if len(live) == shared else s[..., live])
            flat = rows(sp)
            hess[np.ix_(live, live)] += flat.T @ flat
            self.kept.append((rp, sp, x, live))
        vector = lin.fit.vector
        live = (vector.values > vector.low) & (vector.values < vector.high)
        hess = hess + np.diag(vector.precision + np.where(live, 0.0, 1e12))
        size = np.sqrt(np.maximum(np.diagonal(hess), 1e-300))
        self.inverse = (
            np.linalg.pinv(hess / size / size[:, None], rcond=1e-11, hermitian=True)
            / size
            / size[:, None]
        )
        self.columns: list[list[np.ndarray]] = []

    def add(self, blocks: Sequence[np.ndarray], first: int) -> None:
        """Columns [W, R, K] of each group, the first of which has the number `first`."""
        count = blocks[0].shape[2]
        mixed = np.zeros((self.inverse.shape[0], count))
        freed = []
        for c, (_, sp, x, live) in zip(blocks, self.kept, strict=True):
            own = np.flatnonzero(np.any(c, axis=(0, 1)))
            cp = project(x, c if len(own) == count else c[..., own])[0]
            freed.append((cp, own))
            mixed[np.ix_(live, own)] += rows(sp).T @ rows(cp)
        share = self.inverse @ mixed
        curve = np.zeros((len(self.problem.folds), count, count))
        for (cp, own), (rp, sp, _, live) in zip(freed, self.kept, strict=True):
            left = cp - sp @ share[np.ix_(live, own)]
            self.slope[:, first + own] += np.einsum("wrk,wr->wk", left, rp[..., 0])
            for k in range(len(curve)):
                flat = rows(left[self.fold == k])
                curve[k][np.ix_(own, own)] += flat.T @ flat
        self.cross[first] = curve

    def _curve(self, cols: np.ndarray) -> np.ndarray:
        """[F, K, K] of some columns; zero between blocks."""
        out = np.zeros((len(self.problem.folds), len(cols), len(cols)))
        for first, curve in self.cross.items():
            mine = np.flatnonzero((cols >= first) & (cols < first + curve.shape[1]))
            if len(mine):
                out[np.ix_(np.arange(len(out)), mine, mine)] = curve[:, cols[mine] - first][
                    :, :, cols[mine] - first
                ]
        return out

    def _most(self, c: JointCandidate) -> float:
        """What an amplitude that does not act linearly may be, of that at which it is scored."""
        scored = at_scored(self.problem, c)
        if scored is None:
            return np.inf
        return CONFIRMATION.score_reach * abs(scored - c.entries[0].start)

    def score(self, c: JointCandidate, cols: np.ndarray) -> CandidateScore:
        slope, curve = self.slope[:, cols], self._curve(cols)
        folds = range(len(curve))
        by_fold = np.stack([slope[self.fold == k].sum(0) for k in folds])
        total, bend = by_fold.sum(0), curve.sum(0)
        most = self._most(c)
        amplitude = _solved(c, bend, total, most)
        held_out = 0.0
        for k in folds:
            a = _solved(c, bend - curve[k], total - by_fold[k], most)
            held_out += float(a @ by_fold[k] - 0.5 * a @ curve[k] @ a)
        p = score_p(slope[:, amplitude != 0.0])
        if len(cols) == 1:
            scatter = float(np.sqrt(np.square(slope).sum()) / max(bend[0, 0], 1e-300))
        else:
            scatter = 0.0
        return CandidateScore(c, held_out, p, scatter)


def at_scored(problem: TreeProblem, c: JointCandidate) -> float | None:
    """The amplitude at which a candidate that does not act linearly is scored; None where it acts
    so.
    """
    effect = problem.effect(c.effect)
    if effect.jump:
        return c.shaped().get(effect.amplitudes[0].name)
    return None


def _solved(c: JointCandidate, bend: np.ndarray, total: np.ndarray, most: float) -> np.ndarray:
    """Amplitudes within their bounds and none above `most`; of what has no curvature none."""
    acts = np.diagonal(bend) > 1e-12
    low = np.array([max(e.low - e.start, -most) for e in c.entries])
    high = np.array([min(e.high - e.start, most) for e in c.entries])
    prior = np.diag([e.prior**-2.0 for e in c.entries])
    return bounded_step(bend + prior, total, np.where(acts, low, 0.0), np.where(acts, high, 0.0))
