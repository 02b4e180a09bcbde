"""Serialized messages that lie in one piece of memory, so that many are taken apart at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from dynmap_cli.arrays import I64, U8
from dynmap_cli.ingest.messages.stored import UNTIMELY
from dynmap_cli.ingest.raw.plausible import are_stamps

_LATEST = 2**63 - 1
_LEAST_AT_ONCE, _MOST_AT_ONCE, _BYTES_AT_ONCE = 64, 2048, 1 << 19


@dataclass(frozen=True, slots=True)
class Block:
    """Messages in the order of their recording.

    Attributes
    ----------
    content : (n_bytes,) uint8
        Their bytes, and perhaps others.
    starts, sizes : (n,) int64
        Where each lies in the content.
    channels : (n,) int64
        Number of the topic and type of each.
    logged_ns : (n,) int64
        When each was recorded.
    """

    content: U8
    starts: I64
    sizes: I64
    channels: I64
    logged_ns: I64

    @property
    def n_bytes(self) -> int:
        """Length of all messages."""
        return int(self.sizes.sum())

    def picked(self, rows: Any) -> Block:
        """Some of the messages."""
        return Block(
            self.content, self.starts[rows], self.sizes[rows], self.channels[rows], self.logged_ns[rows]
        )

    def data_of(self, row: int) -> bytes:
        """One message."""
        start = int(self.starts[row])
        return self.content[start : start + int(self.sizes[row])].tobytes()

    def columns(self, place: int, size: int) -> U8:
        """(n, size) bytes that stand at one place in all messages, none of which is shorter than that."""
        return columns_of(self.content, self.starts + place, size)


def columns_of(content: U8, places: I64, size: int) -> U8:
    """(n, size) bytes of a content (n_bytes,) from each of the places (n,) on.

    Raises
    ------
    ValueError
        If there are no such places.
    """
    if size == 0 or places.size == 0:
        return np.zeros((places.size, size), dtype=np.uint8)
    if int(places.min()) < 0 or int(places.max()) + size > content.size:
        msg = "places outside the content"
        raise ValueError(msg)
    # Overlapping rows, one from each byte on, of which some are copied, each as one piece.
    windows = np.ndarray((content.size - size + 1,), np.dtype((np.void, size)), content.data, strides=(1,))
    return np.asarray(windows[places].view(np.uint8).reshape(-1, size))


def block_of(data: Sequence[bytes], channels: Any, logged_ns: Any) -> Block:
    """A block of single messages, with the number of the channel and the time of recording (n,) of each.

    A time that 64 bits with a sign do not hold is no time, whatever stands for it: the latest they hold.
    """
    sizes = np.fromiter(map(len, data), dtype=np.int64, count=len(data))
    return Block(
        np.frombuffer(b"".join(data), dtype=np.uint8),
        np.cumsum(sizes) - sizes,
        sizes,
        np.asarray(channels, dtype=np.int64),
        _as_int64(logged_ns),
    )


def _as_int64(logged_ns: Any) -> I64:
    """(n,) integers; what is too large in a damaged file becomes the largest."""
    try:
        return np.asarray(logged_ns, dtype=np.int64)
    except OverflowError:
        return np.array([min(int(stamp_ns), _LATEST) for stamp_ns in logged_ns], dtype=np.int64)


def blocks_of_rows(rows: Iterator[tuple[int, int, bytes]]) -> Iterator[Block]:
    """Yield messages that come one by one, each behind the number of its channel and its time, half a MiB at a time."""
    for channels, logged_ns, data in columns_of_rows(rows):
        yield block_of_rows(data, channels, logged_ns)


def columns_of_rows(rows: Iterator[tuple[Any, Any, Any]]) -> Iterator[tuple[list[Any], list[Any], list[Any]]]:
    """Yield rows of a number, a time, and bytes or nothing, as columns of half a MiB."""
    n_at_once = _LEAST_AT_ONCE
    while True:
        channels, logged_ns, data = [], [], []
        # No rows are kept, for each would be new memory.
        for channel, stamp_ns, message in islice(rows, n_at_once):
            channels.append(channel)
            logged_ns.append(stamp_ns)
            data.append(message)
        if not data:
            return
        yield channels, logged_ns, data
        n_bytes = sum(map(len, filter(None, data)))
        n_at_once = min(max(_BYTES_AT_ONCE * len(data) // (n_bytes + 1), 1), 2 * n_at_once, _MOST_AT_ONCE)


def block_of_rows(data: Sequence[Any], channels: Any, logged_ns: Sequence[Any]) -> Block:
    """A block of rows of a table, which may hold anything.

    Times that are none are refused as well: who reads message by message leaves these out, and counts them as lost.

    Raises
    ------
    ValueError
        If there are rows that are no messages.
    """
    check_rows(logged_ns, data)
    block = block_of(data, channels, logged_ns)
    if not are_stamps(block.logged_ns).all():
        raise ValueError(UNTIMELY)
    return block


def check_rows(logged_ns: Iterable[object], data: Iterable[object]) -> None:
    """Refuse what is no message: a .db3 may hold anything, and a time that is a fraction would be cut in silence.

    Raises
    ------
    ValueError
    """
    if {*map(type, logged_ns)} != {int} or not {*map(type, data)} <= {bytes, memoryview}:
        msg = "rows are no messages"
        raise ValueError(msg)


def joined(blocks: Sequence[Block]) -> Block:
    """Blocks, of which there is at least one, one after the other."""
    if len(blocks) == 1:
        return blocks[0]
    before = np.cumsum([0, *(block.content.size for block in blocks[:-1])])
    return Block(
        np.concatenate([block.content for block in blocks]),
        np.concatenate([block.starts + moved for block, moved in zip(blocks, before, strict=True)]),
        np.concatenate([block.sizes for block in blocks]),
        np.concatenate([block.channels for block in blocks]),
        np.concatenate([block.logged_ns for block in blocks]),
    )


def packed(block: Block) -> Block:
    """The same messages without what lies between them; for few of a large block."""
    data = [block.data_of(row) for row in range(block.starts.size)]
    return block_of(data, block.channels, block.logged_ns)
