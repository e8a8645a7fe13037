"""Which convention of columns, units or lengths explains a motion that the declared one does not:
reported, never applied.

`contradiction` tries each hypothesis of `hypotheses_of` once (`quality.hypotheses`) and says the
one that turns most of the torque from unexplained into explained. Nothing is adapted to it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import BLOCK, CONTRADICTION
from adaptsim_jax.logs.quality.findings import AuditFinding, finding
from adaptsim_jax.logs.quality.hypotheses import (
    SHIFTS,
    BlockMeans,
    Design,
    Hypothesis,
    Track,
    hypothesis,
    linear_fit,
    motion_of,
    rubbing,
    unexplained,
)

TURNS = ((np.pi, "half a turn"), (np.pi / 2, "a quarter turn"), (-np.pi / 2, "a quarter turn"))
AS_DECLARED = "if all is as declared, add --as-declared"


class JointWords(NamedTuple):
    """How one joint and its columns are called."""

    joint: str
    q: str
    v: str
    tau: str


@dataclass(frozen=True)
class Words:
    """How columns are called, each `[n]`: angles `q`, velocities `v`, torques `tau`; `joints`. What
    to write: `swap` to exchange two joints, `reverse(j)` to turn a joint with all its columns,
    `absolute(j, parent)` for an angle measured from the world.
    """

    joints: tuple[str, ...]
    q: tuple[str, ...]
    v: tuple[str, ...]
    tau: tuple[str, ...]
    hinges: tuple[bool, ...]
    swap: str
    reverse: Callable[[int], str]
    absolute: Callable[[int, int], str]

    def of(self, j: int) -> JointWords:
        """The columns of one joint."""
        return JointWords(self.joints[j], self.q[j], self.v[j], self.tau[j])


@dataclass(frozen=True)
class Contradiction:
    """What the motion follows in place of the declared convention.

    - `share_as_declared`: Share of the torque's square as declared.
    - `share_otherwise`: Under the hypothesis.
    - `statement`: What looks otherwise.
    - `mend`: What to write.
    """

    name: str
    statement: str
    mend: str
    share_as_declared: float
    share_otherwise: float

    @property
    def message(self) -> str:
        def share(x):
            if x >= 0.01:
                return f"{100 * x:.0f} %"
            return f"{100 * x:.1f} %"

        return (
            "the columns contradict the declared model, which leaves "
            f"{share(self.share_as_declared)} of the "
            f"torque's square unexplained: {self.statement} ({share(self.share_otherwise)} is left "
            f"then); {self.mend}"
        )


def contradiction(
    tracks: Sequence[Track],
    design: Design,
    words: Words,
    others: Sequence[Hypothesis] = (),
    chain: Sequence[int] = (),
    zeros: Sequence[int] = (),
) -> Contradiction | None:
    """The convention that the motion follows in place of the declared one; None where that does, or
    where none explains it.

    Args:
        others: Hypotheses of the mechanism itself (lengths, zeros).
        chain [n]: The joint whose angle a joint's may have been added to, -1 for none.
        zeros: Joints whose zero may be a quarter or half a turn off.
    """
    hypotheses = (*hypotheses_of(words, chain, zeros), *others)
    for sharp in (False, True):  # fast motion of few rows is exact in short blocks alone
        motion = motion_of(tracks, sharp=sharp)
        if (
            len(motion.q) < BLOCK.min_blocks
            or not np.all(np.isfinite(motion.a))
            or not _is_moving(motion)
        ):
            return None
        share_as_declared = unexplained(motion, design)
        if share_as_declared < CONTRADICTION.max_share_as_declared:
            return None
        share_otherwise, best = _simplest(hypotheses, motion, design)
        min_ratio = (
            CONTRADICTION.min_ratio
            if share_as_declared >= CONTRADICTION.min_doubted_share
            else CONTRADICTION.min_clear_ratio
        )
        if (
            share_otherwise <= CONTRADICTION.max_share_otherwise
            and share_otherwise * min_ratio <= share_as_declared
        ):
            if (
                share_as_declared < CONTRADICTION.min_doubted_share
                and best in others
                and _as_heavy(motion, design)
            ):
                return None
            return Contradiction(
                best.name, best.statement, best.mend, share_as_declared, share_otherwise
            )
    return None


def other_sides(tracks: Sequence[Track], design: Design) -> dict[int, float]:
    """Joints whose logged torque is another number of times the one that moves the declared
    masses; none where that does not explain the motion far better than it is.
    """
    motion = motion_of(tracks)
    if (
        len(motion.q) < BLOCK.min_blocks
        or not np.all(np.isfinite(motion.a))
        or not _is_moving(motion)
    ):
        return {}
    share_as_declared = unexplained(motion, design)
    columns, rubs = design(motion, True), rubbing(motion)
    max_share = min(CONTRADICTION.max_share_otherwise, share_as_declared / CONTRADICTION.min_ratio)
    sizes, n = {}, motion.q.shape[1]
    for j in range(n if share_as_declared > CONTRADICTION.min_doubted_share else 0):
        tau, columns_of_joint = motion.tau[:, j], rubs[:, j, 4 * j : 4 * j + 3]
        columns_of_joint = np.column_stack(
            [columns[:, j, :n].sum(1), motion.a[:, j], columns_of_joint]
        )
        x = np.linalg.lstsq(columns_of_joint, tau, rcond=1e-9)[0]
        if np.var(tau - columns_of_joint @ x) > max_share * np.var(tau):
            return {}
        if x[0] < 0 or abs(np.log(x[0])) > np.log(CONTRADICTION.max_torque_ratio):
            sizes[j] = float(x[0])
    return sizes


def _simplest(
    hypotheses: Sequence[Hypothesis], motion: BlockMeans, design: Design
) -> tuple[float, Hypothesis]:
    """The hypothesis that leaves least, and what that is; of two that do alike the first, which is
    the simpler, stands.
    """
    best = np.inf, hypotheses[0]
    for h in hypotheses:
        share_otherwise = unexplained(h.motion(motion), h.design or design, h.gravity)
        if share_otherwise < CONTRADICTION.max_ratio_to_simpler * best[0]:
            best = share_otherwise, h
    return best


def _as_heavy(motion: BlockMeans, design: Design) -> bool:
    """Whether torques are of the declared masses' size: inertias that are a little off look like
    lengths that are far off.
    """
    scale = linear_fit(motion, design, first=motion.tau.shape[1]).scale
    return 1.0 / CONTRADICTION.max_torque_ratio < scale < CONTRADICTION.max_torque_ratio


def _is_moving(motion: BlockMeans) -> bool:
    is_turning = np.std(motion.q, axis=0) > BLOCK.min_motion
    is_driven = np.std(motion.tau, axis=0) > 1e-9
    return bool(np.all(is_turning) and np.any(is_driven))


def hypotheses_of(
    words: Words, chain: Sequence[int] = (), zeros: Sequence[int] = ()
) -> list[Hypothesis]:
    """Make the hypotheses of the columns, for `n` joints; `chain`, `zeros`: see `contradiction`."""
    n = len(words.joints)
    torques = ", ".join(words.tau)
    pairs = combinations(range(n), 2) if n <= CONTRADICTION.max_swapped_joints else ()
    out = [h for i, j in pairs for h in _swapped(words, i, j)]
    if n > 1:
        torques_turned = hypothesis(
            "torques_turned", lambda m: replace(m, tau=-m.tau), torques=torques
        )
        out.append(torques_turned)
    for j in range(n):
        out += _of_joint(words, j)
    if n > 1 and all(words.hinges):
        out += _units("all angles look to be", "angle", lambda factor: np.full(n, factor))
    for j, parent in enumerate(chain):
        if parent >= 0:
            facts = {"first": words.of(j), "absolute": words.absolute(j, parent)}
            motion = partial(_relative_angle, j=j, parent=parent)
            out.append(hypothesis("absolute_angle", motion, **facts))
    for j in zeros:
        for radians, turn in TURNS:
            shifted = partial(_shift_zero, by=np.where(np.arange(n) == j, radians, 0.0))
            out.append(hypothesis("zero", shifted, first=words.of(j), turn=turn, radians=radians))
    out.append(replace(hypothesis("gravity_missing", torques=torques), gravity=False))
    return out


def _swapped(words: Words, i: int, j: int) -> list[Hypothesis]:
    """Joints `i` and `j` exchanged, with all their columns, with their torques or angles alone."""
    own = list(range(len(words.joints)))
    order = own.copy()
    order[i], order[j] = j, i
    facts = {
        "pair": f"{words.joints[i]} and {words.joints[j]}",
        "first": words.of(i),
        "second": words.of(j),
        "swap": words.swap,
    }
    return [
        hypothesis("joints_swapped", _ordered(order, order), **facts),
        hypothesis("torques_swapped", _ordered(own, order), **facts),
        hypothesis("angles_swapped", _ordered(order, own), **facts),
    ]


def _of_joint(words: Words, j: int) -> list[Hypothesis]:
    """Signs and units of the columns of joint `j`."""
    n = len(words.joints)
    facts = {"first": words.of(j), "reverse": words.reverse(j)}

    def own(factor: float) -> np.ndarray:
        return np.where(np.arange(n) == j, factor, 1.0)

    def scaled(factor: float, m: BlockMeans) -> BlockMeans:
        return replace(m, tau=m.tau * own(factor))

    out = [
        hypothesis("torque_turned", partial(scaled, -1.0), **facts),
        hypothesis("angle_turned", lambda m: _scaled(m, own(-1.0)), **facts),
        hypothesis("joint_reversed", lambda m: scaled(-1.0, _scaled(m, own(-1.0))), **facts),
    ]
    if n > 1:
        out.append(hypothesis("torque_unit", partial(scaled, 1e-3), **facts))
    if words.hinges[j]:
        out += _units(f"{words.q[j]} looks to be", words.q[j], own)
    return out


def _units(what: str, key: str, factors: Callable[[float], np.ndarray]) -> list[Hypothesis]:
    """Angles in another unit than declared.

    Args:
        what: the beginning of the statement.
        key: of `[units]`.
        factors: `factors(factor)` `[n]`, by which each joint's would have to be multiplied.
    """

    def each(code: str, factor: float) -> Hypothesis:
        return hypothesis(code, lambda m: _scaled(m, factors(factor)), what=what, key=key)

    return [
        each("degrees", np.pi / 180.0),
        each("radians", 180.0 / np.pi),
        each("revolutions", 2 * np.pi),
    ]


def _ordered(q: list[int], tau: list[int]):
    return lambda m: BlockMeans(m.q[:, q], m.v[:, q], m.a[:, q], m.tau[:, tau])


def _scaled(m: BlockMeans, size: np.ndarray) -> BlockMeans:
    return replace(m, q=m.q * size, v=m.v * size, a=m.a * size)


def _shift_zero(m: BlockMeans, by: np.ndarray) -> BlockMeans:
    return replace(m, q=m.q + by)


def _relative_angle(m: BlockMeans, j: int, parent: int) -> BlockMeans:
    def less(x: np.ndarray) -> np.ndarray:
        out = x.copy()
        out[:, j] -= x[:, parent]
        return out

    return replace(m, q=less(m.q), v=less(m.v), a=less(m.a))


@dataclass(frozen=True)
class Late:
    """The torque of `seconds` later than it was logged moves the mechanism: positive where the
    torque is logged late, negative where the motion follows late.
    """

    seconds: float
    share_as_declared: float
    share_otherwise: float


def lateness(tracks: Sequence[Track], design: Design) -> Late | None:
    """Estimate by how much the torque is out of step with the motion, all joints alike; None where
    it is not, or where that cannot be told.
    """
    motion = motion_of(tracks)
    if len(motion.q) < BLOCK.min_blocks or not _is_moving(motion):
        return None
    share_as_declared = unexplained(motion, design)
    coarse = SHIFTS[::3]
    scores = [unexplained(motion_of(tracks, s), design) for s in coarse]
    k = int(np.argmin(scores))
    fine = coarse[k] + np.arange(-3, 4) * 1e-3
    shares = [unexplained(motion_of(tracks, s), design) for s in fine]
    i = int(np.argmin(shares))
    best = fine[i]
    if 0 < i < len(fine) - 1:
        a, b, c = shares[i - 1 : i + 2]
        best += 0.5e-3 * (a - c) / max(a - 2 * b + c, 1e-15)
    if (
        shares[i]
        > min(CONTRADICTION.max_shifted_ratio * share_as_declared, CONTRADICTION.min_doubted_share)
        or abs(best) < CONTRADICTION.min_shift
        or k in (0, len(coarse) - 1)
    ):
        return None
    return Late(float(best), share_as_declared, float(shares[i]))


def late_finding(
    path: str, late: Late, step: float, columns: Sequence[str], names_late_logs: bool = False
) -> tuple[AuditFinding, ...]:
    """A warning where the motion follows the torque late, which an effect may be. BadInput where it
    is before its torque, which nothing can be, unless the search to come names logs that are late:
    then a warning too. `step` s between rows.
    """
    ms, names = f"{1e3 * abs(late.seconds):.2g} ms", ", ".join(columns)
    if late.seconds > CONTRADICTION.min_ahead_rows * step:
        count = f"{late.seconds / step:.1f}".removesuffix(".0")
        rows = "1 row" if count == "1" else f"{count} rows"
        what = (
            f"the motion is {ms} ahead of the torque that makes it: {names} are logged about "
            f"{ms} ({rows}) late"
        )
        mend = (
            f"move {names} up by {rows} against time and the angles, or bring both onto one clock"
        )
        if names_late_logs:
            return (finding("late_torque", "", names, late.seconds, ahead=what, mend=mend),)
        raise BadInput(f"{path}: {what}; {mend}; {AS_DECLARED}")
    if late.seconds > 0.0:
        return ()  # a torque that is not held from row to row looks half a row late
    return (finding("late_motion", "", names, late.seconds, ms=ms),)
