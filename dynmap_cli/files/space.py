"""Room on the disk, looked at before much is written."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

from dynmap_cli.errors import ArtifactError

_log = logging.getLogger(__name__)
_WORTH_SAYING_BYTES = 10**8


def check_space(name: str, what: str, n_bytes: int, folder: Path) -> None:
    """Say how much will be written, if it is much, and refuse it if there is not as much room.

    Parameters
    ----------
    name : str
        Whose it is: a recording, or a stage.
    what : str
        What has to be kept, for instance "1000 scans".
    n_bytes : int
        How much is written at most, with what is taken away again at the end.
    folder : Path
        Where; it need not be there yet.

    Raises
    ------
    ArtifactError
        If the disk is too full.
    """
    free = shutil.disk_usage(nearest_folder(folder)).free
    if n_bytes > free:
        msg = (
            f"{name}: {_size(n_bytes)} are needed on the disk of {folder.parent} for {what}, "
            f"{_size(free)} are free. Free the place, or work in a folder on another disk."
        )
        raise ArtifactError(msg)
    if n_bytes >= _WORTH_SAYING_BYTES:
        _log.info(
            "%s: %s need about %s on the disk, %s are free",
            name,
            what,
            _size(n_bytes),
            _size(free),
        )


def nearest_folder(path: Path) -> Path:
    """The path itself where it is a folder, or the nearest one above it that is there."""
    return next(folder for folder in (path, *path.absolute().parents) if folder.is_dir())


def _size(n_bytes: int) -> str:
    """A size for people, in the unit that shows it."""
    factor, unit = next((pair for pair in ((1e9, "GB"), (1e6, "MB")) if n_bytes >= pair[0]), (1e3, "kB"))
    return f"{n_bytes / factor:.1f} {unit}"
