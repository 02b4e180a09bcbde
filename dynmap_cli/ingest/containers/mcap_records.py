"""Messages of an MCAP file in the order in which they were written, without its index.

For files whose profile rosbags refuses, that were not closed, or that are damaged. A file is a chain of records: kind,
length, content. Chunks hold records of schemas, channels and messages, with a checksum; schemas and channels stand
once more in the summary at the end.
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata, Schema
from mcap.records import Channel as ChannelRecord

from dynmap_cli.ingest.containers.unpacking import HELD_BYTES, MOST_UNPACKED, give_back, unpack, view_of
from dynmap_cli.ingest.messages.stored import DAMAGE, Channel, Losses, StoredMessage
from dynmap_cli.printable import printable

LARGEST_COPIED = 1 << 27
"""Bytes of a message or an attachment that is copied, for a copy holds it several times over in memory."""
NOT_COPIED = f"of more than {LARGEST_COPIED >> 20} MiB, not copied"
_MAGIC = b"\x89MCAP0\r\n"
_MAGIC_BYTES = len(_MAGIC)
_FRAME = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_MESSAGE = struct.Struct("<HIQQ")
_U32, _U64 = struct.Struct("<I"), struct.Struct("<Q")
_BROKEN = "a record is broken"
BROKEN_SUMMARY = "its summary fails its checksum"
_FOOTER = struct.Struct("<BQQQI")
_FOOTER_CONTENT_BYTES = 20
_CHUNK_INDEX = struct.Struct("<QQQ")
_DATA_END_BYTES = 13


class SummaryState(Enum):
    """Whether the summary of a file can be believed."""

    UNKNOWN = "there is none, or it has no checksum"
    WHOLE = "it has the checksum it should have"
    BROKEN = "it has another"


def summary_state(path: Path) -> SummaryState:
    """Compare the summary of a file with its checksum, which covers it and the footer up to the checksum."""
    with path.open("rb") as stream:
        size = stream.seek(0, SEEK_END)
        footer_start = size - _MAGIC_BYTES - _FOOTER.size
        if footer_start < _MAGIC_BYTES:
            return SummaryState.UNKNOWN
        stream.seek(footer_start)
        op, length, summary_start, _, checksum = _FOOTER.unpack(stream.read(_FOOTER.size))
        if (op, length) != (Opcode.FOOTER, _FOOTER_CONTENT_BYTES) or checksum == 0 or summary_start == 0:
            return SummaryState.UNKNOWN
        if summary_start > footer_start:
            return SummaryState.BROKEN
        stream.seek(summary_start)
        covered = stream.read(size - _MAGIC_BYTES - _U32.size - summary_start)
    return SummaryState.WHOLE if zlib.crc32(covered) == checksum else SummaryState.BROKEN


def mcap_bytes_behind(path: Path) -> int:
    """How many bytes lie behind the first end of a file, going by the summary that its last footer names.

    A summary without a checksum may be that of another file, to which this one was appended; 0 where there is none.
    """
    view = view_of(path)
    footer_start = len(view) - _MAGIC_BYTES - _FOOTER.size
    if footer_start < _MAGIC_BYTES:
        return 0
    op, _, summary_start, *_ = _FOOTER.unpack_from(view, footer_start)
    if op != Opcode.FOOTER or not _MAGIC_BYTES < summary_start <= footer_start:
        return 0
    end = summary_start
    for record in _records(view, summary_start, Losses()):
        end = record.end
    is_end = bytes(view[end : end + _MAGIC_BYTES]) == _MAGIC
    return len(view) - end - _MAGIC_BYTES if is_end else 0


class _Record(NamedTuple):
    """A record: where its content lies, and whether it is all there."""

    op: int
    start: int
    end: int
    is_whole: bool


@dataclass(slots=True)
class _Names:
    """Schemas and channels by number."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def learn(self, record: _Record, view: memoryview, *, is_checked: bool) -> None:
        """Note a schema or channel; a broken one stays unknown, one under a checksum overrules one that is not."""
        if record.op not in {Opcode.SCHEMA, Opcode.CHANNEL}:
            return
        stream = ReadDataStream(BytesIO(view[record.start : record.end]))
        try:
            if record.op == Opcode.SCHEMA:
                found = Schema.read(stream)
                if is_checked or found.id not in self.schemas:
                    self.schemas[found.id] = found
            else:
                self._add(ChannelRecord.read(stream), is_checked=is_checked)
        except (*DAMAGE, McapError):
            return

    def _add(self, record: ChannelRecord, *, is_checked: bool) -> None:
        if record.id in self.channels and not is_checked:
            return
        schema = self.schemas.get(record.schema_id)
        self.channels[record.id] = Channel(
            printable(record.topic),
            record.message_encoding,
            printable(schema.name) if schema else "",
            schema.encoding if schema else "",
            schema.data if schema else b"",
            tuple(record.metadata.items()),
        )


