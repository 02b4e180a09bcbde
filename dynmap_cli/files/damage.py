"""What reading a file that is missing, cut off, damaged or of something else raises, as one line."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager

from dynmap_cli.errors import DynmapError

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


def reason(error: BaseException) -> str:
    """Say in one line of printable characters what is wrong, without the path that stands before it."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    words = " ".join(str(error).split()) or type(error).__name__
    words = "".join(one if one.isprintable() else "?" for one in words)
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
