"""Where the world is not as in the map: what stays in place, told from what moves through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.kernels.novelties import see_places
from dynmap_cli.localization.sensing.map_pool import SubMapStates

STAYS_S, FORGOTTEN_S = 5.0, 2.0
COARSE_M = 0.2
"""Cells in which things are remembered."""
LEAST_BEAMS = 3
"""A thing is seen in a scan that meets it with so many beams: one may be a person's leg far away, or noise."""
OPENING_CELLS = 3
"""An opening is at least as wide; at the end of a wall, beams that pass it closely cross a cell or two."""
_BIN_M, _AROUND_M = 0.5, 0.75


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

    @property
    def called(self) -> str:
        """For people."""
        if self.submap_id is not None:
            return str(self)
        return f"the {self.kind} at ({self.x_m:.1f}, {self.y_m:.1f}) m"


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
        self._limits = np.array([STAYS_S, FORGOTTEN_S, LEAST_BEAMS, least_cells])
        self._is_fixed = is_fixed
        self._cell = max(round(COARSE_M / frame.resolution_m), 1)
        shape = (frame.rows // self._cell + 1, frame.cols // self._cell + 1)
        self._corner = frame.corner
        self._first_s = np.full(shape, -np.inf)
        self._last_s = np.full(shape, -np.inf)

    def see(self, points_m: F64, now_s: float) -> B1:
        """Note points (n, 2); return which of them belong to what has stayed for `STAYS_S`."""
        staying = np.empty(len(points_m), dtype=np.bool_)
        if staying.size:
            see_places(
                points_m,
                self._corner,
                self._cell,
                now_s,
                self._limits,
                self._is_fixed,
                self._first_s,
                self._last_s,
                staying,
            )
        return staying


def main_place(things_m: F64, openings_m: F64, submaps: Sequence[SubMapStates]) -> Place | None:
    """Where most of the points are that show a thing (n, 2) or an opening (m, 2) that the map has not."""
    if not things_m.size and not openings_m.size:
        return None
    points = np.concatenate([things_m, openings_m])
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
