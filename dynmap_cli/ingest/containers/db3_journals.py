"""Journals that a recorder which was killed left beside a .db3: SQLite plays them back into a copy.

`-wal` holds what was written last and is not in the file yet; `-journal` the pages as they were before a transaction
that was broken off. The readers of .db3 files look for neither, for that would write beside the recording.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

from dynmap_cli.ingest.containers.db3_tables import STEPS_AT_ONCE, WorkBound
from dynmap_cli.ingest.messages.stored import words_of
from dynmap_cli.printable import printable

_WAL, _JOURNAL = "-wal", "-journal"
_WAL_BYTES, _FRAME_BYTES = 32, 24
"""Heads of a write-ahead log, and of each page in it."""
_JOURNAL_MAGIC = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
_BLOCK_BYTES = 1 << 20
_SPARE_BYTES = 1 << 26
"""Room that is left on the disk."""


def journals_of(file: Path) -> list[Path]:
    """What lies beside a .db3: a write-ahead log that is not empty, and a rollback journal that is not done with."""
    log, journal = (file.with_name(file.name + suffix) for suffix in (_WAL, _JOURNAL))
    found = [log] if log.is_file() and log.stat().st_size > 0 else []
    return [*found, journal] if journal.is_file() and not _is_done_with(journal) else found


def _is_done_with(journal: Path) -> bool:
    """Whether the head of a rollback journal was wiped, or it is empty; one that cannot be read may not be."""
    try:
        with journal.open("rb") as stream:
            return stream.read(len(_JOURNAL_MAGIC)) != _JOURNAL_MAGIC
    except OSError:
        return False


def join_journals(file: Path, target: Path, limit_bytes: int) -> tuple[int, list[str]]:
    """Make *target* a copy of a .db3 into which its journals were played back; a link to it where that fails.

    Returns how many bytes were copied, and what is said of it.
    """
    journals = journals_of(file)
    n_bytes = sum(one.stat().st_size for one in (file, *journals))
    names = ", ".join(printable(one.name) for one in journals)
    free = shutil.disk_usage(target.parent).free - _SPARE_BYTES
    # What is written back may lie behind the end of the file.
    if 2 * n_bytes > min(limit_bytes, free):
        why = "a copy of the two would not fit on the disk or into ingest.max_unpacked_gib"
    else:
        try:
            said = _played_back(file, target, journals)
        except (OSError, sqlite3.Error) as err:
            why = words_of(err)
        else:
            return n_bytes, said
    for leftover in (target, *_beside(target)):
        leftover.unlink(missing_ok=True)
    target.symlink_to(file.resolve())
    return 0, [f"{names} beside it, of a recorder that was killed, is not read: {why}"]


def _beside(target: Path) -> Iterator[Path]:
    """What SQLite may have made beside a copy."""
    for suffix in (_WAL, _JOURNAL, "-shm"):
        yield target.with_name(target.name + suffix)


def _played_back(file: Path, target: Path, journals: list[Path]) -> list[str]:
    """Copy a .db3 with its journals, and let SQLite bring them together; what was done, a sentence for each."""
    if any(_names_another_file(one) for one in journals):
        # SQLite deletes the file that such a journal names.
        msg = "it belongs to a transaction over several files"
        raise sqlite3.NotSupportedError(msg)
    # The log first: a recorder that still runs may move what is in it into the file meanwhile.
    for one in (*journals, file):
        _copy(one, target.with_name(target.name + one.name.removeprefix(file.name)))
    address = f"file:{quote(str(target))}?mode=rw"
    with closing(sqlite3.connect(address, uri=True, isolation_level=None)) as connection:
        connection.set_progress_handler(WorkBound(target), STEPS_AT_ONCE)
        connection.execute("SELECT count(*) FROM sqlite_master").fetchall()
        ((page_bytes,),) = connection.execute("PRAGMA page_size").fetchall()
        ((_, _, n_pages),) = connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
        connection.execute("PRAGMA journal_mode=DELETE").fetchall()
    return [_said(one, max(n_pages, 0) * (page_bytes + _FRAME_BYTES)) for one in journals]


def _said(journal: Path, n_read: int) -> str:
    """What was done with one journal."""
    name, size = printable(journal.name), journal.stat().st_size
    if journal.name.endswith(_JOURNAL):
        return f"{name} ({size} bytes) beside it, of a transaction that was broken off, was played back into a copy"
    return (
        f"{name} beside it, of a recorder that was not closed: {n_read and n_read + _WAL_BYTES} of its {size} bytes "
        "are read into a copy"
    )


def _names_another_file(journal: Path) -> bool:
    """Whether a rollback journal ends with the name of a journal above it."""
    with journal.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(size - len(_JOURNAL_MAGIC), 0))
        return journal.name.endswith(_JOURNAL) and stream.read() == _JOURNAL_MAGIC


def _copy(source: Path, target: Path) -> None:
    with source.open("rb") as stream, target.open("wb") as out:
        shutil.copyfileobj(stream, out, _BLOCK_BYTES)
