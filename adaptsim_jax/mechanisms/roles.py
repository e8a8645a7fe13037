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
CONNECT, WELD, JOINT_EQUALITY = (
    int(getattr(mujoco.mjtEq, f"mjEQ_{name}")) for name in ("CONNECT", "WELD", "JOINT")
)
JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
BALL_AXES = "xyz"  # a ball is three hinges, which turn about these axes one after the other
WRAP_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)
HOME = "home"


@dataclass(frozen=True)
class Roles:
    """What each joint of a model file became.

    - `held`: Values (rad, m) by name of the joint, a free joint's or ball's as `qpos`.
    - `followers`: By name.
    - `notes`: What was done, a sentence each.
    - `unsupported`: Features of the file that a tree lacks, a sentence each.
    """

    held: dict[str, np.ndarray]
    followers: dict[str, Follower]
    notes: tuple[str, ...]
    unsupported: tuple[str, ...]


def joint_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of all coordinates that a log may have: hinges and slides, and the three of each
    ball.
    """
    out: list[str] = []
    for k in range(model.njnt):
        name = model.joint(k).name
        if model.jnt_type[k] == BALL:
            out += [f"{name}_{axis}" for axis in BALL_AXES]
        elif model.jnt_type[k] != FREE:
            out.append(name)
    return tuple(out)


def tendon_joints(model: mujoco.MjModel, tendon: int) -> list[int]:
    """Numbers of the joints that a tendon goes over."""
    first = model.tendon_adr[tendon]
    rows = range(first, first + model.tendon_num[tendon])
    return [int(model.wrap_objid[w]) for w in rows if model.wrap_type[w] == WRAP_JOINT]


def _check_names(
    hold: Mapping[str, float | None], names: tuple[str, ...], path, where: str
) -> None:
    for name in hold:
        if name not in names:
            raise BadInput(
                f"{where}: [hold] names {name!r}, which {path} has not; {suggest(name, names)}"
            )


def _held_value(hold, name: str, follower, pose: np.ndarray) -> np.ndarray:
    """Return the value [1] (rad or m) at which a joint is held that `hold` names, or whose leader
    it names; `pose` where `hold` has no number.
    """
    if follower is None or name in hold:
        value = hold.get(name)
        if value is None:
            return pose
        return np.array([value])
    value = hold[follower.leader]
    if value is None:
        return pose
    return np.array([follower.offset + follower.factor * value])


def assign_roles(
    source: Source,
    hold: Mapping[str, float | None],
    logged: Collection[str] | None,
    where: str = "",
) -> Roles:
    """Decide for each joint of a file whether it is a coordinate, held or a follower.

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
    logged_joints = [n for n in names if n not in hold and (logged is None or n in logged)]
    pose, pose_name = pose_of(model)
    followers, unsupported = _followers(source, logged_joints, set(hold))
    looped, loops = _loops(model)
    held: dict[str, np.ndarray] = {}
    held_by_reason: dict[str, list[str]] = {"welded": [], "unlogged": [], "asked": [], "looped": []}
    for k in range(model.njnt):
        name, kind = model.joint(k).name, int(model.jnt_type[k])
        pose_at = pose[model.jnt_qposadr[k] :][: {FREE: 7, BALL: 4}.get(kind, 1)].copy()
        follower = followers.get(name)
        if kind == FREE:
            held[name] = pose_at
            held_by_reason["welded"].append(name)
        elif k in looped:
            held[name] = pose_at
            held_by_reason["looped"].append(name)
        elif name in hold or (follower and follower.leader in hold):
            pose_at = held[name] = _held_value(hold, name, follower, pose_at)
            held_by_reason["asked"].append(f"{name} = {pose_at[0]:.4g}")
        elif kind == BALL:
            if not all(f"{name}_{axis}" in logged_joints for axis in BALL_AXES):
                held[name] = pose_at
                held_by_reason["unlogged"].append(f"{name} (a ball)")
        elif name not in logged_joints and (
            follower is None or follower.leader not in logged_joints
        ):
            held[name] = pose_at
            held_by_reason["unlogged"].append(f"{name} = {pose_at[0]:.4g}")
    for name, f in followers.items():
        if f.leader in held and name not in held:
            held[name] = f.offset + f.factor * held[f.leader]
            held_by_reason["looped"].append(name)
    followers = {n: f for n, f in followers.items() if f.leader not in held and n not in held}
    if len(held) + len(followers) >= model.njnt:
        raise _nothing_moves(source, bool(loops))
    return Roles(
        held,
        followers,
        (*_held_notes(held_by_reason, pose_name), *_follower_notes(followers)),
        (*unsupported, *loops),
    )


def _nothing_moves(source: Source, looped: bool) -> BadInput:
    what = "every joint is in a loop that closes" if looped else "every joint is held"
    return BadInput(
        f"{source.path}: {what}, so that nothing of a tree moves; take --simulator mujoco, or log "
        "a joint that does"
    )


def _fixed(model: mujoco.MjModel) -> dict[str, float]:
    """Return the joints that an equality holds at a constant, with it (rad or m)."""
    equalities = [
        e
        for e in range(model.neq)
        if model.eq_type[e] == JOINT_EQUALITY and model.eq_active0[e] and model.eq_obj2id[e] < 0
    ]
    fixed = {}
    for e in equalities:
        k = int(model.eq_obj1id[e])
        zero_pose = model.qpos0[model.jnt_qposadr[k]]
        fixed[model.joint(k).name] = float(zero_pose + model.eq_data[e, 0])
    return fixed


