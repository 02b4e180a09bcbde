"""Tables of words and numbers for people."""

from __future__ import annotations

from collections.abc import Sequence


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Columns of equal width, two blanks apart; numbers to the right."""
    widths = [max(len(row[column]) for row in [header, *rows]) for column in range(len(header))]
    is_number = [
        all(row[column] == "-" or row[column].replace(".", "").lstrip("-").isdigit() for row in rows)
        for column in range(len(header))
    ]
    return [
        "  "
        + "  ".join(
            word.rjust(width) if number else word.ljust(width)
            for word, width, number in zip(row, widths, is_number, strict=True)
        ).rstrip()
        for row in [header, *rows]
    ]
