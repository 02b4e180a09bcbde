"""Messages of an MCAP file that rosbags has opened: its chunks are unpacked as there, and cut into messages faster.

In the order of rosbags: by time of recording, then by place of the chunk, then as written. Chunks that overlap in time
are sorted together.
"""

from __future__ import annotations

import struct
from typing import Any

from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_mcap import decompress

_FRAME, _MESSAGE_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_HEAD = struct.Struct("<BQHIQ")
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_MESSAGE = 0x05
_MOST_TOGETHER = 8

Found = tuple[int, int, int, bytes]
"""Time of recording, place of the chunk, number of the channel, data."""


def groups_of(chunks: list[Any]) -> list[list[Any]] | None:
    """Chunks in the order of time, those that overlap together; None where too many do to be held in memory."""
    ordered = sorted(chunks, key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset))
    groups: list[list[Any]] = []
    latest, last_place = -1, -1
    for chunk in ordered:
        place = chunk.chunk_start_offset
        is_after = chunk.message_start_time > latest or (
            chunk.message_start_time == latest and place > last_place
        )
        if is_after:
            groups.append([chunk])
        else:
            groups[-1].append(chunk)
        latest, last_place = max(latest, chunk.message_end_time), max(last_place, place)
    return groups if all(len(group) <= _MOST_TOGETHER for group in groups) else None


def messages_of(storage: Any, group: list[Any], wanted: set[int]) -> list[Found]:
    """The messages of chunks that overlap, of some channels.

    Raises
    ------
    ReaderError
        If a chunk is damaged.
    """
    found: list[Found] = []
    for chunk in group:
        if any(chunk.channel_count.get(number, 0) for number in wanted):
            found += _messages_in(storage, chunk, wanted)
    times = [message[0] for message in found]
    if times != sorted(times):
        found.sort(key=lambda message: message[:2])
    return found


def _messages_in(storage: Any, chunk: Any, wanted: set[int]) -> list[Found]:
    """Messages of one chunk, as they were written."""
    content = _unpacked(storage, chunk)
    place, first_ns, last_ns = chunk.chunk_start_offset, chunk.message_start_time, chunk.message_end_time
    found: list[Found] = []
    at, size = 0, len(content)
    unpack, head_bytes = _HEAD.unpack_from, _HEAD.size
    message_head = _FRAME.size + _MESSAGE_HEAD.size
    while at < size:
        if at + head_bytes <= size:
            op, length, channel, _, logged_ns = unpack(content, at)
        elif at + _FRAME.size <= size:
            (op, length), channel, logged_ns = _FRAME.unpack_from(content, at), 0, 0
        else:
            length = size
        end = at + _FRAME.size + length
        if end > size:
            msg = f"Truncated record at offset {at}: expected {length} bytes, got {max(size - at - _FRAME.size, 0)}."
            raise ReaderError(msg)
        if op == _MESSAGE:
            if length < _MESSAGE_HEAD.size:
                msg = f"Message record at offset {at} is too short."
                raise ReaderError(msg)
            if channel in wanted and first_ns <= logged_ns <= last_ns:
                found.append((logged_ns, place, channel, content[at + message_head : end]))
        at = end
    return found


def _unpacked(storage: Any, chunk: Any) -> bytes:
    """Content of a chunk, of the size and with the checksum that it should have."""
    stream = storage.bio
    stream.seek(chunk.chunk_start_offset)
    head = stream.read(_CHUNK_HEAD.size)
    start = chunk.chunk_start_offset + _CHUNK_HEAD.size + 4 + len(chunk.compression) + 8
    stream.seek(start)
    packed = stream.read(chunk.compressed_size)
    if len(head) != _CHUNK_HEAD.size or len(packed) != chunk.compressed_size:
        msg = (
            f"Truncated record at offset {start}: expected {chunk.compressed_size} bytes, got {len(packed)}."
        )
        raise ReaderError(msg)
    checksum = _CHUNK_HEAD.unpack(head)[-1]
    return bytes(decompress(packed, chunk.compression, chunk.uncompressed_size, checksum))
