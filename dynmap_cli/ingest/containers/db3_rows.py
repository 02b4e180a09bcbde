"""Messages of a damaged .db3 in the order of their numbers; gaps are jumped over."""

from __future__ import annotations

import sqlite3
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

from dynmap_cli.ingest.messages.stored import (
    ORPHAN,
    Channel,
    Losses,
    StoredMessage,
    nameless_topics,
    text_of,
    words_of,
)

_MOST_GAPS = 200
_FARTHEST_JUMP = 1 << 32
_HEADER = struct.Struct(">16xH10xI")


def db3_messages(path: Path, losses: Losses) -> Iterator[StoredMessage]:
    """Yield what can be read. `writable_schema` makes SQLite open a file that is shorter than its header says."""
    losses.n_bytes += path.stat().st_size
    losses.note_missing(_missing_bytes(path))
    address = f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1"
    connection = sqlite3.connect(address, uri=True, isolation_level=None)
    try:
        connection.text_factory = lambda text: text.decode("utf-8", "replace")
        connection.execute("PRAGMA writable_schema=ON")
        topics = _topics(connection, losses)
        counts: Counter[int] = Counter()
        for topic_id, stamp_ns, data in _rows(connection, losses):
            if (
                isinstance(topic_id, int)
                and topic_id in topics
                and isinstance(stamp_ns, int)
                and isinstance(data, bytes)
            ):
                yield StoredMessage(stamp_ns, stamp_ns, counts[topic_id], topics[topic_id], data)
                counts[topic_id] += 1
            else:
                is_orphan = isinstance(stamp_ns, int) and isinstance(data, bytes)
                losses.note(ORPHAN if is_orphan else "rows are no messages", messages=1)
    except sqlite3.Error as err:
        losses.note(words_of(err))
    finally:
        connection.close()


def _topics(connection: sqlite3.Connection, losses: Losses) -> dict[int, Channel]:
    """Channels by number; bags before ROS 2 Iron hold no definitions of types, the first ones no profiles."""
    offered = dict(_optional(connection, "SELECT id, offered_qos_profiles FROM topics"))
    definitions = {
        kind: (str(written), str(text).encode())
        for kind, written, text in _optional(
            connection, "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        if written and text
    }
    topics = {}
    rows = list(connection.execute("SELECT id, name, type, serialization_format FROM topics"))
    for why in nameless_topics((name, kind) for _, name, kind, _ in rows):
        losses.note(why)
    for number, name, kind, encoding in rows:
        profiles = (("offered_qos_profiles", str(offered.get(number) or "")),)
        schema = definitions.get(kind, ("", b""))
        topics[number] = Channel(text_of(name), str(encoding), text_of(kind), *schema, profiles)
    return topics


def _optional(connection: sqlite3.Connection, query: str) -> list[tuple[Any, ...]]:
    """Rows of a query; none where the bag has no such table or column, or it is damaged."""
    try:
        return list(connection.execute(query))
    except sqlite3.Error:
        return []


def _rows(connection: sqlite3.Connection, losses: Losses) -> Iterator[tuple[object, object, object]]:
    """Rows by ascending number; behind one that cannot be read the next is looked for in growing steps."""
    last, jump, gaps = -1, 1, 0
    while gaps < _MOST_GAPS and jump < _FARTHEST_JUMP:
        query = "SELECT id, topic_id, timestamp, data FROM messages WHERE id >= ? ORDER BY id"
        try:
            for number, *row in connection.execute(query, (last + jump,)):
                if not isinstance(number, int) or number <= last:
                    msg = "rows are out of order"
                    raise sqlite3.DatabaseError(msg)
                if jump > 1:
                    losses.note("rows are missing", messages=number - last - 1)
                last, jump = number, 1
                yield row[0], row[1], row[2]
            return
        except sqlite3.Error as err:
            losses.note(words_of(err))
            gaps += jump == 1
            jump *= 2


def _missing_bytes(path: Path) -> int:
    """How much shorter the file is than its header says."""
    with path.open("rb") as stream:
        header = stream.read(_HEADER.size)
    if len(header) < _HEADER.size:
        return 0
    page_bytes, n_pages = (int(number) for number in _HEADER.unpack(header))
    return n_pages * (page_bytes if page_bytes > 1 else 1 << 16) - path.stat().st_size
