"""Arrays that are mapped from files: what was read of them counts as memory of the process until it is given back."""

from __future__ import annotations

import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PAGES_CAN_GO = hasattr(mmap, "MADV_DONTNEED")


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
