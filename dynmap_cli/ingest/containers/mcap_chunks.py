"""Messages of an MCAP file that rosbags has opened: its chunks are unpacked as there, and cut into messages faster.

In the order of rosbags: by time of recording, then by place of the chunk, then as written.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_mcap import decompress

from dynmap_cli.arrays import I64, U8
from dynmap_cli.ingest.messages.blocks import Block, columns_of, joined, packed

_FRAME = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_INDEX_HEAD = struct.Struct("<BQHI")
_MESSAGE, _MESSAGE_INDEX = 0x05, 0x07
_HEAD = np.dtype(
    [("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("logged_ns", "<u8")]
)
_MESSAGE_HEAD_BYTES = 22
_BEFORE_DATA = _FRAME.size + _MESSAGE_HEAD_BYTES
_ENTRY_BYTES = 16
_MOST_TOGETHER, _MOST_BYTES_TOGETHER = 64, 1 << 28


def are_orderly(chunks: list[Any]) -> bool:
    """Whether there are chunks, and never so many of them overlap that they could not be held in memory."""
    return (
        bool(chunks) and _most_open(chunks, [1.0] * len(chunks)) <= _MOST_TOGETHER and can_be_sorted(chunks)
    )


def can_be_sorted(chunks: list[Any]) -> bool:
    """Whether those that overlap, all of which are unpacked to bring their messages into order, are small enough."""
    return _most_open(chunks, [float(chunk.uncompressed_size) for chunk in chunks]) <= _MOST_BYTES_TOGETHER


def _most_open(chunks: list[Any], sizes: list[float]) -> float:
    """The largest sum of the sizes of chunks that overlap at a time; 0 without any."""
    starts = np.array([chunk.message_start_time for chunk in chunks], dtype=np.uint64)
    ends = np.array([chunk.message_end_time for chunk in chunks], dtype=np.uint64)
    by_start, by_end = np.argsort(starts, kind="stable"), np.argsort(ends, kind="stable")
    begun = np.cumsum(np.array(sizes)[by_start])
    over = np.concatenate([[0.0], np.cumsum(np.array(sizes)[by_end])])
    return float(
        (begun - over[np.searchsorted(ends[by_end], starts[by_start], side="left")]).max(initial=0.0)
    )


def ordered_messages(storage: Any, wanted: Mapping[int, int]) -> Iterator[Block]:
    """Yield the messages of some channels, those of a chunk or so at a time.

    Parameters
    ----------
    storage : McapReader
    wanted : dict of int to int
        By number of the channel in the file: the number that it has in the blocks.

    Raises
    ------
    ReaderError
        If a chunk is damaged.
    """
    chunks = sorted(
        (chunk for chunk in storage.chunks if any(chunk.channel_count.get(number, 0) for number in wanted)),
        key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset),
    )
    table = np.full(1 << 16, -1)
    table[list(wanted)] = list(wanted.values())
    # What is left of earlier chunks, and the place of the chunk of each message.
    rest: Block | None = None
    rest_places: I64 = np.zeros(0, dtype=np.int64)
    for number, chunk in enumerate(chunks):
        block = _messages_in(storage, chunk, table)
        places = np.full(block.starts.size, chunk.chunk_start_offset)
        if rest is not None:
            block, places = joined([packed(rest), block]), np.concatenate([rest_places, places])
        if (np.diff(block.logged_ns) < 0).any():
            order = np.lexsort((places, block.logged_ns))
            block, places = block.picked(order), places[order]
        rest = None
        if number + 1 < len(chunks):
            # Messages of the next chunk may come before the rest.
            ready = int(np.searchsorted(block.logged_ns, chunks[number + 1].message_start_time))
            if ready < block.starts.size:
                rest, rest_places = block.picked(slice(ready, None)), places[ready:]
                block = block.picked(slice(ready))
        yield block


def _messages_in(storage: Any, chunk: Any, table: I64) -> Block:
    """Messages of one chunk, as they were written; of the channels that have a number in the table."""
    content = np.frombuffer(_unpacked(storage, chunk), dtype=np.uint8)
    starts = _indexed(storage, chunk, content)
    if starts is None:
        starts = _walked(content)
    heads = columns_of(content, starts, _HEAD.itemsize).view(_HEAD)[:, 0]
    short = np.flatnonzero(heads["length"] < _MESSAGE_HEAD_BYTES)
    if short.size:
        msg = f"Message record at offset {starts[short[0]]} is too short."
        raise ReaderError(msg)
    channels = table[heads["channel"]]
    logged_ns = heads["logged_ns"]
    is_wanted = (channels >= 0) & (logged_ns >= chunk.message_start_time)
    rows = np.flatnonzero(is_wanted & (logged_ns <= chunk.message_end_time))
    return Block(
        content,
        starts[rows] + _BEFORE_DATA,
        heads["length"][rows].astype(np.int64) - _MESSAGE_HEAD_BYTES,
        channels[rows],
        logged_ns[rows].astype(np.int64),
    )


def _indexed(storage: Any, chunk: Any, content: U8) -> I64 | None:
    """Where message records begin (n,), from the index behind a chunk; None where they do not fill the chunk.

    The index need not be trusted: records that begin where it says and join without a gap are all there are.
    """
    storage.bio.seek(chunk.chunk_start_offset + chunk.chunk_length)
    index = storage.bio.read(chunk.message_index_length)
    found, at = [], 0
    while at + _INDEX_HEAD.size <= len(index):
        op, length, _, n_bytes = _INDEX_HEAD.unpack_from(index, at)
        end = at + _FRAME.size + length
        if op != _MESSAGE_INDEX or end > len(index) or at + _INDEX_HEAD.size + n_bytes != end:
            return None
        if n_bytes % _ENTRY_BYTES == 0:
            entries = np.frombuffer(index, dtype="<u8", count=n_bytes // 8, offset=at + _INDEX_HEAD.size)
            found.append(entries[1::2])
        at = end
    if not found:
        return None
    offsets = np.sort(np.concatenate(found))
    if not offsets.size or int(offsets[-1]) + _HEAD.itemsize > content.size:
        return None
    starts = offsets.astype(np.int64)
    heads = columns_of(content, starts, _FRAME.size).view([("op", "u1"), ("length", "<u8")])[:, 0]
    ends = offsets + np.uint64(_FRAME.size) + heads["length"]
    is_chain = starts[0] == 0 and bool((ends[:-1] == offsets[1:]).all()) and int(ends[-1]) == content.size
    return starts if is_chain and bool((heads["op"] == _MESSAGE).all()) else None


def _walked(content: U8) -> I64:
    """The same by going from record to record."""
    buffer, size = content.data, content.size
    found: list[int] = []
    at = 0
    while at < size:
        op, length = _FRAME.unpack_from(buffer, at) if at + _FRAME.size <= size else (0, size)
        end = at + _FRAME.size + length
        if end > size:
            msg = f"Truncated record at offset {at}: expected {length} bytes, got {max(size - at - _FRAME.size, 0)}."
            raise ReaderError(msg)
        if op == _MESSAGE:
            if length < _MESSAGE_HEAD_BYTES:
                msg = f"Message record at offset {at} is too short."
                raise ReaderError(msg)
            found.append(at)
        at = end
    return np.array(found, dtype=np.int64)


def _unpacked(storage: Any, chunk: Any) -> bytes:
    """Content of a chunk, of the size and with the checksum that it should have."""
    stream = storage.bio
    stream.seek(chunk.chunk_start_offset)
    head = stream.read(_CHUNK_HEAD.size)
    start = chunk.chunk_start_offset + _CHUNK_HEAD.size + 4 + len(chunk.compression) + 8
    stream.seek(start)
    packed_bytes = stream.read(chunk.compressed_size)
    if len(head) != _CHUNK_HEAD.size or len(packed_bytes) != chunk.compressed_size:
        msg = f"Truncated record at offset {start}: expected {chunk.compressed_size} bytes, got {len(packed_bytes)}."
        raise ReaderError(msg)
    checksum = _CHUNK_HEAD.unpack(head)[-1]
    return bytes(decompress(packed_bytes, chunk.compression, chunk.uncompressed_size, checksum))
