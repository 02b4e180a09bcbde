"""One writer per folder: an advisory lock that the system lets go of when the process ends, however it ends."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from dynmap_cli.errors import ArtifactError

LOCK_NAME = ".lock"


@contextmanager
def writing(folder: Path, *, is_output: bool = False) -> Iterator[None]:
    """Hold a folder for writing; made if it is missing, and gone again where work that fails puts nothing into it.

    Parameters
    ----------
    folder : Path
    is_output : bool
        It was named with --output, so another one may be named as well.

    Raises
    ------
    ArtifactError
        If another process reads or writes it, or it cannot be written.
    """
    try:
        missing = [place for place in (folder, *folder.parents) if not place.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        stream = (folder / LOCK_NAME).open("a")
    except OSError as err:
        remedy = "Choose another output or free the place" if is_output else "Let dynmap write there"
        msg = f"{folder}: cannot be written ({err.strerror}). {remedy}."
        raise ArtifactError(msg) from err
    with stream:
        _take(stream.fileno(), folder, fcntl.LOCK_EX, ", or choose another output" if is_output else "")
        try:
            yield
        except BaseException:
            _take_away_stub(missing)
            raise


def _take_away_stub(made: Sequence[Path]) -> None:
    """Take away folders that were made, innermost first, if no file but the lock is in them."""
    if not made or any(path.is_file() and path.name != LOCK_NAME for path in made[0].rglob("*")):
        return
    with suppress(OSError):
        (made[0] / LOCK_NAME).unlink(missing_ok=True)
        inner = sorted((path for path in made[0].rglob("*") if path.is_dir()), reverse=True)
        for place in (*inner, *made):
            place.rmdir()


@contextmanager
def reading(folder: Path) -> Iterator[None]:
    """Hold a folder for reading, together with other readers; one that cannot be written has no writers.

    Raises
    ------
    ArtifactError
        If another process writes it.
    """
    try:
        stream = (folder / LOCK_NAME).open("a")
    except OSError:
        yield
        return
    with stream:
        _take(stream.fileno(), folder, fcntl.LOCK_SH)
        yield


def _take(descriptor: int, folder: Path, kind: int, instead: str = "") -> None:
    """Lock at once or say who has it, and what may be done instead of waiting."""
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
        # Who had it before may have taken the folder away.
        if (folder / LOCK_NAME).stat().st_ino != os.fstat(descriptor).st_ino:
            raise BlockingIOError
    except (BlockingIOError, FileNotFoundError) as err:
        msg = f"{folder}: another dynmap is working in this folder. Wait until it is done{instead}."
        raise ArtifactError(msg) from err
    except OSError as err:
        msg = f"{folder}: cannot be locked ({err.strerror}). Use a file system with locks (flock)."
        raise ArtifactError(msg) from err
