"""ROS 1 and ROS 2 bags and MCAP files: joint states, and commands where a topic has them, as one raw trial a bag.

Read by the library `rosbags` (extra `ros`). Messages: sensor_msgs/JointState for the state; for commands a JointState
(position: targets; else effort), trajectory_msgs/JointTrajectory, control_msgs/JointTrajectoryControllerState,
std_msgs/Float64MultiArray or Float64 (in the order of the model's actuators).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.clock import Series, merge
from adaptsim_jax.logs.extras import need
from adaptsim_jax.logs.tables import RawTrial

ENDINGS = (".bag", ".mcap", ".db3")
STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
ARRAYS = ("std_msgs/msg/Float64MultiArray", "std_msgs/msg/Float64")
COMMANDS = (STATE, TRAJECTORY, CONTROLLER, *ARRAYS)
COMMAND_WORDS = ("command", "cmd", "desired", "target", "reference", "goal", "setpoint")


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: its name, message type and number of messages."""

    name: str
    kind: str
    count: int


@dataclass(frozen=True)
class Clock:
    """Of the state's messages: whether they are `stamped`, the `first` time and how `late` they arrive (median), in ns."""

    stamped: bool
    first: int
    late: int


def bags(folder: Path) -> list[Path]:
    """The bags that a folder holds: files, or folders with `metadata.yaml`; the folder itself where it is one."""
    if is_bag(folder):
        return [folder]
    return sorted(p for p in folder.iterdir() if is_bag(p) and not p.name.startswith("."))


def is_bag(path: Path) -> bool:
    """Whether a path is a bag by its ending, or a ROS 2 bag's folder."""
    return (path / "metadata.yaml").is_file() if path.is_dir() else path.suffix.lower() in ENDINGS


def read_bag(path: Path, options: Mapping[str, str]) -> RawTrial:
    """One bag as a raw trial with columns `q_NAME`, `v_NAME`, `tau_NAME`, `target_NAME`, ... on one clock.

    `options`: `state_topic`, `command_topic` where chosen. Raises `BadInput`: no such topic, a damaged bag, `rosbags` missing.
    """
    with _opened(path) as reader:
        state, command, notes = _choose(path, _topics(reader), options)
        series, clock = _state(reader, state)
        commands = _command(reader, command, clock) if command else []
    if not series:
        raise BadInput(f"{path}: topic {state.name} has no message with positions; name another by state_topic")
    columns, told = merge(str(path), series, commands)
    notes += told
    zero = [name for name, values in columns.items() if name.startswith("tau_") and not np.any(values)]
    if zero and len(zero) == sum(name.startswith("tau_") for name in columns):
        columns = {name: values for name, values in columns.items() if name not in zero}
        notes = (*notes, "efforts are zero throughout: not taken for torques")
    if not clock.stamped:
        notes = (*notes, f"topic {state.name} has no stamps: the bag's time of arrival is taken")
    if command and clock.stamped and clock.late and command.kind in ARRAYS:
        notes = (
            *notes,
            f"topic {command.name} has no stamps: its arrival is taken, less the delay of the state's messages",
        )
    if command and command.kind in ARRAYS:
        notes = (*notes, f"topic {command.name} names no joints: taken in the order of the model's actuators")
    if command and command.kind == TRAJECTORY:
        notes = (*notes, f"topic {command.name}: each point is held to the next, no interpolation by a controller")
    rows = np.arange(1, len(columns["time"]) + 1)
    return RawTrial(path.stem if path.is_file() else path.name, str(path), columns, rows, "message", notes=notes)


def bag_topics(path: Path, options: Mapping[str, str]) -> tuple[tuple[Topic, ...], dict[str, str]]:
    """All topics of a bag, and those that `read_bag` takes with these options, by `state_topic` and `command_topic`."""
    with _opened(path) as reader:
        topics = _topics(reader)
        state, command, _ = _choose(path, topics, options)
    return topics, {"state_topic": state.name} | ({"command_topic": command.name} if command else {})


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The library's reader of any bag; what it says of damaged ones in one line."""
    highlevel, typesys = need(path, "rosbags.highlevel", "ros"), need(path, "rosbags.typesys", "ros")
    try:
        with highlevel.AnyReader([path], default_typestore=typesys.get_typestore(typesys.Stores.LATEST)) as reader:
            yield reader
    except BadInput:
        raise
    except Exception as error:  # the library raises many kinds for damaged bytes: struct, sqlite, yaml, assertions
        why = " ".join(str(error).split())[:120] or type(error).__name__
        mend = {".mcap": "mend it by 'mcap recover'", ".bag": "mend it by 'rosbag reindex'"}.get(
            path.suffix, "record it again"
        )
        raise BadInput(f"{path}: is no readable bag ({why}); {mend}, or convert it to CSV") from None


def _topics(reader: Any) -> tuple[Topic, ...]:
    return tuple(Topic(name, info.msgtype or "", info.msgcount) for name, info in reader.topics.items())


# ---------------------------------------------------------------- which topics


