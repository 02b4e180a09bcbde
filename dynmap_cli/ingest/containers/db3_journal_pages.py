"""What is in the journals of SQLite by their own marks: pages that are whole, and pages that nobody can play back.

Formats: "Database File Format" of sqlite.org, sections 3 (rollback journal) and 4 (write-ahead log). Numbers are
32 bits, the first byte the highest.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO, NamedTuple

JOURNAL_MAGIC = b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
LOG_BYTES, FRAME_BYTES = 32, 24
"""Heads of a write-ahead log, and of each page in it."""
_LOG_HEAD = struct.Struct(">8I")
"""Magic, version, size of a page, checkpoints, two salts, two checksums."""
_FRAME_HEAD = struct.Struct(">4I")
"""Number of the page, pages of the file where a transaction ends here or 0, two salts."""
_LOG_MAGICS = (0x377F0682, 0x377F0683)
"""The second: numbers that are added up have their highest byte first."""
_MOST_RESTARTS = 1 << 20
"""How often a log was begun again at most, each time with its first salt one higher, since a page in it was left."""
_JOURNAL_HEAD = struct.Struct(">8x5I")
"""Pages in this part, start of checksums, pages of the file before, size of a sector, size of a page."""
_UP_TO_THE_END = 0xFFFFFFFF
_SUMMED_EVERY = 200
_WORD = 1 << 32


class JournalPages(NamedTuple):
    """Pages of a rollback journal.

    Attributes
    ----------
    n_stated : int
    n_whole : int
        Of these, before the first that is cut off or fails its checksum: SQLite plays back no others.
    file_bytes : int
        Size of the file before the transaction.
    """

    n_stated: int
    n_whole: int
    file_bytes: int


def fault_of_log(log: Path, n_read: int) -> str:
    """What is lost of a write-ahead log of which the first *n_read* pages were read; "" where nothing is.

    What was left of an earlier round was written back before the log was begun again, and of a transaction that was
    not ended nothing counts.
    """
    size = log.stat().st_size
    with log.open("rb") as stream:
        head = stream.read(LOG_BYTES)
        if len(head) < LOG_BYTES:
            return "it ends in its head" if head else ""
        _, _, page_bytes, _, *salts, _, _ = _LOG_HEAD.unpack(head)
        if not _is_head_whole(head):
            return "its head is damaged"
        n_pages, n_rest = divmod(size - LOG_BYTES, FRAME_BYTES + page_bytes)
        is_left_over = False
        for number in range(n_read, n_pages + 1):
            stream.seek(LOG_BYTES + number * (FRAME_BYTES + page_bytes))
            frame = stream.read(_FRAME_HEAD.size)
            if len(frame) < _FRAME_HEAD.size:
                break
            _, ends_at, first_salt, second_salt = _FRAME_HEAD.unpack(frame)
            if [first_salt, second_salt] != salts:
                is_left_over = 0 < (salts[0] - first_salt) % _WORD < _MOST_RESTARTS
            elif ends_at and number < n_pages:
                return f"the transaction with its page {number + 1} is not whole"
            elif is_left_over:
                return f"its page {number} is damaged"
            if not (is_left_over or [first_salt, second_salt] == salts):
                return f"its page {number + 1} is damaged"
    return f"it ends in its page {n_pages + 1}" if n_rest and not is_left_over else ""


def _is_head_whole(head: bytes) -> bool:
    """Whether a log begins as one, with the checksum that its first six numbers give."""
    magic, _, page_bytes, *_, first, second = _LOG_HEAD.unpack(head)
    if magic not in _LOG_MAGICS or not _is_power(page_bytes, 512):
        return False
    words = struct.unpack(">6I" if magic & 1 else "<6I", head[:24])
    sums = [0, 0]
    for even, odd in zip(words[::2], words[1::2], strict=True):
        sums[0] = (sums[0] + even + sums[1]) % _WORD
        sums[1] = (sums[1] + odd + sums[0]) % _WORD
    return sums == [first, second]


def pages_of_journal(journal: Path) -> JournalPages | None:
    """Count the pages of a rollback journal as SQLite plays them back; None where its head is damaged."""
    size = journal.stat().st_size
    n_stated = n_whole = offset = 0
    with journal.open("rb") as stream:
        head = stream.read(_JOURNAL_HEAD.size)
        if len(head) < _JOURNAL_HEAD.size:
            return None
        *_, n_before, sector_bytes, page_bytes = _JOURNAL_HEAD.unpack(head)
        if not (_is_power(sector_bytes, 32) and _is_power(page_bytes, 512)):
            return None
        while n_stated == n_whole and head.startswith(JOURNAL_MAGIC) and len(head) == _JOURNAL_HEAD.size:
            n_pages, start, *_ = _JOURNAL_HEAD.unpack(head)
            offset += sector_bytes
            if n_pages == _UP_TO_THE_END:
                n_pages = max(size - offset, 0) // (page_bytes + 8)
            stream.seek(offset)
            n_stated += n_pages
            n_whole += _whole_pages(stream, n_pages, page_bytes, start)
            offset += n_pages * (page_bytes + 8)
            offset += -offset % sector_bytes
            stream.seek(offset)
            head = stream.read(_JOURNAL_HEAD.size) if n_pages else b""
    return JournalPages(n_stated, n_whole, n_before * page_bytes)


def _whole_pages(stream: BinaryIO, n_pages: int, page_bytes: int, start: int) -> int:
    """How many of the next pages are there with their checksum: *start* plus every 200th byte from the end."""
    for number in range(n_pages):
        record = stream.read(page_bytes + 8)
        if len(record) < page_bytes + 8 or not any(record[:4]):
            return number
        summed = start + sum(record[4 + page_bytes - _SUMMED_EVERY : 4 : -_SUMMED_EVERY])
        if summed % _WORD != int.from_bytes(record[-4:], "big"):
            return number
    return n_pages


def _is_power(number: int, least: int) -> bool:
    """Whether a size is a power of two that SQLite knows."""
    return least <= number <= 1 << 16 and number & (number - 1) == 0
