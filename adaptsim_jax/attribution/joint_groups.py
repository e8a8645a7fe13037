"""Groups of joints that do not touch (the legs of a hung quadruped), each by itself."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from adaptsim_jax.attribution.linear import Linear, inside
from adaptsim_jax.attribution.parameters import Entry, Vector
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.weights import group_losses


def touched(problem: TreeProblem, entries: Iterable[Entry], joints: Sequence[int]) -> list[int]:
    """Numbers of the groups that a change at `joints` touches: all of them where groups share a
    value.
    """
    owner = {j: k for k, g in enumerate(problem.groups) for j in g.joints}
    if any(len({owner[j] for j in e.joints}) > 1 for e in entries):
        return list(range(len(problem.groups)))
    return sorted({owner[j] for j in joints})


def by_group(problem: TreeProblem, entries: Sequence[Entry]) -> list[list[int]]:
    """Numbers of the entries, by what is fitted apart: a group of joints each, or all where groups
    share a value.
    """
    if len(touched(problem, entries, problem.groups[0].joints)) == len(problem.groups):
        return [list(range(len(entries)))]
    return [inside(entries, [g]) for g in problem.groups]


def part_of(
    problem: TreeProblem, vector: Vector, some: Sequence[int]
) -> tuple[TreeProblem, Vector, list[int]]:
    """The problem of some groups only, their entries, and the numbers of these."""
    part = replace(problem, groups=tuple(problem.groups[k] for k in some))
    at = inside(vector.entries, part.groups)
    return part, Vector(tuple(vector.entries[i] for i in at), vector.values[at]), at


def put_back(
    vector: Vector, starts: Sequence[np.ndarray], at, some, values, own
) -> tuple[Vector, tuple[np.ndarray, ...]]:
    """Vector and starts of the whole with the values of the entries `at` and the starts `own` of
    the groups `some`.
    """
    every = vector.values.copy()
    every[at] = values
    new = dict(zip(some, own, strict=True))
    return vector.at(every), tuple(new.get(k, x) for k, x in enumerate(starts))


def linear_part(
    part: TreeProblem, lin: Linear, own: Vector, at: Sequence[int], some: Sequence[int]
) -> Linear:
    """Of a linearised fit what `part_of` has taken."""

    def pick(z):
        return tuple(z[k] for k in some)

    loss = np.sum(group_losses(part, [made.path for made in pick(lin.paths)], lin.fit.weights), 0)
    fit = replace(lin.fit, vector=own, starts=pick(lin.fit.starts), loss=loss)
    shared = tuple(s[..., at] for s in pick(lin.shared))
    rest = (pick(z) for z in (lin.paths, lin.slopes, lin.counted))
    return Linear(fit, pick(lin.residual), pick(lin.start), shared, *rest)
