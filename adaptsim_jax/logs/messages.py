"""What messages of bags hold, and which topics of a bag are taken."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.bag import Topic

STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
GOAL = "control_msgs/msg/FollowJointTrajectoryActionGoal"
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
PR2 = "pr2_controllers_msgs/msg/JointTrajectoryControllerState"
DYNAMIC = "control_msgs/msg/DynamicJointState"
FOXGLOVE = ("foxglove.JointStates", "foxglove_msgs/msg/JointStates")
ARRAYS = (
    "std_msgs/msg/Float64MultiArray",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Float32MultiArray",
    "std_msgs/msg/Float32",
)
TRAJECTORIES = (TRAJECTORY, GOAL)
CONTROLLERS = (CONTROLLER, PR2)
FIELDS = {"position": "q", "velocity": "v", "effort": "tau"}

Fields = tuple[tuple[str, ...], Mapping[str, Any]]
"""Names of joints (none where the message gives none), and their values by stem of our columns."""


def _joint_state(m: Any) -> Fields:
    def get(field):
        return _numbers(getattr(m, field, ()))

    return tuple(getattr(m, "name", ())), {stem: get(field) for field, stem in FIELDS.items()}


def _joint_states(m: Any) -> Fields:
    joints = list(getattr(m, "joints", ()))
    values: dict[str, np.ndarray] = {}
    for field, stem in FIELDS.items():
        if any(_has_field(joint, field) for joint in joints):
            values[stem] = np.array([_number(getattr(joint, field, None)) for joint in joints])
    return tuple(joint.name for joint in joints), values


def _has_field(joint: Any, field: str) -> bool:
    """Whether a joint has the field: in protobuf a field that may be left out is 0 where it is."""
    try:
        return joint.HasField(field)
    except (AttributeError, ValueError):
        return getattr(joint, field, None) is not None


def _dynamic(m: Any) -> Fields:
    readings = {stem: np.full(len(m.joint_names), np.nan) for stem in FIELDS.values()}
    for j, values in enumerate(m.interface_values):
        for name, value in zip(values.interface_names, values.values, strict=False):
            if name in FIELDS:
                readings[FIELDS[name]][j] = value
    return tuple(m.joint_names), {stem: x for stem, x in readings.items() if np.isfinite(x).any()}


def _actual(m: Any) -> Fields:
    point = _point(m, ("feedback", "actual"))
    if point is not None:
        values = {"q": point.positions, "v": point.velocities, "tau": point.effort}
    else:
        values = {}
    return tuple(m.joint_names), {stem: _numbers(x) for stem, x in values.items()}


def _desired(m: Any) -> Fields:
    point = _point(m, ("reference", "desired"))
    return tuple(m.joint_names), {"target": _numbers(point.positions) if point is not None else ()}


def _point(m: Any, names: tuple[str, ...]) -> Any:
    """Newer messages say `reference` and `feedback`, older ones `desired` and `actual`; those
    between have both, and fill one.
    """
    points = [getattr(m, name) for name in names if hasattr(m, name)]
    return next((point for point in points if len(point.positions)), None)


def _commanded(m: Any) -> Fields:
    names, values = _joint_state(m)
    return names, {"target": values["q"]} if len(values["q"]) else {"tau_commanded": values["tau"]}


def _commanded_states(m: Any) -> Fields:
    names, values = _joint_states(m)
    return names, {"target": values["q"]} if "q" in values else {
        "tau_commanded": values.get("tau", ())
    }


def _array(m: Any) -> Fields:
    values = np.atleast_1d(_numbers(m.data))
    return tuple(str(i) for i in range(1, len(values) + 1)), {"ctrl": values}


def _number(value: Any) -> float:
    """JSON writes NaN as nothing, or as a word."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return np.nan


def _numbers(values: Any) -> np.ndarray:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        return np.array([_number(value) for value in values])


