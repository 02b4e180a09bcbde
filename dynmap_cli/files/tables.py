"""Tables of one number for each beam, and arrays: in memory while they are few, otherwise in nameless files."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynmap_cli.domain.mapped import give_back

_MOST_IN_MEMORY_BYTES = 1 << 25
_PIECE_BYTES, _BYTES_AT_ONCE, _ALIGNED_BYTES = 1 << 26, 1 << 23, 64


def new_table(n_rows: int, width: int, folder: Path | None, dtype: Any = np.float32) -> NDArray[Any]:
    """A table (n_rows, width) of zeros: in memory if it is small, otherwise mapped from a nameless file.

    Parameters
    ----------
    n_rows, width : int
    folder : Path or None
        On which disk the file lies; None = where temporary files are put.
    dtype : type
    """
    n_bytes = np.dtype(dtype).itemsize * n_rows * width
    if n_bytes <= _MOST_IN_MEMORY_BYTES:
        return np.zeros((n_rows, width), dtype=dtype)
    # The mapping keeps the file.
    with tempfile.TemporaryFile(dir=folder) as stream:
        # On a full disk this fails, where writing to the mapping would end the process.
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(stream.fileno(), 0, n_bytes)
        return np.memmap(stream, dtype=dtype, mode="w+", shape=(n_rows, width)).view(np.ndarray)


class Shelf:
    """Arrays that are put away one after another.

    Parameters
    ----------
    folder : Path or None
        On which disk they lie where they are many; None = where temporary files are put.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._pieces: list[NDArray[np.uint8]] = []
        self._used = self._put_bytes = 0

    def put(self, array: NDArray[Any]) -> NDArray[Any]:
        """The same array on the shelf."""
        n_bytes = -(-array.nbytes // _ALIGNED_BYTES) * _ALIGNED_BYTES
        if not self._pieces or self._used + n_bytes > self._pieces[-1].size:
            piece_bytes = _PIECE_BYTES if self._pieces else _MOST_IN_MEMORY_BYTES
            self._pieces.append(new_table(1, max(piece_bytes, n_bytes), self._folder, np.uint8)[0])
            self._used = 0
        room = self._pieces[-1][self._used : self._used + array.nbytes]
        self._used += n_bytes
        kept: NDArray[Any] = room.view(array.dtype).reshape(array.shape)
        kept[...] = array
        self._put_bytes += n_bytes
        if self._put_bytes > _BYTES_AT_ONCE:
            self.give_back()
            self._put_bytes = 0
        return kept

    def give_back(self) -> None:
        """Take what is in files out of memory; it is read again where it is used."""
        for piece in self._pieces:
            give_back(piece)
