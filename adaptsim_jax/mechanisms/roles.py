"""What each joint of a model file is in a tree: a coordinate, held where it is, or a follower of
another; and what stays out.

A joint that the log lacks is held, at what `[hold]` says, else where the file's `home` pose or its
zero has it. A free joint is welded. A mimic or an equality of two joints makes one of them follow.
Loops that close (connect, weld) hold what is in them.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.mechanisms.spec import Source
from adaptsim_jax.mechanisms.urdf import Follower

FREE, BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
CONNECT, WELD, TIE = (
    int(getattr(mujoco.mjtEq, f"mjEQ_{name}")) for name in ("CONNECT", "WELD", "JOINT")
)
JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
TURNS = "xyz"  # a ball is three hinges, which turn about these axes one after the other
WRAPPED = int(mujoco.mjtWrap.mjWRAP_JOINT)
HOME = "home"


@dataclass(frozen=True)
class Roles:
    """What each joint of a model file became.

    - `held`: Values (rad, m) by name of the joint, a free joint's or ball's as `qpos`.
    - `followers`: By name.
    - `notes`: What was done, a sentence each.
    - `beyond`: What of the file a tree has not, a sentence each.
    """

    held: dict[str, np.ndarray]
    followers: dict[str, Follower]
    notes: tuple[str, ...]
    beyond: tuple[str, ...]


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of all coordinates that a log may have: hinges and slides, and the three of each
    ball.
    """
    out: list[str] = []
    for k in range(model.njnt):
        name = model.joint(k).name
        if model.jnt_type[k] == BALL:
            out += [f"{name}_{axis}" for axis in TURNS]
        elif model.jnt_type[k] != FREE:
            out.append(name)
    return tuple(out)


def tendon_joints(model: mujoco.MjModel, tendon: int) -> list[int]:
    """Numbers of the joints that a tendon goes over."""
    first = model.tendon_adr[tendon]
    rows = range(first, first + model.tendon_num[tendon])
    return [int(model.wrap_objid[w]) for w in rows if model.wrap_type[w] == WRAPPED]


def _check_names(
    hold: Mapping[str, float | None], names: tuple[str, ...], path, where: str
) -> None:
    for name in hold:
        if name not in names:
            raise BadInput(
                f"{where}: [hold] names {name!r}, which {path} has not; {suggest(name, names)}"
            )


def _asked(hold, name: str, leads, at: np.ndarray) -> np.ndarray:
    """Where a joint is held that was asked to be, or whose leader was."""
    if leads is None or name in hold:
        given = hold.get(name)
        if given is None:
            return at
        return np.array([given])
    given = hold[leads.leader]
    if given is None:
        return at
    return np.array([leads.offset + leads.factor * given])


def roles(
    source: Source,
    hold: Mapping[str, float | None],
    logged: Collection[str] | None,
    where: str = "",
) -> Roles:
    """Of all joints.

    Raises BadInput where `hold` names no joint, or nothing is left that moves.

    Args:
        hold: Joints to hold, with their value (None: as the file has it).
        logged: Names (of `joint_names`) of which there is a log, None: all.
        where: The file that `hold` comes from.
    """
    model = source.model
    names = joint_names(model)
    _check_names(hold, names, source.path, where)
    hold = dict(_fixed(model)) | dict(hold)
    have = [n for n in names if n not in hold and (logged is None or n in logged)]
    pose, pose_name = pose_of(model)
    followers, beyond = _followers(source, have, set(hold))
    looped, loops = _loops(model)
    held: dict[str, np.ndarray] = {}
    dropped: dict[str, list[str]] = {"welded": [], "unlogged": [], "asked": [], "looped": []}
    for k in range(model.njnt):
        name, kind = model.joint(k).name, int(model.jnt_type[k])
        at = pose[model.jnt_qposadr[k] :][: {FREE: 7, BALL: 4}.get(kind, 1)].copy()
        leads = followers.get(name)
        if kind == FREE:
            held[name] = at
            dropped["welded"].append(name)
        elif k in looped:
            held[name] = at
            dropped["looped"].append(name)
        elif name in hold or (leads and leads.leader in hold):
            at = held[name] = _asked(hold, name, leads, at)
            dropped["asked"].append(f"{name} = {at[0]:.4g}")
        elif kind == BALL:
            if not all(f"{name}_{axis}" in have for axis in TURNS):
                held[name] = at
                dropped["unlogged"].append(f"{name} (a ball)")
        elif name not in have and (leads is None or leads.leader not in have):
            held[name] = at
            dropped["unlogged"].append(f"{name} = {at[0]:.4g}")
    for name, f in followers.items():
        if f.leader in held and name not in held:
            held[name] = f.offset + f.factor * held[f.leader]
            dropped["looped"].append(name)
    followers = {n: f for n, f in followers.items() if f.leader not in held and n not in held}
    if len(held) + len(followers) >= model.njnt:
        raise _nothing_moves(source, bool(loops))
    return Roles(
        held,
        followers,
        (*_held_notes(dropped, pose_name), *_fold_notes(followers)),
        (*beyond, *loops),
    )


