"""What is too thin or too restless for cells to contradict one another, but comes back to the same spot.

Somebody who sits at a desk leaves a few cells, never the same ones: feet shift, and chairs roll. But within the width
of a person the spot is taken at one time and empty at another, hours apart and again and again. Who stands somewhere
once, however long, does not come back; who only passes there, however often, does not stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from dynmap_cli.arrays import B1, F64, I32, I64
from dynmap_cli.counting.evidence import SurfaceCells
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.segmentation.large_changes import LEAST_EXTENT_M
from dynmap_cli.segmentation.windows import WindowRecord

OCCASION_S = 3600.0
_LEAST_OCCASIONS, _LEAST_SHARE = 3, 0.2
_LEAST_TAKEN_CELLS, _LEAST_EMPTY_SHARE = 3, 0.8
_CLEAR_M = 0.15


def occasions(starts_ns: I64) -> I32:
    """Number of the occasion of each window (n,), from 0: a new one begins an hour after the last one began."""
    number = np.zeros(starts_ns.size, dtype=np.int32)
    begin_ns, current = None, -1
    for k in np.argsort(starts_ns, kind="stable").tolist():
        if begin_ns is None or starts_ns[k] - begin_ns >= OCCASION_S * 1e9:
            begin_ns, current = starts_ns[k], current + 1
        number[k] = current
    return number


def recurring_cells(
    surface: SurfaceCells, record: WindowRecord, occasion: I32, standing: B1, explained: I64
) -> B1:
    """Find the cells (n,) that something was seen in which is now there and now not, on three occasions each or more.

    A spot is the neighbourhood of a cell, as wide as a person. A window sees it taken if three of its cells are
    occupied. It is taken on an occasion if most windows that know it see it so, for who passes or stands about for a
    moment does not stay; and empty if no window sees any of its cells occupied, and one most of them free.

    Parameters
    ----------
    surface : SurfaceCells
    record : WindowRecord
    occasion : (n_windows,) int32
        Number of the occasion of each window.
    standing : (n,) bool
        Cells that are nearly always occupied; poses that are off move these, so cells beside them say nothing.
    explained : (m, 2) int64
        Cells of what changes otherwise.
    """
    found = np.zeros(standing.size, dtype=bool)
    n_occasions = int(occasion.max(initial=-1)) + 1
    if n_occasions < 2 * _LEAST_OCCASIONS:
        return found
    numbers = np.flatnonzero((record.occupied > 0) & (record.free >= _LEAST_OCCASIONS) & ~standing)
    clear = _CLEAR_M / surface.frame.resolution_m
    for others in (surface.cells[standing], explained):
        numbers = numbers[_distances(surface.cells[numbers], others) > clear]
    if numbers.size == 0:
        return found
    spots = _spots(surface.cells[numbers], 0.5 * LEAST_EXTENT_M / surface.frame.resolution_m)
    sizes = np.asarray(spots.sum(axis=1))
    taken, empty = np.zeros((2, numbers.size), dtype=np.int64)
    for current in range(n_occasions):
        windows_taken, windows_known = np.zeros((2, numbers.size), dtype=np.int64)
        any_occupied = np.zeros(numbers.size, dtype=bool)
        for window in np.flatnonzero(occasion == current).tolist():
            occupied, free = (seen[numbers] for seen in record.window(window))
            is_taken = _count(spots, occupied) >= _LEAST_TAKEN_CELLS
            windows_taken += is_taken
            windows_known += is_taken | (_count(spots, free) >= _LEAST_EMPTY_SHARE * sizes)
            any_occupied |= occupied
        taken += (windows_taken > 0) & (2 * windows_taken > windows_known)
        empty += (windows_known > 0) & (_count(spots, any_occupied) == 0)
    recurs = (np.minimum(taken, empty) >= _LEAST_OCCASIONS) & (taken >= _LEAST_SHARE * (taken + empty))
    found[numbers[_count(spots, recurs) > 0]] = True
    return found


def with_recurring(submaps: Sequence[SubMap], recurring: B1) -> tuple[SubMap, ...]:
    """Mark those contested cells of sub-maps that are recurring ones (rows, cols) of the whole map."""
    marked = []
    for submap in submaps:
        rows, cols = submap.contested.shape
        own = submap.contested & recurring[submap.row : submap.row + rows, submap.col : submap.col + cols]
        marked.append(replace(submap, recurring=own) if own.any() else submap)
    return tuple(marked)


def _distances(cells: I64, others: I64) -> F64:
    """Distance of cells (n, 2) to the nearest of others, in cells."""
    if cells.shape[0] == 0 or others.shape[0] == 0:
        return np.full(cells.shape[0], np.inf)
    return np.asarray(cKDTree(others).query(cells)[0])


def _spots(cells: I64, reach: float) -> csr_array:
    """(n, n) 1 where two cells are in the same spot; a cell is in its own."""
    pairs = cKDTree(cells).query_pairs(reach, output_type="ndarray")
    own = np.arange(cells.shape[0])
    rows, cols = np.concatenate([pairs, pairs[:, ::-1], np.column_stack([own, own])]).T
    return coo_array((np.ones(rows.size, dtype=np.int64), (rows, cols)), shape=(own.size, own.size)).tocsr()


def _count(spots: csr_array, cells: B1) -> I64:
    """How many of some cells are in each spot, (n,)."""
    return np.asarray(spots[np.flatnonzero(cells)].sum(axis=0), dtype=np.int64)
