"""Bags opened, of whatever kind, as topics and messages.

ROS 1 and ROS 2 bags are read by the library rosbags, MCAP by the library mcap.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, BinaryIO, Protocol

from adaptsim_jax.core.errors import BadInput


def need(path: Path, module: str, extra: str) -> ModuleType:
    """The module, or `BadInput` with the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        library = module.partition(".")[0]
        raise BadInput(
            f"{path}: reading it needs {library}; run: pip install 'adaptsim_jax[{extra}]'"
        ) from None


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


ROS = ("cdr", "ros1")
READ = (*ROS, "json", "protobuf")
"""Encodings of messages that are read."""
Decoder = Callable[[bytes], Any]


class McapBag:
    """Open MCAP files as one bag."""

    def __init__(self, path: Path, files: list[BinaryIO]):
        need(path, "rosbags.typesys", "ros")
        reader = need(path, "mcap.reader", "ros")
        self.path, self.files = path, files
        self._make = reader.make_reader
        counts: Counter[str] = Counter()
        kinds: dict[str, set[tuple[str, str]]] = {}
        for file in files:
            summary = self._reader(file).get_summary()
            if (
                summary is None
                or summary.statistics is None
                or (summary.statistics.message_count and not summary.channels)
            ):
                for schema, channel, _ in self._reader(file).iter_messages(log_time_order=False):
                    counts[channel.topic] += 1
                    kinds.setdefault(channel.topic, set()).add(
                        (_kind(schema), channel.message_encoding)
                    )
                continue
            for number, channel in summary.channels.items():
                counts[channel.topic] += summary.statistics.channel_message_counts.get(number, 0)
                kind = _kind(summary.schemas.get(channel.schema_id))
                kinds.setdefault(channel.topic, set()).add((kind, channel.message_encoding))
        self.topics = tuple(_topic(name, kinds[name], counts[name]) for name in kinds)

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Time of arrival in ns and message, in the order of arrival."""
        decoders: dict[tuple[int, int], Decoder] = {}
        for which, file in enumerate(self.files):
            for schema, channel, message in self._reader(file).iter_messages(topics=[topic]):
                key = which, channel.id
                if key not in decoders:
                    decoders[key] = self._decoder(schema, channel)
                yield message.log_time, decoders[key](_unpacked(message.data))

    def _reader(self, file: BinaryIO) -> Any:
        file.seek(0)
        return self._make(file, validate_crcs=True)

    def _decoder(self, schema: Any, channel: Any) -> Decoder:
        encoding = channel.message_encoding
        if encoding == "json":
            return lambda data: json.loads(
                data, object_hook=lambda fields: SimpleNamespace(**fields)
            )
        if encoding == "protobuf":
            return _protobuf(self.path, schema)
        if encoding in READ:
            return _ros_decoder(self.path, schema, encoding)
        raise BadInput(
            f"{self.path}: topic {channel.topic} is in {encoding or 'no known encoding'}; record "
            "it as a ROS message, in JSON or in protobuf"
        )


PACKED = b"\x28\xb5\x2f\xfd"
"""What a message begins with that `ros2 bag record --compression-mode message` packed."""


def _unpacked(data: bytes) -> bytes:
    if data[:4] != PACKED:
        return data
    zstandard = importlib.import_module("zstandard")  # comes with the library mcap
    return zstandard.ZstdDecompressor().decompressobj().decompress(data)


def _topic(name: str, kinds: set[tuple[str, str]], count: int) -> Topic:
    kind = next(iter(kinds))[0] if len(kinds) == 1 else ""
    encoding = next((encoding or "no encoding" for _, encoding in kinds if encoding not in ROS), "")
    return Topic(name, kind, count, encoding, encoding not in ("", *READ))


def _kind(schema: Any) -> str:
    """A message type as ROS 2 names it; others as they stand."""
    name = schema.name if schema is not None else ""
    parts = name.split("/")
    if len(parts) == 2:
        return f"{parts[0]}/msg/{parts[1]}"
    return name


def _ros_decoder(path: Path, schema: Any, encoding: str) -> Decoder:
    """Make the decoder of ROS messages: by the definition in the file, and by the common types
    where it holds none.
    """
    typesys = need(path, "rosbags.typesys", "ros")
    kind, stores = _kind(schema), typesys.Stores
    known = typesys.get_typestore(stores.ROS1_NOETIC if encoding == "ros1" else stores.LATEST)
    types = dict(known.fielddefs)
    text = schema.data.decode()
    if "idl" in schema.encoding:
        line = "=" * 80 + "\n"
        for part in text.split(line) if line in text else [text]:
            if part.startswith("IDL:"):
                idl = part.partition("\n")[2]
            else:
                idl = part
            types |= typesys.get_types_from_idl(idl) if idl.strip() else {}
    elif text.strip():
        types |= typesys.get_types_from_msg(text, kind)
    store = typesys.get_typestore(stores.EMPTY)
    store.register(types)
    if encoding == "ros1":
        return lambda data: store.deserialize_ros1(data, kind)
    return lambda data: store.deserialize_cdr(data, kind)


def _protobuf(path: Path, schema: Any) -> Decoder:
    """Make the decoder of protobuf messages by the file descriptors that the schema holds."""
    described = need(path, "google.protobuf.descriptor_pb2", "ros")
    pools, factory = (
        need(path, "google.protobuf.descriptor_pool", "ros"),
        need(path, "google.protobuf.message_factory", "ros"),
    )
    pool = pools.DescriptorPool()
    for file in described.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString


ENDINGS = (".bag", ".mcap", ".db3", ".active")
REINDEX = "mend it by 'rosbag reindex'"
MENDS = {".mcap": "mend it by 'mcap recover'", ".bag": REINDEX, ".active": REINDEX}
"""Of bags that cannot be read; `.bag.active` is one that was being recorded."""


def bags(path: Path) -> list[Path]:
    """The bags that a folder holds: files, or folders of one; the path itself where it is one."""
    if is_bag(path):
        return [path]
    if path.is_dir():
        inside = (p for p in path.iterdir() if is_bag(p) or _is_cut(p))
        return sorted(p for p in inside if not p.name.startswith("."))
    return []


def is_bag(path: Path) -> bool:
    """Whether a path is a bag by its ending, or a ROS 2 bag's folder."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.suffix.lower() in ENDINGS


