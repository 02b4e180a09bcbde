"""Rays through grids: the plain cell traversal (Amanatides and Woo, 1987)."""

from __future__ import annotations

import math

from dynmap_cli.arrays import F64, I64
from dynmap_cli.kernels.jit import kernel


@kernel
def cells_on_ray(
    x0: float, y0: float, x1: float, y1: float, rows: int, cols: int, out_cells: I64, out_lengths: F64
) -> int:
    """Write the cells that the segment from (x0, y0) to (x1, y1) passes, in order, with the length in each.

    Coordinates are in cells: cell (row, col) covers [col, col + 1) x [row, row + 1). Parts outside the
    grid are left out.

    Parameters
    ----------
    x0, y0, x1, y1 : float
        Ends of the segment, cells.
    rows, cols : int
        Size of the grid.
    out_cells : (n, 2) int64
        Row and column of each cell; n at least 3 + |x1 - x0| + |y1 - y0|.
    out_lengths : (n,) float64
        Length of the segment in each cell, cells.

    Returns
    -------
    int
        How many cells were written.
    """
    dx, dy = x1 - x0, y1 - y0
    length = math.sqrt(dx * dx + dy * dy)
    col, row = math.floor(x0), math.floor(y0)
    end_col, end_row = math.floor(x1), math.floor(y1)
    step_col = 1 if dx > 0 else -1
    step_row = 1 if dy > 0 else -1
    next_x = ((col + (dx > 0)) - x0) / dx if dx != 0.0 else math.inf
    next_y = ((row + (dy > 0)) - y0) / dy if dy != 0.0 else math.inf
    delta_x = abs(1.0 / dx) if dx != 0.0 else math.inf
    delta_y = abs(1.0 / dy) if dy != 0.0 else math.inf
    steps = abs(end_col - col) + abs(end_row - row)
    count = 0
    entered = 0.0
    for step in range(steps + 1):
        leaving = min(next_x, next_y, 1.0) if step < steps else 1.0
        if 0 <= row < rows and 0 <= col < cols:
            out_cells[count, 0] = row
            out_cells[count, 1] = col
            out_lengths[count] = max(leaving - entered, 0.0) * length
            count += 1
        entered = max(leaving, entered)
        if next_x < next_y:
            col += step_col
            next_x += delta_x
        else:
            row += step_row
            next_y += delta_y
    return count
