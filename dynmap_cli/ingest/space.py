"""Room on the disk for the scans of recordings: checked before they are written."""

from __future__ import annotations

import logging
import shutil
import tempfile
from pathlib import Path

from dynmap_cli.errors import ArtifactError

_log = logging.getLogger(__name__)
_WORTH_SAYING_BYTES = 10**8
_SMALL_COLUMNS_BYTES = 100


class Space:
    """The disk on which ranges lie while recordings are read, and columns afterwards.

    Parameters
    ----------
    folder : Path or None
        Where the columns are written; None = they are not, and ranges lie where temporary files are put.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self._columns_bytes = 0

    def reserve(self, name: str, n_scans: int, ranges_bytes: int) -> None:
        """Say how much a recording needs, and refuse it if there is not as much.

        While it is read its ranges lie in a nameless file, and then in the columns also.

        Parameters
        ----------
        name : str
            The recording.
        n_scans, ranges_bytes : int
            How many sweeps it says that it holds, and about how many bytes their ranges are.

        Raises
        ------
        ArtifactError
            If the disk is too full.
        """
        if self.folder is not None:
            self._columns_bytes += ranges_bytes + _SMALL_COLUMNS_BYTES * n_scans
        needed = self._columns_bytes + ranges_bytes
        where = self.folder or Path(tempfile.gettempdir())
        free = shutil.disk_usage(where).free
        if needed > free:
            msg = (
                f"{name}: {_size(needed)} are needed on the disk of {where.parent} for {n_scans} scans, "
                f"{_size(free)} are free. Free the place or choose another output."
            )
            raise ArtifactError(msg)
        if needed >= _WORTH_SAYING_BYTES:
            _log.info(
                "%s: %d scans need about %s on the disk, %s are free",
                name,
                n_scans,
                _size(needed),
                _size(free),
            )


def _size(n_bytes: int) -> str:
    """A size for people, in the unit that shows it."""
    factor, unit = next((pair for pair in ((1e9, "GB"), (1e6, "MB")) if n_bytes >= pair[0]), (1e3, "kB"))
    return f"{n_bytes / factor:.1f} {unit}"
