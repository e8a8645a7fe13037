"""From which size on each effect shows in the torque along a motion, alone and beside what it is
mistaken for: of a recorded log, or of a motion before it is recorded.

The torque that a model misses is linear in small effects: size times column, bodies, damping,
noise. The length of a column outside the span of what is fitted beside it, over the noise, is what
a unit of its size adds to a test's statistic (Ds-optimality: Atkinson, Donev and Tobias, 2007,
ch. 10).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter

import numpy as np
from scipy import stats

from adaptsim_jax.attribution.candidates import JointCandidate, adjacent, candidates
from adaptsim_jax.attribution.criteria import BALANCE, TEXT
from adaptsim_jax.attribution.equation.balance import Balance, rms
from adaptsim_jax.attribution.equation.searched import EffectTable
from adaptsim_jax.attribution.equation.solve import rows_of
from adaptsim_jax.attribution.parameters import INERTIA, TILT, Vector
from adaptsim_jax.attribution.problem import TreeProblem
from adaptsim_jax.attribution.sentences import label
from adaptsim_jax.core.config import Table
from adaptsim_jax.diagnosis.criteria import FOLD, Criteria
from adaptsim_jax.effects.base import Reach
from adaptsim_jax.effects.joints.catalogue import ETA
from adaptsim_jax.effects.joints.friction import VISCOUS

CRITERIA = Criteria()
POINTS = 4  # sizes at which what does not act linearly is looked at
ROUNDING = 1e-9  # of a column's square: less of it is left by rounding alone


@dataclass(frozen=True)
class Item:
    """A candidate at one of its shapes. at: numbers of its columns, first the one whose size is
    told; least: size below which no diagnosis names it, however little noise there is; only: the
    size at which its column holds, 0 where any.
    """

    candidate: JointCandidate
    at: tuple[int, ...]
    least: float
    only: float
    fitted: bool


def shown(
    problem: TreeProblem,
    balance: Balance,
    fitted: Vector,
    reach: Reach,
    left: np.ndarray,
    least: np.ndarray | float = 0.0,
    criteria: Criteria = CRITERIA,
) -> list[Table]:
    """What a motion shows, by effect and joint.

    Args:
        problem: The machine along the motion.
        balance: Of a group of its joints.
        fitted: What is fitted whatever is named, with its priors.
        reach: What the motion covers.
        left: [K, n] N m, torque missing in windows that no effect explains: the noise.
        least: [n] N m, the least that it is taken to be; a search takes a share of the torque.
        criteria: Those of the diagnosis.

    Returns:
        `{name, where, size, unit, power, alone, rival}`. Of recordings with the effect at `size`
        the share `power` names it; from `alone` on by itself, told from `rival`. None: at no size
        in its range.
    """
    table = EffectTable(problem, balance, fitted)
    torque = _size(balance.averaged(table.driven()[0]))
    least = np.maximum(least, BALANCE.min_of_torque * torque)
    rows = rows_of(left, left, balance.trial, balance.time, least, balance.clear)
    columns = [table.stack(fitted.entries)]
    precision = list(fitted.precision)
    items = []
    for c, own in _asked(problem, balance, fitted, reach):
        at = (own,)
        if own is None:
            columns.append(table.stack(c.entries, c.shaped()))
            at = tuple(len(precision) + k for k in range(len(c.entries)))
            precision += [e.prior**-2.0 for e in c.entries]
        share = np.max(
            _size((columns[-1] if own is None else columns[0][..., at])[..., 0]) / torque
        )
        items.append(_item(problem, c, at, own is not None, float(share), reach, criteria))
    weighed = np.concatenate(columns, -1) * rows.weight[..., None]
    weighed = weighed.reshape(-1, weighed.shape[-1])
    gram, always = weighed.T @ weighed, list(range(len(fitted)))
    return _table(problem, balance, items, gram, np.array(precision), always, criteria)


def _size(z: np.ndarray) -> np.ndarray:
    """Root mean square over windows."""
    return rms(z) + 1e-300


def _asked(
    problem: TreeProblem, balance: Balance, fitted: Vector, reach: Reach
) -> Iterator[tuple[JointCandidate, int | None]]:
    """Candidates, and which entry of the fitted ones each is, None for none: damping, bodies that
    are heavier, laws at each joint at the middle one of their shapes (what does not act linearly:
    at some).
    """
    for i, e in enumerate(fitted.entries):
        if e.owner == VISCOUS.name or (e.owner == INERTIA and e.name == ETA[0]):
            yield JointCandidate(e.owner, e.joints, "joint", (e,)), i
    joints = set(balance.group.joints)
    for key, group in groupby(candidates(problem, fitted, reach), lambda c: c.key):
        effect, some = problem.effect(key[0]), list(group)
        if not effect.in_balance or effect.describes or not set(key[1]) <= joints:
            continue
        if key[2] == "joint" or effect.name == TILT:
            step = max(1, len(some) // POINTS)
            jumps = effect.jump and effect.place == "force"
            for c in some[step // 2 :: step] if jumps else [some[len(some) // 2]]:
                yield c, None


def _item(
    problem: TreeProblem,
    c: JointCandidate,
    at: tuple[int, ...],
    fitted: bool,
    share: float,
    reach: Reach,
    criteria: Criteria,
) -> Item:
    """share: of a joint's torque, root mean square, that a unit of its size is."""
    if fitted:
        return Item(c, at, 0.0, 0.0, True)
    effect, shape = problem.effect(c.effect), c.shaped()
    least = criteria.torque.worth / share
    if effect.shifts_commands:
        least = max(least, criteria.torque.paired * reach.dt)
    only = shape.get(c.entries[0].name, 0.0) if effect.place == "force" else 0.0
    return Item(c, at, least, only, False)


