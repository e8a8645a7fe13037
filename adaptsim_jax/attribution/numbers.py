"""Numbers of a tree of joints by trial and log (`diagnosis/numbers.py`): what was fitted, by the
objective that judged, and how late each log's input is.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.attribution.candidates import JointCandidate, entries_of
from adaptsim_jax.attribution.equation.models import GroupSearch, part_of
from adaptsim_jax.attribution.equation.searched import EffectTable
from adaptsim_jax.attribution.estimate import candidate_columns, normal
from adaptsim_jax.attribution.inquiry import Examined
from adaptsim_jax.attribution.parameters import INERTIA, Entry, Vector
from adaptsim_jax.attribution.physical_inertias import quantities
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.sentences import place
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import FOLD
from adaptsim_jax.diagnosis.folds import pieces
from adaptsim_jax.diagnosis.numbers import Evidence, Number, tabled
from adaptsim_jax.diagnosis.report import words
from adaptsim_jax.effects.base import Reach
from adaptsim_jax.effects.joints.actuator import DELAY

LATE = "input logged late by"
"""How the number is called that no model has: how much later than the angles the input stands in
the log.
"""


def number_rows(e: Examined, fixed: Table) -> list[Table]:
    """Rows of `numbers` of a report. fixed: `declared` rows of the final model."""
    final, machine = e.found.final, e.inquiry.machine
    vector = final.fit.vector
    trials = [t.name for t in machine.tracks]
    labels = [machine.log.label_of(name) for name in trials]
    made = [
        Number(q.name, q.unit, row["value"], row["high"] - row["value"], q.slope)
        for q in quantities(machine, e.problem, final)
        if (row := fixed.get(q.name)) and (row["identifiable"] or q.combined)
    ]
    for k, (entry, value, wide) in enumerate(
        zip(vector.entries, vector.values, final.half_width, strict=True)
    ):
        if entry.owner != INERTIA:
            name = _name(e.problem, entry)
            made.append(Number(name, entry.unit, float(value), float(wide), np.eye(len(vector))[k]))
    rows = []
    for evidence, entries, at in _evidence(e):
        known = [i for i, k in enumerate(entries) if k in vector.index()]
        own = [vector.index()[entries[i]] for i in known]
        some = []
        for n in made:
            slope = np.zeros(len(entries))
            slope[known] = n.slope[own]
            if np.any(slope):
                some.append(replace(n, slope=slope))
        if at is not None:
            late = -np.eye(len(entries))[-1]  # a delay of the input is a record that is early
            some.append(Number(f"{LATE}{at}", "s", 0.0, 0.0, late, fitted=False))
        rows += tabled(some, evidence, trials, labels) if some else []
    return rows


def _name(problem: TreeProblem, entry: Entry) -> str:
    where = place(problem, JointCandidate(entry.owner, entry.joints, "joint", (entry,)))
    return f"{words(entry.owner)} {entry.name.replace('_', ' ')} at {where}"


def _evidence(e: Examined):
    """By group of joints that are fitted apart: evidence, keys of its entries, and which joints
    the last of them, the delay, is of (None: it is none).
    """
    vector = e.found.final.fit.vector
    late = _late(e.problem, vector, e.found.reach)
    if e.by_torque is None:
        return [_of_stretches(e, late)]
    # linear, so that a log that is far away says by how much, whatever judged
    searches = e.by_torque.searches
    return [_of_balance(e.problem, w, part_of(vector, w.balance), late) for w in searches]


def _late(problem: TreeProblem, vector: Vector, reach: Reach) -> JointCandidate | None:
    """One delay of all inputs, where none is fitted and it may be looked for."""
    fitted = any(e.owner == DELAY.name for e in vector.entries)
    if fitted or DELAY.name not in {f.name for f in problem.effects}:
        return None
    joints = tuple(range(problem.joints))
    entries = entries_of(problem, reach, DELAY, joints, shared=True)
    return JointCandidate(DELAY.name, joints, "common", entries, (("delay", reach.dt),))


def _of_balance(problem: TreeProblem, w: GroupSearch, vector: Vector, late: JointCandidate | None):
    """Of the torque along the motion of a group, about a vector of its entries."""
    free = _free(vector)
    table = EffectTable(problem, w.balance, vector)
    entries, rows, where = [vector.entries[i] for i in free], w.state.rows, None
    columns = table.stack(entries)
    if late is not None:
        own = tuple(j for j in late.joints if j in w.balance.group.joints)
        here = tuple(replace(k, joints=own) for k in late.entries)
        columns = np.concatenate([columns, table.stack(here, late.shaped())], -1)
        entries, where = [*entries, *here], _where(problem, own)
    weighed, left = columns * rows.weight[..., None], table.missing() * rows.weight
    count = rows.block.max() + 1
    parts = [(weighed[rows.block == b], left[rows.block == b]) for b in range(count)]
    hess = np.stack([np.einsum("kna,knb->ab", z, z) for z, _ in parts])
    slope = np.stack([np.einsum("kna,kn->a", z, y) for z, y in parts])
    first = [int(np.argmax(rows.block == b)) for b in range(count)]
    evidence = _with_prior(hess, slope, entries, vector, w.balance.trial[first])
    return evidence, [k.key for k in entries], where


def _of_stretches(e: Examined, late: JointCandidate | None):
    """Of simulated stretches, their starts eliminated. A trial that is far from the fit of all
    counts as any other: the weights of its stretches are over their median.
    """
    problem, lin, vector = e.problem, e.found.final.lin, e.found.final.fit.vector
    shared, free, where = lin.shared, _free(vector), None
    entries = [vector.entries[i] for i in free]
    shared = [s[..., free] for s in shared]
    if late is not None:
        more = candidate_columns(problem, lin, [(k, late.shaped()) for k in late.entries])
        shared = [np.concatenate(pair, 2) for pair in zip(shared, more, strict=True)]
        entries, where = [*entries, *late.entries], ""
    trial = problem.groups[0].stretches.trial[: len(problem.fold)]
    even = np.ones(problem.groups[0].stretches.count)
    for t in np.unique(trial):
        mine = np.flatnonzero(trial == t)
        even[mine] = np.median(lin.fit.weights.stretch[mine]) ** -0.5
    block = pieces(trial, FOLD.test_pieces)
    count = block.max() + 1
    by_block = replace(problem, fold=block, folds=tuple(map(str, range(count))))
    left, start, shared = (
        [(z.T * even).T for z in parts] for parts in (lin.residual, lin.start, shared)
    )
    n = normal(by_block, left, start, shared)
    first = [int(np.argmax(block == b)) for b in range(count)]
    return (
        _with_prior(n.hess, n.slope, entries, vector, trial[first]),
        [k.key for k in entries],
        where,
    )


def _free(vector: Vector) -> list[int]:
    """Numbers of the entries that are not at an end of their range."""
    return [i for i, (e, z) in enumerate(vector.pairs()) if e.low < z < e.high]


def _with_prior(
    hess: np.ndarray, slope: np.ndarray, entries: Sequence[Entry], at: Vector, trial: np.ndarray
) -> Evidence:
    known = at.known()
    precision = np.array([k.prior**-2.0 for k in entries])
    off = np.array([known.get(k.key, k.start) - k.start for k in entries])
    return Evidence(hess, slope, np.diag(precision), -precision * off, trial)


def _where(problem: TreeProblem, joints: Sequence[int]) -> str:
    """Of which joints, where not of all."""
    if len(joints) == problem.joints:
        return ""
    return f" at {', '.join(problem.joint_names[j] for j in joints)}"
