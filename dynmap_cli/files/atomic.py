"""Writes that are whole or absent."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from dynmap_cli.errors import ArtifactError

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a scratch path beside *path*; rename it over *path* on success."""
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        part.replace(path)
    except OSError as err:
        msg = f"{path}: cannot be written ({_why(err)}). {_remedy(err)}."
        raise ArtifactError(msg) from err
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


@contextmanager
def scratch_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder `.part` beside the files it will become; it is gone afterwards.

    Raises
    ------
    ArtifactError
        If it cannot be made or filled. Other failures of the system are not about writing, and pass.
    """
    part = _scratch_of(folder)
    try:
        discard_scratch(folder)
        part.mkdir(parents=True)
        yield part
    except OSError as err:
        where = Path(str(err.filename or part))
        if err.errno not in _NO_SPACE and not where.is_relative_to(folder.parent):
            raise
        if err.errno in _NO_SPACE and not where.is_relative_to(part):
            # It may name what was read.
            where = part
        msg = f"{where}: cannot be written ({_why(err)}). {_remedy(err)}."
        raise ArtifactError(msg) from err
    finally:
        discard_scratch(folder)


def discard_scratch(folder: Path) -> None:
    """Take away what a process that was killed left in the scratch folder of *folder*."""
    shutil.rmtree(_scratch_of(folder), ignore_errors=True)


def _scratch_of(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.part")


def _remedy(err: OSError) -> str:
    """What to do, in words that hold for verbs that take an output and for those that do not."""
    return (
        "Free space on this disk" if err.errno in _NO_SPACE else "Let dynmap write there, or work elsewhere"
    )


def _why(err: OSError) -> str:
    """What the system says; NumPy only counts what it could not write."""
    return err.strerror or (str(err) if err.errno else f"not to its end, as on a full disk: {err}")
