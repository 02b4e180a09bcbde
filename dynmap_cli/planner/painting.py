"""States on the mean map, and the mask of all areas that change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynmap_cli.arrays import I8
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, GridFrame, OccupancyGrid
from dynmap_cli.domain.submaps import SubMap


def combined(states: Sequence[I8], first: int) -> I8:
    """Cells (rows, cols) that are *first*, FREE or OCCUPIED, where any state is, else what the others know.

    Parameters
    ----------
    states : sequence of (rows, cols) int8
        At least one.
    first : int
    """
    second = OCCUPIED if first == FREE else FREE
    stacked = np.stack(states)
    cells = np.full(stacked.shape[1:], UNKNOWN, dtype=np.int8)
    cells[(stacked == second).any(axis=0)] = second
    cells[(stacked == first).any(axis=0)] = first
    return cells


def painted(cells: I8, submap: SubMap, state: I8) -> tuple[I8, int]:
    """Put a state over the map; what the state does not know stays.

    Parameters
    ----------
    cells : (map rows, map cols) int8
    submap : SubMap
    state : (rows, cols) int8
        OCCUPIED, FREE or UNKNOWN.

    Returns
    -------
    (map rows, map cols) int8
    int
        How many cells differ from before.
    """
    rows, cols = submap.frame.shape
    result = cells.copy()
    window = result[submap.row : submap.row + rows, submap.col : submap.col + cols]
    before = window.copy()
    window[state != UNKNOWN] = state[state != UNKNOWN]
    return result, int((window != before).sum())


def mask_of(frame: GridFrame, submaps: Sequence[SubMap]) -> OccupancyGrid:
    """Occupied where a cell belongs to a sub-map, free elsewhere: a filter mask for costmaps."""
    cells = np.full(frame.shape, FREE, dtype=np.int8)
    for submap in submaps:
        rows, cols = submap.frame.shape
        window = cells[submap.row : submap.row + rows, submap.col : submap.col + cols]
        window[submap.owned] = OCCUPIED
    return OccupancyGrid(frame, cells)
