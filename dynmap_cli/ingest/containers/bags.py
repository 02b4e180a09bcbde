"""ROS 1 and ROS 2 bags through rosbags; like `db3_opening` tied to this library, whose minor versions differ."""

from __future__ import annotations

import functools
import logging
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn, Self

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag2 import reader as rosbag2_reader
from rosbags.rosbag2 import storage_mcap
from rosbags.rosbag2.errors import ReaderError
from rosbags.typesys.store import Typestore

from dynmap_cli.ingest.containers.bag1_chunks import bag1_blocks, is_orderly
from dynmap_cli.ingest.containers.bag_checks import (
    UnreadableBagError,
    check_counts,
    check_file,
    check_index,
    check_order,
    check_topics,
    files_of,
)
from dynmap_cli.ingest.containers.db3_blocks import db3_blocks
from dynmap_cli.ingest.containers.db3_opening import Db3Reader, use_db3_reader
from dynmap_cli.ingest.containers.mcap_chunks import are_orderly, ordered_messages
from dynmap_cli.ingest.containers.type_stores import ros1_types, ros2_types
from dynmap_cli.ingest.containers.unpacking import unpack_whole, unpacked_message
from dynmap_cli.ingest.messages.batches import Batches
from dynmap_cli.ingest.messages.blocks import Block, blocks_of_rows
from dynmap_cli.ingest.messages.definitions import check_definitions, check_size, is_usual
from dynmap_cli.ingest.messages.foxglove import as_ros
from dynmap_cli.ingest.messages.kinds import LASER_TYPES, USED_TYPES
from dynmap_cli.ingest.messages.layouts import has_layout, layout_of
from dynmap_cli.ingest.messages.ros_messages import Message, decoding_failed, end_of_messages
from dynmap_cli.ingest.messages.stored import ORPHAN, ros2_spelling, words_of
from dynmap_cli.ingest.raw.recording import RawRecording, Topic
from dynmap_cli.ingest.space import Space
from dynmap_cli.printable import printable

_log = logging.getLogger(__name__)
_ABOUT_FILE = re.compile(r"^Cannot open database .*?: ")
_NO_TOPICS = "its metadata.yaml names no topic"
_NOTHING_WRONG = ""
_NO_DAMAGE = ("Profile is not ros2", "messages are not in timestamp order")
_SCHEMAS_OF_OTHERS = frozenset({"ros1msg", "jsonschema", "protobuf", "flatbuffer"})
"""Well-known encodings of schemas, by the registry of MCAP, of which the library knows nothing."""


def _bound_blocks() -> None:
    """Let the library unpack no block of messages to more than is sane: 45 bytes of bzip2 can hold 45 MB."""
    for how in ("bz2", "lz4"):
        rosbag1_reader.decompressors[how] = functools.partial(unpack_whole, compression=how)
    for how in ("lz4", "zstd"):
        storage_mcap.DECOMPRESSORS[how] = functools.partial(_unpack_sized, how)
    unbounded: Any = rosbag2_reader
    unbounded.zstd = _BoundedZstd


def _unpack_sized(how: str, data: bytes, _n_bytes: int) -> bytes:
    return unpack_whole(data, how)


class _BoundedZstd:
    """What the library uses of zstd for folders: messages that are packed one by one, and files that are."""

    @staticmethod
    def decompress(data: bytes) -> bytes:
        """Unpack a message."""
        return unpack_whole(data, "zstd")

    @staticmethod
    def open(*_: object) -> NoReturn:
        """Refuse to unpack a file: that is done before, with a bound on the disk."""
        msg = "its files are packed, and not as its metadata.yaml says"
        raise ReaderError(msg)


_bound_blocks()


