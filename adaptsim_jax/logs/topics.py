"""Which topic of a bag holds the state, and which the commands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from adaptsim_jax.core.config import suggest
from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.bag import Topic
from adaptsim_jax.logs.messages import COMMANDED, CONTROLLERS, STATE, STATES, TRAJECTORIES

COMMAND_WORDS = ("command", "cmd", "desired", "target", "reference", "goal", "setpoint")


def choose(
    path: Path,
    topics: tuple[Topic, ...],
    options: Mapping[str, str],
    knows: Callable[[Topic], int] = lambda topic: 0,
) -> tuple[Topic, Topic | None, tuple[str, ...]]:
    """The topics of the state and of the commands (None: there is none), by `options` where these
    name them, and notes. knows: how many joints of the model a topic speaks of.
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
            kinds = "JointState, JointTrajectory, JointTrajectoryControllerState, Float64MultiArray, Float64"
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
            f"states that is read "
            f"(foxglove.JointStates in JSON or protobuf, DynamicJointState, "
            f"JointTrajectoryControllerState); record one (topics: {kinds})"
        )
    measured = [topic for topic in states if not _is_command(topic)] or states
    state = max(measured, key=lambda topic: (knows(topic) if len(measured) > 1 else 0, topic.count))
    told = f"state taken from topic {state.name} of {', '.join(topic.name for topic in states)}"
    return state, (told,) if len(states) > 1 else ()


def _what(topic: Topic) -> str:
    kind = topic.kind or "of several types"
    if topic.encoding:
        return f"{kind} in {topic.encoding}"
    return kind


def _commands_of(topic: Topic) -> bool:
    return not topic.unread and topic.kind in (*TRAJECTORIES, *COMMANDED)


def _is_command(topic: Topic) -> bool:
    return topic.kind in TRAJECTORIES or any(word in topic.name.lower() for word in COMMAND_WORDS)
