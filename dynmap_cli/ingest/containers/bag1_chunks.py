"""Messages of a ROS 1 bag that rosbags has opened: its chunks are unpacked as there, and cut into messages faster.

In the order of rosbags: by time of recording, then by connection, then as written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from io import BytesIO
from itertools import chain
from os import SEEK_CUR
from typing import Any

import numpy as np
from rosbags.rosbag1.reader import Header, ReaderError, RecordType, read_bytes, read_uint32

from dynmap_cli.arrays import I64, U8
from dynmap_cli.ingest.messages.blocks import Block, columns_of, packed

_LEAST_RUN = 8
_MOST_HELD = 4
_SIZES = {b"op": 1, b"conn": 4, b"time": 8}
_U32 = np.dtype("<u4")


def is_orderly(reader: Any, connections: list[Any]) -> bool:
    """Whether messages that follow one another mostly lie in one chunk."""
    _, entries = _entries(reader, connections)
    n_runs = int(np.count_nonzero(np.diff(entries[:, 1])))
    return bool(n_runs <= len(reader.chunks) + entries.shape[0] // _LEAST_RUN)


def bag1_blocks(reader: Any, connections: list[Any], numbers: Mapping[int, int]) -> Iterator[Block]:
    """Yield the messages of some connections, those of a chunk at a time.

    Parameters
    ----------
    reader : rosbags.rosbag1.Reader
    connections : list of Connection
    numbers : dict of int to int
        By number of the connection in the file: the number that it has in the blocks.

    Raises
    ------
    ReaderError
        If a chunk is damaged.
    """
    owners, entries = _entries(reader, connections)
    ends = [*(np.flatnonzero(np.diff(entries[:, 1])) + 1).tolist(), entries.shape[0]]
    held: dict[int, bytes] = {}
    start = 0
    for end in ends if entries.size else []:
        run, place = slice(start, end), int(entries[start, 1])
        content = held.pop(place, None)
        if content is None:
            where = reader.chunks[place]
            reader.bio.seek(where.datapos)
            content = bytes(where.decompressor(read_bytes(reader.bio, where.datasize)))
        held[place] = content
        while len(held) > _MOST_HELD:
            del held[next(iter(held))]
        start = end
        starts, sizes = _located(content, owners[run], entries[run])
        channels = np.array([numbers[number] for number in owners[run].tolist()], dtype=np.int64)
        block = Block(np.frombuffer(content, dtype=np.uint8), starts, sizes, channels, entries[run, 0])
        yield block if 2 * block.n_bytes > len(content) else packed(block)


def _entries(reader: Any, connections: list[Any]) -> tuple[I64, I64]:
    """Connection (n,) of each message, and (n, 3) time, place of the chunk, and place in it, from the index."""
    parts = [reader.indexes[connection.id] for connection in connections]
    n_numbers = 3 * sum(map(len, parts))
    flat = chain.from_iterable(chain.from_iterable(parts))
    entries = np.fromiter(flat, dtype=np.int64, count=n_numbers).reshape(-1, 3)
    owners = np.repeat([connection.id for connection in connections], [len(part) for part in parts])
    order = np.argsort(entries[:, 0], kind="stable")
    return owners[order], entries[order]


def _located(content: bytes, owners: I64, entries: I64) -> tuple[I64, I64]:
    """Where the data of messages begin (n,) in a chunk, and their sizes (n,).

    Records of messages mostly have the same fields in the same order, so that those of the first one hold for the
    others; the rest, such as one behind the record of its connection, is taken apart one by one.
    """
    bytes_of = np.frombuffer(content, dtype=np.uint8)
    starts, sizes = np.full(owners.size, -1), np.zeros(owners.size, dtype=np.int64)
    shape = _shape_of_head(content, entries[:, 2])
    if shape is not None:
        head, places = shape
        inside = np.flatnonzero(entries[:, 2] + len(head) + 4 <= len(content))
        rows = columns_of(bytes_of, entries[inside, 2], len(head) + 4)
        is_fixed = np.ones(len(head) + 4, dtype=bool)
        for name in (b"conn", b"time"):
            is_fixed[places[name] : places[name] + _SIZES[name]] = False
        is_fixed[len(head) :] = False
        fits = (rows[:, is_fixed] == np.frombuffer(head, dtype=np.uint8)[is_fixed[: len(head)]]).all(axis=1)
        fits &= _number(rows, places[b"conn"]) == owners[inside]
        seconds, rest = _number(rows, places[b"time"]), _number(rows, places[b"time"] + 4)
        fits &= seconds * 10**9 + rest == entries[inside, 0]
        length = _number(rows, len(head))
        begin = entries[inside, 2] + len(head) + 4
        fits &= begin + length <= len(content)
        starts[inside[fits]], sizes[inside[fits]] = begin[fits], length[fits]
    for row in np.flatnonzero(starts < 0).tolist():
        starts[row], sizes[row] = _located_alone(content, int(owners[row]), *entries[row].tolist())
    return starts, sizes


def _number(rows: U8, place: int) -> I64:
    """(n,) uint32 that stand at one place in rows of bytes."""
    return np.ascontiguousarray(rows[:, place : place + 4]).view(_U32)[:, 0].astype(np.int64)


def _shape_of_head(content: bytes, offsets: I64) -> tuple[bytes, dict[bytes, int]] | None:
    """The head of a record of a message with its length before it, and where its fields are; None if none is usual."""
    for offset in offsets[: len(_SIZES)].tolist():
        size = int.from_bytes(content[offset : offset + 4], "little")
        head = content[offset : offset + 4 + size]
        places: dict[bytes, int] = {}
        at = 4
        while at + 4 < len(head):
            length = int.from_bytes(head[at : at + 4], "little")
            name, _, value = head[at + 4 : at + 4 + length].partition(b"=")
            places[name] = at + 4 + len(name) + 1
            if _SIZES.get(name) != len(value):
                break
            at += 4 + length
        is_whole = at == len(head) == 4 + size and places.keys() == _SIZES.keys()
        if is_whole and head[places[b"op"]] == RecordType.MSGDATA:
            return head, places
    return None


def _located_alone(content: bytes, owner: int, logged_ns: int, _place: int, offset: int) -> tuple[int, int]:
    """The same for one message, as rosbags reads it."""
    stream = BytesIO(content)
    stream.seek(offset)
    while True:
        header = Header.read(stream)
        kind = header.get_uint8("op")
        if kind != RecordType.CONNECTION:
            break
        stream.seek(read_uint32(stream), SEEK_CUR)
    if kind != RecordType.MSGDATA:
        msg = "Expected to find message data."
        raise ReaderError(msg)
    size = read_uint32(stream)
    start = stream.tell()
    read_bytes(stream, size)
    if header.get_uint32("conn") != owner or header.get_time("time") != logged_ns:
        msg = "the index has another connection or time than the message"
        raise ReaderError(msg)
    return start, size