class _UsedTypes:
    """A reader that hides definitions of types that are not used: for one that is odd the library refuses the bag."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def __enter__(self) -> Self:
        self._inner.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._inner.close()

    @property
    def stored_connections(self) -> list[Any]:
        """As they are in the bag; messages come with these."""
        return list(self._inner.connections)

    @property
    def connections(self) -> list[Any]:
        """Those of types that are used as they are, for they are known by their identity."""
        hidden = MessageDefinition(MessageDefinitionFormat.NONE, "")
        found = []
        for one in self._inner.connections:
            is_used = one.msgtype in USED_TYPES
            if is_used:
                check_size(one.msgtype, one.msgdef.data)
            found.append(one if is_used else one._replace(msgdef=hidden))
        return found


def read_bag(path: Path, name: str, kind: str, space: Space) -> RawRecording:
    """Read the laser scans, odometry and transforms of a bag.

    Parameters
    ----------
    path : Path
        A ROS 1 bag, a ROS 2 folder with metadata.yaml, or a lone .db3 or .mcap file.
    name, kind : str
        For messages: what the operator called it, and what it is.
    space : Space
        On which disk ranges lie that do not fit into memory.

    Raises
    ------
    ArtifactError
        If the disk is too full.
    UnreadableBagError
        If the bag is cut off or damaged, holds fewer messages than it says, or is an MCAP file of another profile.
    """
    with open_bag(path) as reader:
        recording = RawRecording(name, kind, folder=space.folder)
        found = _take_all(reader, recording, space)
        with _refusals():
            orphans = check_counts(reader)
        if orphans:
            recording.drop_broken(ORPHAN, orphans)
        # Those of the readers, for they may have been counted only while they were read.
        readers: Any = reader.readers
        counts: Counter[tuple[str, str]] = Counter()
        for connection in (one for inner in readers for one in inner.connections):
            counts[connection.topic, connection.msgtype] += connection.msgcount
        recording.topics = [
            Topic(printable(topic), printable(msgtype), count)
            for (topic, msgtype), count in sorted(counts.items())
        ]
        stated = sum(topic.count for topic in recording.topics if topic.kind in USED_TYPES)
        if found != stated:
            msg = f"it says that it holds {stated} messages of the types that are used, and holds {found}"
            raise UnreadableBagError(msg)
        end_of_messages(recording)
    recording.give_back()
    return recording


@contextmanager
def open_bag(path: Path) -> Iterator[AnyReader]:
    """Open a bag, for whoever reads or copies it; whatever the library raises then becomes one error.

    Raises
    ------
    UnreadableBagError
        If it is cut off or damaged as far as can be told without reading it, or an MCAP file of another profile.
    """
    reader = None
    try:
        with _refusals():
            for file in sorted(path.iterdir()) if path.is_dir() else [path]:
                check_file(file)
            reader = AnyReader([path], default_typestore=ros2_types())
            for inner in reader.readers:
                use_db3_reader(inner)
            inside: Any = [_UsedTypes(inner) for inner in reader.readers]
            reader.readers = inside
            reader.open()
            for inner in reader.readers:
                check_index(inner)
                check_order(inner)
            if path.is_dir() and not reader.connections:
                raise UnreadableBagError(_NO_TOPICS)
            check_topics(reader)
            if any(
                one.msgtype not in USED_TYPES and ros2_spelling(one.msgtype) in USED_TYPES
                for one in reader.connections
            ):
                raise UnreadableBagError(_NOTHING_WRONG)
            used = [one.msgtype for one in reader.connections if one.msgtype in USED_TYPES]
            check_definitions(reader.typestore, _standard(reader), used)
    except UnreadableBagError:
        _close(reader)
        raise
    try:
        yield reader
    finally:
        reader.close()


@contextmanager
def _refusals() -> Iterator[None]:
    """Make one error of whatever the library raises.

    Raises
    ------
    UnreadableBagError
    """
    try:
        yield
    except UnreadableBagError:
        raise
    except Exception as err:
        raise UnreadableBagError(_damage_in(err)) from err


def _damage_in(err: Exception) -> str:
    """What the library complains of; "" where that is no damage."""
    if isinstance(err, KeyError) and err.args and str(err.args[0]) in _SCHEMAS_OF_OTHERS:
        return _NOTHING_WRONG
    why = _ABOUT_FILE.sub("", words_of(err))
    return _NOTHING_WRONG if any(words in why for words in _NO_DAMAGE) else why


def _close(reader: AnyReader | None) -> None:
    """Close a reader that may not be open, or not wholly."""
    for inner in () if reader is None else reader.readers:
        with suppress(Exception):
            inner.close()


def _expected(
    reader: AnyReader, usual: set[str], numbers: Mapping[int, int], block: Block
) -> tuple[int, int]:
    """How many sweeps there are, and how many bytes their ranges are if all are as long as the first of a topic.

    Parameters
    ----------
    reader : AnyReader
    usual : set of str
        Message types that are defined as usual.
    numbers : dict of int to int
        Numbers of channels by the identity of their connection.
    block : Block
        The first messages; what is not among them is looked for.
    """
    n_scans, n_bytes = 0, 0
    for connection in reader.connections:
        if connection.msgtype not in LASER_TYPES or not connection.msgcount:
            continue
        try:
            rows = np.flatnonzero(block.channels == numbers[id(connection)])
            if rows.size:
                data = block.data_of(int(rows[0]))
            else:
                *_, data = next(reader.messages(connections=[connection]))
            n_beams = _n_beams_of(reader, connection.msgtype, data, is_usual=connection.msgtype in usual)
        except Exception as err:
            # None, or damaged: the same is found when all are read.
            _log.debug("%s: %s", connection.topic, words_of(err))
            continue
        n_scans += connection.msgcount
        n_bytes += 4 * connection.msgcount * n_beams
    return n_scans, n_bytes


def _n_beams_of(reader: AnyReader, kind: str, data: bytes, *, is_usual: bool) -> int:
    """How many ranges a scan has; the library is only asked where fields do not lie as usual, for it has to learn."""
    if is_usual and has_layout(kind):
        with suppress(ValueError):
            return layout_of(data, kind, is_cdr=reader.is2).parts[0].n_beams
    scan: Any = reader.deserialize(data, kind)
    return len(scan.ranges)


def _take_all(reader: AnyReader, recording: RawRecording, space: Space) -> int:
    """Take the messages of the types that are used, in the order of their recording; returns how many there are."""
    wanted = [connection for connection in reader.connections if connection.msgtype in USED_TYPES]
    if not wanted:
        return 0

    def decode(topic: str, message_type: str, logged_ns: int, data: bytes) -> list[Message]:
        try:
            content: Any = reader.deserialize(unpacked_message(data) if reader.is2 else data, message_type)
            return as_ros(Message(topic, message_type, logged_ns, content))
        except Exception as err:
            decoding_failed(recording, topic, err)
            return []

    kinds = {connection.msgtype for connection in wanted}
    usual = {kind for kind in kinds if is_usual(reader.typestore, _standard(reader), kind)}
    batches = Batches(recording, decode, usual, is_cdr=reader.is2)
    numbers = {
        id(connection): batches.number_of(printable(connection.topic), connection.msgtype)
        for connection in wanted
    }
    blocks = _from_storage(reader, wanted, numbers) or _from_reader(reader, wanted, numbers)
    found = 0
    while True:
        with _refusals():
            block = next(blocks, None)
        if block is None:
            break
        if found == 0:
            space.reserve(recording.name, *_expected(reader, usual, numbers, block))
        found += block.starts.size
        batches.add(block)
    batches.finish()
    return found


def stored_connections(reader: AnyReader) -> list[Any]:
    """Connections as they are in a bag, none of whose definitions is hidden; messages come with these."""
    readers: Any = reader.readers
    return [one for inner in readers for one in inner.stored_connections]


def _from_reader(reader: AnyReader, wanted: list[Any], numbers: Mapping[int, int]) -> Iterator[Block]:
    """Messages as rosbags gives them, many at a time; numbers of channels by the identity of their connection."""
    (inner,) = reader.readers
    messages = inner.messages(connections=wanted)
    return blocks_of_rows(
        (numbers[id(connection)], logged_ns, data) for connection, logged_ns, data in messages
    )


def _from_storage(reader: AnyReader, wanted: list[Any], numbers: Mapping[int, int]) -> Iterator[Block] | None:
    """The same from chunks of bags and MCAP files, or rows of .db3 files; None where they have to come one by one."""
    if len(reader.readers) != 1:
        return None
    (inner,) = reader.readers
    if not reader.is2:
        by_id = {connection.id: numbers[id(connection)] for connection in wanted}
        return bag1_blocks(inner, wanted, by_id) if is_orderly(inner, wanted) else None
    outer: Any = getattr(inner, "storage", None)
    if outer is None or outer.metadata.compression_mode == "message":
        return None
    storages = files_of(inner)
    kinds = {(connection.topic, connection.msgtype): numbers[id(connection)] for connection in wanted}
    if all(isinstance(storage, Db3Reader) for storage in storages):
        return _from_files(storages, kinds, db3_blocks)
    if all(
        isinstance(storage, storage_mcap.McapReader) and are_orderly(storage.chunks) for storage in storages
    ):
        return _from_files(storages, kinds, ordered_messages)
    return None


def _from_files(
    storages: list[Any],
    kinds: Mapping[tuple[str, str], int],
    blocks_of: Callable[[Any, Mapping[int, int]], Iterator[Block]],
) -> Iterator[Block]:
    """Messages of some topics and types from the files of a bag, one after the other."""
    for storage in storages:
        channels = {
            connection.id: kinds[connection.topic, connection.msgtype]
            for connection in storage.connections
            if (connection.topic, connection.msgtype) in kinds
        }
        yield from blocks_of(storage, channels)


def _standard(reader: AnyReader) -> Typestore:
    """Message types as they should be in a bag."""
    return ros2_types() if reader.is2 else ros1_types()
