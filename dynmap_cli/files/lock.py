"""One writer per folder: an advisory lock that the system lets go of when the process ends, however it ends."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dynmap_cli.errors import ArtifactError

LOCK_NAME = ".lock"


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Hold a folder for writing; made if it is missing.

    Raises
    ------
    ArtifactError
        If another process reads or writes it, or it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stream = (folder / LOCK_NAME).open("a")
    except OSError as err:
        msg = f"{folder}: cannot be written ({err.strerror}). Choose another output or free the place."
        raise ArtifactError(msg) from err
    with stream:
        _take(stream.fileno(), folder, fcntl.LOCK_EX)
        yield


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


def _take(descriptor: int, folder: Path, kind: int) -> None:
    """Lock at once or say who has it."""
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
    except BlockingIOError as err:
        msg = f"{folder}: another dynmap is working in this folder. Wait until it is done, or choose another output."
        raise ArtifactError(msg) from err
    except OSError as err:
        msg = f"{folder}: cannot be locked ({err.strerror}). Use a file system with locks (flock)."
        raise ArtifactError(msg) from err
