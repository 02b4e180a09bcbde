"""Areas that change."""

from __future__ import annotations

from dataclasses import dataclass

from dynmap_cli.arrays import B1
from dynmap_cli.domain.grid import GridFrame


@dataclass(frozen=True, slots=True)
class SubMap:
    """A rectangle of the map in which contradictions were seen (paper, 1.3.1).

    Rectangles may overlap; the cells that a sub-map owns do not.

    Attributes
    ----------
    submap_id : int
        Number within the run, from 0.
    frame : GridFrame
        The rectangle, on the cells of the whole map.
    row, col : int
        Cell of the whole map at the lower left corner of the rectangle.
    contested : (rows, cols) bool
        Cells that were seen occupied and free at different times, and belong to this sub-map.
    owned : (rows, cols) bool
        Cells that are nearer to these contested cells than to those of the rectangles that overlap.
    area_m2 : float
        Area of the rectangle.
    """

    submap_id: int
    frame: GridFrame
    row: int
    col: int
    contested: B1
    owned: B1
    area_m2: float

    @property
    def center_m(self) -> tuple[float, float]:
        """Middle of the rectangle in the map frame: x, y."""
        frame = self.frame
        return (
            frame.origin_x_m + 0.5 * frame.cols * frame.resolution_m,
            frame.origin_y_m + 0.5 * frame.rows * frame.resolution_m,
        )

    @property
    def size_m(self) -> tuple[float, float]:
        """Width (along x) and height (along y) of the rectangle."""
        return self.frame.cols * self.frame.resolution_m, self.frame.rows * self.frame.resolution_m
