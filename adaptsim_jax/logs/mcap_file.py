"""MCAP files: channels of ROS messages (CDR, ROS 1), of JSON and of protobuf; channels in other
encodings are left.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

from adaptsim_jax.core.errors import BadInput
from adaptsim_jax.logs.bag import Topic
from adaptsim_jax.logs.extras import need

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
                yield message.log_time, decoders[key](message.data)

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
            return _ros(self.path, schema, encoding)
        raise BadInput(
            f"{self.path}: topic {channel.topic} is in {encoding or 'no known encoding'}; record "
            f"it as a ROS message, in JSON or "
            "in protobuf"
        )


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


def _ros(path: Path, schema: Any, encoding: str) -> Decoder:
    """Of ROS messages: by the definition in the file, and by the common types where it holds
    none.
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
    """By the file descriptors that the schema holds."""
    described = need(path, "google.protobuf.descriptor_pb2", "ros")
    pools, factory = (
        need(path, "google.protobuf.descriptor_pool", "ros"),
        need(path, "google.protobuf.message_factory", "ros"),
    )
    pool = pools.DescriptorPool()
    for file in described.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString
