"""Tables of one number for each beam: in memory while they are small, otherwise in nameless files."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST_IN_MEMORY_BYTES = 1 << 25


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
