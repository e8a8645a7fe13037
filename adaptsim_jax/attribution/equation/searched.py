"""What a search along the measured motion knows of a group: its columns, the entries that are
always fitted, rows and weights; and by what a candidate is ranked.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from adaptsim_jax.attribution.criteria import BALANCE
from adaptsim_jax.attribution.equation.balance import GAIN, Balance, in_proportion
from adaptsim_jax.attribution.equation.columns import EffectTable
from adaptsim_jax.attribution.equation.solve import Solved, Sums, rows_of, solved
from adaptsim_jax.attribution.parameters import Vector
from adaptsim_jax.attribution.problem import TreeProblem, held
from adaptsim_jax.attribution.score import JointCandidate
from adaptsim_jax.diagnosis.criteria import Criteria
from adaptsim_jax.effects.base import Reach
from adaptsim_jax.mechanisms.tree import ancestors

MIN_SHIFT = 1e-4  # s: smaller shifts in time make no column


class Searched:
    """The search of one group: its table of columns, the entries that are always fitted, the
    effects so far.
    """

    def __init__(
        self,
        problem: TreeProblem,
        balance: Balance,
        null: Vector,
        reach: Reach,
        criteria: Criteria,
        commanded: bool,
    ):
        self.problem, self.balance, self.reach, self.criteria = problem, balance, reach, criteria
        self.commanded, self.limits = commanded, criteria.torque
        self.table = EffectTable(problem, balance, null)
        self.null = null
        self.bends = {e.name for e in problem.effects if e.scales_torque} - {GAIN}
        self.follows = bool(np.any(held(self.table.values.actuator[..., 0])))
        self.base = self.table.stack(null.entries)
        missing = self.table.missing()
        self.averaged = balance.averaged(self.table.driven()[0])
        torque = np.sqrt(np.mean(np.square(self.averaged), 0))
        size = np.sqrt(np.mean(np.square(missing), 0))
        taken = self.averaged + missing  # by the motion, where nothing is told of what acts
        self.torque = np.where(torque > 0, torque, np.sqrt(np.mean(np.square(taken), 0)))
        self.minimum = np.maximum(BALANCE.min_of_torque * torque, BALANCE.min_of_missing * size)
        self.rows = rows_of(
            missing, missing, balance.trial, balance.time, self.minimum, balance.clear
        )
        self._summed()
        self.weigh(self.set_of(()))
        self.local = {j: k for k, j in enumerate(balance.group.joints)}

    def weigh(self, fitted: Solved) -> None:
        """Weights from what a set leaves."""
        self.table.explained = fitted.columns @ fitted.step
        left = self.rows.missing - self.table.explained
        self.rows = rows_of(
            self.rows.missing,
            left,
            self.balance.trial,
            self.balance.time,
            self.minimum,
            self.balance.clear,
        )
        self._summed()

    def _summed(self) -> None:
        self.sums = Sums(self.rows)
        self.sums.add("", self.base)

    def set_of(self, added: Sequence[JointCandidate]) -> Solved:
        names: list[Any] = [""]
        entries, now = list(self.null.entries), list(self.null.values)
        for c in added:
            entries += c.entries
            now += [e.start for e in c.entries]
            names.append((c.key, c.shape))
            self.sums.add(names[-1], self.table.stack(c.entries, c.shaped()))
        found = solved(self.sums, names, entries, np.array(now))
        changed = [i for i, e in enumerate(entries) if e.owner in self.bends]
        if not changed:
            return found
        driven = self.averaged + found.columns[..., changed] @ found.step[changed]
        return replace(found, loss=found.loss / np.square(in_proportion(self.averaged, driven)))

    def settled(self, added: Sequence[JointCandidate], c: JointCandidate) -> JointCandidate:
        """A shift with its column made at the value that it comes to: a lag of 60 ms scaled to one
        of 3 ms is none of 3 ms.
        """
        if not c.shape or not self.problem.effect(c.effect).shifts_commands:
            return c
        for _ in range(2):
            value = float(self.set_of([*added, c]).step[-1]) + c.entries[0].start
            if abs(value) >= MIN_SHIFT:
                c = replace(c, shape=((c.shape[0][0], value),))
        return c

    def likely(self, c: JointCandidate) -> bool:
        """Whether like drives have it, so that it was put in at all joints: real joints rub."""
        traits = self.problem.effect(c.effect).traits
        return traits.family and traits.tried_first > 0

    def own(self, *some: JointCandidate) -> list[int]:
        """Local numbers of the joints at which effects show: a body, and where it is, at all that
        carry it.
        """
        tree = self.balance.group.model.tree

        def at_parents(c):
            return self.problem.effect(c.effect).traits.at_parents

        shows = {
            k
            for c in some
            for k in (self.local[j] for j in c.joints if j in self.local)
            for k in (k, *(ancestors(tree, k) if at_parents(c) else ()))
        }
        return sorted(shows)

    def carry(self, c: JointCandidate) -> float:
        """How many joints tell of one at which an effect is: of a body all that carry it."""
        return len(self.own(c)) / len(c.joints)


def ranked(state: Searched, now: Solved, some: Sequence[JointCandidate]) -> list[JointCandidate]:
    """Candidates by what they gain held out at first order, the best shape of each."""
    if not some:
        return []
    rows = state.rows
    left = (rows.missing - now.columns @ now.step) * rows.weight
    total = np.maximum(np.square(left).sum(0), 1e-300)
    even = np.sqrt(total.mean() / total)  # joints count alike, whatever they leave

    def weigh(z):
        return (z * (rows.weight * even)[..., None]).reshape(left.size, z.shape[2])

    began = [*state.null.values, *(e.start for e in now.entries[len(state.null) :])]
    free = [
        i
        for i, (e, z) in enumerate(zip(now.entries, began + now.step, strict=True))
        if e.low < z < e.high
    ]
    a, y = weigh(now.columns[..., free]), left * even
    prior = np.diag([now.entries[i].prior ** -2.0 for i in free])
    inverse = np.linalg.pinv(a.T @ a + prior, rcond=1e-12, hermitian=True)
    fold, flat = np.repeat(rows.fold, y.shape[1]), y.ravel()
    blocks = [state.table.stack(c.entries, c.shaped()) for c in some]
    wide = weigh(np.concatenate(blocks, 2))
    freed = wide - a @ (inverse @ (a.T @ wide))
    best: dict[tuple, tuple[float, JointCandidate]] = {}
    at = 0
    for c, block in zip(some, blocks, strict=True):
        own = freed[:, at : at + block.shape[2]]
        at += block.shape[2]
        share = _gain(own, flat, fold, c) / (0.5 * total.mean() * len(state.own(c)))
        gain = share * state.carry(c) - state.limits.gain * len(c.entries)
        if c.key not in best or gain > best[c.key][0]:
            best[c.key] = gain, c
    return [c for gain, c in sorted(best.values(), key=lambda z: -z[0]) if gain > 0.0]


def _gain(columns: np.ndarray, y: np.ndarray, fold: np.ndarray, c: JointCandidate) -> float:
    """Half the squares that amplitudes of the other folds take off each."""
    folds, count = fold.max() + 1, columns.shape[1]
    hess, slope = np.zeros((folds, count, count)), np.zeros((folds, count))
    for f in range(folds):
        mine = columns[fold == f]
        hess[f], slope[f] = mine.T @ mine, mine.T @ y[fold == f]
    low = np.array([e.low - e.start for e in c.entries])
    high = np.array([e.high - e.start for e in c.entries])
    prior = np.diag([e.prior**-2.0 for e in c.entries])
    gain = 0.0
    for f in range(folds):
        h = hess.sum(0) - hess[f] + prior
        step = np.linalg.lstsq(
            h + 1e-9 * np.diag(np.diagonal(h)), slope.sum(0) - slope[f], rcond=1e-10
        )[0]
        step = np.clip(step, low, high)
        gain += float(step @ slope[f] - 0.5 * step @ hess[f] @ step)
    return gain
