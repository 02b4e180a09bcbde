"""Where something was seen that the map has not, and how long it has stayed there."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.kernels.jit import kernel


@kernel
def clip_edges(behind_m: F64, crossings_m: F64, limits: F64, out: B1) -> None:
    """Write which beams only clip the edge of a wall: they cross it in a place that is hardly wide.

    Parameters
    ----------
    behind_m : (n,) float64
        How far behind the first wall on its way each beam ends, in the order of the beams.
    crossings_m : (n, 2) float64
        Where it crosses that wall.
    limits : (3,) float64
        Metres behind a wall from which on a beam went through; between crossings next to each other that are in one
        place at most; and, from corner to corner of what holds them, of a place that is an edge.
    out : (n,) bool
    """
    out[:] = False
    start = 0
    while start < behind_m.size:
        if not behind_m[start] > limits[0]:
            start += 1
            continue
        low_x, low_y = crossings_m[start]
        high_x, high_y, last, end = low_x, low_y, start, start + 1
        while end < behind_m.size:
            if behind_m[end] > limits[0]:
                x, y = crossings_m[end]
                if math.hypot(x - crossings_m[last, 0], y - crossings_m[last, 1]) > limits[1]:
                    break
                low_x, low_y, high_x, high_y = min(low_x, x), min(low_y, y), max(high_x, x), max(high_y, y)
                last = end
            end += 1
        if math.hypot(high_x - low_x, high_y - low_y) < limits[2]:
            for k in range(start, end):
                out[k] = behind_m[k] > limits[0]
        start = end


@kernel
def _take_connected(open_cells: B1, row: int, col: int, reached: I64) -> int:
    """Close the open cells that touch one another from (row, col) on, also at corners; write and count them."""
    rows, cols = open_cells.shape
    open_cells[row, col] = False
    reached[0, 0], reached[0, 1] = row, col
    count, done = 1, 0
    while done < count:
        row, col = reached[done, 0], reached[done, 1]
        done += 1
        for near_row in range(max(row - 1, 0), min(row + 2, rows)):
            for near_col in range(max(col - 1, 0), min(col + 2, cols)):
                if open_cells[near_row, near_col]:
                    open_cells[near_row, near_col] = False
                    reached[count, 0], reached[count, 1] = near_row, near_col
                    count += 1
    return count


@kernel
def _seen_often(cells: I64, beams: I64, least_beams: float, out: B1) -> None:
    """Write which points lie in cells that touch one another and hold so many beams together.

    Parameters
    ----------
    cells : (n, 2) int64
        Row and column of each point; -1 = outside.
    beams : (rows, cols) int64
        Points in each cell.
    least_beams : float
    out : (n,) bool
    """
    open_cells, is_often = beams > 0, np.zeros(beams.shape, dtype=np.bool_)
    reached = np.empty((beams.size, 2), dtype=np.int64)
    for k in range(cells.shape[0]):
        row, col = cells[k, 0], cells[k, 1]
        out[k] = False
        if row < 0:
            continue
        if open_cells[row, col]:
            count, total = _take_connected(open_cells, row, col, reached), 0
            for part in range(count):
                total += beams[reached[part, 0], reached[part, 1]]
            for part in range(count):
                is_often[reached[part, 0], reached[part, 1]] = total >= least_beams
        out[k] = is_often[row, col]


@kernel
def see_places(
    points_m: F64,
    cell: F64,
    cells_at_once: int,
    now_s: float,
    limits: F64,
    is_fixed: bool,
    first_s: F64,
    last_s: F64,
    out: B1,
) -> None:
    """Note when points were seen, by cells; write which of them belong to a thing that has stayed.

    Cells that touch belong to one thing, which is as old as its oldest cell. Only cells within the bounds of
    the points and beside them are looked at.

    Parameters
    ----------
    points_m : (n, 2) float64
    cell : (3,) float64
        x and y of the map's lower left corner, and the edge of one of its cells, in metres.
    cells_at_once : int
        Cells of the map along the edge of a cell here.
    now_s : float
    limits : (4,) float64
        Seconds after which a thing has stayed, and after which a cell that was not seen is forgotten; points that
        touch one another at least, else they are not noted; cells of a thing at least.
    is_fixed : bool
        Whether cells that are seen take over the age of their thing.
    first_s, last_s : (rows, cols) float64
        When something was seen in each cell, first and last; -inf = never.
    out : (n,) bool
    """
    n = points_m.shape[0]
    rows, cols = first_s.shape
    cells = np.full((n, 2), -1, dtype=np.int64)
    top, left, bottom, right = rows, cols, -1, -1
    for k in range(n):
        col = int(math.floor((points_m[k, 0] - cell[0]) / cell[2])) // cells_at_once
        row = int(math.floor((points_m[k, 1] - cell[1]) / cell[2])) // cells_at_once
        if 0 <= row < rows and 0 <= col < cols:
            cells[k, 0], cells[k, 1] = row, col
            top, left, bottom, right = min(top, row), min(left, col), max(bottom, row), max(right, col)
    top, left, bottom, right = max(top - 1, 0), max(left - 1, 0), min(bottom + 2, rows), min(right + 2, cols)
    beams = np.zeros((max(bottom - top, 0), max(right - left, 0)), dtype=np.int64)
    for k in range(n):
        if cells[k, 0] >= 0:
            cells[k, 0] -= top
            cells[k, 1] -= left
            beams[cells[k, 0], cells[k, 1]] += 1
    _seen_often(cells, beams, limits[2], out)
    first, last = first_s[top:bottom, left:right], last_s[top:bottom, left:right]
    for k in range(n):
        if out[k]:
            row, col = cells[k, 0], cells[k, 1]
            if now_s - last[row, col] > limits[1]:
                first[row, col] = now_s
            last[row, col] = now_s
    recent, stays = now_s - last <= limits[1], np.zeros(beams.shape, dtype=np.bool_)
    reached = np.empty((beams.size, 2), dtype=np.int64)
    for k in range(n):
        if not out[k]:
            continue
        if recent[cells[k, 0], cells[k, 1]]:
            count = _take_connected(recent, cells[k, 0], cells[k, 1], reached)
            oldest_s, start_s = 0.0, now_s
            for part in range(count):
                row, col = reached[part, 0], reached[part, 1]
                start_s = min(start_s, first[row, col])
                oldest_s = max(oldest_s, last[row, col] - first[row, col])
            if is_fixed:
                oldest_s = now_s - start_s
            for part in range(count):
                row, col = reached[part, 0], reached[part, 1]
                stays[row, col] = oldest_s >= limits[0] and count >= limits[3]
                if is_fixed and last[row, col] == now_s:
                    first[row, col] = start_s
        out[k] = stays[cells[k, 0], cells[k, 1]]
