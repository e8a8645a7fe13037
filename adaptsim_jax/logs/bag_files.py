"""Bags opened, of whatever kind: ROS 1 and ROS 2 by the library rosbags, MCAP by the library mcap,
each as topics and messages.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.bag import Bag, Topic
from adaptsim_jax.logs.extras import need
from adaptsim_jax.logs.mcap_file import McapBag

ENDINGS = (".bag", ".mcap", ".db3")


def bags(path: Path) -> list[Path]:
    """The bags that a folder holds: files, or folders with `metadata.yaml`; the path itself where
    it is one.
    """
    if is_bag(path):
        return [path]
    if path.is_dir():
        return sorted(p for p in path.iterdir() if is_bag(p) and not p.name.startswith("."))
    return []


def is_bag(path: Path) -> bool:
    """Whether a path is a bag by its ending, or a ROS 2 bag's folder."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.suffix.lower() in ENDINGS


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """A bag of any kind, open. What the libraries say of damaged ones comes in one line
    (`BadInput`).
    """
    try:
        files = [path] if path.is_file() else sorted(path.glob("*.mcap"))
        if files and all(file.suffix.lower() == ".mcap" for file in files):
            with contextlib.ExitStack() as stack:
                yield McapBag(path, [stack.enter_context(file.open("rb")) for file in files])
        else:
            with _ros(path) as bag:
                yield bag
    except BadInput:
        raise
    # the libraries raise many kinds for damaged bytes: struct, sqlite, yaml, assertions
    except Exception as error:
        why = " ".join(str(error).split())[:120] or type(error).__name__
        mend = {".mcap": "mend it by 'mcap recover'", ".bag": "mend it by 'rosbag reindex'"}.get(
            path.suffix, "record it again"
        )
        raise BadInput(
            f"{path}: is no readable bag ({why}); {mend}, or convert it to CSV"
        ) from None


@dataclass(frozen=True)
class _RosBag:
    reader: Any

    @property
    def topics(self) -> tuple[Topic, ...]:
        return tuple(
            Topic(name, info.msgtype or "", info.msgcount)
            for name, info in self.reader.topics.items()
        )

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        connections = [c for c in self.reader.connections if c.topic == topic]
        for connection, when, data in self.reader.messages(connections=connections):
            yield when, self.reader.deserialize(data, connection.msgtype)


@contextlib.contextmanager
def _ros(path: Path) -> Iterator[_RosBag]:
    highlevel, typesys = (
        need(path, "rosbags.highlevel", "ros"),
        need(path, "rosbags.typesys", "ros"),
    )
    with highlevel.AnyReader(
        [path], default_typestore=typesys.get_typestore(typesys.Stores.LATEST)
    ) as reader:
        yield _RosBag(reader)
