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
from adaptsim_jax.logs.angles import follow_turns, without_turns
from adaptsim_jax.logs.bag import ENDINGS, Bag, Topic, bags, is_bag, opened
from adaptsim_jax.logs.clock import MessageTimes, Series, merge, message_times
from adaptsim_jax.logs.columns import role
from adaptsim_jax.logs.criteria import CLOCK, TABLE
from adaptsim_jax.logs.messages import (
    ARRAYS,
    COMMANDED,
    STATES,
    TRAJECTORIES,
    RosOptions,
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
from adaptsim_jax.logs.trajectories import followed_commands, plan_of, sample_and_hold

__all__ = ["ENDINGS", "Topic", "bag_topics", "bags", "is_bag", "read_bag"]

POINTS = ("ramp", "hold")
"""How the points of a trajectory command: moved to (as controllers do), or each held until the
next.
"""


@dataclass(frozen=True)
class Clock:
    """Of the state's messages: whether they `has_stamps`, the `first` time and the `delay` of their
    arrival (median), in ns.
    """

    has_stamps: bool
    first: int
    delay: int


def read_bag(path: Path, wanted: Wanted) -> RawTrial:
    """One bag as a raw trial with columns `q_NAME`, `v_NAME`, `tau_NAME`, `target_NAME`, ... on one
    clock.

    Options: `state_topic`, `command_topic`, `trajectory` where chosen. Raises `BadInput`: no such
    topic, a damaged bag, a library missing.
    """
    with opened(path) as bag:
        state_topics, command_topics, notes = choose(
            path, bag.topics, wanted.options, lambda t: _model_joints_named(bag, t, wanted.joints)
        )
        series, clock, more_notes = _states(path, bag, state_topics, wanted.joints)
        notes += more_notes
        series, more_notes = _with_model_joints(series, wanted)
        notes += more_notes
        commands: list[Series] = []
        for topic in command_topics:
            topic_commands, more_notes = _commands(path, bag, topic, clock, series, wanted)
            commands += topic_commands
            notes += more_notes
        commands, _ = _with_model_joints(commands, wanted)
        commands = [_with_whole_turns(s, series, wanted.servos) for s in commands]
    columns, more_notes = merge(str(path), series, commands)
    notes += more_notes
    columns, more_notes = _without_zeros(columns)
    notes += more_notes
    rows = np.arange(1, len(columns["time"]) + 1)
    return RawTrial(
        path.stem if path.is_file() else path.name, str(path), columns, rows, "message", notes=notes
    )


def bag_topics(
    path: Path, options: RosOptions, joints: Collection[str] = ()
) -> tuple[tuple[Topic, ...], dict[str, str | Sequence[str]]]:
    """All topics of a bag, and those that `read_bag` takes with these options, by `state_topic` and
    `command_topic`: a name, or a list of them.

    Args:
        joints: The model's.
    """
    with opened(path) as bag:
        topics = bag.topics
        states, commands, _ = choose(
            path, topics, options, lambda t: _model_joints_named(bag, t, joints)
        )
    chosen = {"state_topic": states, "command_topic": commands}
    names = {key: [topic.name for topic in of_key] for key, of_key in chosen.items() if of_key}
    return topics, {
        key: topic_names[0] if len(topic_names) == 1 else topic_names
        for key, topic_names in names.items()
    }


# ---------------------------------------------------------------- messages


def _model_joints_named(bag: Bag, topic: Topic, joints: Collection[str]) -> set[str]:
    """The joints of the model that the first messages of a topic name."""
    if not joints:
        return set()
    first = itertools.islice(bag.messages(topic.name), CLOCK.n_first_messages)
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
    topic_of: dict[str, str] = {}
    states = [_state(bag, topic, joints) for topic in topics]
    for topic, (rows, *_) in zip(topics, states, strict=True):
        if not rows:
            raise BadInput(
                f"{path}: topic {topic.name} has no message with positions; name another by "
                "state_topic"
            )
        for joint in {name for _, names, _ in rows for name in names}:
            if topic_of.setdefault(joint, topic.name) != topic.name:
                raise BadInput(
                    f"{path}: topics {topic_of[joint]} and {topic.name} both speak of {joint!r}; "
                    "name one of them by state_topic"
                )
    times = states[0][1]
    first = min(row[0] for rows, *_ in states for row in rows)
    series = [
        group_series
        for rows, *_ in states
        for group_series in _series(
            [((time - first) * 1e-9, names, values) for time, names, values in rows]
        )
    ]
    delay = times.delay if times.has_stamps else 0
    notes = tuple(note for *_, topic_notes in states for note in topic_notes)
    return series, Clock(times.has_stamps, first, delay), notes


def _state(
    bag: Bag, topic: Topic, joints: Collection[str]
) -> tuple[list[Message], MessageTimes, tuple[str, ...]]:
    """The messages of a topic that are taken, their times, and what was made of them."""
    arrived, stamps, messages = _messages(bag, topic)
    read = STATES[topic.kind]
    readings = [
        (in_model(topic.name, names, joints) if any(names) else (), values)
        for names, values in map(read, messages)
    ]
    notes: list[str] = []
    if duplicate := next((n for names, _ in readings for n in names if names.count(n) > 1), None):
        raise BadInput(
            f"{topic.name}: its messages name {duplicate!r} more than once; record names that "
            "differ"
        )
    sizes = [len(values.get("q", ())) for _, values in readings]
    nameless = sum(not names and n > 0 for (names, _), n in zip(readings, sizes, strict=True))
    if nameless:
        notes.append(
            f"topic {topic.name}: names are empty in {nameless} messages, taken in the order of "
            "the model's joints"
        )

        def numbers(values):
            return tuple(str(i) for i in range(1, len(values.get("q", ())) + 1))

        readings = [(names or numbers(values), values) for names, values in readings]
    counts = [len(names) for names, _ in readings]
    is_complete = np.array([n == count > 0 for n, count in zip(sizes, counts, strict=True)], bool)
    n_incomplete = sum(n > 0 for n, is_used in zip(sizes, is_complete, strict=True) if not is_used)
    if n_incomplete and is_complete.any():
        notes.append(
            f"topic {topic.name}: {n_incomplete} messages with another number of positions than of "
            "names left out"
        )
    elif n_incomplete:
        one = next((names, values) for names, values in readings if len(values.get("q", ())))
        raise BadInput(
            f"{topic.name}: its messages name {len(one[0])} joints and hold {len(one[1]['q'])} "
            "positions; record it so that they agree"
        )
    sender = {
        key: k for k, key in enumerate(dict.fromkeys(tuple(sorted(names)) for names, _ in readings))
    }
    group = np.array([sender[tuple(sorted(names))] for names, _ in readings])
    if len(arrived):
        times = message_times(arrived, stamps, group)
    else:
        times = MessageTimes(arrived, arrived > 0, False, 0)
    notes += times.notes(topic.name)
    is_used = times.has_time & is_complete
    rows = [
        (time, *one)
        for time, one, is_used in zip(times.time.tolist(), readings, is_used, strict=True)
        if is_used
    ]
    rows, sender_notes = one_sender(topic.name, rows)
    return rows, times, (*notes, *sender_notes)


def _commands(
    path: Path, bag: Bag, topic: Topic, clock: Clock, states: list[Series], wanted: Wanted
) -> tuple[list[Series], tuple[str, ...]]:
    """What a topic commands, and what was made of it."""
    arrived, stamps, messages = _messages(bag, topic)
    notes: list[str] = []
    arrival = arrived - clock.delay
    uses_stamp = (stamps > 0) & clock.has_stamps
    if topic.kind not in TRAJECTORIES:
        # a stamp of another clock, or of another computer's, says nothing beside those of the
        # states
        uses_stamp &= np.abs(stamps - arrival) < CLOCK.max_offset
    if np.mean(uses_stamp) <= 0.5:
        uses_stamp[:] = False

    def seconds_since(ns):
        return (ns - clock.first) * 1e-9

    if topic.kind in ARRAYS:
        if clock.has_stamps and clock.delay:
            notes.append(
                f"topic {topic.name} has no stamps: its arrival is taken, less the delay of the "
                "state's messages"
            )
        notes.append(
            f"topic {topic.name} names no joints: taken in the order of the model's actuators"
        )
    if topic.kind in TRAJECTORIES:
        plans = []
        for m, a, s in zip(messages, arrival.tolist(), stamps.tolist(), strict=True):
            if hasattr(m, "goal"):
                start = nanoseconds(m.goal.trajectory.header.stamp)
            else:
                start = s
            plan = plan_of(
                m,
                seconds_since(start) if start > 0 and clock.has_stamps else None,
                seconds_since(a),
            )
            plans.append(replace(plan, joints=in_model(topic.name, plan.joints, wanted.joints)))
        return _trajectory(path, topic, plans, states, wanted, notes)
    read = COMMANDED[topic.kind]
    times = np.where(uses_stamp, stamps, arrival)
    rows = []
    for time, m in zip(times.tolist(), messages, strict=True):
        names, values = read(m)
        names = in_model(topic.name, names, wanted.joints)
        n_values = max((len(x) for x in values.values()), default=0)
        rows.append(
            (seconds_since(time), names or tuple(str(i) for i in range(1, n_values + 1)), values)
        )
    rows, sender_notes = one_commander(topic.name, rows)
    return _series(rows), (*notes, *sender_notes)


def _trajectory(
    path: Path, topic: Topic, plans: list, states: list[Series], wanted: Wanted, notes: list[str]
) -> tuple[list[Series], tuple[str, ...]]:
    """Points of trajectories as commands: as `[ros] trajectory` says, else in the way that the
    angles follow far better, else as controllers take them.
    """

    def angle(joint: str, at: float) -> float:
        state = next((s for s in states if f"q_{joint}" in s.columns), None)
        if state:
            return float(np.interp(at, state.time, state.columns[f"q_{joint}"]))
        return 0.0

    option = wanted.options.get("trajectory")
    interpolation = option if isinstance(option, str) else None
    if interpolation is None and not any(
        t > plan.takes_over for plan in plans for t, *_ in plan.points
    ):
        return followed_commands(plans, angle, True), tuple(
            notes
        )  # points that give no time to move are commands as they come
    commands_by_kind = {
        kind: followed_commands(plans, angle, kind == "hold")
        for kind in POINTS
        if interpolation in (None, kind)
    }
    if (
        "ramp" in commands_by_kind
        # a controller that steps with the states holds what it has from row to row; a faster one
        # does
        # not wait
    ):
        main = max(states, key=lambda s: len(s.time)).time
        sampled_commands = [sample_and_hold(series, main) for series in commands_by_kind["ramp"]]
        commands_by_kind["ramp"] = min(
            (sampled_commands, commands_by_kind["ramp"]),
            key=lambda commands: _unexplained_share(str(path), states, commands),
        )
    kind = interpolation or "ramp"
    reason = "as controllers take it"
    if interpolation is None:
        shares = {h: _unexplained_share(str(path), states, commands_by_kind[h]) for h in POINTS}
        best, other = sorted(POINTS, key=lambda h: shares[h])
        if shares[best] < CLOCK.decisive_ratio * shares[other]:
            kind, reason = best, "which the angles follow far better"
    text = {
        "ramp": "points are moved to from one to the next",
        "hold": "each point is held to the next",
    }[kind]
    if interpolation is None:
        mend = f'; write trajectory = "{"hold" if kind == "ramp" else "ramp"}" under [ros] if not'
    else:
        mend = ""
    notes.append(
        f"topic {topic.name}: {text}{'' if interpolation else f', {reason}'}, a new trajectory "
        f"takes the place of what is ahead{mend}"
    )
    return commands_by_kind[kind], tuple(notes)


def _unexplained_share(path: str, states: list[Series], commands: list[Series]) -> float:
    """What commands leave of the joints' accelerations, in the middle; infinite where that cannot
    be told.
    """
    try:
        columns, _ = merge(path, states, commands)
    except BadInput:
        return float("inf")
    shares = []
    for name in columns:
        q = columns.get("q" + name.removeprefix("target"))
        if name.startswith("target_") and q is not None:
            shares.append(
                unexplained([Track(columns["time"], q[:, None], None, columns[name][:, None])])
            )
    shares = [x for x in shares if np.isfinite(x)]
    if shares:
        return float(np.median(shares))
    return float("inf")


def _with_whole_turns(command: Series, states: list[Series], servos: Mapping[str, str]) -> Series:
    """Targets, and what `servos` says are, with the whole turns of their angles, before they are
    brought onto the clock of these: a mean over a row of a target that counts anew within it would
    be no target.
    """
    columns = dict(command.columns)
    for name, values in command.columns.items():
        joint = servos.get(name) or name.removeprefix("target_")
        state = next((s for s in states if f"q_{joint}" in s.columns), None)
        finite = values[np.isfinite(values)]
        if (
            not (name in servos or name.startswith("target_"))
            or state is None
            or len(finite) < 4
            or np.ptp(finite) < np.pi
        ):
            continue
        has_angle = np.isfinite(state.columns[f"q_{joint}"])
        time, first = np.unique(state.time[has_angle], return_index=True)
        if len(time) > 3:
            q = without_turns(time, state.columns[f"q_{joint}"][has_angle][first]).q
            columns[name] = follow_turns(np.interp(command.time, time, q), values)
    return replace(command, columns=columns)


def _with_model_joints(
    series: list[Series], wanted: Wanted
) -> tuple[list[Series], tuple[str, ...]]:
    """Remove what `ignore` names, and whole joints that the model lacks where all that it
    has are there: what speaks of others decides nothing of the clock.
    """
    joints = wanted.joints
    joints_there = {
        column.joint
        for s in series
        for name in s.columns
        if (column := role(name, joints)) and column.stem == "q"
    }
    unknown_joints: set[str] = set()
    if joints and set(joints) <= joints_there:
        unknown_joints = {
            joint for joint in joints_there if isinstance(joint, str) and joint not in joints
        }

    def is_kept(name: str) -> bool:
        if name in wanted.named:
            return True
        column_role = role(name, joints)
        joint = column_role.joint if column_role else None
        return name not in wanted.ignore and (
            not isinstance(joint, str) or joint not in {*wanted.ignore, *unknown_joints}
        )

    kept = [s.of({name for name in s.columns if is_kept(name)}) for s in series]
    excluded = sorted(unknown_joints - set(wanted.ignore))
    if excluded:
        notes = (f"joints that the model lacks are left out: {', '.join(excluded)}",)
    else:
        notes = ()
    return [s for s in kept if s.columns], notes


def _without_zeros(columns: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Remove efforts, and speeds, that are zero throughout, as drivers write them that
    have none.
    """
    notes: tuple[str, ...] = ()
    angles = [x for n, x in columns.items() if n.startswith("q_") and np.isfinite(x).any()]
    is_moving = any(np.nanmax(x) - np.nanmin(x) > TABLE.min_motion for x in angles)
    for stem, note in (
        ("tau_", "efforts are zero throughout: not taken for torques"),
        ("v_", "velocities are zero throughout though joints move: left out"),
    ):
        names = [
            name for name in columns if name.startswith(stem) and not name.endswith("_commanded")
        ]
        if (
            names
            and not any(np.any(columns[name]) for name in names)
            and (stem == "tau_" or is_moving)
        ):
            columns = {name: values for name, values in columns.items() if name not in names}
            notes = (*notes, note)
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
            for i, (_, order, values_by_stem) in enumerate(group):
                if len(row := values_by_stem.get(stem, ())) == len(names):
                    if order == names:
                        table[i] = row
                    else:
                        table[i] = [row[order.index(name)] for name in names]
            # efforts of one joint alone that are NaN throughout are no column that is not there:
            # said where torques are chosen
            filled = np.any(np.isfinite(table), axis=0)
            has_any = bool(np.any(filled))
            values |= {
                _column(stem, name): table[:, j]
                for j, name in enumerate(names)
                if filled[j] or (has_any and stem == "tau")
            }
        is_reordered = any(order != names for _, order, _ in group)
        out.append(Series(np.array([time for time, _, _ in group]), values, is_reordered))
    return out


def _column(stem: str, name: str) -> str:
    if stem == "tau_commanded":
        return f"tau_{name}_commanded"
    if stem == "ctrl":
        return f"ctrl{name}"
    return f"{stem}_{name}"


READER = Reader(lambda path, wanted: [read_bag(path, wanted)], ENDINGS, bags)
