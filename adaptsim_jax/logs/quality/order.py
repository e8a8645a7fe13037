"""Whether the joints of a log, with all their columns, are in another order than the model's:
arrays without names say nothing of it, and simulators have orders of their own.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.criteria import BLOCK, CONTRADICTION
from adaptsim_jax.logs.quality.contradictions import AS_DECLARED
from adaptsim_jax.logs.quality.hypotheses import Design, Track, motion_of, unexplained

Order = tuple[int, ...]
"""The column that holds each joint of the model."""


def other_order(
    tracks: Callable[[Order], Sequence[Track]],
    design: Design,
    orders: Sequence[Order],
    driven: Sequence[bool],
) -> tuple[float, float, Order] | None:
    """The order of columns that the motion follows in place of the model's, after the shares of
    the torque's square that this and that leave; None where none explains the motion.

    Args:
        tracks: The trials with joints from these columns, and the torques of their drives then.
        orders: Those that simulators have; exchanges of two joints are tried too, one upon the
            other.
        driven: Of each joint, whether the model gives it a drive: only columns of such a joint
            can have a target.
    """

    def unexplained_share(order: Order) -> float:
        if any(driven[j] != driven[k] for j, k in enumerate(order)):
            return np.inf
        return unexplained(motion_of(tracks(order), sharp=True), design)

    model_order = tuple(range(len(orders[0])))
    motion = motion_of(tracks(model_order), sharp=True)
    if len(motion.q) < BLOCK.min_blocks or np.min(np.std(motion.q, axis=0)) < BLOCK.min_motion:
        return None
    declared = unexplained_share(model_order)
    if not declared > CONTRADICTION.max_share_as_declared:
        return None
    best = min((unexplained_share(order), order) for order in orders)
    best = min(best, (declared, model_order))
    while (exchanged := min((unexplained_share(o), o) for o in _with_exchange(best[1]))) < best:
        if exchanged[0] > CONTRADICTION.max_ratio_to_simpler * best[0]:
            break
        best = exchanged
    min_ratio = (
        CONTRADICTION.min_ratio
        if declared >= CONTRADICTION.min_doubted_share
        else CONTRADICTION.min_clear_ratio
    )
    if best[0] <= CONTRADICTION.max_share_otherwise and best[0] * min_ratio <= declared:
        return declared, *best
    return None


def _with_exchange(order: Order) -> Iterator[Order]:
    """All orders in which two joints are exchanged; itself where these are too many."""
    yield order
    if len(order) <= CONTRADICTION.max_swapped_joints:
        for i, j in combinations(range(len(order)), 2):
            swapped = list(order)
            swapped[i], swapped[j] = order[j], order[i]
            yield tuple(swapped)


def usual_orders(parents: Sequence[int], names: Sequence[str]) -> list[Order]:
    """Orders that simulators and loggers have: joint level by joint level, and by name."""
    depth: list[int] = []
    for parent in parents:
        depth.append(depth[parent] + 1 if parent >= 0 else 0)
    by_level = sorted(range(len(parents)), key=lambda j: (depth[j], j))
    by_name = sorted(range(len(parents)), key=lambda j: names[j])
    return [tuple(map(int, np.argsort(one))) for one in (by_level, by_name)]


def check_order(
    path: str,
    tracks: Callable[[Order], Sequence[Track]],
    design: Design,
    names: Sequence[str],
    parents: Sequence[int],
    driven: Sequence[bool],
    stems: Sequence[str],
) -> None:
    """BadInput where a machine's columns of these `stems` together are in another order than its
    joints `names`, of which each hangs at that of `parents`.
    """
    if len(names) < 2:
        return
    order_found = other_order(tracks, design, usual_orders(parents, names), driven)
    if order_found is None:
        return
    share_as_declared, share_otherwise, order = order_found
    names_there = ", ".join(names[j] for j in np.argsort(order))
    places = {s: ", ".join(f'"{s}[{k}]"' for k in order) for s in stems}
    lines = " and ".join(f"{stem} = [{place_text}]" for stem, place_text in places.items())
    raise BadInput(
        f"{path}: {' and '.join(stems)} look to be in the order {names_there} (which leaves "
        f"{100 * share_otherwise:.2g} % of the torque's square unexplained, the model's order "
        f"{100 * share_as_declared:.2g} %); write {lines} under [columns] in meta.toml where they "
        f"are arrays, or exchange the names of columns; {AS_DECLARED}"
    )
