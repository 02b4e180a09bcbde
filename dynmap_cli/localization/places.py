"""Where the world is not as in the map: what stays in place, told from what moves through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.localization.map_pool import SubMapStates

STAYS_S, FORGOTTEN_S = 5.0, 2.0
COARSE_M = 0.2
"""Cells in which things are remembered."""
LEAST_BEAMS = 3
"""A thing is seen in a scan that meets it with so many beams: one may be a person's leg far away, or noise."""
OPENING_CELLS = 3
"""An opening is at least as wide; at the end of a wall, beams that pass it closely cross a cell or two."""
_BIN_M, _AROUND_M = 0.5, 0.75
_ALL_NEIGHBOURS = np.ones((3, 3))


@dataclass(frozen=True, slots=True)
class Place:
    """One place where the world differs from the map.

    Attributes
    ----------
    kind : str
        object = something that the map has not, opening = a gap in a wall of the map, sub-map = a sub-map
        is in a state that nobody knew.
    x_m, y_m : float
        Where, in the map frame.
    submap_id : int or None
        Of the sub-map.
    """

    kind: Literal["object", "opening", "sub-map"]
    x_m: float
    y_m: float
    submap_id: int | None = None

    def __str__(self) -> str:
        """As it stands in health.csv."""
        if self.submap_id is not None:
            return f"sub-map {self.submap_id}"
        return f"{self.kind} {self.x_m:.1f} {self.y_m:.1f}"


class NovelPlaces:
    """Remembers where something was seen that the map does not explain, and since when.

    Cells that touch belong to one thing, which is as old as its oldest cell: who drives by sees ever new
    parts of it.

    Parameters
    ----------
    frame : GridFrame
    least_cells : int
        Cells that a thing has at least.
    is_fixed : bool
        Whether the things cannot move, as gaps in walls. Then a new part is as old as what it touches, also when the
        older parts are out of sight; what can move would hand its age on along its way.
    """

    def __init__(self, frame: GridFrame, least_cells: int = 1, *, is_fixed: bool = False) -> None:
        self._least_cells, self._is_fixed = least_cells, is_fixed
        self._cell = max(round(COARSE_M / frame.resolution_m), 1)
        shape = (frame.rows // self._cell + 1, frame.cols // self._cell + 1)
        self._frame = frame
        self._first_s = np.full(shape, -np.inf)
        self._last_s = np.full(shape, -np.inf)

    def see(self, points_m: F64, now_s: float) -> B1:
        """Note points (n, 2); return which of them belong to what has stayed for `STAYS_S`."""
        cells = self._frame.to_cells(points_m)
        seen = np.asarray(((cells >= 0) & (cells < self._frame.shape)).all(axis=1))
        seen[seen] = _are_many(cells[seen] // self._cell)
        staying = np.zeros(seen.size, dtype=np.bool_)
        if not bool(seen.any()):
            return staying
        rows, cols = (cells[seen] // self._cell).T
        is_new = now_s - self._last_s[rows, cols] > FORGOTTEN_S
        self._first_s[rows[is_new], cols[is_new]] = now_s
        self._last_s[rows, cols] = now_s
        top, left = max(rows.min() - 1, 0), max(cols.min() - 1, 0)
        window = (slice(top, rows.max() + 2), slice(left, cols.max() + 2))
        first_s, last_s = self._first_s[window], self._last_s[window]
        recent = now_s - last_s <= FORGOTTEN_S
        things, count = ndimage.label(recent, _ALL_NEIGHBOURS)
        numbers, here = np.arange(1, count + 1), things[rows - top, cols - left] - 1
        if self._is_fixed:
            oldest_s = np.asarray(ndimage.minimum(first_s, things, numbers))
            self._first_s[rows, cols] = oldest_s[here]
        seconds = np.where(recent, last_s, 0.0) - np.where(recent, first_s, 0.0)
        stays = np.asarray(ndimage.maximum(seconds, things, numbers)) >= STAYS_S
        stays &= np.bincount(things.ravel(), minlength=count + 1)[1:] >= self._least_cells
        staying[seen] = stays[here]
        return staying


def _are_many(cells: I64) -> B1:
    """Which points, given by their coarse cells (n, 2), lie in groups of `LEAST_BEAMS` or more that touch."""
    if len(cells) < LEAST_BEAMS:
        return np.zeros(len(cells), dtype=np.bool_)
    rows, cols = (cells - cells.min(axis=0)).T
    counts = np.zeros((rows.max() + 1, cols.max() + 1))
    np.add.at(counts, (rows, cols), 1.0)
    groups, n_groups = ndimage.label(counts, _ALL_NEIGHBOURS)
    sums = np.bincount(groups.ravel(), counts.ravel(), minlength=n_groups + 1)
    return np.asarray(sums[groups[rows, cols]] >= LEAST_BEAMS)


def main_place(things_m: F64, openings_m: F64, submaps: Sequence[SubMapStates]) -> Place | None:
    """Where most of the points are that show a thing (n, 2) or an opening (m, 2) that the map has not."""
    points = np.concatenate([things_m, openings_m])
    if not points.size:
        return None
    _, bins, counts = np.unique(np.floor(points / _BIN_M), axis=0, return_inverse=True, return_counts=True)
    middle = points[bins.ravel() == int(np.argmax(counts))].mean(axis=0)
    near = np.hypot(*(points - middle).T) <= _AROUND_M
    middle = points[near].mean(axis=0) if bool(near.any()) else middle
    for submap in submaps:
        x0, y0, x1, y1 = submap.rectangle_m
        if x0 <= middle[0] <= x1 and y0 <= middle[1] <= y1:
            return Place("sub-map", float(middle[0]), float(middle[1]), submap.submap_id)
    is_thing = int(near[: len(things_m)].sum()) * 2 >= int(near.sum())
    return Place("object" if is_thing else "opening", float(middle[0]), float(middle[1]))
