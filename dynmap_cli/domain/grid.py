"""Grids: row 0 has the lowest y, column 0 the lowest x; only `files/pgm.py` knows that a PGM is upside down."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I8, I64, U8

FREE, OCCUPIED, UNKNOWN = 0, 1, -1
"""Values of a tri-state grid (int8)."""
MAX_CELLS = 120_000_000
"""No grid has more: 540 m x 540 m at 5 cm."""
RESOLUTIONS_M = (0.001, 100.0)
"""Smallest and largest edge of a cell that is read."""
FARTHEST_M = 1e7
"""No place is farther from the origin: fixed-point sums and cell numbers keep their millimetres up to there."""


@dataclass(frozen=True, slots=True)
class GridFrame:
    """Where a grid lies: axes parallel to the map frame, no rotation.

    Attributes
    ----------
    resolution_m : float
        Edge of a cell.
    origin_x_m, origin_y_m : float
        Lower left corner of cell (row 0, col 0) in the map frame.
    rows, cols : int
    """

    resolution_m: float
    origin_x_m: float
    origin_y_m: float
    rows: int
    cols: int

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.rows, self.cols

    @property
    def corner(self) -> F64:
        """(3,) x and y of the lower left corner and the edge of a cell, as kernels take it."""
        return np.array([self.origin_x_m, self.origin_y_m, self.resolution_m])

    @property
    def center_m(self) -> tuple[float, float]:
        """Middle in the map frame: x, y; to the micrometre, so that a file changes no digit of it."""
        return (
            round(self.origin_x_m + 0.5 * self.cols * self.resolution_m, 6),
            round(self.origin_y_m + 0.5 * self.rows * self.resolution_m, 6),
        )

    def to_cells(self, points_m: F64) -> I64:
        """(..., 2) points in the map frame -> (..., 2) row, col; may lie outside the grid."""
        cells = np.empty(points_m.shape)
        np.subtract(points_m[..., 1], self.origin_y_m, out=cells[..., 0])
        np.subtract(points_m[..., 0], self.origin_x_m, out=cells[..., 1])
        cells /= self.resolution_m
        return np.floor(cells, out=cells).astype(np.int64)

    def to_points(self, cells: I64) -> F64:
        """(..., 2) row, col -> (..., 2) x, y of the cell centres."""
        x = self.origin_x_m + (cells[..., 1] + 0.5) * self.resolution_m
        y = self.origin_y_m + (cells[..., 0] + 0.5) * self.resolution_m
        return np.stack([x, y], axis=-1)

    def window(self, row: int, col: int, rows: int, cols: int) -> GridFrame:
        """Frame of the cut-out that starts at (row, col)."""
        return GridFrame(
            self.resolution_m,
            self.origin_x_m + col * self.resolution_m,
            self.origin_y_m + row * self.resolution_m,
            rows,
            cols,
        )


def frame_around(points_m: F64, resolution_m: float, margin_m: float) -> GridFrame:
    """Smallest frame on whole multiples of the resolution that holds all points (n, 2) and a margin.

    Raises
    ------
    ValueError
        If there are no points, or they lie so far apart that the grid would have more than `MAX_CELLS`.
    """
    if points_m.shape[0] == 0:
        msg = "there is no point to draw a map around"
        raise ValueError(msg)
    least, most = points_m.min(axis=0) - margin_m, points_m.max(axis=0) + margin_m
    width, height = (most - least).tolist()
    cells = (width / resolution_m + 1.0) * (height / resolution_m + 1.0)
    if not (cells <= MAX_CELLS and np.abs([least, most]).max() < FARTHEST_M):
        msg = (
            f"poses and end points of beams span {width:.4g} m x {height:.4g} m around "
            f"({0.5 * (least[0] + most[0]):.4g}, {0.5 * (least[1] + most[1]):.4g}) m, "
            f"{cells:.1e} cells of {resolution_m:g} m; a grid has at most {MAX_CELLS:.2g} cells "
            f"within {FARTHEST_M:.0e} m of the origin"
        )
        raise ValueError(msg)
    low, high = np.floor(least / resolution_m), np.ceil(most / resolution_m)
    cols, rows = np.maximum((high - low).astype(np.int64), 1)
    return GridFrame(
        resolution_m, float(low[0] * resolution_m), float(low[1] * resolution_m), int(rows), int(cols)
    )


def mark_around(grid: B1 | U8, row: I64, col: I64, reach: int) -> None:
    """Set the cells (n,) and all those within so many rows and columns of one of them to 1."""
    rows, cols = grid.shape
    for up, right in product(range(-reach, reach + 1), repeat=2):
        grid[np.clip(row + up, 0, rows - 1), np.clip(col + right, 0, cols - 1)] = 1


@dataclass(frozen=True, slots=True)
class CountingMap:
    """How often beams ended in each cell and how far they passed through it (Eq. 1.12-1.15).

    Beams end in one cell of a hundred, so what belongs to hits is kept of those cells only; as grids it is made anew
    each time that it is asked for.

    Attributes
    ----------
    frame : GridFrame
    passed_cells : (rows, cols) float64
        Length by which beams passed through without ending here, in cells.
    hit_cells : (n,) int64
        Flat index row * cols + col of each cell in which beams ended, ascending.
    static_at_hits : (n,) float64
        alpha: sum of e over the beams that end in each.
    dynamic_at_hits : (n,) float64
        Sum of 1 - e over the beams that end in each.
    centroids_at_hits_m : (n, 2) float64
        Mean of the end points in each, weighted with e; NaN where alpha is 0.
    """

    frame: GridFrame
    passed_cells: F64
    hit_cells: I64
    static_at_hits: F64
    dynamic_at_hits: F64
    centroids_at_hits_m: F64

    @classmethod
    def of_grids(
        cls,
        frame: GridFrame,
        static_hits: F32 | F64,
        dynamic_hits: F32 | F64,
        passed_cells: F64,
        centroids_m: F32 | F64,
    ) -> CountingMap:
        """The map of grids (rows, cols), of the centroids (rows, cols, 2)."""
        static, dynamic = static_hits.ravel(), dynamic_hits.ravel()
        cells = np.flatnonzero((static > 0) | (dynamic > 0))
        alpha, others = static[cells].astype(np.float64), dynamic[cells].astype(np.float64)
        centroids = np.where((alpha > 0)[:, None], centroids_m.reshape(-1, 2)[cells], np.nan)
        return cls(frame, passed_cells, cells, alpha, others, centroids.astype(np.float64))

    @property
    def static_hits(self) -> F64:
        """(rows, cols) alpha."""
        return self._on_grid(self.static_at_hits)

    @property
    def dynamic_hits(self) -> F64:
        """(rows, cols) sum of 1 - e over the beams that end in each cell."""
        return self._on_grid(self.dynamic_at_hits)

    @property
    def centroids_m(self) -> F64:
        """(rows, cols, 2) mean of the end points in each cell; NaN where alpha is 0."""
        grid = np.full((*self.frame.shape, 2), np.nan)
        grid.reshape(-1, 2)[self.hit_cells] = self.centroids_at_hits_m
        return grid

    @property
    def passed_at_hits(self) -> F64:
        """(n,) length by which beams passed through each cell in which others ended, cells."""
        return np.asarray(self.passed_cells.reshape(-1)[self.hit_cells])

    @property
    def reflectance_at_hits(self) -> F64:
        """(n,) m = alpha / (alpha + beta), Eq. 1.15: the probability that a beam is *reflected* by the cell.

        That is not the probability that the cell is occupied: glass may have 0.3, a fence 0.5.
        """
        return self.static_at_hits / (self.static_at_hits + self.dynamic_at_hits + self.passed_at_hits)

    @property
    def reflectance(self) -> F64:
        """(rows, cols) m of all cells; NaN where nothing was seen."""
        grid = np.full(self.frame.shape, np.nan)
        grid[self.passed_cells > 0] = 0.0
        grid.reshape(-1)[self.hit_cells] = self.reflectance_at_hits
        return grid

    def _on_grid(self, values: F64) -> F64:
        """(rows, cols) values of the cells in which beams ended, elsewhere 0."""
        grid = np.zeros(self.frame.shape)
        grid.reshape(-1)[self.hit_cells] = values
        return grid


@dataclass(frozen=True, slots=True)
class OccupancyGrid:
    """A tri-state map, as map_server stores it.

    Attributes
    ----------
    frame : GridFrame
    cells : (rows, cols) int8
        FREE, OCCUPIED or UNKNOWN.
    """

    frame: GridFrame
    cells: I8
