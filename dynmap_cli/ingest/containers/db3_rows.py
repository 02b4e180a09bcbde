"""Messages of a damaged .db3 in the order of their numbers; gaps are jumped over."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from dynmap_cli.ingest.containers.db3_tables import (
    DEFINITIONS,
    MESSAGES,
    MOST_TOPICS,
    TOO_LONG,
    TOPICS,
    bytes_behind,
    odd_tables,
    open_tables,
    size_by_header,
    words_of_database,
)
from dynmap_cli.ingest.messages.stored import (
    ORPHAN,
    Channel,
    Losses,
    StoredMessage,
    nameless_topics,
    text_of,
    words_of_encoding,
)

_MOST_GAPS = 200
_FARTHEST_JUMP = 1 << 32
_LEAST_NUMBER = -(1 << 63)
_USUAL_ENCODING = "cdr"


def db3_messages(path: Path, losses: Losses) -> Iterator[StoredMessage]:
    """Yield what can be read. `writable_schema` makes SQLite open a file that is shorter than its header says."""
    losses.n_bytes += path.stat().st_size
    losses.note_missing(size_by_header(path) - path.stat().st_size)
    losses.note_behind(bytes_behind(path))
    try:
        with open_tables(path) as connection:
            connection.text_factory = lambda text: text.decode("utf-8", "backslashreplace")
            connection.execute("PRAGMA writable_schema=ON")
            odd = odd_tables(connection)
            for why in odd.values():
                losses.note(why)
            if MESSAGES in odd:
                return
            topics = (
                {} if TOPICS in odd else _topics(connection, losses, has_definitions=DEFINITIONS not in odd)
            )
            yield from _messages(connection, topics, losses)
    except (sqlite3.Error, UnicodeDecodeError) as err:
        losses.note(words_of_database(err))


def _messages(
    connection: sqlite3.Connection, topics: Mapping[object, Channel], losses: Losses
) -> Iterator[StoredMessage]:
    """Rows that are messages of the topics, by their numbers."""
    counts: Counter[object] = Counter()
    for topic_id, stamp_ns, data in _rows(connection, losses):
        if not (isinstance(stamp_ns, int) and isinstance(data, bytes)):
            losses.note("rows have no time in whole nanoseconds or no data", messages=1)
        elif topic_id in topics:
            yield StoredMessage(stamp_ns, stamp_ns, counts[topic_id], topics[topic_id], data)
            counts[topic_id] += 1
        else:
            losses.note(ORPHAN, messages=1)


def _topics(
    connection: sqlite3.Connection, losses: Losses, *, has_definitions: bool
) -> dict[object, Channel]:
    """Channels by number; bags before ROS 2 Iron hold no definitions of types, the first ones no profiles."""
    offered = dict(_optional(connection, "SELECT id, offered_qos_profiles FROM topics"))
    query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions LIMIT ?"
    definitions = {
        kind: (str(written), str(text).encode())
        for kind, written, text in (_optional(connection, query, MOST_TOPICS) if has_definitions else [])
        if written and text
    }
    query = "SELECT id, name, type, serialization_format FROM topics LIMIT ?"
    rows = connection.execute(query, (MOST_TOPICS,)).fetchall()
    for why in nameless_topics((name, kind) for _, name, kind, _ in rows):
        losses.note(why)
    names = _names([(number, name) for number, name, *_ in rows])
    topics: dict[object, Channel] = {}
    for (number, _, kind, stated), name in zip(rows, names, strict=True):
        if number in topics:
            losses.note(
                f"{topics[number].topic} and {name} have one number, so their messages are not told apart"
            )
        encoding = text_of(stated) if isinstance(stated, str) else _USUAL_ENCODING
        if not isinstance(stated, str):
            losses.note(words_of_encoding(name))
        profiles = (("offered_qos_profiles", str(offered.get(number) or "")),)
        schema = definitions.get(kind, ("", b""))
        topics[number] = Channel(name, encoding, text_of(kind), *schema, profiles)
    return topics


def _names(rows: Sequence[tuple[object, object]]) -> list[str]:
    """Names of topics from their numbers and names; those that are no text are kept apart from all others."""
    taken = {name for _, name in rows if isinstance(name, str)}
    names = []
    for number, name in rows:
        shown = text_of(name)
        if not isinstance(name, str) and (not shown or shown in taken):
            shown = f"{shown or '/nameless'}_{text_of(number)}"
        taken.add(shown)
        names.append(shown)
    return names


def _optional(connection: sqlite3.Connection, query: str, *values: int) -> list[tuple[Any, ...]]:
    """Rows of a query; none where the bag has no such table or column, or it is damaged."""
    try:
        return connection.execute(query, values).fetchall()
    except (sqlite3.Error, UnicodeDecodeError):
        return []


def _rows(connection: sqlite3.Connection, losses: Losses) -> Iterator[tuple[object, object, object]]:
    """Rows by ascending number; behind one that cannot be read the next is looked for in growing steps."""
    last, jump, gaps = _LEAST_NUMBER, 0, 0
    while gaps < _MOST_GAPS and jump < _FARTHEST_JUMP:
        query = "SELECT rowid, topic_id, timestamp, data FROM messages WHERE rowid >= ? ORDER BY rowid"
        try:
            for number, *row in connection.execute(query, (last + jump,)):
                if not isinstance(number, int) or number < last + jump:
                    msg = "rows are out of order"
                    raise sqlite3.DatabaseError(msg)
                if jump > 1:
                    losses.note("rows are missing", messages=number - last - 1)
                last, jump = number, 1
                yield row[0], row[1], row[2]
            return
        except (sqlite3.Error, UnicodeDecodeError) as err:
            why = words_of_database(err)
            losses.note(why)
            if why == TOO_LONG:
                return
            # Recorders number from 1 on.
            last = max(last, 0)
            gaps += jump <= 1
            jump = max(2 * jump, 1)
