"""Messages of a damaged .db3 in the order of their numbers; gaps are jumped over."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from dynmap_cli.ingest.plausible import printable
from dynmap_cli.ingest.stored import Losses, StoredMessage, words_of

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
        topics = {
            number: (printable(str(name)), printable(str(kind)), str(encoding))
            for number, name, kind, encoding in connection.execute(
                "SELECT id, name, type, serialization_format FROM topics"
            )
        }
        for topic_id, stamp_ns, data in _rows(connection, losses):
            if topic_id in topics and isinstance(stamp_ns, int) and isinstance(data, bytes):
                name, kind, encoding = topics[topic_id]
                yield StoredMessage(name, kind, encoding, stamp_ns, data)
            else:
                losses.note("rows are no messages", messages=1)
    except sqlite3.Error as err:
        losses.note(words_of(err))
    finally:
        connection.close()


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
