"""The messages of recordings as they are stored: bytes with their channel, in the order of their recording."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import IO, Any, TypeVar

from mcap import stream_reader
from mcap.reader import McapReader, NonSeekingReader, make_reader
from mcap.records import Attachment, Message, Metadata, Schema
from mcap.records import Channel as ChannelRecord
from mcap.summary import Summary
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, ConnectionExtRosbag1, MessageDefinitionFormat
from rosbags.rosbag2.metadata import dump_qos_v8

from dynmap_cli.export.channels import as_usual, faults_of
from dynmap_cli.ingest.containers.bag_checks import UnreadableBagError, check_counts, missing_messages
from dynmap_cli.ingest.containers.bags import open_bag, stored_connections
from dynmap_cli.ingest.containers.mcap_chunks import are_orderly
from dynmap_cli.ingest.containers.mcap_records import (
    LARGEST_COPIED,
    NOT_COPIED,
    mcap_attachments,
    mcap_metadata,
)
from dynmap_cli.ingest.containers.opening import Source
from dynmap_cli.ingest.containers.salvage import Span, stored_messages
from dynmap_cli.ingest.containers.type_stores import usual_definition
from dynmap_cli.ingest.containers.unpacking import MOST_UNPACKED, unpack_whole, unpacked_message
from dynmap_cli.ingest.messages.blocks import check_rows
from dynmap_cli.ingest.messages.stored import ORPHAN, UNTIMELY, Channel, Losses, StoredMessage, words_of
from dynmap_cli.ingest.raw.plausible import is_stamp
from dynmap_cli.ingest.raw.recording import file_name

_DEFINITIONS = {MessageDefinitionFormat.MSG: "msg", MessageDefinitionFormat.IDL: "idl"}
_TOO_LARGE = f"messages {NOT_COPIED}"
_Found = tuple[Schema | None, ChannelRecord, Message]
Extra = TypeVar("Extra", Attachment, Metadata)


class _BoundedUnpacking:
    """What the library of MCAP uses to unpack chunks, which believes any size that they state."""

    def __init__(self, compression: str) -> None:
        self._compression = compression

    def decompress(self, data: bytes, _n_bytes: int = 0) -> bytes:
        """Unpack a chunk."""
        return unpack_whole(data, self._compression)


def _bound_chunks() -> None:
    library: Any = stream_reader
    library.zstandard, library.lz4 = _BoundedUnpacking("zstd"), _BoundedUnpacking("lz4")


_bound_chunks()


class UnreadableContainerError(Exception):
    """A recording that its own library refuses, at first or on the way.

    Attributes
    ----------
    path : Path
    why : str
    """

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(why)
        self.path, self.why = path, why


@dataclass(slots=True)
class Damage:
    """What was found in a damaged recording, and what was lost; filled while its messages are read."""

    name: str
    kind: str
    losses: Losses
    messages: int = 0
    span: Span = field(default_factory=Span)

    def line(self) -> str:
        """Say it in one sentence."""
        return self.losses.line(file_name(self.name), self.kind, self.messages, self.span.seconds)


@dataclass(frozen=True, slots=True)
class Container:
    """One recording, open.

    Attributes
    ----------
    profile : str
        "ros1", "ros2", or what an MCAP file says.
    messages : iterator of StoredMessage
    attachments : iterable of Attachment
    metadata : iterable of Metadata
        Of MCAP files; to be gone through once.
    damage : Damage or None
        Of a recording that is read as far as it is whole.
    """

    profile: str
    messages: Iterator[StoredMessage]
    attachments: Iterable[Attachment] = ()
    metadata: Iterable[Metadata] = ()
    damage: Damage | None = None


def in_order(containers: Sequence[Container]) -> Iterator[StoredMessage]:
    """Messages of several recordings by the time of their recording."""
    yield from heapq.merge(*(one.messages for one in containers), key=lambda stored: stored.logged_ns)


def open_container(source: Source, refused: Mapping[Path, str], stack: ExitStack) -> list[Container]:
    """Open a bag or MCAP file, or the MCAP files of a ROS 2 bag folder.

    Parameters
    ----------
    source : Source
    refused : mapping of Path to str
        What is to be read record by record, as far as it is whole, and why.
    stack : ExitStack

    Raises
    ------
    UnreadableContainerError
        If it is cut off or damaged, and not known to be.
    """
    path = source.path
    kind = "MCAP file" if source.kind == "mcap" else "ROS 1 bag" if source.kind == "ros1" else "ROS 2 bag"
    if path in refused:
        return [_salvaged(path, source.name, kind, refused[path])]
    files = sorted(path.glob("*.mcap")) if source.kind == "ros2" else []
    if source.kind != "mcap" and not files:
        return [_open_bag(source, stack)]
    try:
        with open_bag(path) as reader:
            check_counts(reader)
            why = missing_messages(reader)
    except UnreadableBagError as err:
        # Nothing is wrong with an MCAP file of another profile.
        why = err.why
    if why:
        raise UnreadableContainerError(path, why)
    return [_open_mcap(file, path, stack) for file in files or [path]]


def _open_mcap(file: Path, path: Path, stack: ExitStack) -> Container:
    """Open an MCAP file of any profile; *path* is the file, or the folder it is part of."""
    try:
        stream = stack.enter_context(file.open("rb"))
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        if summary is None:
            raise UnreadableContainerError(path, "it has no summary")
        if any(chunk.uncompressed_size > MOST_UNPACKED for chunk in summary.chunk_indexes):
            raise UnreadableContainerError(
                path, f"a block of messages of more than {MOST_UNPACKED >> 20} MiB"
            )
        return Container(
            reader.get_header().profile,
            _mcap_messages(_found(reader, stream, summary), path, summary),
            _whole_extras(mcap_attachments, file, path),
            _whole_extras(mcap_metadata, file, path),
        )
    except UnreadableContainerError:
        raise
    except Exception as err:
        raise UnreadableContainerError(path, words_of(err)) from err


def _whole_extras(read: Callable[[Path, Losses], Iterator[Extra]], file: Path, path: Path) -> Iterator[Extra]:
    """Attachments or metadata of a file, of which none may be lost."""
    losses = Losses()
    yield from read(file, losses)
    for why in losses.why:
        raise UnreadableContainerError(path, why)


def _found(reader: McapReader, stream: IO[bytes], summary: Summary) -> Iterator[_Found]:
    """All messages, by log time; as they lie in the file where the memory would not hold what is out of order."""
    if are_orderly(list(summary.chunk_indexes)):
        return reader.iter_messages()
    stream.seek(0)
    return NonSeekingReader(stream, validate_crcs=True).iter_messages(log_time_order=False)


def _mcap_messages(stream: Iterator[_Found], path: Path, summary: Summary) -> Iterator[StoredMessage]:
    """All messages of a file, whose summary says how many there are."""
    channels: dict[int, Channel] = {}
    found = 0
    while True:
        try:
            schema, channel, message = next(stream)
        except StopIteration:
            break
        except Exception as err:
            raise UnreadableContainerError(path, words_of(err)) from err
        if channel.id not in channels:
            found_channel = Channel(
                channel.topic,
                channel.message_encoding,
                schema.name if schema else "",
                schema.encoding if schema else "",
                schema.data if schema else b"",
                tuple(channel.metadata.items()),
            )
            for fault in faults_of(found_channel):
                raise UnreadableContainerError(path, fault)
            channels[channel.id] = found_channel
        found += 1
        _check_time(path, message.log_time)
        _check_size(path, message.data)
        yield _plain(
            StoredMessage(
                message.log_time, message.publish_time, message.sequence, channels[channel.id], message.data
            )
        )
    if summary.statistics is not None:
        _check_count(path, summary.statistics.message_count, found)


def _open_bag(source: Source, stack: ExitStack) -> Container:
    """Open a ROS 1 bag, or a ROS 2 bag in SQLite."""
    try:
        reader = stack.enter_context(open_bag(source.path))
        orphans = check_counts(reader)
        channels = {id(one): _channel_of(one) for one in stored_connections(reader)}
    except Exception as err:
        why = err.why if isinstance(err, UnreadableBagError) else words_of(err)
        raise UnreadableContainerError(source.path, why) from err
    if orphans:
        raise UnreadableContainerError(source.path, ORPHAN)
    profile = "ros1" if source.kind == "ros1" else "ros2"
    return Container(profile, _bag_messages(reader, channels, source.path))


def _bag_messages(reader: AnyReader, channels: dict[int, Channel], path: Path) -> Iterator[StoredMessage]:
    """All messages, by the time of their recording; bags do not number them, so they are counted."""
    counts: Counter[int] = Counter()
    stream = reader.messages()
    while True:
        try:
            connection, logged_ns, data = next(stream)
            check_rows([logged_ns], [data])
        except StopIteration:
            break
        except Exception as err:
            raise UnreadableContainerError(path, words_of(err)) from err
        key = id(connection)
        _check_time(path, logged_ns)
        _check_size(path, data)
        yield _plain(StoredMessage(logged_ns, logged_ns, counts[key], channels[key], bytes(data)))
        counts[key] += 1
    _check_count(path, sum(connection.msgcount for connection in stored_connections(reader)), counts.total())


def _check_count(path: Path, stated: int, found: int) -> None:
    """Refuse a recording that holds another number of messages than it says."""
    if found != stated:
        why = f"it says that it holds {stated} messages, and holds {found}"
        raise UnreadableContainerError(path, why)


def _check_time(path: Path, logged_ns: int) -> None:
    """Refuse a recording with a message from no possible time, as the reader does."""
    if not is_stamp(logged_ns):
        raise UnreadableContainerError(path, UNTIMELY)


def _check_size(path: Path, data: bytes) -> None:
    """Refuse a recording with a message that is not copied, to be read message by message without it."""
    if len(data) > LARGEST_COPIED:
        raise UnreadableContainerError(path, _TOO_LARGE)


def _salvaged(path: Path, name: str, kind: str, why: str) -> Container:
    """What is whole in a damaged recording, in the order in which it was written."""
    damage = Damage(name, kind, Losses([why]))
    messages = _whole_messages(path, damage)
    if kind == "ROS 1 bag":
        return Container("ros1", messages, damage=damage)
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path] if path.suffix == ".mcap" else []
    attachments = chain.from_iterable(mcap_attachments(file, damage.losses) for file in files)
    metadata = chain.from_iterable(mcap_metadata(file, damage.losses) for file in files)
    profile = _profile_of(files[0]) if files else "ros2"
    return Container(profile, messages, attachments, metadata, damage=damage)


def _whole_messages(path: Path, damage: Damage) -> Iterator[StoredMessage]:
    """Yield the messages that are whole and count them."""
    described: dict[Channel, Channel] = {}
    for stored in stored_messages(path, damage.losses):
        if len(stored.data) > LARGEST_COPIED:
            damage.losses.note(_TOO_LARGE, messages=1)
            continue
        damage.messages += 1
        damage.span.add(stored.logged_ns)
        if stored.channel not in described:
            for fault in faults_of(stored.channel):
                damage.losses.note(fault)
            described[stored.channel] = as_usual(stored.channel)
        yield _plain(stored._replace(channel=described[stored.channel]))


def _plain(stored: StoredMessage) -> StoredMessage:
    """The same message, not compressed; without the metadata of their folder bags do not say which are."""
    if stored.channel.message_encoding != "cdr":
        return stored
    return stored._replace(data=unpacked_message(stored.data))


def _profile_of(path: Path) -> str:
    """Profile that the head of an MCAP file names, "" where it is damaged."""
    try:
        with path.open("rb") as stream:
            return make_reader(stream).get_header().profile
    except Exception:
        return ""


def _channel_of(connection: Connection) -> Channel:
    """The channel that the MCAP profiles ros1 and ros2 ask for."""
    definition, extra = connection.msgdef.data, connection.ext
    if isinstance(extra, ConnectionExtRosbag1):
        metadata = {"md5sum": connection.digest, "callerid": extra.callerid or ""}
        if extra.latching:
            metadata["latching"] = str(extra.latching)
        name = connection.msgtype.replace("/msg/", "/")
        return _channel(connection.topic, "ros1", name, "ros1msg", definition, metadata)
    written = _DEFINITIONS.get(connection.msgdef.format)
    metadata = {"offered_qos_profiles": dump_qos_v8(extra.offered_qos_profiles)}
    encoding = f"ros2{written}" if written else ""
    channel = _channel(
        connection.topic, extra.serialization_format, connection.msgtype, encoding, definition, metadata
    )
    return channel if written else usual_definition(channel)


def _channel(
    topic: str, encoding: str, schema: str, schema_encoding: str, definition: Any, metadata: dict[str, str]
) -> Channel:
    return Channel(topic, encoding, schema, schema_encoding, definition.encode(), tuple(metadata.items()))
