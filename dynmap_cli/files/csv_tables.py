"""Tables of comma-separated values that somebody else may have written, or a `ValueError`."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

from dynmap_cli.files.documents import as_text
from dynmap_cli.files.plain_values import said

_MOST_WHOLE = 2**31 - 1


def rows_of(content: bytes, columns: Sequence[str], name: str) -> Iterator[tuple[str, dict[str, str]]]:
    """Rows of a table by column, each with the words for where it stands.

    Parameters
    ----------
    content : bytes
        UTF-8 with a header.
    columns : sequence of str
        The header.
    name : str
        Of the table, for messages.
    """
    reader = csv.reader(io.StringIO(as_text(content, name), newline=""), strict=True)
    try:
        header = next(reader, [])
        if header != list(columns):
            msg = f"{name} has the columns {said(header)}, not {','.join(columns)}"
            raise ValueError(msg)
        for row in reader:
            where = f"{name} line {reader.line_num}"
            if len(row) != len(columns):
                msg = f"{where} has {len(row)} columns, not {len(columns)}"
                raise ValueError(msg)
            yield where, dict(zip(columns, row, strict=True))
    except csv.Error as err:
        msg = f"{name} line {reader.line_num} is not a line of comma-separated values"
        raise ValueError(msg) from err


def whole_in(word: str, where: str) -> int:
    """A whole number of a table, digits only; raises ValueError."""
    if not (word.isascii() and word.isdecimal() and len(word) <= 10 and int(word) <= _MOST_WHOLE):
        msg = f"{where} is {said(word)}, not a whole number from 0 to {_MOST_WHOLE}"
        raise ValueError(msg)
    return int(word)