def _is_cut(path: Path) -> bool:
    """Whether a folder is a ROS 2 bag whose `metadata.yaml` was never written: a power cut came
    before the end. Its files differ in their last number.
    """
    files = [p for p in path.iterdir() if is_bag(p)] if path.is_dir() else []
    return len({re.sub(r"_\d+$", "", p.stem) for p in files if p.is_file()}) == 1


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """A bag of any kind, open. What the libraries say of damaged ones comes in one line
    (`BadInput`).
    """
    try:
        files = [path]
        if not is_bag(path) or any(path.glob("*.mcap")):
            files = sorted(p for p in path.iterdir() if is_bag(p))
        if all(file.suffix.lower() == ".mcap" for file in files):
            with contextlib.ExitStack() as stack:
                yield McapBag(path, [stack.enter_context(file.open("rb")) for file in files])
        else:
            with _ros(path, files) as bag:
                yield bag
    except BadInput:
        raise
    # the libraries raise many kinds for damaged bytes: struct, sqlite, yaml, assertions
    except Exception as error:
        why = " ".join(str(error).split())[:120] or type(error).__name__
        mend = MENDS.get(path.suffix, "record it again")
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
            yield when, self.reader.deserialize(_unpacked(data), connection.msgtype)


@contextlib.contextmanager
def _ros(path: Path, files: list[Path]) -> Iterator[_RosBag]:
    highlevel, typesys = (
        need(path, "rosbags.highlevel", "ros"),
        need(path, "rosbags.typesys", "ros"),
    )
    with highlevel.AnyReader(
        files, default_typestore=typesys.get_typestore(typesys.Stores.LATEST)
    ) as reader:
        yield _RosBag(reader)