Read = Callable[[Any], Fields]
STATES: dict[str, Read] = {
    STATE: _joint_state,
    DYNAMIC: _dynamic,
    **dict.fromkeys(CONTROLLERS, _actual),
    **dict.fromkeys(FOXGLOVE, _joint_states),
}
"""What reads states of joints from messages of a type."""
COMMANDED: dict[str, Read] = {
    STATE: _commanded,
    **dict.fromkeys(CONTROLLERS, _desired),
    **dict.fromkeys(FOXGLOVE, _commanded_states),
    **dict.fromkeys(ARRAYS, _array),
}
"""What reads commands from messages of a type, but for trajectories."""


def joints_of(topic: Topic, message: Any) -> tuple[str, ...]:
    """The joints that a message of states or commands names."""
    if topic.kind in TRAJECTORIES:
        goal = getattr(message, "goal", None)
        return tuple((message if goal is None else goal.trajectory).joint_names)
    return (STATES | COMMANDED)[topic.kind](message)[0]


def in_model(topic: str, names: Sequence[str], joints: Collection[str]) -> tuple[str, ...]:
    """Names of a topic's joints as the model has them: as they are, or with a part of the topic's
    name before each where the model knows all of them so, and none as it is (`left_elbow`, said as
    `elbow` on `/left/joint_states`).
    """
    if not set(names) & set(joints):
        for part in topic.split("/"):
            if set(prefixed := tuple(f"{part}_{name}" for name in names)) <= set(joints):
                return prefixed
    return tuple(names)


def stamp_of(message: Any) -> int:
    """A message's own time in ns; 0 where it has none."""
    header = getattr(message, "header", None)
    return nanoseconds(
        getattr(header, "stamp", None)
        if header is not None
        else getattr(message, "timestamp", None)
    )


def nanoseconds(time: Any) -> int:
    """Convert a time or duration to ns: of ROS, JSON (also by ISO 8601) or protobuf, or a number of
    seconds; 0 for none.
    """
    if time is None:
        return 0
    if isinstance(time, str):
        try:
            moment = datetime.fromisoformat(
                re.sub(r"(\.\d{6})\d+", r"\1", time)
            )  # none is finer than 1 us there
        except ValueError:
            return 0
        return round(moment.timestamp() * 1e6) * 1000
    if isinstance(time, int | float):
        if time < 1e12:
            return round(time * 1e9)
        return int(time)

    def part(*names):
        return next((int(getattr(time, name)) for name in names if hasattr(time, name)), 0)

    return part("sec", "seconds", "secs") * 10**9 + part(
        "nanosec", "nsec", "nanos", "nsecs", "nanoseconds"
    )


COMMAND_WORDS = ("command", "cmd", "desired", "target", "reference", "goal", "setpoint")


RosOptions = Mapping[str, str | Sequence[str]]
"""Of `[ros]`."""


def topics_named(options: RosOptions, key: str) -> tuple[str, ...]:
    """The topics that a key of `[ros]` names: one, or a list."""
    value = options.get(key, ())
    return (value,) if isinstance(value, str) else tuple(value)


def choose(
    path: Path,
    topics: tuple[Topic, ...],
    options: RosOptions,
    joints_known: Callable[[Topic], set[str]] = lambda topic: set(),
) -> tuple[tuple[Topic, ...], tuple[Topic, ...], tuple[str, ...]]:
    """The topics of the state and of the commands (maybe none), by `options` where these name them,
    and notes.

    Args:
        joints_known: The joints of the model that a topic speaks of.
    """
    by_name = {topic.name: topic for topic in topics}
    for key in ("state_topic", "command_topic"):
        for name in topics_named(options, key):
            if name not in by_name:
                raise BadInput(f"{path}: has no topic {name!r} ({key}); {suggest(name, by_name)}")
    states, notes = _state_topics(path, topics, options, joints_known)
    foreign = [
        t
        for t in topics
        if t.encoding
        and t not in states
        and (t.unread or not (_has_commands(t) or t.kind in STATES))
    ]
    if foreign:
        names = ", ".join(f"{t.name} ({t.kind or 'no type'}, {t.encoding})" for t in foreign)
        notes = (*notes, f"topics that hold no ROS messages, left out: {names}")
    if command_names := topics_named(options, "command_topic"):
        commands = tuple(by_name[name] for name in command_names)
        for command in commands:
            if not _has_commands(command):
                raise BadInput(
                    f"{path}: topic {command.name} is {_description(command)}; commands are read "
                    "of JointState, JointTrajectory, JointTrajectoryControllerState, "
                    "Float64MultiArray, Float64"
                )
        return states, commands, notes
    if controllers := tuple(state for state in states if state.kind in CONTROLLERS):
        note = f"state and commands taken from the controller's topic {_topic_names(controllers)}"
        return states, controllers, (*notes, note)
    command_topics = [t for t in topics if t.count and t not in states and _has_commands(t)]
    candidates = [t for t in command_topics if t.kind in CONTROLLERS or _is_command(t)]
    if candidates and len(taken := _with_other_joints(candidates, joints_known)) == len(candidates):
        return states, taken, (*notes, f"commands taken from topic {_topic_names(taken)}")
    if command_topics:
        notes = (
            *notes,
            f"topics that may hold commands: {_topic_names(command_topics)}; name one by "
            "command_topic, or a list of them",
        )
    return states, (), notes