def mcap_attachments(path: Path, losses: Losses) -> Iterator[Attachment]:
    """Yield attachments that are whole, none of them of more than `LARGEST_COPIED`."""
    for record, view in _whole_records(path, Opcode.ATTACHMENT):
        if record.end - record.start > LARGEST_COPIED:
            losses.note(f"an attachment {NOT_COPIED}")
            continue
        content = bytes(view[record.start : record.end])
        try:
            if _U32.unpack(content[-_U32.size :])[0] not in {0, zlib.crc32(content[: -_U32.size])}:
                losses.note("an attachment fails its checksum")
                continue
            attachment = Attachment.read(ReadDataStream(BytesIO(content)))
        except (*DAMAGE, McapError):
            losses.note("an attachment is broken")
        else:
            yield attachment


def mcap_metadata(path: Path, losses: Losses) -> Iterator[Metadata]:
    """Yield metadata that are whole."""
    for record, view in _whole_records(path, Opcode.METADATA):
        try:
            metadata = Metadata.read(ReadDataStream(BytesIO(view[record.start : record.end])))
        except (*DAMAGE, McapError):
            losses.note("metadata are broken")
        else:
            yield metadata


def _whole_records(path: Path, op: Opcode) -> Iterator[tuple[_Record, memoryview]]:
    """Records of a kind outside of chunks, and the bytes of the file."""
    view = view_of(path)
    for record in _records(view, _MAGIC_BYTES, Losses(), _known_places(view, summary_state(path))):
        if record.is_whole and record.op == op:
            yield record, view


def mcap_messages(path: Path, losses: Losses) -> Iterator[StoredMessage]:
    """Yield what can be read: without chunks that fail their checksum, and up to the first record that is broken.

    Behind that one reading goes on with the next chunk, where there is a summary that can be believed.
    """
    view = view_of(path)
    losses.n_bytes += len(view)
    names = _Names()
    summary = summary_state(path)
    if summary is SummaryState.BROKEN:
        losses.note(BROKEN_SUMMARY)
    places = _known_places(view, summary)
    losses.stated_messages += _stated_messages(view, summary)
    is_checked = False
    for record in _records(view, _MAGIC_BYTES, Losses(), places):
        if record.op == Opcode.DATA_END:
            if summary is SummaryState.BROKEN:
                break
            is_checked = summary is SummaryState.WHOLE
        names.learn(record, view, is_checked=is_checked)
    is_closed = False
    for record in _records(view, _MAGIC_BYTES, losses, places):
        is_closed |= record.op in {Opcode.DATA_END, Opcode.FOOTER}
        if record.op == Opcode.CHUNK:
            yield from _chunk(record, view, names, losses)
        elif record.op == Opcode.MESSAGE and record.is_whole:
            yield from _message(record, view, names, losses)
    if not is_closed:
        losses.note("it was not closed properly")
        losses.is_size_known = False


