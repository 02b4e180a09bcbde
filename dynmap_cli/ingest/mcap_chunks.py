"""Messages of an MCAP file that rosbags has opened: its chunks are unpacked as there, and cut into messages faster.

In the order of rosbags: by time of recording, then by place of the chunk, then as written.
"""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections.abc import Iterator
from typing import Any

import numpy as np
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_mcap import decompress

_FRAME, _MESSAGE_HEAD = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_HEAD = struct.Struct("<BQHIQ")
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_MESSAGE = 0x05
_MOST_TOGETHER = 64

Found = tuple[int, int, int, bytes]
"""Time of recording, place of the chunk, number of the channel, data."""


def are_orderly(chunks: list[Any]) -> bool:
    """Whether there are chunks, and never so many of them overlap that they could not be held in memory."""
    starts = np.sort([chunk.message_start_time for chunk in chunks])
    ends = np.sort([chunk.message_end_time for chunk in chunks])
    n_open = np.arange(1, starts.size + 1) - np.searchsorted(ends, starts, side="left")
    return starts.size > 0 and int(n_open.max()) <= _MOST_TOGETHER


def ordered_messages(storage: Any, wanted: set[int]) -> Iterator[list[Found]]:
    """Yield the messages of some channels, those of a chunk or so at a time.

    Raises
    ------
    ReaderError
        If a chunk is damaged.
    """
    chunks = sorted(
        (chunk for chunk in storage.chunks if any(chunk.channel_count.get(number, 0) for number in wanted)),
        key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset),
    )
    nexts = [chunk.message_start_time for chunk in chunks[1:]]
    waiting: list[Found] = []
    for number, chunk in enumerate(chunks):
        waiting += _messages_in(storage, chunk, wanted)
        times = [message[0] for message in waiting]
        if times != sorted(times):
            waiting.sort(key=_by_time_and_place)
            times = [message[0] for message in waiting]
        # Messages of the next chunk may come before the rest.
        ready = bisect_left(times, nexts[number]) if number < len(nexts) else len(times)
        yield waiting[:ready]
        waiting = waiting[ready:]


def _by_time_and_place(message: Found) -> tuple[int, int]:
    return message[0], message[1]


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
