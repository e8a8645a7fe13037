"""What messages of bags hold, and which topics of a bag are taken."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
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
    stated: dict[str, np.ndarray] = {}
    for field, stem in FIELDS.items():
        if any(_given(joint, field) for joint in joints):
            stated[stem] = np.array([_number(getattr(joint, field, None)) for joint in joints])
    return tuple(joint.name for joint in joints), stated


def _given(joint: Any, field: str) -> bool:
    """Whether a joint has the field: in protobuf a field that may be left out is 0 where it is."""
    try:
        return joint.HasField(field)
    except (AttributeError, ValueError):
        return getattr(joint, field, None) is not None


def _dynamic(m: Any) -> Fields:
    stated = {stem: np.full(len(m.joint_names), np.nan) for stem in FIELDS.values()}
    for j, values in enumerate(m.interface_values):
        for name, value in zip(values.interface_names, values.values, strict=False):
            if name in FIELDS:
                stated[FIELDS[name]][j] = value
    return tuple(m.joint_names), {stem: x for stem, x in stated.items() if np.isfinite(x).any()}


def _actual(m: Any) -> Fields:
    point = _point(m, ("feedback", "actual"))
    if point is not None:
        stated = {"q": point.positions, "v": point.velocities, "tau": point.effort}
    else:
        stated = {}
    return tuple(m.joint_names), {stem: _numbers(x) for stem, x in stated.items()}


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
    names, stated = _joint_state(m)
    return names, {"target": stated["q"]} if len(stated["q"]) else {"tau_commanded": stated["tau"]}


def _commanded_states(m: Any) -> Fields:
    names, stated = _joint_states(m)
    return names, {"target": stated["q"]} if "q" in stated else {
        "tau_commanded": stated.get("tau", ())
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


def stamp_of(message: Any) -> int:
    """A message's own time in ns; 0 where it has none."""
    header = getattr(message, "header", None)
    return nanoseconds(
        getattr(header, "stamp", None)
        if header is not None
        else getattr(message, "timestamp", None)
    )


def nanoseconds(time: Any) -> int:
    """Of a time or duration of ROS, JSON (also by ISO 8601) or protobuf, or a number of seconds; 0
    for none.
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


def choose(
    path: Path,
    topics: tuple[Topic, ...],
    options: Mapping[str, str],
    knows: Callable[[Topic], int] = lambda topic: 0,
) -> tuple[Topic, Topic | None, tuple[str, ...]]:
    """The topics of the state and of the commands (None: there is none), by `options` where these
    name them, and notes.

    Args:
        knows: How many joints of the model a topic speaks of.
    """
    by_name = {topic.name: topic for topic in topics}
    for key in ("state_topic", "command_topic"):
        if (name := options.get(key)) is not None and name not in by_name:
            raise BadInput(f"{path}: has no topic {name!r} ({key}); {suggest(name, by_name)}")
    state, notes = _state_topic(path, topics, options, knows)
    foreign = [
        t
        for t in topics
        if t.encoding and t is not state and (t.unread or not (_commands_of(t) or t.kind in STATES))
    ]
    if foreign:
        names = ", ".join(f"{t.name} ({t.kind or 'no type'}, {t.encoding})" for t in foreign)
        notes = (*notes, f"topics that hold no ROS messages, left out: {names}")
    if wanted := options.get("command_topic"):
        command = by_name[wanted]
        if not _commands_of(command):
            kinds = (
                "JointState, JointTrajectory, JointTrajectoryControllerState, "
                "Float64MultiArray, Float64"
            )
            raise BadInput(
                f"{path}: topic {wanted} is {_what(command)}; commands are read of {kinds}"
            )
        return state, command, notes
    if state.kind in CONTROLLERS:
        return (
            state,
            state,
            (*notes, f"state and commands taken from the controller's topic {state.name}"),
        )
    others = [t for t in topics if t.count and t is not state and _commands_of(t)]
    named = [t for t in others if t.kind in CONTROLLERS or _is_command(t)]
    if len(named) == 1:
        return state, named[0], (*notes, f"commands taken from topic {named[0].name}")
    if others:
        names = ", ".join(topic.name for topic in others)
        notes = (*notes, f"topics that may hold commands: {names}; name one by command_topic")
    return state, None, notes


def _state_topic(
    path: Path, topics: tuple[Topic, ...], options: Mapping[str, str], knows: Callable[[Topic], int]
) -> tuple[Topic, tuple[str, ...]]:
    """The topic of the state: chosen, or of joint states, or of what else holds them; of several
    that of most joints of the model, then that with most messages.
    """
    if chosen := options.get("state_topic"):
        state = next(topic for topic in topics if topic.name == chosen)
        if state.kind not in STATES or state.unread:
            raise BadInput(
                f"{path}: topic {chosen} is {_what(state)}; name one of sensor_msgs/JointState"
            )
        return state, ()
    able = [
        t
        for t in topics
        if t.count and t.kind in STATES and not t.unread and t.name != options.get("command_topic")
    ]
    states = (
        [t for t in able if t.kind == STATE]
        or [t for t in able if t.kind not in CONTROLLERS]
        or able
    )
    if options.get("command_topic") and not states:
        states = [t for t in topics if t.name == options["command_topic"] and t.kind in CONTROLLERS]
    if not states:
        kinds = ", ".join(f"{topic.name} ({_what(topic)})" for topic in topics) or "none"
        raise BadInput(
            f"{path}: has no topic of sensor_msgs/JointState, nor of another message of joint "
            "states that is read (foxglove.JointStates in JSON or protobuf, DynamicJointState, "
            f"JointTrajectoryControllerState); record one (topics: {kinds})"
        )
    measured = [topic for topic in states if not _is_command(topic)] or states
    state = max(measured, key=lambda topic: (knows(topic) if len(measured) > 1 else 0, topic.count))
    reported = f"state taken from topic {state.name} of {', '.join(topic.name for topic in states)}"
    return state, (reported,) if len(states) > 1 else ()


def _what(topic: Topic) -> str:
    kind = topic.kind or "of several types"
    if topic.encoding:
        return f"{kind} in {topic.encoding}"
    return kind


def _commands_of(topic: Topic) -> bool:
    return not topic.unread and topic.kind in (*TRAJECTORIES, *COMMANDED)


def _is_command(topic: Topic) -> bool:
    return topic.kind in TRAJECTORIES or any(word in topic.name.lower() for word in COMMAND_WORDS)
