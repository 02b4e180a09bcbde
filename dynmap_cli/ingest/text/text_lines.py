"""Lines of a text log, whatever a broken disk or a foreign program left in it."""

from __future__ import annotations

import codecs
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

LONGEST_BYTES = 1 << 23
BYTE_ORDER_MARK = codecs.BOM_UTF8
"""Before the first line, from editors that write UTF-8 with it."""


@contextmanager
def _plain_lines(path: Path) -> Iterator[IO[bytes]]:
    """Open a file whose lines end with line feeds; a copy where they end with carriage returns alone."""
    with path.open("rb") as stream:
        head = stream.read(LONGEST_BYTES)
        stream.seek(0)
        if b"\r" not in head or b"\n" in head:
            yield stream
            return
        with tempfile.TemporaryFile() as copy:
            while block := stream.read(LONGEST_BYTES):
                copy.write(block.replace(b"\r", b"\n"))
            copy.seek(0)
            yield copy


def text_lines(path: Path, drop_broken: Callable[[str], None]) -> Iterator[tuple[int, bytes]]:
    """Yield number, from 1, and text of each line; lines with null bytes or over 8 MiB go to *drop_broken* instead."""
    number = 0
    with _plain_lines(path) as stream:
        if stream.read(len(BYTE_ORDER_MARK)) != BYTE_ORDER_MARK:
            stream.seek(0)
        while line := stream.readline(LONGEST_BYTES):
            number += 1
            if len(line) == LONGEST_BYTES and not line.endswith(b"\n"):
                drop_broken("line longer than 8 MiB")
                while line and not line.endswith(b"\n"):
                    line = stream.readline(LONGEST_BYTES)
            elif b"\x00" in line:
                drop_broken("line with null bytes, as unclean shutdowns leave them")
            else:
                yield number, line
