"""Room on the disk for the scans of recordings: checked before they are written."""

from __future__ import annotations

import tempfile
from pathlib import Path

from dynmap_cli.files.space import check_space

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
        check_space(name, f"{n_scans} scans", needed, where)
