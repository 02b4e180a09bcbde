"""Changes that were seen in one time window only, and are too large for somebody who stands there.

Two windows of either kind rule out people who stand. A door that was open at one of six visits has only one; but its
leaf is longer than people are wide, which one window shows. A window whose poses are off shows displaced walls in the
same way, but each beside the place where it stands, and what stands around it is not in its place either.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from dynmap_cli.arrays import B1, I32, I64
from dynmap_cli.counting.evidence import SurfaceCells
from dynmap_cli.segmentation.windows import WindowRecord

LEAST_EXTENT_M = 0.7
"""People are less wide, and so is a pair of legs."""
_LEAST_OTHER_WINDOWS = 2
_AROUND_M, _LEAST_AROUND, _LEAST_IN_PLACE_SHARE = 1.0, 10, 0.9
_DISPLACED_M, _MOST_DISPLACED_SHARE = 0.3, 0.5
_TOUCHING_CELLS = 2


def large_changes(surface: SurfaceCells, record: WindowRecord, standing: B1) -> B1:
    """Find the cells (n,) that one window saw occupied and others free, or the reverse, in groups larger than a person.

    A group counts if what stands around it is in its place in that window.

    Parameters
    ----------
    surface : SurfaceCells
    record : WindowRecord
    standing : (n,) bool
        Cells that are nearly always occupied.
    """
    found = np.zeros(standing.size, dtype=bool)
    standing = standing & (record.occupied >= _LEAST_OTHER_WINDOWS)
    came = (record.occupied == 1) & (record.free >= _LEAST_OTHER_WINDOWS)
    went = (record.free == 1) & (record.occupied >= _LEAST_OTHER_WINDOWS)
    least_cells = LEAST_EXTENT_M / surface.frame.resolution_m
    for changed, last in ((came, record.last_occupied), (went, record.last_free)):
        for group in _groups(surface.cells, np.flatnonzero(changed), last):
            extent = np.ptp(surface.cells[group], axis=0) + 1
            if float(np.hypot(*extent)) < least_cells:
                continue
            occupied, free = record.window(int(last[group[0]]))
            missed, new = standing & ~occupied, occupied & ~standing
            new[group], missed[group] = False, False
            found[group] = _is_in_place(surface, group, standing, occupied, free) and not _is_displaced(
                surface, group, missed if changed is came else new
            )
    return found


def _groups(cells: I64, numbers: I64, window: I32) -> list[I64]:
    """Groups of those cells that changed in the same window and touch, or lie one cell apart."""
    if numbers.size == 0:
        return []
    apart = (_TOUCHING_CELLS + 1) * window[numbers].astype(np.int64)
    places = np.column_stack([cells[numbers], apart])
    pairs = cKDTree(places).query_pairs(_TOUCHING_CELLS, p=np.inf, output_type="ndarray")
    links = coo_array(
        (np.ones(pairs.shape[0]), (pairs[:, 0], pairs[:, 1])), shape=(numbers.size, numbers.size)
    )
    _, label = connected_components(links, directed=False)
    order = np.argsort(label, kind="stable")
    return np.split(numbers[order], np.flatnonzero(np.diff(label[order])) + 1)


def _is_in_place(surface: SurfaceCells, group: I64, standing: B1, occupied: B1, free: B1) -> bool:
    """Whether the standing cells around a group were seen occupied, not free, in a window."""
    around = round(_AROUND_M / surface.frame.resolution_m)
    low, high = surface.cells[group].min(axis=0) - around, surface.cells[group].max(axis=0) + around
    near = standing & (surface.cells >= low).all(axis=1) & (surface.cells <= high).all(axis=1)
    near[group] = False
    in_place, gone = int((near & occupied).sum()), int((near & free).sum())
    return in_place >= _LEAST_AROUND and in_place >= _LEAST_IN_PLACE_SHARE * (in_place + gone)


def _is_displaced(surface: SurfaceCells, group: I64, counterparts: B1) -> bool:
    """Whether most cells of a group lie beside what a displaced surface leaves: where it stands, or where it shows."""
    others = surface.cells[counterparts]
    if others.shape[0] == 0:
        return False
    reach = _DISPLACED_M / surface.frame.resolution_m
    distance, _ = cKDTree(others).query(surface.cells[group], distance_upper_bound=reach)
    return bool(np.isfinite(distance).mean() > _MOST_DISPLACED_SHARE)