def _nothing_moves(source: Source, looped: bool) -> BadInput:
    what = "every joint is in a loop that closes" if looped else "every joint is held"
    return BadInput(
        f"{source.path}: {what}, so that nothing of a tree moves; take --simulator mujoco, or log "
        "a joint that does"
    )


def _fixed(model: mujoco.MjModel) -> dict[str, float]:
    """Joints that an equality holds at a constant."""
    alone = [
        e
        for e in range(model.neq)
        if model.eq_type[e] == TIE and model.eq_active0[e] and model.eq_obj2id[e] < 0
    ]
    out = {}
    for e in alone:
        k = int(model.eq_obj1id[e])
        rest = model.qpos0[model.jnt_qposadr[k]]
        out[model.joint(k).name] = float(rest + model.eq_data[e, 0])
    return out


def pose_of(model: mujoco.MjModel) -> tuple[np.ndarray, str]:
    """Where joints are held: the file's `home`, where it has one, else its zero."""
    for k in range(model.nkey):
        if model.key(k).name.lower() == HOME:
            return model.key_qpos[k], f"as in key '{model.key(k).name}'"
    return model.qpos0, "as the file has them"


def _held_notes(dropped: dict[str, list[str]], pose: str) -> tuple[str, ...]:
    out = []
    if dropped["welded"]:
        out.append(
            f"welded to the world, as no pose of it is simulated: {', '.join(dropped['welded'])}"
        )
    if dropped["unlogged"]:
        out.append(
            f"held {pose}, as no log has them: {', '.join(dropped['unlogged'])} (another value: "
            "[hold] in meta.toml)"
        )
    if dropped["asked"]:
        out.append(
            "held where [hold], an equality or a log that never moves has them: "
            f"{', '.join(dropped['asked'])}"
        )
    if dropped["looped"]:
        out.append(f"held {pose}, as a loop closes over them: {', '.join(dropped['looped'])}")
    return tuple(out)


def _fold_notes(followers: Mapping[str, Follower]) -> tuple[str, ...]:
    each = []
    for f in followers.values():
        offset = f"{f.offset:.4g} + " if f.offset else ""
        each.append(f"{f.joint} = {offset}{f.factor:.4g} {f.leader}")
    if each:
        return (f"joints that follow others: {', '.join(each)}",)
    return ()


Near = dict[str, list[tuple[str, float, float]]]
"""Joint -> joints tied to it, each at offset + factor * (its angle): (name, factor, offset)."""


def ties(source: Source) -> dict[str, tuple[str, ...]]:
    """Of each joint that is tied to others (mimics, equalities of two joints), directly or by
    others, these.
    """
    near, _ = _near(source)
    out: dict[str, tuple[str, ...]] = {}
    for start in near:
        reached = [start]
        for name in reached:
            reached += [other for other, *_ in near[name] if other not in reached]
        out[start] = tuple(reached[1:])
    return out


