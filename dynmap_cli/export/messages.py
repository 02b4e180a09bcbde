"""The messages of recordings as they are stored: bytes with their channel, in the order of their recording."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from mcap.reader import McapReader, make_reader
from mcap.records import Attachment, Metadata
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, ConnectionExtRosbag1, MessageDefinitionFormat
from rosbags.rosbag2.metadata import dump_qos_v8
from rosbags.typesys import Stores, get_typestore

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.bags import damaged
from dynmap_cli.ingest.containers import Source

_DEFINITIONS = {MessageDefinitionFormat.MSG: "msg", MessageDefinitionFormat.IDL: "idl"}


@dataclass(frozen=True, slots=True)
class Channel:
    """What an MCAP channel and its schema say.

    Attributes
    ----------
    topic, message_encoding : str
    schema_name, schema_encoding : str
        "" = no schema.
    schema_data : bytes
    metadata : tuple of (str, str)
    """

    topic: str
    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema_data: bytes
    metadata: tuple[tuple[str, str], ...] = ()

    @property
    def message_type(self) -> str:
        """ROS 2 spelling of the type."""
        package, _, last = self.schema_name.rpartition("/")
        return f"{package.removesuffix('/msg')}/msg/{last}"


class Stored(NamedTuple):
    """One message."""

    logged_ns: int
    published_ns: int
    sequence: int
    channel: Channel
    data: bytes


@dataclass(frozen=True, slots=True)
class Container:
    """One recording, open.

    Attributes
    ----------
    profile : str
        "ros1", "ros2", or what an MCAP file says.
    messages : iterator of Stored
    attachments : tuple of Attachment
    metadata : tuple of Metadata
        Of MCAP files.
    """

    profile: str
    messages: Iterator[Stored]
    attachments: tuple[Attachment, ...] = ()
    metadata: tuple[Metadata, ...] = ()


def in_order(containers: Sequence[Container]) -> Iterator[Stored]:
    """Messages of several recordings by the time of their recording."""
    yield from heapq.merge(*(one.messages for one in containers), key=lambda stored: stored.logged_ns)


def open_container(source: Source, stack: ExitStack) -> list[Container]:
    """Open a bag or MCAP file, or the MCAP files of a ROS 2 bag folder.

    Raises
    ------
    LogError
        If it is cut off or damaged.
    """
    files = sorted(source.path.glob("*.mcap")) if source.kind == "ros2" else []
    if source.kind == "mcap" or files:
        return [_open_mcap(path, source.name, stack) for path in files or [source.path]]
    return [_open_bag(source, stack)]


def _open_mcap(path: Path, name: str, stack: ExitStack) -> Container:
    """Open an MCAP file of any profile."""
    try:
        reader = make_reader(stack.enter_context(path.open("rb")), validate_crcs=True)
        if reader.get_summary() is None:
            msg = "it has no summary"
            raise ValueError(msg)
        return Container(
            reader.get_header().profile,
            _mcap_messages(reader, name),
            tuple(reader.iter_attachments()),
            tuple(reader.iter_metadata()),
        )
    except Exception as err:
        raise damaged(name, "MCAP file", err) from err


def _mcap_messages(reader: McapReader, name: str) -> Iterator[Stored]:
    """All messages, by log time."""
    channels: dict[int, Channel] = {}
    try:
        for schema, channel, message in reader.iter_messages():
            if channel.id not in channels:
                channels[channel.id] = Channel(
                    channel.topic,
                    channel.message_encoding,
                    schema.name if schema else "",
                    schema.encoding if schema else "",
                    schema.data if schema else b"",
                    tuple(channel.metadata.items()),
                )
            yield Stored(
                message.log_time, message.publish_time, message.sequence, channels[channel.id], message.data
            )
    except LogError:
        raise
    except Exception as err:
        raise damaged(name, "MCAP file", err) from err


def _open_bag(source: Source, stack: ExitStack) -> Container:
    """Open a ROS 1 bag, or a ROS 2 bag in SQLite."""
    kind = "ROS 1 bag" if source.kind == "ros1" else "ROS 2 bag"
    try:
        reader = AnyReader([source.path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        stack.enter_context(reader)
        channels = {id(one): _channel_of(one, reader) for one in reader.connections}
    except Exception as err:
        raise damaged(source.name, kind, err) from err
    return Container(
        "ros1" if source.kind == "ros1" else "ros2", _bag_messages(reader, channels, source, kind)
    )


def _bag_messages(
    reader: AnyReader, channels: dict[int, Channel], source: Source, kind: str
) -> Iterator[Stored]:
    """All messages, by the time of their recording; bags do not number them, so they are counted."""
    counts = dict.fromkeys(channels, 0)
    try:
        for connection, logged_ns, data in reader.messages():
            key = id(connection)
            yield Stored(logged_ns, logged_ns, counts[key], channels[key], bytes(data))
            counts[key] += 1
    except LogError:
        raise
    except Exception as err:
        raise damaged(source.name, kind, err) from err


def _channel_of(connection: Connection, reader: AnyReader) -> Channel:
    """The channel that the MCAP profiles ros1 and ros2 ask for."""
    definition, extra = connection.msgdef.data, connection.ext
    if isinstance(extra, ConnectionExtRosbag1):
        metadata = {"md5sum": connection.digest, "callerid": extra.callerid or ""}
        if extra.latching:
            metadata["latching"] = str(extra.latching)
        name = connection.msgtype.replace("/msg/", "/")
        return _channel(connection.topic, "ros1", name, "ros1msg", definition, metadata)
    written = _DEFINITIONS.get(connection.msgdef.format)
    if written is None and connection.msgtype in reader.typestore.fielddefs:
        written, definition = "msg", reader.typestore.generate_msgdef(connection.msgtype, ros_version=2)[0]
    metadata = {"offered_qos_profiles": dump_qos_v8(extra.offered_qos_profiles)}
    encoding = f"ros2{written}" if written else ""
    return _channel(
        connection.topic, extra.serialization_format, connection.msgtype, encoding, definition, metadata
    )


def _channel(
    topic: str, encoding: str, schema: str, schema_encoding: str, definition: Any, metadata: dict[str, str]
) -> Channel:
    return Channel(topic, encoding, schema, schema_encoding, definition.encode(), tuple(metadata.items()))
