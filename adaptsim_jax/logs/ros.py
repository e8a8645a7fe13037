"""ROS 1 and ROS 2 bags and MCAP files: joint states, and commands where a topic has them, as one
raw trial a bag.

Read by the libraries `rosbags` and `mcap` (extra `ros`). `messages.py` lists the types of messages:
for the state JointState (ROS or foxglove), DynamicJointState, or a trajectory controller's own
state, for commands these, JointTrajectory, Float64MultiArray and Float64 (in the order of the
model's actuators).
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.angles import followed_turns, without_turns
from adaptsim_jax.logs.bag import ENDINGS, Bag, Topic, bags, is_bag, opened
from adaptsim_jax.logs.clock import Series, Stamped, merge, stamped
from adaptsim_jax.logs.columns import role
from adaptsim_jax.logs.criteria import CLOCK, TABLE
from adaptsim_jax.logs.messages import (
    ARRAYS,
    COMMANDED,
    STATES,
    TRAJECTORIES,
    Asked,
    choose,
    in_model,
    joints_of,
    nanoseconds,
    stamp_of,
)
from adaptsim_jax.logs.quality.commands import unexplained
from adaptsim_jax.logs.quality.hypotheses import Track
from adaptsim_jax.logs.readers import Reader, Wanted
from adaptsim_jax.logs.senders import Message, one_commander, one_sender
from adaptsim_jax.logs.tables import RawTrial
from adaptsim_jax.logs.trajectories import followed, plan_of, sampled

__all__ = ["ENDINGS", "Topic", "bag_topics", "bags", "is_bag", "read_bag"]

POINTS = ("ramp", "hold")
"""How the points of a trajectory command: moved to (as controllers do), or each held until the
next.
"""


@dataclass(frozen=True)
class Clock:
    """Of the state's messages: whether they are `stamped`, the `first` time and how `late` they
    arrive (median), in ns.
    """

    stamped: bool
    first: int
    late: int


def read_bag(path: Path, wanted: Wanted) -> RawTrial:
    """One bag as a raw trial with columns `q_NAME`, `v_NAME`, `tau_NAME`, `target_NAME`, ... on one
    clock.

    Options: `state_topic`, `command_topic`, `trajectory` where chosen. Raises `BadInput`: no such
    topic, a damaged bag, a library missing.
    """
    with opened(path) as bag:
        states, commanded, notes = choose(
            path, bag.topics, wanted.options, lambda t: _known(bag, t, wanted.joints)
        )
        series, clock, reported = _states(path, bag, states, wanted.joints)
        notes += reported
        series, left = _of_the_model(series, wanted)
        notes += left
        commands: list[Series] = []
        for topic in commanded:
            made, reported = _commands(path, bag, topic, clock, series, wanted)
            commands += made
            notes += reported
        commands, _ = _of_the_model(commands, wanted)
        commands = [_turned(s, series, wanted.servos) for s in commands]
    columns, reported = merge(str(path), series, commands)
    notes += reported
    columns, reported = _without_zeros(columns)
    notes += reported
    rows = np.arange(1, len(columns["time"]) + 1)
    return RawTrial(
        path.stem if path.is_file() else path.name, str(path), columns, rows, "message", notes=notes
    )


def bag_topics(
    path: Path, options: Asked, joints: Collection[str] = ()
) -> tuple[tuple[Topic, ...], dict[str, str | Sequence[str]]]:
    """All topics of a bag, and those that `read_bag` takes with these options, by `state_topic` and
    `command_topic`: a name, or a list of them.

    Args:
        joints: The model's.
    """
    with opened(path) as bag:
        topics = bag.topics
        states, commands, _ = choose(path, topics, options, lambda t: _known(bag, t, joints))
    chosen = {"state_topic": states, "command_topic": commands}
    names = {key: [topic.name for topic in taken] for key, taken in chosen.items() if taken}
    return topics, {key: own[0] if len(own) == 1 else own for key, own in names.items()}


# ---------------------------------------------------------------- messages


def _known(bag: Bag, topic: Topic, joints: Collection[str]) -> set[str]:
    """The joints of the model that the first messages of a topic name."""
    if not joints:
        return set()
    first = itertools.islice(bag.messages(topic.name), CLOCK.first)
    named = (in_model(topic.name, joints_of(topic, message), joints) for _, message in first)
    return set(joints).intersection(set().union(*named))


def _messages(bag: Bag, topic: Topic) -> tuple[np.ndarray, np.ndarray, list[Any]]:
    """Times of arrival `[K]` and the messages' own stamps `[K]` (0 for none) in ns, and the
    messages.
    """
    arrived, stamps, out = [], [], []
    for when, message in bag.messages(topic.name):
        arrived.append(when)
        stamps.append(stamp_of(message))
        out.append(message)
    return np.array(arrived, dtype=np.int64), np.array(stamps, dtype=np.int64), out


def _states(
    path: Path, bag: Bag, topics: Sequence[Topic], joints: Collection[str]
) -> tuple[list[Series], Clock, tuple[str, ...]]:
    """What topics of states say, on the clock of the first of them."""
    whose: dict[str, str] = {}
    found = [_state(bag, topic, joints) for topic in topics]
    for topic, (rows, *_) in zip(topics, found, strict=True):
        if not rows:
            raise BadInput(
                f"{path}: topic {topic.name} has no message with positions; name another by "
                "state_topic"
            )
        for joint in {name for _, names, _ in rows for name in names}:
            if whose.setdefault(joint, topic.name) != topic.name:
                raise BadInput(
                    f"{path}: topics {whose[joint]} and {topic.name} both speak of {joint!r}; name "
                    "one of them by state_topic"
                )
    times = found[0][1]
    first = min(row[0] for rows, *_ in found for row in rows)
    series = [
        one
        for rows, *_ in found
        for one in _series([((time - first) * 1e-9, names, values) for time, names, values in rows])
    ]
    late = times.late if times.stamped else 0
    notes = tuple(note for *_, own in found for note in own)
    return series, Clock(times.stamped, first, late), notes


def _state(
    bag: Bag, topic: Topic, joints: Collection[str]
) -> tuple[list[Message], Stamped, tuple[str, ...]]:
    """The messages of a topic that are taken, their times, and what was made of them."""
    arrived, stamps, messages = _messages(bag, topic)
    read = STATES[topic.kind]
    stated = [
        (in_model(topic.name, names, joints) if any(names) else (), values)
        for names, values in map(read, messages)
    ]
    notes: list[str] = []
    if twice := next((n for names, _ in stated for n in names if names.count(n) > 1), None):
        raise BadInput(
            f"{topic.name}: its messages name {twice!r} more than once; record names that differ"
        )
    sizes = [len(values.get("q", ())) for _, values in stated]
    nameless = sum(not names and n > 0 for (names, _), n in zip(stated, sizes, strict=True))
    if nameless:
        notes.append(
            f"topic {topic.name}: names are empty in {nameless} messages, taken in the order of "
            "the model's joints"
        )

        def numbers(values):
            return tuple(str(i) for i in range(1, len(values.get("q", ())) + 1))

        stated = [(names or numbers(values), values) for names, values in stated]
    counts = [len(names) for names, _ in stated]
    whole = np.array([n == count > 0 for n, count in zip(sizes, counts, strict=True)], bool)
    some = sum(n > 0 for n, here in zip(sizes, whole, strict=True) if not here)
    if some and whole.any():
        notes.append(
            f"topic {topic.name}: {some} messages with another number of positions than of names "
            "left out"
        )
    elif some:
        one = next((names, values) for names, values in stated if len(values.get("q", ())))
        raise BadInput(
            f"{topic.name}: its messages name {len(one[0])} joints and hold {len(one[1]['q'])} "
            "positions; record it so that they agree"
        )
    sender = {
        key: k for k, key in enumerate(dict.fromkeys(tuple(sorted(names)) for names, _ in stated))
    }
    group = np.array([sender[tuple(sorted(names))] for names, _ in stated])
    if len(arrived):
        times = stamped(arrived, stamps, group)
    else:
        times = Stamped(arrived, arrived > 0, False, 0)
    notes += times.notes(topic.name)
    keep = times.selected & whole
    rows = [
        (time, *one)
        for time, one, here in zip(times.time.tolist(), stated, keep, strict=True)
        if here
    ]
    rows, reported = one_sender(topic.name, rows)
    return rows, times, (*notes, *reported)


def _commands(
    path: Path, bag: Bag, topic: Topic, clock: Clock, states: list[Series], wanted: Wanted
) -> tuple[list[Series], tuple[str, ...]]:
    """What a topic commands, and what was made of it."""
    arrived, stamps, messages = _messages(bag, topic)
    notes: list[str] = []
    came = arrived - clock.late
    own = (stamps > 0) & clock.stamped
    if topic.kind not in TRAJECTORIES:
        # a stamp of another clock, or of another computer's, says nothing beside those of the
        # states
        own &= np.abs(stamps - came) < CLOCK.max_offset
    if np.mean(own) <= 0.5:
        own[:] = False

    def since(ns):
        return (ns - clock.first) * 1e-9

    if topic.kind in ARRAYS:
        if clock.stamped and clock.late:
            notes.append(
                f"topic {topic.name} has no stamps: its arrival is taken, less the delay of the "
                "state's messages"
            )
        notes.append(
            f"topic {topic.name} names no joints: taken in the order of the model's actuators"
        )
    if topic.kind in TRAJECTORIES:
        plans = []
        for m, a, s in zip(messages, came.tolist(), stamps.tolist(), strict=True):
            if hasattr(m, "goal"):
                begins = nanoseconds(m.goal.trajectory.header.stamp)
            else:
                begins = s
            plan = plan_of(m, since(begins) if begins > 0 and clock.stamped else None, since(a))
            plans.append(replace(plan, joints=in_model(topic.name, plan.joints, wanted.joints)))
        return _trajectory(path, topic, plans, states, wanted, notes)
    read = COMMANDED[topic.kind]
    times = np.where(own, stamps, came)
    rows = []
    for time, m in zip(times.tolist(), messages, strict=True):
        names, values = read(m)
        names = in_model(topic.name, names, wanted.joints)
        most = max((len(x) for x in values.values()), default=0)
        rows.append((since(time), names or tuple(str(i) for i in range(1, most + 1)), values))
    rows, reported = one_commander(topic.name, rows)
    return _series(rows), (*notes, *reported)


def _trajectory(
    path: Path, topic: Topic, plans: list, states: list[Series], wanted: Wanted, notes: list[str]
) -> tuple[list[Series], tuple[str, ...]]:
    """Points of trajectories as commands: as `[ros] trajectory` says, else in the way that the
    angles follow far better, else as controllers take them.
    """

    def angle(joint: str, at: float) -> float:
        own = next((s for s in states if f"q_{joint}" in s.columns), None)
        if own:
            return float(np.interp(at, own.time, own.columns[f"q_{joint}"]))
        return 0.0

    asked = wanted.options.get("trajectory")
    reported = asked if isinstance(asked, str) else None
    if reported is None and not any(t > plan.takes_over for plan in plans for t, *_ in plan.points):
        return followed(plans, angle, True), tuple(
            notes
        )  # points that give no time to move are commands as they come
    made = {how: followed(plans, angle, how == "hold") for how in POINTS if reported in (None, how)}
    if (
        "ramp" in made
        # a controller that steps with the states holds what it has from row to row; a faster one
        # does
        # not wait
    ):
        main = max(states, key=lambda s: len(s.time)).time
        each = [sampled(series, main) for series in made["ramp"]]
        made["ramp"] = min(
            (each, made["ramp"]), key=lambda commands: _left(str(path), states, commands)
        )
    how = reported or "ramp"
    why = "as controllers take it"
    if reported is None:
        left = {h: _left(str(path), states, made[h]) for h in POINTS}
        best, other = sorted(POINTS, key=lambda h: left[h])
        if left[best] < CLOCK.better * left[other]:
            how, why = best, "which the angles follow far better"
    statement = {
        "ramp": "points are moved to from one to the next",
        "hold": "each point is held to the next",
    }[how]
    if reported is None:
        mend = f'; write trajectory = "{"hold" if how == "ramp" else "ramp"}" under [ros] if not'
    else:
        mend = ""
    notes.append(
        f"topic {topic.name}: {statement}{'' if reported else f', {why}'}, a new trajectory takes "
        f"the place of what is ahead{mend}"
    )
    return made[how], tuple(notes)


def _left(path: str, states: list[Series], commands: list[Series]) -> float:
    """What commands leave of the joints' accelerations, in the middle; infinite where that cannot
    be told.
    """
    try:
        columns, _ = merge(path, states, commands)
    except BadInput:
        return float("inf")
    left = []
    for name in columns:
        q = columns.get("q" + name.removeprefix("target"))
        if name.startswith("target_") and q is not None:
            left.append(
                unexplained([Track(columns["time"], q[:, None], None, columns[name][:, None])])
            )
    left = [x for x in left if np.isfinite(x)]
    if left:
        return float(np.median(left))
    return float("inf")


def _turned(command: Series, states: list[Series], servos: Mapping[str, str]) -> Series:
    """Targets, and what `servos` says are, with the whole turns of their angles, before they are
    brought onto the clock of these: a mean over a row of a target that counts anew within it would
    be no target.
    """
    out = dict(command.columns)
    for name, values in command.columns.items():
        joint = servos.get(name) or name.removeprefix("target_")
        own = next((s for s in states if f"q_{joint}" in s.columns), None)
        stated = values[np.isfinite(values)]
        if (
            not (name in servos or name.startswith("target_"))
            or own is None
            or len(stated) < 4
            or np.ptp(stated) < np.pi
        ):
            continue
        here = np.isfinite(own.columns[f"q_{joint}"])
        time, first = np.unique(own.time[here], return_index=True)
        if len(time) > 3:
            q = without_turns(time, own.columns[f"q_{joint}"][here][first]).q
            out[name] = followed_turns(np.interp(command.time, time, q), values)
    return replace(command, columns=out)


def _of_the_model(series: list[Series], wanted: Wanted) -> tuple[list[Series], tuple[str, ...]]:
    """Without what `ignore` names, and without whole joints that the model lacks where all that it
    has are there: what speaks of others decides nothing of the clock.
    """
    joints = wanted.joints
    has = {
        column.joint
        for s in series
        for name in s.columns
        if (column := role(name, joints)) and column.stem == "q"
    }
    strange: set[str] = set()
    if joints and set(joints) <= has:
        strange = {joint for joint in has if isinstance(joint, str) and joint not in joints}

    def keeps(name: str) -> bool:
        if name in wanted.named:
            return True
        found = role(name, joints)
        joint = found.joint if found else None
        return name not in wanted.ignore and (
            not isinstance(joint, str) or joint not in {*wanted.ignore, *strange}
        )

    selected = [s.of({name for name in s.columns if keeps(name)}) for s in series]
    out = sorted(strange - set(wanted.ignore))
    if out:
        notes = (f"joints that the model lacks are left out: {', '.join(out)}",)
    else:
        notes = ()
    return [s for s in selected if s.columns], notes


def _without_zeros(columns: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Without efforts, and without speeds, that are zero throughout, as drivers write them that
    have none.
    """
    notes: tuple[str, ...] = ()
    angles = [x for n, x in columns.items() if n.startswith("q_") and np.isfinite(x).any()]
    moves = any(np.nanmax(x) - np.nanmin(x) > TABLE.moving for x in angles)
    for stem, reported in (
        ("tau_", "efforts are zero throughout: not taken for torques"),
        ("v_", "velocities are zero throughout though joints move: left out"),
    ):
        own = [
            name for name in columns if name.startswith(stem) and not name.endswith("_commanded")
        ]
        if own and not any(np.any(columns[name]) for name in own) and (stem == "tau_" or moves):
            columns = {name: values for name, values in columns.items() if name not in own}
            notes = (*notes, reported)
    return columns, notes


