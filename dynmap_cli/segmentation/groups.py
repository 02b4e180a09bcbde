"""Which groups of contested cells are things that came, went or moved."""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.segmentation.contradictions import Contradictions
from dynmap_cli.segmentation.large_changes import LEAST_EXTENT_M

_FARTHER = 1.5


def changed_as_one(found: Contradictions, groups: list[I64], min_cells: int) -> list[I64]:
    """Groups of contested cells, (n, 2) each, of which windows enough saw *min_cells* at once in either state.

    The cells of an object appear and vanish together. Where a surface is ragged, or the poses blur it, cells contradict
    one another one by one. For things that are not large two more rules hold:

    - Who stands for less than a window is seen by two windows that follow one another. So, of things no larger than a
      person, a run of windows counts as one less than its length.
    - What is thin vanishes from afar: the spot of a beam grows, and most of it goes past. So some window must see half
      as many cells free from not much farther than they were seen occupied.

    Parameters
    ----------
    found : Contradictions
    groups : list of (n, 2) int64
    min_cells : int
    """
    if not groups:
        return []
    group_of = np.full(found.surface.cells.shape[0], -1, dtype=np.int64)
    needed = np.full(len(groups), found.windows_needed, dtype=np.int64)
    resolution_m = found.surface.frame.resolution_m
    for number, cells in enumerate(groups):
        own = found.surface.index[cells[:, 0], cells[:, 1]]
        group_of[own] = number
        if found.is_short and found.large[own].any():
            needed[number] = 1
    occupied, free = found.record.cells_shown(group_of, len(groups))
    is_occupied, is_free = occupied >= min_cells, free >= min_cells
    is_large = needed == 1
    is_wide = np.array(
        [np.hypot(*(np.ptp(cells, axis=0) + 1)) * resolution_m >= LEAST_EXTENT_M for cells in groups]
    )
    stays = is_occupied.sum(axis=0) - np.where(is_wide, 0, _long_runs(is_occupied, found.windows.follows))
    kept = np.minimum(stays, is_free.sum(axis=0)) >= needed
    away = np.column_stack([_distances_m(found, cells) for cells in groups])
    near = away <= _FARTHER * np.where(is_occupied, away, 0.0).max(axis=0)
    kept &= is_large | (near & (2 * free >= min_cells)).any(axis=0)
    return [cells for cells, is_kept in zip(groups, kept.tolist(), strict=True) if is_kept]


def _long_runs(seen: B1, follows: B1) -> I64:
    """How many runs of two or more windows that follow one another saw something; (n_windows, n) -> (n,)."""
    again = np.zeros_like(seen)
    again[1:] = seen[1:] & seen[:-1] & follows[1:, None]
    begins = again.copy()
    begins[1:] &= ~again[:-1]
    return np.asarray(begins.sum(axis=0), dtype=np.int64)


def _distances_m(found: Contradictions, cells: I64) -> F64:
    """(n_windows,) from the robot to the middle of some cells (n, 2)."""
    frame = found.surface.frame
    middle = (cells.mean(axis=0)[::-1] + 0.5) * frame.resolution_m + [frame.origin_x_m, frame.origin_y_m]
    return np.asarray(np.linalg.norm(found.windows.places_m - middle, axis=1))