def _choose(
    path: Path, topics: tuple[Topic, ...], options: Mapping[str, str]
) -> tuple[Topic, Topic | None, tuple[str, ...]]:
    by_name = {topic.name: topic for topic in topics}
    for key, name in options.items():
        if name not in by_name:
            raise BadInput(f"{path}: has no topic {name!r} ({key}); {suggest(name, by_name)}")
    wanted = options.get("command_topic")
    states = [topic for topic in topics if topic.kind == STATE and topic.count and topic.name != wanted]
    if chosen := options.get("state_topic"):
        state = by_name[chosen]
        if state.kind != STATE:
            raise BadInput(
                f"{path}: topic {chosen} is {state.kind or 'of several types'}; name one of sensor_msgs/JointState"
            )
    elif not states:
        kinds = ", ".join(f"{topic.name} ({topic.kind})" for topic in topics) or "none"
        raise BadInput(f"{path}: has no topic of sensor_msgs/JointState; record one (topics: {kinds})")
    else:
        measured = [topic for topic in states if not _is_command(topic)] or states
        state = max(measured, key=lambda topic: topic.count)
    notes: tuple[str, ...] = ()
    if len(states) > 1 and "state_topic" not in options:
        notes = (f"state taken from topic {state.name} of {', '.join(topic.name for topic in states)}",)
    if wanted:
        command = by_name[wanted]
        if command.kind not in COMMANDS:
            known = ", ".join(COMMANDS)
            raise BadInput(
                f"{path}: topic {wanted} is {command.kind or 'of several types'}; commands are read of {known}"
            )
        return state, command, notes
    others = [t for t in topics if t.count and t is not state and t.kind in COMMANDS]
    named = [t for t in others if t.kind == CONTROLLER or _is_command(t)]
    if len(named) == 1:
        return state, named[0], (*notes, f"commands taken from topic {named[0].name}")
    if others:
        names = ", ".join(topic.name for topic in others)
        notes = (*notes, f"topics that may hold commands: {names}; name one by command_topic")
    return state, None, notes


def _is_command(topic: Topic) -> bool:
    return any(word in topic.name.lower() for word in COMMAND_WORDS)


# ---------------------------------------------------------------- messages


def _messages(reader: Any, topic: Topic) -> tuple[np.ndarray, np.ndarray | None, list[Any]]:
    """Times of arrival `[K]` and the messages' own stamps `[K]` (None where they have none) in ns, and the messages."""
    connections = [c for c in reader.connections if c.topic == topic.name]
    arrived, stamps, out = [], [], []
    for connection, when, data in reader.messages(connections=connections):
        message = reader.deserialize(data, connection.msgtype)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        arrived.append(when)
        stamps.append(stamp.sec * 10**9 + stamp.nanosec if stamp is not None else 0)
        out.append(message)
    stamped = bool(stamps) and min(stamps) > 0 and len(set(stamps)) > len(stamps) // 2
    return np.array(arrived, dtype=np.int64), np.array(stamps, dtype=np.int64) if stamped else None, out


def _state(reader: Any, topic: Topic) -> tuple[list[Series], Clock]:
    arrived, stamps, messages = _messages(reader, topic)
    times = arrived if stamps is None else stamps
    first = int(times.min()) if len(times) else 0
    late = int(np.median(arrived - times)) if len(times) else 0
    rows = []
    for time, m in zip((times - first) * 1e-9, messages, strict=True):
        if len(m.position) == len(m.name) > 0:
            rows.append((float(time), tuple(m.name), {"q": m.position, "v": m.velocity, "tau": m.effort}))
    return _series(rows), Clock(stamps is not None, first, late)


def _command(reader: Any, topic: Topic, clock: Clock) -> list[Series]:
    arrived, stamps, messages = _messages(reader, topic)
    times = stamps if stamps is not None and clock.stamped else arrived - clock.late
    rows = []
    for time, m in zip((times - clock.first) * 1e-9, messages, strict=True):
        if topic.kind == STATE:
            given = {"target": m.position} if len(m.position) else {"tau_commanded": m.effort}
            rows.append((float(time), tuple(m.name), given))
        elif topic.kind == CONTROLLER:
            # older messages say `desired`; those between have both, and fill one of them
            points = [getattr(m, name) for name in ("reference", "desired") if hasattr(m, name)]
            told = next((point.positions for point in points if len(point.positions)), ())
            rows.append((float(time), tuple(m.joint_names), {"target": told}))
        elif topic.kind == TRAJECTORY:
            for point in m.points:
                after = point.time_from_start.sec + point.time_from_start.nanosec * 1e-9
                rows.append((float(time) + after, tuple(m.joint_names), {"target": point.positions}))
        else:
            values = np.atleast_1d(np.asarray(m.data, dtype=np.float64))
            rows.append((float(time), tuple(str(i) for i in range(1, len(values) + 1)), {"ctrl": values}))
    return _series(rows)


def _series(rows: list[tuple[float, tuple[str, ...], Mapping[str, Any]]]) -> list[Series]:
    """Rows that name the same joints, in whatever order, together; what a message lacks is NaN."""
    groups: dict[tuple[str, ...], list[tuple[float, tuple[str, ...], Mapping[str, Any]]]] = {}
    for row in rows:
        groups.setdefault(tuple(sorted(row[1])), []).append(row)
    out = []
    for group in groups.values():
        names = group[0][1]
        values: dict[str, np.ndarray] = {}
        for stem in group[0][2] if len({tuple(r[2]) for r in group}) == 1 else {s for r in group for s in r[2]}:
            table = np.full((len(group), len(names)), np.nan)
            for i, (_, order, given) in enumerate(group):
                if len(row := given.get(stem, ())) == len(names):
                    table[i] = row if order == names else [row[order.index(name)] for name in names]
            # efforts of one joint alone that are NaN throughout are no column that is not there: said where torques are chosen
            some = np.isfinite(table).any()
            values |= {
                _column(stem, name): table[:, j]
                for j, name in enumerate(names)
                if np.isfinite(table[:, j]).any() or (some and stem == "tau")
            }
        reordered = any(order != names for _, order, _ in group)
        out.append(Series(np.array([time for time, _, _ in group]), values, reordered))
    return out


def _column(stem: str, name: str) -> str:
    if stem == "tau_commanded":
        return f"tau_{name}_commanded"
    return f"ctrl{name}" if stem == "ctrl" else f"{stem}_{name}"