def _series(rows: list[Message]) -> list[Series]:
    """Rows that name the same joints, in whatever order, together; what a message lacks is NaN."""
    groups: dict[tuple[str, ...], list[Message]] = {}
    for row in rows:
        groups.setdefault(tuple(sorted(row[1])), []).append(row)
    out = []
    for group in groups.values():
        names = group[0][1]
        values: dict[str, np.ndarray] = {}
        for stem in (
            group[0][2]
            if len({tuple(r[2]) for r in group}) == 1
            else {s for r in group for s in r[2]}
        ):
            table = np.full((len(group), len(names)), np.nan)
            for i, (_, order, given) in enumerate(group):
                if len(row := given.get(stem, ())) == len(names):
                    if order == names:
                        table[i] = row
                    else:
                        table[i] = [row[order.index(name)] for name in names]
            # efforts of one joint alone that are NaN throughout are no column that is not there:
            # said where torques are chosen
            filled = np.any(np.isfinite(table), axis=0)
            some = bool(np.any(filled))
            values |= {
                _column(stem, name): table[:, j]
                for j, name in enumerate(names)
                if filled[j] or (some and stem == "tau")
            }
        reordered = any(order != names for _, order, _ in group)
        out.append(Series(np.array([time for time, _, _ in group]), values, reordered))
    return out


def _column(stem: str, name: str) -> str:
    if stem == "tau_commanded":
        return f"tau_{name}_commanded"
    if stem == "ctrl":
        return f"ctrl{name}"
    return f"{stem}_{name}"


READER = Reader(lambda path, wanted: [read_bag(path, wanted)], ENDINGS, bags)
