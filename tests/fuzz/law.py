"""The law of all readers: success, or one clear line; within 10 s of CPU and 1 GB, and without waiting for ever."""

from __future__ import annotations

import resource
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from dynmap_cli.errors import DynmapError

LONGEST_S, LONGEST_WAIT_S = 10, 300
"""Of CPU, and by the clock: other processes may leave a reader little of the machine."""
MOST_BYTES = 1 << 30
_LONGEST_LINE = 2000


class TooSlowError(BaseException):
    """A reader that took too long; no `except Exception` swallows it."""


class LawBrokenError(AssertionError):
    """What a reader did that it must not do."""


def obey(read: Callable[[Path], object], folder: Path) -> DynmapError | None:
    """Read what lies in *folder*; the refusal, or None where it was read.

    Raises
    ------
    TooSlowError, LawBrokenError, or whatever the reader lets through
    """
    refusal: DynmapError | None = None
    before = _peak_bytes()
    with _limited(), warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read(folder)
        except DynmapError as err:
            refusal = err
    if refusal is not None:
        _check_line(refusal)
    grown = _peak_bytes() - before
    if grown > MOST_BYTES:
        msg = f"took {grown / 2**30:.1f} GiB"
        raise LawBrokenError(msg)
    return refusal


def _check_line(refusal: DynmapError) -> None:
    """One line of printable characters that is not about memory."""
    line = str(refusal)
    if not line or "\n" in line or len(line) > _LONGEST_LINE or not line.isprintable():
        msg = f"not one clear line: {line[:500]!r}"
        raise LawBrokenError(msg) from refusal
    cause: BaseException | None = refusal
    while cause is not None:
        if isinstance(cause, MemoryError):
            msg = f"wanted more than {MOST_BYTES} bytes: {line}"
            raise LawBrokenError(msg) from refusal
        cause = cause.__cause__ or cause.__context__


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@contextmanager
def _limited() -> Iterator[None]:
    """Stop after so many seconds; no more memory than is allowed and what is there already."""

    def stop(_signal: int, _frame: object) -> None:
        raise TooSlowError

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = (
        int(Path("/proc/self/statm").read_text().split()[0]) if Path("/proc/self/statm").exists() else None
    )
    limits = (
        (signal.SIGPROF, signal.ITIMER_PROF, LONGEST_S),
        (signal.SIGALRM, signal.ITIMER_REAL, LONGEST_WAIT_S),
    )
    before = [signal.signal(kind, stop) for kind, _, _ in limits]
    for _, timer, seconds in limits:
        signal.setitimer(timer, seconds)
    if pages is not None:
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MOST_BYTES, hard))
    try:
        yield
    finally:
        for (kind, timer, _), old in zip(limits, before, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(kind, old)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