def _with_other_joints(
    topics: Sequence[Topic], joints_known: Callable[[Topic], set[str]]
) -> tuple[Topic, ...]:
    """The first topic, and those that speak of joints that none before them does, as those of
    several arms.
    """
    chosen, joints = [topics[0]], joints_known(topics[0]) if len(topics) > 1 else set()
    for topic in topics[1:]:
        topic_joints = joints_known(topic)
        if topic_joints and not topic_joints & joints:
            chosen, joints = [*chosen, topic], joints | topic_joints
    return tuple(chosen)


def _topic_names(topics: Sequence[Topic]) -> str:
    return ", ".join(topic.name for topic in topics)


def _state_topics(
    path: Path,
    topics: tuple[Topic, ...],
    options: RosOptions,
    joints_known: Callable[[Topic], set[str]],
) -> tuple[tuple[Topic, ...], tuple[str, ...]]:
    """The topics of the state: those chosen, or of joint states, or of what else holds them; of
    several that of most joints of the model, then that with most messages, with those of other
    joints.
    """
    command_names = topics_named(options, "command_topic")
    if state_names := topics_named(options, "state_topic"):
        states = tuple(t for name in state_names for t in topics if t.name == name)
        for state in states:
            if state.kind not in STATES or state.unread:
                raise BadInput(
                    f"{path}: topic {state.name} is {_description(state)}; name one of "
                    "sensor_msgs/JointState"
                )
        return states, ()
    readable = [t for t in topics if t.count and t.kind in STATES and not t.unread]
    not_commands = [t for t in readable if t.name not in command_names]
    states = (
        [t for t in not_commands if t.kind == STATE]
        or [t for t in not_commands if t.kind not in CONTROLLERS]
        or not_commands
        or [t for t in readable if t.kind in CONTROLLERS]
    )
    if not states:
        kinds = ", ".join(f"{topic.name} ({_description(topic)})" for topic in topics) or "none"
        raise BadInput(
            f"{path}: has no topic of sensor_msgs/JointState, nor of another message of joint "
            "states that is read (foxglove.JointStates in JSON or protobuf, DynamicJointState, "
            f"JointTrajectoryControllerState); record one (topics: {kinds})"
        )
    measured = [topic for topic in states if not _is_command(topic)] or states
    if len(measured) > 1:
        measured = sorted(measured, key=lambda t: (len(joints_known(t)), t.count), reverse=True)
    chosen = _with_other_joints(measured, joints_known)
    note = f"state taken from topic {_topic_names(chosen)} of {_topic_names(measured)}"
    if excluded := [topic for topic in measured if topic not in chosen]:
        note += f", left out: {_topic_names(excluded)}; state_topic names others, or a list of them"
    return chosen, (note,) if len(measured) > 1 else ()


def _description(topic: Topic) -> str:
    kind = topic.kind or "of several types"
    if topic.encoding:
        return f"{kind} in {topic.encoding}"
    return kind


def _has_commands(topic: Topic) -> bool:
    return not topic.unread and topic.kind in (*TRAJECTORIES, *COMMANDED)


def _is_command(topic: Topic) -> bool:
    return topic.kind in TRAJECTORIES or any(word in topic.name.lower() for word in COMMAND_WORDS)