def _table(
    problem: TreeProblem,
    balance: Balance,
    items: Sequence[Item],
    gram: np.ndarray,
    precision: np.ndarray,
    always: list[int],
    criteria: Criteria,
) -> list[Table]:
    count = len({i.candidate.key for i in items})
    level = stats.norm.isf(0.5 * criteria.torque.level / count)
    folds = np.sqrt(FOLD.pieces / (FOLD.pieces - 1.0))
    needed = float(level + stats.norm.ppf(TEXT.power)) * folds
    among, best = _freed(gram, precision, always), {}
    for item in items:
        c, (me, *others) = item.candidate, item.at
        mine = _freed(gram, precision, [k for k in always if k != me]) if item.fitted else among
        pairs = [(_length(mine, precision, me, others), None)]
        for r in items:
            simple = not r.fitted and len(r.at) <= len(item.at)  # else the simpler has the name
            if simple and _mistaken(problem, c, r.candidate):
                beside = _length(mine, precision, me, [*others, *r.at])
                pairs.append((beside, "@".join(label(problem, r.candidate))))
        length, rival = min(pairs, key=itemgetter(0))
        unit, whole = _in_unit(balance, item)
        row = {
            **label(problem, c)._asdict(),
            "size": _from(needed, pairs[0][0], item, whole),
            "unit": unit,
            "power": TEXT.power,
            "alone": _from(needed, length, item, whole),
            "rival": rival,
        }
        if c.key not in best or _order(row) < _order(best[c.key]):
            best[c.key] = row
    return list(best.values())


def _in_unit(balance: Balance, item: Item) -> tuple[str, float]:
    """The unit of an item's size, and its worth in that: of a body kg, all of it in proportion."""
    e = item.candidate.entries[0]
    if e.owner != INERTIA:
        return e.unit, 1.0
    body = balance.group.joints.index(e.joints[0])
    return "kg", 2.0 * float(balance.group.inertias.declared[body, 0])


def _order(row: Table) -> tuple[float, float]:
    return row["alone"] or np.inf, row["size"] or np.inf


def _from(needed: float, length: float, item: Item, unit: float) -> float | None:
    """The size at which it is found, and large enough for a name; None where that is beyond its
    range.
    """
    e = item.candidate.entries[0]
    size = max(needed / length, item.least + float(stats.norm.ppf(TEXT.power)) / length)
    if size > (item.only or max(e.high - e.start, e.start - e.low)):
        return None
    return float(unit * (item.only or size))


def _mistaken(problem: TreeProblem, c: JointCandidate, other: JointCandidate) -> bool:
    """Whether the other one may stand for it: what looks alike at its joint, itself at the next."""
    if other.effect == c.effect:
        return other.joints != c.joints and adjacent(problem, c, other)
    alike = problem.effect(c.effect).look_alikes if problem.offers(c.effect) else ()
    return other.effect in alike and bool(set(c.joints) & set(other.joints))


def _freed(gram: np.ndarray, precision: np.ndarray, free: Sequence[int]) -> np.ndarray:
    """Products of columns outside the span of the free ones, as far as their priors let these
    move.
    """
    among = gram[np.ix_(free, free)] + np.diag(precision[free])
    scale = 1.0 / np.sqrt(np.maximum(np.diag(among), 1e-300))
    among = among * np.outer(scale, scale) + ROUNDING * np.eye(len(free))
    cross = gram[free] * scale[:, None]
    return gram - cross.T @ np.linalg.solve(among, cross)


def _length(gram: np.ndarray, precision: np.ndarray, me: int, free: Sequence[int]) -> float:
    """Of a column outside the span of the free ones."""
    own = [me, *free]
    left = _freed(gram[np.ix_(own, own)], precision[own], range(1, len(own)))[0, 0]
    return float(np.sqrt(max(left, ROUNDING * abs(gram[me, me]), 1e-300)))
