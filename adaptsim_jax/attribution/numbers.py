"""Numbers of a tree of joints by trial and log (`diagnosis/numbers.py`): what was fitted, and how
late each log's input is.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.attribution.candidates import JointCandidate, entries_of
from adaptsim_jax.attribution.equation.models import TorqueSearch, part_of
from adaptsim_jax.attribution.equation.searched import EffectTable
from adaptsim_jax.attribution.estimate import candidate_columns, normal
from adaptsim_jax.attribution.fitted import FittedTree
from adaptsim_jax.attribution.inquiry import Examined
from adaptsim_jax.attribution.parameters import INERTIA, Entry, Normal, Vector
from adaptsim_jax.attribution.physical_inertias import quantities
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.sentences import place
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import FOLD
from adaptsim_jax.diagnosis.folds import pieces
from adaptsim_jax.diagnosis.numbers import Evidence, Number, tabled
from adaptsim_jax.diagnosis.report import words
from adaptsim_jax.effects.joints.actuator import DELAY

LATE = "input logged late by"
"""How the number is called that no model has: how much later than the angles the input stands in
the log.
"""
Said = tuple[list[int], Normal, np.ndarray]
"""Numbers of entries, what blocks of rows say of these, and of which trial each block is [B]."""


def number_rows(e: Examined, fixed: Table) -> list[Table]:
    """Rows of `numbers` of a report. fixed: `declared` rows of the final model."""
    problem, final, log = e.problem, e.found.final, e.inquiry.machine.log
    vector, late = final.fit.vector, _late(e)
    wide = vector.with_entries(late)
    unit = np.eye(len(wide))
    numbers = []
    for q in quantities(e.inquiry.machine, problem, final):
        row = fixed.get(q.name)
        if row and (row["identifiable"] or q.combined):
            half = row["high"] - row["value"]
            numbers.append(
                Number(q.name, q.unit, row["value"], half, q.slope @ unit[: len(vector)])
            )
    for entry, value, half, slope in zip(
        vector.entries, vector.values, final.half_width, unit, strict=False
    ):
        if entry.owner != INERTIA:
            numbers.append(Number(_name(problem, entry), entry.unit, value, half, slope))
    numbers += [Number(LATE, k.unit, 0.0, 0.0, -unit[-1], fitted=False) for k in late]
    if e.by_torque is None:
        said = [_of_stretches(problem, final, late)]
    else:  # linear, so that a log that is far away says by how much, whatever judged
        said = list(_of_torque(problem, e.by_torque, vector, late))
    trials = [t.name for t in e.inquiry.machine.tracks]
    return tabled(numbers, _evidence(wide, said), trials, [log.label_of(t) for t in trials])


def _name(problem: TreeProblem, entry: Entry) -> str:
    where = place(problem, JointCandidate(entry.owner, entry.joints, "joint", (entry,)))
    return f"{words(entry.owner)} {entry.name.replace('_', ' ')} at {where}"


def _late(e: Examined) -> tuple[Entry, ...]:
    """One delay of all inputs, where none is fitted and it may be looked for."""
    fitted = any(k.owner == DELAY.name for k in e.found.final.fit.vector.entries)
    if fitted or not e.problem.offers(DELAY.name):
        return ()
    joints = tuple(range(e.problem.joints))
    return entries_of(e.problem, e.found.reach, DELAY, joints, shared=True)


def _of_torque(
    problem: TreeProblem, found: TorqueSearch, vector: Vector, late: Sequence[Entry]
) -> Iterator[Said]:
    """Of the torque along the motion, by group of joints."""
    index = vector.with_entries(late).index()
    for w in found.searches:
        own = part_of(vector, w.balance)
        table, some = EffectTable(problem, w.balance, own), [own.entries[i] for i in _free(own)]
        columns = [table.stack(some), table.stack(late, {DELAY.name: problem.reach.dt})]
        rows = w.state.rows
        weighed = np.concatenate(columns, -1) * rows.weight[..., None]
        left = table.missing() * rows.weight
        blocks = [rows.block == b for b in range(rows.block.max() + 1)]
        hess = [np.einsum("kna,knb->ab", weighed[b], weighed[b]) for b in blocks]
        slope = [np.einsum("kna,kn->a", weighed[b], left[b]) for b in blocks]
        trial = np.array([w.balance.trial[b][0] for b in blocks])
        yield [index[k.key] for k in (*some, *late)], Normal(np.stack(hess), np.stack(slope)), trial


def _of_stretches(problem: TreeProblem, final: FittedTree, late: Sequence[Entry]) -> Said:
    """Of simulated stretches, their starts eliminated. A trial that is far from the fit of all
    counts as any other: the weights of its stretches are over their median.
    """
    lin, free, count = final.lin, _free(final.fit.vector), len(final.fit.vector)
    shape = {DELAY.name: problem.reach.dt}
    more = candidate_columns(problem, lin, [(k, shape) for k in late])
    shared = [np.concatenate([s[..., free], m], 2) for s, m in zip(lin.shared, more, strict=True)]
    trial = problem.groups[0].stretches.trial[: len(problem.fold)]
    even = np.ones(problem.groups[0].stretches.count)
    for t in np.unique(trial):
        mine = np.flatnonzero(trial == t)
        even[mine] = np.median(lin.fit.weights.stretch[mine]) ** -0.5
    left, start, shared = ([(z.T * even).T for z in s] for s in (lin.residual, lin.start, shared))
    block = pieces(trial, FOLD.test_pieces)
    first = np.unique(block, return_index=True)[1]
    by_block = replace(problem, fold=block, folds=tuple(map(str, first)))
    at = [*free, *range(count, count + len(late))]
    return at, normal(by_block, left, start, shared), trial[first]


def _free(vector: Vector) -> list[int]:
    """Numbers of the entries that are not at an end of their range."""
    return [i for i, (e, z) in enumerate(vector.pairs()) if e.low < z < e.high]


def _evidence(vector: Vector, said: Sequence[Said]) -> Evidence:
    """What all say of a vector."""
    trial, size = np.concatenate([t for _, _, t in said]), len(vector)
    hess, slope, b = np.zeros((len(trial), size, size)), np.zeros((len(trial), size)), 0
    for at, n, own in said:
        rows = np.arange(b, b := b + len(own))
        hess[np.ix_(rows, at, at)], slope[np.ix_(rows, at)] = n.hess, n.slope
    pull = vector.precision * (vector.start - vector.values)
    return Evidence(hess, slope, np.diag(vector.precision), pull, trial)
