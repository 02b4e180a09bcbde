"""What reading a file that is missing, cut off, damaged or of something else raises, as one line."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager

from dynmap_cli.errors import DynmapError
from dynmap_cli.printable import printable

DAMAGE = (
    OSError,
    EOFError,
    LookupError,
    TypeError,
    ValueError,
    AttributeError,
    ArithmeticError,
    MemoryError,
    RuntimeError,  # also RecursionError, and of zipfile: encrypted, unknown compression
    Warning,
    zipfile.BadZipFile,
    zlib.error,
)
_LONGEST_WORDS = 200
_PLAIN_WORDS: dict[type[BaseException], str] = {
    AttributeError: "a value of another kind than expected",
    TypeError: "a value of another kind than expected",
    IndexError: "fewer values than expected",
    MemoryError: "larger than the memory",
    RecursionError: "nested too deeply",
    EOFError: "it ends too early",
    zlib.error: "compressed data are damaged",
}
"""Where Python's own words would tell an operator nothing."""


def reason(error: BaseException) -> str:
    """Say in one line of printable characters what is wrong, without the path that stands before it."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if type(error) in _PLAIN_WORDS:
        return _PLAIN_WORDS[type(error)]
    words = printable(" ".join(str(error).split())) or type(error).__name__
    if isinstance(error, KeyError):
        words = f"{words} is missing"
    return words if len(words) <= _LONGEST_WORDS else f"{words[:_LONGEST_WORDS]}..."


@contextmanager
def refusing_damage(what: str, remedy: str, error: type[DynmapError]) -> Iterator[None]:
    """Turn whatever reading a damaged file raises into *error*: `<what> (<reason>). <remedy>`."""
    try:
        yield
    except DAMAGE as err:
        msg = f"{what} ({reason(err)}). {remedy}"
        raise error(msg) from err