def _near(source: Source) -> tuple[Near, list[str]]:
    model = source.model
    links: list[tuple[str, str, float, float]] = [
        (m.joint, m.leader, m.factor, m.offset) for m in source.mimics
    ]
    beyond: list[str] = []
    for e in range(model.neq):
        if model.eq_type[e] != TIE or not model.eq_active0[e] or model.eq_obj2id[e] < 0:
            continue
        one, two = (int(k) for k in (model.eq_obj1id[e], model.eq_obj2id[e]))
        a = model.eq_data[e]
        names = model.joint(one).name, model.joint(two).name
        if np.any(a[2:5]) or a[1] == 0:
            beyond.append(f"an equality of {names[0]} and {names[1]} that is no straight line")
            continue
        rest = model.qpos0[model.jnt_qposadr[[one, two]]]
        offset = float(rest[0] + a[0] - a[1] * rest[1])
        links.append((*names, float(a[1]), offset))
    near: Near = {}
    for one, two, factor, offset in links:  # a leader comes before its followers
        near.setdefault(two, []).append((one, factor, offset))
    for one, two, factor, offset in links:
        near.setdefault(one, []).append((two, 1.0 / factor, -offset / factor))
    return near, beyond


def _followers(
    source: Source, have: list[str], hold: set[str]
) -> tuple[dict[str, Follower], list[str]]:
    """Chains of joints that follow joints, each resolved to one leader: the first that is held by
    hand, else logged, else driven.
    """
    model = source.model
    near, beyond = _near(source)
    out: dict[str, Follower] = {}
    visited: set[str] = set()
    driven = {
        model.joint(int(model.actuator_trnid[k, 0])).name
        for k in range(model.nu)
        if model.actuator_trntype[k] in JOINTS
    }
    for start in sorted(near, key=lambda n: (n not in hold, n not in have, n not in driven)):
        if start in visited:
            continue
        visited.add(start)
        reached = [(start, 1.0, 0.0)]
        for name, factor, offset in reached:
            for other, f, o in near[name]:
                if other not in visited:
                    visited.add(other)
                    reached.append((other, f * factor, o + f * offset))
                    out[other] = Follower(other, start, f * factor, o + f * offset)
    return out, beyond


def _loops(model: mujoco.MjModel) -> tuple[set[int], list[str]]:
    """Joints in loops that equalities close, and a sentence on each such equality."""
    looped: set[int] = set()
    lines = []
    for e in range(model.neq):
        kind = int(model.eq_type[e])
        if not model.eq_active0[e] or kind not in (CONNECT, WELD):
            if model.eq_active0[e] and kind not in (TIE, int(mujoco.mjtEq.mjEQ_TENDON)):
                lines.append(f"an equality of {mujoco.mjtEq(kind).name[5:].lower()}s")
            continue
        ends = [int(k) for k in (model.eq_obj1id[e], model.eq_obj2id[e])]
        if model.eq_objtype[e] == int(mujoco.mjtObj.mjOBJ_SITE):
            ends = [int(model.site_bodyid[k]) for k in ends]
        ways = [upwards(model, max(b, 0)) for b in ends]
        own = set(ways[0]) ^ set(ways[1])
        for b in own:
            looped |= {
                k
                for k in range(model.njnt)
                if model.jnt_bodyid[k] == b and model.jnt_type[k] != FREE
            }
        what = "connects" if kind == CONNECT else "welds"
        bodies = [model.body(max(b, 0)).name for b in ends]
        lines.append(f"a loop: an equality {what} {bodies[0]} and {bodies[1]}")
    return looped, lines


def upwards(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and those that carry it, up to the world, which is left out."""
    out = []
    while body > 0:
        out.append(body)
        body = int(model.body_parentid[body])
    return out