def pose_of(model: mujoco.MjModel) -> tuple[np.ndarray, str]:
    """Return the pose at which joints are held, and its name: the file's `home`, where it has one,
    else its zero.
    """
    for k in range(model.nkey):
        if model.key(k).name.lower() == HOME:
            return model.key_qpos[k], f"as in key '{model.key(k).name}'"
    return model.qpos0, "as the file has them"


def _held_notes(held_by_reason: dict[str, list[str]], pose: str) -> tuple[str, ...]:
    out = []
    if held_by_reason["welded"]:
        out.append(
            "welded to the world, as no pose of it is simulated: "
            f"{', '.join(held_by_reason['welded'])}"
        )
    if held_by_reason["unlogged"]:
        out.append(
            f"held {pose}, as no log has them: {', '.join(held_by_reason['unlogged'])} "
            "(another value: [hold] in meta.toml)"
        )
    if held_by_reason["asked"]:
        out.append(
            "held where [hold], an equality or a log that never moves has them: "
            f"{', '.join(held_by_reason['asked'])}"
        )
    if held_by_reason["looped"]:
        out.append(
            f"held {pose}, as a loop closes over them: {', '.join(held_by_reason['looped'])}"
        )
    return tuple(out)


def _follower_notes(followers: Mapping[str, Follower]) -> tuple[str, ...]:
    couplings = []
    for f in followers.values():
        offset = f"{f.offset:.4g} + " if f.offset else ""
        couplings.append(f"{f.joint} = {offset}{f.factor:.4g} {f.leader}")
    if couplings:
        return (f"joints that follow others: {', '.join(couplings)}",)
    return ()


Couplings = dict[str, list[tuple[str, float, float]]]
"""Joint -> joints coupled to it, each at offset + factor * (its angle): (name, factor, offset)."""


def coupled_joints(source: Source) -> dict[str, tuple[str, ...]]:
    """Return for each joint that is coupled to others (mimics, equalities of two joints), directly
    or by others, the names of these.
    """
    couplings, _ = _couplings(source)
    out: dict[str, tuple[str, ...]] = {}
    for start in couplings:
        reached = [start]
        for name in reached:
            reached += [other for other, *_ in couplings[name] if other not in reached]
        out[start] = tuple(reached[1:])
    return out


def _couplings(source: Source) -> tuple[Couplings, list[str]]:
    model = source.model
    links: list[tuple[str, str, float, float]] = [
        (m.joint, m.leader, m.factor, m.offset) for m in source.mimics
    ]
    unsupported: list[str] = []
    for e in range(model.neq):
        if model.eq_type[e] != JOINT_EQUALITY or not model.eq_active0[e] or model.eq_obj2id[e] < 0:
            continue
        first, second = (int(k) for k in (model.eq_obj1id[e], model.eq_obj2id[e]))
        coefficients = model.eq_data[e]
        names = model.joint(first).name, model.joint(second).name
        if np.any(coefficients[2:5]) or coefficients[1] == 0:
            unsupported.append(f"an equality of {names[0]} and {names[1]} that is no straight line")
            continue
        zero_pose = model.qpos0[model.jnt_qposadr[[first, second]]]
        offset = float(zero_pose[0] + coefficients[0] - coefficients[1] * zero_pose[1])
        links.append((*names, float(coefficients[1]), offset))
    couplings: Couplings = {}
    for first, second, factor, offset in links:  # a leader comes before its followers
        couplings.setdefault(second, []).append((first, factor, offset))
    for first, second, factor, offset in links:
        couplings.setdefault(first, []).append((second, 1.0 / factor, -offset / factor))
    return couplings, unsupported


def _followers(
    source: Source, logged_joints: list[str], hold: set[str]
) -> tuple[dict[str, Follower], list[str]]:
    """Resolve chains of joints that follow joints to one leader each: the first that is held by
    hand, else logged, else driven.
    """
    model = source.model
    couplings, unsupported = _couplings(source)
    out: dict[str, Follower] = {}
    visited: set[str] = set()
    driven = {
        model.joint(int(model.actuator_trnid[k, 0])).name
        for k in range(model.nu)
        if model.actuator_trntype[k] in JOINT_TRANSMISSIONS
    }
    for start in sorted(
        couplings, key=lambda n: (n not in hold, n not in logged_joints, n not in driven)
    ):
        if start in visited:
            continue
        visited.add(start)
        reached = [(start, 1.0, 0.0)]
        for name, factor, offset in reached:
            for other, f, o in couplings[name]:
                if other not in visited:
                    visited.add(other)
                    reached.append((other, f * factor, o + f * offset))
                    out[other] = Follower(other, start, f * factor, o + f * offset)
    return out, unsupported


def _loops(model: mujoco.MjModel) -> tuple[set[int], list[str]]:
    """Joints in loops that equalities close, and a sentence on each such equality."""
    looped: set[int] = set()
    lines = []
    for e in range(model.neq):
        kind = int(model.eq_type[e])
        if not model.eq_active0[e] or kind not in (CONNECT, WELD):
            if model.eq_active0[e] and kind not in (JOINT_EQUALITY, int(mujoco.mjtEq.mjEQ_TENDON)):
                lines.append(f"an equality of {mujoco.mjtEq(kind).name[5:].lower()}s")
            continue
        ends = [int(k) for k in (model.eq_obj1id[e], model.eq_obj2id[e])]
        if model.eq_objtype[e] == int(mujoco.mjtObj.mjOBJ_SITE):
            ends = [int(model.site_bodyid[k]) for k in ends]
        chains = [upwards(model, max(b, 0)) for b in ends]
        between = set(chains[0]) ^ set(chains[1])
        for b in between:
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
    """Return the numbers of a body and of those that carry it, without the world."""
    out = []
    while body > 0:
        out.append(body)
        body = int(model.body_parentid[body])
    return out
