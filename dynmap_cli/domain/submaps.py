"""Areas that change."""

from __future__ import annotations

from dataclasses import dataclass

from dynmap_cli.arrays import B1
from dynmap_cli.domain.grid import GridFrame


@dataclass(frozen=True, slots=True)
class SubMap:
    """A rectangle of the map in which contradictions were seen (paper, 1.3.1).

    Attributes
    ----------
    submap_id : int
        Number within the run, from 0.
    frame : GridFrame
        The rectangle, on the cells of the whole map.
    row, col : int
        Cell of the whole map at the lower left corner of the rectangle.
    contested : (rows, cols) bool
        Cells that were seen occupied and free at different times.
    area_m2 : float
        Area of the rectangle.
    """

    submap_id: int
    frame: GridFrame
    row: int
    col: int
    contested: B1
    area_m2: float
