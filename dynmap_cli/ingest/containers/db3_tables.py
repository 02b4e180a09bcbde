"""A .db3 before it is read: what may take for ever, or hides rows, is found first, and nothing else is run.

SQL in a file can make a table of nothing: a view, a virtual table, a computed column. Pages that are used over and
over do the same. So only real tables are read, for no longer than a file of its size takes.
"""

from __future__ import annotations

import os
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from dynmap_cli.ingest.messages.stored import words_of

MESSAGES, TOPICS, DEFINITIONS = "messages", "topics", "message_definitions"
MOST_TOPICS = 10_000
_LOOKED_AT = (MESSAGES, TOPICS, DEFINITIONS, "schema", "metadata")
_STEPS_AT_LEAST, _STEPS_PER_BYTE = 1 << 23, 2
"""Steps of SQLite's machine; a row takes about ten of them, and not less than 20 bytes."""
STEPS_AT_ONCE = 1 << 14
_BY_INDEX = 'SELECT total(1) FROM messages INDEXED BY "{}"'
_NUMBERS = "SELECT count(DISTINCT id) FROM topics NOT INDEXED WHERE typeof(id) = 'integer'"
_HEADER = struct.Struct(">16xH6xII60xI")
"""Size of a page, changes of the file, its number of pages, and the change at which that was right."""
TOO_LONG = "its tables hold more rows than have room in the file"


class WorkBound:
    """Progress handler that ends a query when all of a connection took more steps than a file of its size is worth."""

    def __init__(self, path: Path) -> None:
        self._left = _STEPS_AT_LEAST + _STEPS_PER_BYTE * path.stat().st_size

    def __call__(self) -> int:
        """Be called every `STEPS_AT_ONCE` steps."""
        self._left -= STEPS_AT_ONCE
        return int(self.is_over)

    @property
    def is_over(self) -> bool:
        """Whether it took more."""
        return self._left < 0


@contextmanager
def open_tables(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a .db3 to be read only, with a bound on the work it may take; no file beside it is made or looked for.

    Raises
    ------
    sqlite3.Error
        From its queries, if it is damaged or takes too long.
    """
    address = f"file:{quote(os.fsencode(path.resolve()))}?mode=ro&immutable=1"
    connection = sqlite3.connect(address, uri=True, isolation_level=None)
    connection.set_progress_handler(WorkBound(path), STEPS_AT_ONCE)
    try:
        yield connection
    finally:
        connection.close()


def odd_tables(connection: Any) -> dict[str, str]:
    """What is wrong with each table that is read and is none, or has columns that are computed."""
    faults = {}
    query = "SELECT name, type, sql FROM sqlite_master WHERE lower(name) = ?"
    for table in _LOOKED_AT:
        for _, kind, statement in connection.execute(query, (table,)).fetchall():
            is_plain = str(statement).upper().split()[:2] == ["CREATE", "TABLE"]
            if kind != "table" or not is_plain:
                what = "a virtual table" if kind == "table" else f"a {kind}"
                faults[table] = f"its {table} is {what}, which is not read"
                continue
            columns = connection.execute(f"PRAGMA table_xinfo({table})").fetchall()
            computed = [str(name) for _, name, *_, hidden in columns if hidden]
            if computed:
                faults[table] = f"its {table} has the computed column {computed[0]!r}, which is not read"
    return faults


def size_by_header(path: Path) -> int:
    """How long a file should be, by its header; 0 where the header does not say."""
    with path.open("rb") as stream:
        header = stream.read(_HEADER.size)
    if len(header) < _HEADER.size:
        return 0
    page_bytes, changed, n_pages, valid_for = (int(number) for number in _HEADER.unpack(header))
    # Old versions of SQLite do not keep the number of pages.
    return n_pages * (page_bytes if page_bytes > 1 else 1 << 16) if changed == valid_for else 0


def bytes_behind(path: Path) -> int:
    """How many bytes lie behind the end of a file by its header; they are not read."""
    size = size_by_header(path)
    return max(path.stat().st_size - size, 0) if size else 0


def words_of_database(err: sqlite3.Error | UnicodeDecodeError) -> str:
    """What SQLite complains of, which may be in words of a damaged file that are none."""
    if isinstance(err, UnicodeDecodeError):
        return "database disk image is malformed"
    return TOO_LONG if str(err) == "interrupted" else words_of(err)


def odd_topics(connection: Any) -> Iterator[str]:
    """Say so where there are more than any robot has, or not each has a number of its own."""
    n_topics = _count(connection, "SELECT total(1) FROM topics NOT INDEXED")
    if n_topics > MOST_TOPICS:
        yield f"it has {n_topics} topics (at most {MOST_TOPICS})"
        return
    n_numbers = _count(connection, _NUMBERS)
    if n_topics and not n_numbers:
        yield f"none of its {n_topics} topics has a whole number"
    elif n_numbers != n_topics:
        yield f"its {n_topics} topics have {n_numbers} different numbers"


def odd_indexes(connection: Any, n_rows: int) -> Iterator[str]:
    """Say which indexes leave out some of the messages, or have too many: by these they are put into order."""
    query = "SELECT name FROM sqlite_master WHERE type = 'index' AND lower(tbl_name) = ? AND sql IS NOT NULL"
    for (name,) in connection.execute(query, (MESSAGES,)).fetchall():
        quoted = str(name).replace('"', '""')
        n_indexed = _count(connection, _BY_INDEX.format(quoted))
        if n_indexed != n_rows:
            yield f"its index {name!r} has {n_indexed} messages, its table {n_rows}"


def _count(connection: Any, query: str) -> int:
    """Number of rows, counted one by one, for only so the bound on the work holds."""
    ((count,),) = connection.execute(query).fetchall()
    return int(count)
