"""Messages of a .db3 that rosbags has opened: the same rows in the same order, many at a time.

SQLite gives rows of equal time in an order of its own, so the query is that of rosbags, word by word.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dynmap_cli.ingest.messages.blocks import Block, blocks_of_rows

_QUERY = (
    "SELECT topics.id,messages.timestamp,messages.data FROM messages JOIN topics ON messages.topic_id=topics.id "
    "WHERE topics.id IN ({}) ORDER BY timestamp"
)


def db3_blocks(storage: Any, wanted: Mapping[int, int]) -> Iterator[Block]:
    """Yield the messages of some topics.

    Parameters
    ----------
    storage : Sqlite3Reader
    wanted : dict of int to int
        By number of the topic in the file: the number that it has in the blocks.
    """
    topics = np.array(sorted(wanted), dtype=np.int64)
    numbers = np.array([wanted[topic] for topic in topics.tolist()], dtype=np.int64)
    rows = storage.dbconn.execute(_QUERY.format(",".join("?" * len(wanted))), topics.tolist())
    for block in blocks_of_rows(rows):
        yield replace(block, channels=numbers[np.searchsorted(topics, block.channels)])
