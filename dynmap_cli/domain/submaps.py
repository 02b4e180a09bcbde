"""Areas that change."""

from __future__ import annotations

from dataclasses import dataclass

from dynmap_cli.arrays import B1
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.points import point_for_people


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle in the map frame, metres."""

    left_m: float
    bottom_m: float
    right_m: float
    top_m: float

    @property
    def area_m2(self) -> float:
        """Width times height."""
        return (self.right_m - self.left_m) * (self.top_m - self.bottom_m)

    def common_m2(self, other: Rectangle) -> float:
        """Area that lies in both."""
        width = min(self.right_m, other.right_m) - max(self.left_m, other.left_m)
        height = min(self.top_m, other.top_m) - max(self.bottom_m, other.bottom_m)
        return max(width, 0.0) * max(height, 0.0)

    def likeness(self, other: Rectangle) -> float:
        """Common area over the area of both together: 0 where they lie apart, 1 where they are the same."""
        common = self.common_m2(other)
        return common / max(self.area_m2 + other.area_m2 - common, 1e-12)


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
    name : str
        What people call it; "" where nobody gave it a name.
    by_hand : bool
        Whether it was added by hand; then all cells that it owns count as contested.
    recurring : (rows, cols) bool or None
        Of the contested cells: those of what comes back to the same spot without ever being in the same cells, as
        people at a desk; None = none of them. Together the cells of a spot say whether it is taken.
    """

    submap_id: int
    frame: GridFrame
    row: int
    col: int
    contested: B1
    owned: B1
    area_m2: float
    name: str = ""
    by_hand: bool = False
    recurring: B1 | None = None

    @property
    def called(self) -> str:
        """Its number, and its name where it has one."""
        return f"{self.submap_id} ({self.name})" if self.name else str(self.submap_id)

    @property
    def rectangle(self) -> Rectangle:
        """Where it lies."""
        left, bottom = self.frame.origin_x_m, self.frame.origin_y_m
        width, height = self.size_m
        return Rectangle(left, bottom, left + width, bottom + height)

    @property
    def center_m(self) -> tuple[float, float]:
        """Middle of the rectangle in the map frame: x, y."""
        return self.frame.center_m

    @property
    def place(self) -> str:
        """Its middle for people, metres: wherever it is named it is named so."""
        return point_for_people(*self.center_m)

    @property
    def size_m(self) -> tuple[float, float]:
        """Width (along x) and height (along y) of the rectangle."""
        return self.frame.cols * self.frame.resolution_m, self.frame.rows * self.frame.resolution_m
