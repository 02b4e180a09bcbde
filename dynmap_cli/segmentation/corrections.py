"""Corrections by hand of the sub-maps that were found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.corrections import Addition, Correction, Merge, Name, describe, find_place
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.segmentation.regions import make_submaps

_MOSTLY = 0.5


def apply_corrections(
    submaps: Sequence[SubMap], corrections: Sequence[Correction], frame: GridFrame, margin: int
) -> tuple[tuple[SubMap, ...], list[str]]:
    """Add, drop and name sub-maps, in the order in which it was said.

    Parameters
    ----------
    submaps : sequence of SubMap
        As found, with their numbers.
    corrections : sequence of Correction
        Those of states are passed over.
    frame : GridFrame
        Of the whole map.
    margin : int
        Border of a rectangle around an added area, cells.

    Returns
    -------
    tuple of SubMap
        By their numbers.
    list of str
        What was done, and warnings about what could not be done.
    """
    result, lines = list(submaps), []
    for number, correction in enumerate(corrections, start=1):
        if isinstance(correction, Merge):
            continue
        words = f"correction {number}: {describe(correction)}"
        if isinstance(correction, Addition):
            meant = added_submap(correction, frame, margin)
            if meant is not None:
                result = [*_without_cells_of(meant, result), meant]
        else:
            meant = find_place(correction.place, result)
            if meant is not None:
                result = [submap for submap in result if submap is not meant]
            if meant is not None and isinstance(correction, Name):
                result.append(replace(meant, name=correction.name))
        lines.append(words if meant is not None else f"warning: {words}, but nothing is found there any more")
    return tuple(sorted(result, key=lambda submap: submap.submap_id)), lines


def added_submap(addition: Addition, frame: GridFrame, margin: int) -> SubMap | None:
    """The sub-map of a polygon: it owns the cells whose centres lie inside; None where the map has no such cell."""
    cells = cells_inside(np.array(addition.corners_m), frame)
    if not cells.any():
        return None
    (submap,) = make_submaps([np.argwhere(cells).astype(np.int64)], frame, margin)
    return replace(submap, submap_id=addition.submap_id, owned=submap.contested, by_hand=True)


def cells_inside(corners_m: F64, frame: GridFrame) -> B1:
    """(rows, cols) whether the centre of a cell lies inside a polygon, by the even-odd rule.

    Parameters
    ----------
    corners_m : (n, 2) float64
    frame : GridFrame
    """
    inside = np.zeros(frame.shape, dtype=bool)
    low, high = frame.to_cells(np.stack([corners_m.min(axis=0), corners_m.max(axis=0)]))
    row, col = np.maximum(low, 0).tolist()
    rows, cols = np.minimum(high + 1, frame.shape).tolist()
    if row >= rows or col >= cols:
        return inside
    x = frame.origin_x_m + (np.arange(col, cols) + 0.5) * frame.resolution_m
    y = frame.origin_y_m + (np.arange(row, rows) + 0.5) * frame.resolution_m
    window = inside[row:rows, col:cols]
    for (x0, y0), (x1, y1) in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
        crosses = (y0 <= y) != (y1 <= y)
        at = x0 + (y[crosses] - y0) * (x1 - x0) / (y1 - y0) if crosses.any() else np.zeros(0)
        window[crosses] ^= x < at[:, None]
    return inside


def _without_cells_of(added: SubMap, submaps: Sequence[SubMap]) -> list[SubMap]:
    """Sub-maps without the cells of an added one; those that lie in it with most contested cells are gone."""
    left = []
    for submap in submaps:
        inside = _mask_on(added, submap)
        if (submap.contested & inside).sum() <= _MOSTLY * submap.contested.sum():
            left.append(replace(submap, contested=submap.contested & ~inside, owned=submap.owned & ~inside))
    return left


def _mask_on(added: SubMap, submap: SubMap) -> B1:
    """Cells of the added sub-map, as a mask of the rectangle of another."""
    mask = np.zeros(submap.frame.shape, dtype=bool)
    step = np.array([added.row - submap.row, added.col - submap.col])
    cells = np.argwhere(added.owned) + step
    cells = cells[((cells >= 0) & (cells < submap.frame.shape)).all(axis=1)]
    mask[cells[:, 0], cells[:, 1]] = True
    return mask
