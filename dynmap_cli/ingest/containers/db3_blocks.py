"""Messages of a .db3 that rosbags has opened, many at a time, and counted on the way.

SQLite gives the rows by an index, and an index may leave some out: what is counted is compared with the table. Rows
that are not asked for come without their bytes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import compress
from typing import Any, NamedTuple

from dynmap_cli.ingest.containers.db3_opening import Db3Reader
from dynmap_cli.ingest.messages.blocks import Block, block_of_rows, columns_of_rows

_QUERY = "SELECT topic_id, timestamp, CASE WHEN topic_id IN ({}) THEN data END FROM messages ORDER BY timestamp, rowid"


def db3_blocks(storage: Db3Reader, wanted: Mapping[int, int]) -> Iterator[Block]:
    """Yield the messages of some topics by the time of their recording; those of equal time in the order of the table.

    Parameters
    ----------
    storage : Db3Reader
        Knows afterwards how many messages it has of each topic.
    wanted : dict of int to int
        By number of the topic in the file: the number that it has in the blocks.

    Raises
    ------
    ReaderError
        After the last one, if the index leaves out messages, or after any, if there are more than the file has room.
    ValueError
        If there are rows that are no messages.
    """
    query = _QUERY.format(",".join("?" * len(wanted)))
    counts: Counter[Any] = Counter()
    with storage.bounded() as database:
        for topics, logged_ns, data in columns_of_rows(database.execute(query, [*wanted])):
            counts.update(topics)
            rows = _asked_for(list(map(wanted.get, topics)), logged_ns, data)
            if rows.data:
                yield block_of_rows(rows.data, rows.channels, rows.logged_ns)
    storage.take_counts(counts)


class _Rows(NamedTuple):
    """Columns of rows: the number of the channel of each in the blocks, its time and its bytes."""

    channels: Sequence[Any]
    logged_ns: Sequence[Any]
    data: Sequence[Any]


def _asked_for(channels: list[int | None], logged_ns: list[Any], data: list[Any]) -> _Rows:
    """Those that have a channel."""
    if None not in channels:
        return _Rows(channels, logged_ns, data)
    is_asked_for = [channel is not None for channel in channels]
    return _Rows(*(list(compress(column, is_asked_for)) for column in (channels, logged_ns, data)))
