"""Messages of a ROS 1 bag in the order in which they were written, without its index: for bags that lost theirs.

A bag is a chain of records: header length, header of `length name=value` fields, data length, data. Chunks hold
records of connections and messages; connections stand once more in the index at the end.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from itertools import chain, repeat
from pathlib import Path
from typing import NamedTuple

from dynmap_cli.ingest.containers.unpacking import HELD_BYTES, give_back, unpack, view_of
from dynmap_cli.ingest.messages.stored import DAMAGE, Channel, Losses, StoredMessage
from dynmap_cli.printable import printable

_MAGIC_BYTES = len(b"#ROSBAG V2.0\n")
_MESSAGE, _BAG, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 5, 6, 7
_SIZES = {_MESSAGE: {b"conn": 4, b"time": 8}, _CONNECTION: {b"conn": 4}}
_U32, _U64 = struct.Struct("<I"), struct.Struct("<Q")
_TIME = struct.Struct("<II")
_CUT = "it ends in the middle of a record"
_BROKEN = "a record is broken"


class _Record(NamedTuple):
    """A record: its fields, where its data lie, and whether they are all there."""

    fields: dict[bytes, bytes]
    start: int
    end: int
    is_whole: bool

    @property
    def op(self) -> int:
        """Kind of record."""
        return self.fields[b"op"][0]


def bag1_messages(path: Path, losses: Losses) -> Iterator[StoredMessage]:
    """Yield what can be read; damaged chunks are passed over, behind a broken record nothing is found."""
    view = view_of(path)
    losses.n_bytes += len(view)
    end = _end_of(view)
    losses.note_behind(len(view) - end)
    view = view[:end]
    connections: dict[int, Channel] = {}
    counts: Counter[Channel] = Counter()
    for record in _records(view, _MAGIC_BYTES, Losses()):
        if record.op == _CONNECTION:
            _learn(connections, record, view)
    for record in _records(view, _MAGIC_BYTES, losses):
        if record.op == _CHUNK:
            for logged_ns, channel, data in _chunk(record, view, connections, losses):
                # Bags do not number their messages.
                yield StoredMessage(logged_ns, logged_ns, counts[channel], channel, data)
                counts[channel] += 1
        elif record.op == _BAG and len(index_at := record.fields.get(b"index_pos", b"")) == _U64.size:
            index_at_byte = _U64.unpack(index_at)[0]
            losses.is_size_known = index_at_byte > 0
            losses.note_missing(index_at_byte - len(view))


def bag1_bytes_behind(path: Path) -> int:
    """How many bytes lie behind the index of a bag, which is its end; 0 where it has none, or a broken one."""
    view = view_of(path)
    return len(view) - _end_of(view)


def _end_of(view: memoryview) -> int:
    """Where the index ends: a record of each connection, then one of each chunk; the end of the file without one."""
    losses = Losses()
    header = next(_records(view, _MAGIC_BYTES, losses), None)
    if header is None or header.op != _BAG:
        return len(view)
    try:
        (index_at,) = _U64.unpack(header.fields[b"index_pos"])
        (n_connections,) = _U32.unpack(header.fields[b"conn_count"])
        (n_chunks,) = _U32.unpack(header.fields[b"chunk_count"])
    except DAMAGE:
        return len(view)
    kinds = chain(repeat(_CONNECTION, n_connections), repeat(_CHUNK_INFO, n_chunks))
    n_found, end = 0, 0
    for kind, record in zip(kinds, _records(view, index_at, losses), strict=False):
        if record.op != kind or not record.is_whole:
            return len(view)
        n_found, end = n_found + 1, record.end
    return end if 0 < n_found == n_connections + n_chunks else len(view)


def _chunk(
    record: _Record, view: memoryview, connections: dict[int, Channel], losses: Losses
) -> Iterator[tuple[int, Channel, bytes]]:
    """Time, channel and data of the messages of one chunk."""
    packed = view[record.start : record.end]
    compression = record.fields.get(b"compression", b"").decode("ascii", "replace")
    try:
        inner, is_whole = unpack(packed, compression)
    except ValueError as err:
        losses.note(str(err), n_bytes=len(packed), chunks=1)
        return
    if not is_whole:
        losses.note("a block of messages does not unpack to its end", chunks=1)
    inner_losses = Losses()
    for found in _records(inner, 0, inner_losses):
        if found.op == _CONNECTION:
            _learn(connections, found, inner)
        elif found.op == _MESSAGE and found.is_whole:
            channel = connections.get(_U32.unpack(found.fields[b"conn"])[0])
            if channel is None:
                losses.note("messages without a topic", messages=1)
                continue
            seconds, nanoseconds = _TIME.unpack(found.fields[b"time"])
            yield seconds * 10**9 + nanoseconds, channel, bytes(inner[found.start : found.end])
    if inner_losses.why and is_whole and record.is_whole:
        losses.note(inner_losses.why[0], n_bytes=min(inner_losses.lost_bytes, len(packed)), chunks=1)


def _learn(connections: dict[int, Channel], record: _Record, view: memoryview) -> None:
    """Note topic and type of a connection, as the MCAP profile ros1 asks for it; one that is broken stays unknown."""
    try:
        details = _fields(view[record.start : record.end])
        number = _U32.unpack(record.fields[b"conn"])[0]
        topic, msgtype = (printable(word.decode()) for word in (record.fields[b"topic"], details[b"type"]))
        metadata = {
            "md5sum": details.get(b"md5sum", b"").decode(),
            "callerid": details.get(b"callerid", b"").decode(),
        }
        if b"latching" in details:
            metadata["latching"] = details[b"latching"].decode()
    except DAMAGE:
        return
    definition = details.get(b"message_definition", b"")
    channel = Channel(topic, "ros1", msgtype, "ros1msg", definition, tuple(metadata.items()))
    if topic:
        connections.setdefault(number, channel)


def _records(view: memoryview, position: int, losses: Losses) -> Iterator[_Record]:
    """The records of a file or chunk up to the first that is broken; one that is cut off comes as far as it goes."""
    held_from = position
    while position < len(view):
        if position - held_from > HELD_BYTES:
            give_back(view)
            held_from = position
        try:
            (header_bytes,) = _U32.unpack_from(view, position)
            start = position + 8 + header_bytes
            (data_bytes,) = _U32.unpack_from(view, start - 4)
            fields = _fields(view[position + 4 : start - 4])
            record = _Record(
                fields, start, min(start + data_bytes, len(view)), start + data_bytes <= len(view)
            )
            is_complete = all(len(fields[name]) == size for name, size in _SIZES.get(record.op, {}).items())
        except DAMAGE:
            losses.note(_BROKEN, n_bytes=len(view) - position)
            return
        if not is_complete:
            losses.note(_BROKEN, n_bytes=len(view) - position)
            return
        if not record.is_whole:
            losses.note(_CUT)
        yield record
        position = start + data_bytes


def _fields(view: memoryview) -> dict[bytes, bytes]:
    """The `name=value` fields of a header; ValueError if they are none."""
    fields: dict[bytes, bytes] = {}
    position = 0
    while position < len(view):
        (size,) = _U32.unpack_from(view, position)
        word = bytes(view[position + 4 : position + 4 + size])
        name, equals, value = word.partition(b"=")
        if len(word) != size or not equals:
            msg = "a header field is broken"
            raise ValueError(msg)
        fields[name] = value
        position += 4 + size
    return fields
