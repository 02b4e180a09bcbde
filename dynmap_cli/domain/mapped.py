"""Arrays whose pages come and go: mapped from files, or sparse ones of which only what was written is in memory."""

from __future__ import annotations

import math
import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PAGES_CAN_GO = hasattr(mmap, "MADV_DONTNEED")
_CAN_BE_SPARSE = hasattr(mmap, "MAP_ANONYMOUS") and hasattr(mmap, "MADV_NOHUGEPAGE")
_LEAST_SPARSE_BYTES = 1 << 24


def mapping_of(array: Any) -> mmap.mmap | None:
    """The mapping in which an array lies; None where it lies in memory."""
    base = array
    while isinstance(base, np.ndarray):
        base = base.base
    return base if isinstance(base, mmap.mmap) else None


def give_back(array: Any) -> None:
    """Take the pages of a mapped array out of the process; what was written stays, and they are read again on use."""
    mapping = mapping_of(array)
    if mapping is not None and _PAGES_CAN_GO:
        mapping.madvise(mmap.MADV_DONTNEED)


def copied_rows(table: NDArray[Any], rows: Any) -> NDArray[Any]:
    """Some rows of a table in memory; where it is mapped from a file, nothing else of it stays there."""
    part = np.asarray(table[rows])
    if np.may_share_memory(part, table):
        part = part.copy()
    give_back(table)
    return part


def sparse_zeros(shape: int | tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Zeros of which a large array takes memory only where something was written, in pages of a few kB.

    `np.zeros` asks for pages of 2 MB, of which almost all are touched when a hundredth of the entries is.
    """
    size = math.prod(shape) if isinstance(shape, tuple) else shape
    n_bytes = size * np.dtype(dtype).itemsize
    if not _CAN_BE_SPARSE or n_bytes < _LEAST_SPARSE_BYTES:
        return np.zeros(shape, dtype=dtype)
    pages = mmap.mmap(-1, n_bytes, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    pages.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(pages, dtype=dtype).reshape(shape)
