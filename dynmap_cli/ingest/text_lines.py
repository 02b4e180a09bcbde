"""Lines of a text log, whatever a broken disk or a foreign program left in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

_LONGEST_BYTES = 1 << 23


def text_lines(path: Path, dropped: Counter[str]) -> Iterator[bytes]:
    """Yield the lines of a file; those with null bytes, or longer than 8 MiB, are counted instead."""
    with path.open("rb") as stream:
        while line := stream.readline(_LONGEST_BYTES):
            if len(line) == _LONGEST_BYTES and not line.endswith(b"\n"):
                dropped["line longer than 8 MiB"] += 1
                while line and not line.endswith(b"\n"):
                    line = stream.readline(_LONGEST_BYTES)
            elif b"\x00" in line:
                dropped["line with null bytes, as unclean shutdowns leave them"] += 1
            else:
                yield line
