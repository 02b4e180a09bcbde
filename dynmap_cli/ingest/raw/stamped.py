"""What was recorded with a stamp: columns with one row for each message."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dynmap_cli.arrays import B1, I64
from dynmap_cli.ingest.raw.columns import Growing


class Stamped:
    """Stamps and times of recording, in the order of recording; the base of what has further columns.

    Parameters
    ----------
    folder : Path or None
        On which disk columns lie that do not fit into memory; None = where temporary files are put.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._stamps_ns = Growing(np.int64, folder=folder)
        self._logged_ns = Growing(np.int64, folder=folder)

    @property
    def _columns(self) -> tuple[Growing, ...]:
        """All that has one row for each message."""
        return (self._stamps_ns, self._logged_ns)

    @property
    def stamps_ns(self) -> I64:
        """(n,) stamps in the headers."""
        return self._stamps_ns.rows

    @stamps_ns.setter
    def stamps_ns(self, stamps_ns: I64) -> None:
        self._stamps_ns.rows = stamps_ns

    @property
    def logged_ns(self) -> I64:
        """(n,) when the messages were recorded; the stamps where only these are known."""
        return self._logged_ns.rows

    @logged_ns.setter
    def logged_ns(self, logged_ns: I64) -> None:
        self._logged_ns.rows = logged_ns

    def keep(self, wanted: B1 | I64) -> None:
        """Forget all other rows; of numbers the order counts."""
        for column in self._columns:
            column.rows = column.rows[wanted]

    def give_back(self) -> None:
        """Take what is in files out of memory."""
        for column in self._columns:
            column.give_back()
