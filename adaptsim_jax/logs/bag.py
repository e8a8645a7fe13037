"""What every bag is to its readers: topics and messages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: its name, message type (empty: of several) and number of messages.
    `encoding` of messages that are not ROS'; `unread`: whether it is none that can be read.
    """

    name: str
    kind: str
    count: int
    encoding: str = ""
    unread: bool = False


class Bag(Protocol):
    """An open bag."""

    @property
    def topics(self) -> tuple[Topic, ...]:
        """All of its topics."""
        ...

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Time of arrival in ns and message, whose fields are attributes."""
        ...