def _chunk(record: _Record, view: memoryview, names: _Names, losses: Losses) -> Iterator[StoredMessage]:
    """Messages of one chunk; of one at which the file ends those before the end."""
    content = view[record.start : record.end]
    try:
        *_, checksum, name_bytes = _CHUNK.unpack_from(content)
        start = _CHUNK.size + name_bytes
        compression = bytes(content[_CHUNK.size : start]).decode()
        (size,) = _U64.unpack_from(content, start)
        inner, is_whole = unpack(content[start + 8 : start + 8 + size], compression)
    except DAMAGE:
        losses.note("a block of messages is broken", n_bytes=len(content), chunks=1)
        return
    if len(inner) > MOST_UNPACKED and compression:
        losses.note(
            f"a block of messages of more than {MOST_UNPACKED >> 20} MiB", n_bytes=len(content), chunks=1
        )
        return
    if record.is_whole and not (is_whole and checksum in {0, zlib.crc32(inner)}):
        losses.note("a block of messages fails its checksum", n_bytes=len(content), chunks=1)
        return
    found = Losses()
    for inner_record in _records(inner, 0, found):
        names.learn(inner_record, inner, is_checked=record.is_whole and checksum != 0)
        if inner_record.op == Opcode.MESSAGE and inner_record.is_whole:
            yield from _message(inner_record, inner, names, losses)
    if found.why:
        losses.note(found.why[0], chunks=1)


def _message(record: _Record, view: memoryview, names: _Names, losses: Losses) -> Iterator[StoredMessage]:
    """A message, if its channel is known."""
    start = record.start + _MESSAGE.size
    if start > record.end:
        losses.note(_BROKEN, messages=1)
        return
    number, sequence, logged_ns, published_ns = _MESSAGE.unpack_from(view, record.start)
    if number not in names.channels:
        losses.note("messages without a channel", messages=1)
        return
    data = bytes(view[start : record.end])
    yield StoredMessage(logged_ns, published_ns, sequence, names.channels[number], data)


def _stated_messages(view: memoryview, summary: SummaryState) -> int:
    """How many messages there are by the statistics of a summary that can be believed; 0 where it does not say."""
    if summary is not SummaryState.WHOLE:
        return 0
    _, _, summary_start, *_ = _FOOTER.unpack_from(view, len(view) - _MAGIC_BYTES - _FOOTER.size)
    for record in _records(view, summary_start, Losses()):
        if record.op == Opcode.STATISTICS and record.end - record.start >= _U64.size:
            return int(_U64.unpack_from(view, record.start)[0])
    return 0


def _known_places(view: memoryview, summary: SummaryState) -> tuple[int, ...]:
    """Where chunks, and at last the end of the data, begin, by a summary that can be believed; ascending."""
    if summary is not SummaryState.WHOLE:
        return ()
    _, _, summary_start, *_ = _FOOTER.unpack_from(view, len(view) - _MAGIC_BYTES - _FOOTER.size)
    found = {summary_start - _DATA_END_BYTES}
    for record in _records(view, summary_start, Losses()):
        if record.op == Opcode.CHUNK_INDEX and record.end - record.start >= _CHUNK_INDEX.size:
            found.add(_CHUNK_INDEX.unpack_from(view, record.start)[2])
    return tuple(sorted(place for place in found if _MAGIC_BYTES <= place < summary_start))


def _records(
    view: memoryview, position: int, losses: Losses, places: tuple[int, ...] = ()
) -> Iterator[_Record]:
    """The records of a file or chunk up to its end; one that is cut off comes as far as it goes.

    No record reaches over one of the *places*: reading goes on there behind one that is broken.
    """
    held_from = position
    while position < len(view):
        if position - held_from > HELD_BYTES:
            give_back(view)
            held_from = position
        if bytes(view[position : position + _MAGIC_BYTES]) == _MAGIC:
            losses.note_behind(len(view) - position - _MAGIC_BYTES)
            return
        if position + _FRAME.size > len(view):
            losses.note("it ends in the middle of a record")
            return
        op, size = _FRAME.unpack_from(view, position)
        start = position + _FRAME.size
        number = bisect_right(places, position)
        limit = places[number] if number < len(places) else None
        if limit is not None and (op == 0 or start + size > limit):
            # A chunk says once more, inside, how long it is.
            is_chunk = op == Opcode.CHUNK and position in places
            losses.note(_BROKEN, n_bytes=0 if is_chunk else limit - position)
            if is_chunk:
                yield _Record(op, start, limit, True)
            position = limit
            continue
        if op == 0:
            losses.note(_BROKEN, n_bytes=len(view) - position)
            return
        is_whole = start + size <= len(view)
        if not is_whole:
            losses.note_missing(start + size - len(view))
        yield _Record(op, start, min(start + size, len(view)), is_whole)
        position = start + size
