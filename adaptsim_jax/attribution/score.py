"""Score tests of every candidate at a fit: what would it gain, at first order and without fitting
it?

For each candidate at each of its shapes the columns that it adds are freed of what the stretches'
starts and the fitted parameters explain. What is left is regressed on the residual. Stretches are
clusters: the variance of a score is taken from the scores of the stretches themselves (White, 1980;
Liang and Zeger, 1986), so that a model that is wrong otherwise gives no small p by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptsim_jax.attribution.criteria import CONFIRMATION
from adaptsim_jax.attribution.linear import Linear, candidate_columns, padded_fold, project, rows
from adaptsim_jax.attribution.parameters import INERTIA, TILT, Entry, Vector, inertia_entries
from adaptsim_jax.attribution.problem import TreeProblem, off_value
from adaptsim_jax.diagnosis.testing import score_p
from adaptsim_jax.effects.base import Effect, Reach, unit_at
from adaptsim_jax.effects.joints.catalogue import TILTS
from adaptsim_jax.effects.joints.forces import ARMATURE


@dataclass(frozen=True)
class JointCandidate:
    """An effect at some joints; sharing: `joint`, `all` (own values at each) or `common` (one
    value); shape: fixed shapes by joint's number and parameter, where scored.
    """

    effect: str
    joints: tuple[int, ...]
    sharing: str
    entries: tuple[Entry, ...]
    shape: tuple[tuple[str, float], ...] = ()

    @property
    def key(self) -> tuple[str, tuple[int, ...], str]:
        return self.effect, self.joints, self.sharing

    def shaped(self) -> dict[str, float]:
        return dict(self.shape)

    def at(self, entries: Sequence[Entry]) -> "JointCandidate":
        """With some of its entries, at their joints alone."""
        joints = tuple(dict.fromkeys(j for e in entries for j in e.joints))
        return replace(
            self,
            joints=joints,
            entries=tuple(entries),
            sharing="joint" if len(joints) == 1 else self.sharing,
        )

    def split(self) -> "list[JointCandidate]":
        """One a joint, where it has own values at each of several."""
        if self.sharing != "all":
            return [self]
        return [self.at([e for e in self.entries if e.joints == (j,)]) for j in self.joints]


@dataclass(frozen=True)
class CandidateScore:
    """Of a candidate at its best shape: amplitudes [K], first-order fall of the loss, of the
    held-out loss, robust p, share of folds in which it gains; scatter: cluster-robust standard
    error of its only amplitude, 0 where it has several.
    """

    candidate: JointCandidate
    amplitude: np.ndarray
    gain: float
    held_out: float
    p: float
    folds: float
    scatter: float = 0.0


def entries_of(
    problem: TreeProblem, reach: Reach, effect: Effect, joints: Sequence[int], shared: bool
) -> tuple[Entry, ...]:
    """Amplitude entries of an effect at joints."""
    out = []
    for p in effect.amplitudes:
        for j in [tuple(joints)] if shared else [(j,) for j in joints]:
            ends = [p.bounds(float(reach.torque[k]), float(reach.speed[k])) for k in j]
            start = off_value(problem, effect.name, p.name, j[0])
            low, high = min(e[0] for e in ends), max(e[1] for e in ends)
            low = 0.0 if p.sign > 0 else low
            prior = p.prior * max(e[1] for e in ends) / p.high
            unit = unit_at(p.unit, problem.kinds[j[0]])
            out.append(
                Entry(
                    effect.name, p.name, j, start, start, min(low, start), high + start, unit, prior
                )
            )
    return tuple(out)


def shape_entries(
    problem: TreeProblem, reach: Reach, candidate: JointCandidate
) -> tuple[Entry, ...]:
    """Entries of the shapes that are fitted once an effect is in the model, at the values it was
    scored with.
    """
    effect, given = problem.effect(candidate.effect), candidate.shaped()
    out = []
    for p in effect.shapes:
        if p.held and p.name not in given:
            continue
        for j in (
            [candidate.joints]
            if candidate.sharing == "common"
            else [(j,) for j in candidate.joints]
        ):
            low, high = p.bounds(float(reach.torque[j[0]]), float(reach.speed[j[0]]))
            value = given.get(p.name, p.default)
            if p.held:
                low = high = value
            elif p.name == "angle":
                span = float(reach.q_high[j[0]] - reach.q_low[j[0]])
                low, high = value - 0.2 * span, value + 0.2 * span
            else:
                low, high = (
                    max(low, value / 3.0 if value > 0 else low),
                    min(high, value * 3.0 if value > 0 else high),
                )
            out.append(
                Entry(
                    effect.name,
                    p.name,
                    j,
                    value,
                    value,
                    low,
                    high,
                    unit_at(p.unit, problem.kinds[j[0]]),
                    prior=np.inf,
                )
            )
    return tuple(out)


def candidates(problem: TreeProblem, vector: Vector, reach: Reach) -> list[JointCandidate]:
    """All that may be added to the vector: each effect at each joint, at all of them, with one
    value for all; a tilted base.
    """
    taken = {(e.owner, j) for e in vector.entries for j in e.joints}
    out = []
    for effect in problem.effects:
        free = _free_joints(problem, effect, taken)
        if not effect.traits.offered:
            continue
        if effect.place == "model":
            out += _of_model(problem, effect.name, taken)
            continue
        follows = np.array([np.any(g.actuator[2] != 0.0) for g in problem.groups]).any()
        if effect.traits.of_controller and not follows:
            continue
        grids = [(j, effect.grid_points(reach, j)) for j in free]
        if effect.place == "drive":
            rotors = [
                j
                for j in free
                if off_value(problem, ARMATURE.name, "inertia", j) > 0.0
                or (ARMATURE.name, j) in taken
            ]
            # without a position controller it does not matter on which side that one's encoder is
            grids = [
                (j, [z for z in points if follows or z["link"] == z["control"]])
                for j, points in grids
                if j in rotors
            ]

        def make(joints, shared, effect=effect):
            return entries_of(problem, reach, effect, joints, shared)

        for j, points in grids:
            if j in problem.unlike:
                continue
            for point in points:
                out.append(
                    JointCandidate(effect.name, (j,), "joint", make([j], False), _fixed(point))
                )
        if len(free) > 1 and effect.traits.family and not effect.shapes:
            out.append(JointCandidate(effect.name, tuple(free), "all", make(free, False)))
        if len(free) > 1 and effect.traits.shared:
            for point in grids[0][1]:
                out.append(
                    JointCandidate(
                        effect.name, tuple(free), "common", make(free, True), _fixed(point)
                    )
                )
    return out


def _free_joints(problem: TreeProblem, effect: Effect, taken: set[tuple[str, int]]) -> list[int]:
    """Joints at which an effect is not fitted and can act."""
    driven = [j for j in range(problem.joints) if problem.reach.peak[j] > 0.0]
    first = {g.joints[0] for g in problem.groups}
    return [
        j
        for j in range(problem.joints)
        if (effect.name, j) not in taken
        and (effect.name, j) not in problem.excluded
        and (j not in problem.unlike or effect.traits.shared)
        and (j in driven or not effect.on_actuator)
        and not (effect.pair and j in first)
    ]


def _of_model(problem: TreeProblem, name: str, taken: set[tuple[str, int]]) -> list[JointCandidate]:
    """What frees parameters of the model itself: the direction of gravity, where there is any. The
    inertia of a body with a mass.
    """
    if name == INERTIA:
        bodies = [
            j for g in problem.groups for at, j in enumerate(g.joints) if g.inertias.massive[at]
        ]

        def own(j):
            return inertia_entries(np.arange(j + 1) == j)

        return [
            JointCandidate(INERTIA, (j,), "joint", own(j))
            for j in bodies
            if (INERTIA, j) not in taken | problem.excluded and j not in problem.unlike
        ]
    weightless = not any(np.any(np.asarray(g.model.tree.gravity)) for g in problem.groups)
    if weightless or (TILT, 0) in taken:
        return []
    everywhere = tuple(range(problem.joints))
    entries = tuple(
        Entry(TILT, t, everywhere, 0.0, 0.0, -0.5, 0.5, "rad", prior=1.0) for t in TILTS
    )
    return [JointCandidate(TILT, everywhere, "common", entries)]


def _fixed(point) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((k, float(z)) for k, z in point.items()))


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
    best: dict[tuple, CandidateScore] = {}
    for c, cols in zip(many, where, strict=True):
        score = sums.score(c, np.array(cols))
        if c.key not in best or score.held_out > best[c.key].held_out:
            best[c.key] = score
    return sorted(best.values(), key=lambda s: -s.held_out)


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
        gain = float(amplitude @ total - 0.5 * amplitude @ bend @ amplitude)
        each = []
        for k in folds:
            a = _solved(c, bend - curve[k], total - by_fold[k], most)
            each.append(float(a @ by_fold[k] - 0.5 * a @ curve[k] @ a))
        p = score_p(slope[:, amplitude != 0.0])
        if len(cols) == 1:
            scatter = float(np.sqrt(np.square(slope).sum()) / max(bend[0, 0], 1e-300))
        else:
            scatter = 0.0
        return CandidateScore(
            c, amplitude, gain, float(np.sum(each)), p, float(np.mean(np.array(each) > 0)), scatter
        )


def at_scored(problem: TreeProblem, c: JointCandidate) -> float | None:
    """The amplitude at which a candidate that does not act linearly is scored; None where it acts
    so.
    """
    effect = problem.effect(c.effect)
    if effect.jump:
        return c.shaped().get(effect.amplitudes[0].name)
    return None


def _solved(c: JointCandidate, bend: np.ndarray, total: np.ndarray, most: float) -> np.ndarray:
    """Amplitudes within their bounds and none above `most`; those that would leave them at once are
    left out.
    """
    low = np.array([max(e.low - e.start, -most) for e in c.entries])
    high = np.array([min(e.high - e.start, most) for e in c.entries])
    on = np.diagonal(bend) > 1e-12
    bend = bend + np.diag([e.prior**-2.0 for e in c.entries])
    out = np.zeros(len(total))
    for _ in range(len(total) + 1):
        out[:] = 0.0
        if not on.any():
            break
        part = bend[np.ix_(on, on)]
        part = part + 1e-9 * np.diag(np.diagonal(part))
        out[on] = np.linalg.solve(part, total[on])
        bad = on & ((out < low) & (low == 0.0))
        if not bad.any():
            break
        on &= ~bad
    return np.clip(out, low, high)
