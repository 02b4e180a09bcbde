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
from typing import NoReturn
from urllib.parse import quote

from dynmap_cli.ingest.containers.db3_journal_pages import (
    FRAME_BYTES,
    JOURNAL_MAGIC,
    LOG_BYTES,
    fault_of_log,
    pages_of_journal,
)
from dynmap_cli.ingest.containers.db3_tables import STEPS_AT_ONCE, WorkBound
from dynmap_cli.ingest.containers.remarks import Remark
from dynmap_cli.ingest.messages.stored import words_of
from dynmap_cli.printable import printable

_WAL, _JOURNAL = "-wal", "-journal"
_BLOCK_BYTES = 1 << 20
_SPARE_BYTES = 1 << 26
"""Room that is left on the disk."""


def journals_of(file: Path) -> list[Path]:
    """What lies beside a .db3: a write-ahead log that is not empty, and a rollback journal that is not done with."""
    log, journal = (file.with_name(file.name + suffix) for suffix in (_WAL, _JOURNAL))
    found = [log] if log.is_file() and log.stat().st_size > 0 else []
    return [*found, journal] if journal.is_file() and not _is_done_with(journal) else found


def odd_journals(file: Path) -> list[Remark]:
    """Say what beside a .db3 is named like a journal of it and is no regular file, so that it is not looked into."""
    found = (file.with_name(file.name + suffix) for suffix in (_WAL, _JOURNAL))
    return [
        Remark(f"{printable(one.name)} beside it is no regular file and is not read")
        for one in found
        if (one.exists() or one.is_symlink()) and not one.is_file()
    ]


def is_named_journal(file: Path) -> bool:
    """Whether a file is named like a journal of a .db3."""
    return file.name.endswith((f".db3{_WAL}", f".db3{_JOURNAL}"))


def _is_done_with(journal: Path) -> bool:
    """Whether the head of a rollback journal was wiped, or it is empty; one that cannot be read may not be."""
    try:
        with journal.open("rb") as stream:
            return stream.read(len(JOURNAL_MAGIC)) != JOURNAL_MAGIC
    except OSError:
        return False


def join_journals(file: Path, target: Path, limit_bytes: int) -> tuple[int, list[Remark]]:
    """Make *target* a copy of a .db3 into which its journals were played back; a link to it where that fails.

    Returns how many bytes were copied, and what is said of it.
    """
    journals = journals_of(file)
    n_bytes = sum(one.stat().st_size for one in (file, *journals))
    names = ", ".join(printable(one.name) for one in journals)
    free = shutil.disk_usage(target.parent).free - _SPARE_BYTES
    # What is written back may lie behind the end of the file.
    most_bytes = 2 * n_bytes
    is_loss = False
    if most_bytes > min(limit_bytes, free):
        why = "a copy of the two would not fit on the disk or into ingest.max_unpacked_gib"
    else:
        try:
            said = _played_back(file, target, journals)
            if target.stat().st_size > most_bytes:
                _refuse_size()
        except OSError as err:
            why = words_of(err)
        except sqlite3.Error as err:
            why, is_loss = words_of(err), True
        else:
            return n_bytes, said
    for leftover in (target, *_beside(target)):
        leftover.unlink(missing_ok=True)
    target.symlink_to(file.resolve())
    return 0, [Remark(f"{names} beside it, of a recorder that was killed, is not read: {why}", is_loss)]


def _beside(target: Path) -> Iterator[Path]:
    """What SQLite may have made beside a copy."""
    for suffix in (_WAL, _JOURNAL, "-shm"):
        yield target.with_name(target.name + suffix)


def _played_back(file: Path, target: Path, journals: list[Path]) -> list[Remark]:
    """Copy a .db3 with its journals, and let SQLite bring them together; what was done, a sentence for each."""
    if any(_names_another_file(one) for one in journals):
        # SQLite deletes the file that such a journal names.
        msg = "it belongs to a transaction over several files"
        raise sqlite3.NotSupportedError(msg)
    # The log first: a recorder that still runs may move what is in it into the file meanwhile.
    copies = {
        one: target.with_name(target.name + one.name.removeprefix(file.name)) for one in (*journals, file)
    }
    for one, copy in copies.items():
        _copy(one, copy)
    n_bytes = sum(copy.stat().st_size for copy in copies.values())
    said = [_said_of_journal(one, copies[one], n_bytes) for one in journals if one.name.endswith(_JOURNAL)]
    address = f"file:{quote(str(target))}?mode=rw"
    with closing(sqlite3.connect(address, uri=True, isolation_level=None)) as connection:
        connection.set_progress_handler(WorkBound(target), STEPS_AT_ONCE)
        connection.execute("SELECT count(*) FROM sqlite_master").fetchall()
        ((page_bytes,),) = connection.execute("PRAGMA page_size").fetchall()
        ((_, _, n_pages),) = connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
        said += [
            _said_of_log(one, copies[one], max(n_pages, 0), page_bytes)
            for one in journals
            if one.name.endswith(_WAL)
        ]
        connection.execute("PRAGMA journal_mode=DELETE").fetchall()
    return said


def _said_of_log(log: Path, copy: Path, n_pages: int, page_bytes: int) -> Remark:
    """What was done with a write-ahead log, of which SQLite read the first pages of its copy."""
    size = copy.stat().st_size
    n_read = n_pages * (page_bytes + FRAME_BYTES) + LOG_BYTES if n_pages else 0
    told = (
        f"{printable(log.name)} beside it, of a recorder that was not closed: {n_read} of its {size} bytes "
        "are read into a copy"
    )
    why = fault_of_log(copy, n_pages)
    if why:
        return Remark(f"{told}; it is damaged or cut off, {why}", is_loss=True)
    if n_read < size:
        told += ", the others were written back before or are of no whole transaction"
    return Remark(told)


def _said_of_journal(journal: Path, copy: Path, n_bytes: int) -> Remark:
    """What will be done with a rollback journal.

    Raises
    ------
    sqlite3.Error
        If nothing of it can be played back, or it would make the file larger than what is there, *n_bytes*.
    """
    pages = pages_of_journal(copy)
    if pages is None:
        msg = "its head is damaged"
        raise sqlite3.DatabaseError(msg)
    if pages.file_bytes > n_bytes:
        _refuse_size()
    if pages.n_stated and not pages.n_whole:
        msg = f"none of its {pages.n_stated} pages is whole"
        raise sqlite3.DatabaseError(msg)
    told = f"{printable(journal.name)} ({copy.stat().st_size} bytes) beside it, of a transaction that was broken off,"
    if pages.n_whole < pages.n_stated:
        return Remark(
            f"{told} is damaged or cut off: {pages.n_whole} of its {pages.n_stated} pages were played back into a copy",
            is_loss=True,
        )
    return Remark(
        f"{told} was played back into a copy" if pages.n_whole else f"{told} has no page to play back"
    )


def _refuse_size() -> NoReturn:
    msg = "it states more pages than it and the file have room for"
    raise sqlite3.DatabaseError(msg)


def _names_another_file(journal: Path) -> bool:
    """Whether a rollback journal ends with the name of a journal above it."""
    with journal.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(size - len(JOURNAL_MAGIC), 0))
        return journal.name.endswith(_JOURNAL) and stream.read() == JOURNAL_MAGIC


def _copy(source: Path, target: Path) -> None:
    with source.open("rb") as stream, target.open("wb") as out:
        shutil.copyfileobj(stream, out, _BLOCK_BYTES)
