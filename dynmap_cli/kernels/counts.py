"""Counting: where beams end and how far they pass through each cell, exactly and in any order.

A ray with a given major axis u passes equal lengths through the cells of a run, so only three things are written:
where it starts, where it ends, and where it crosses from one row v of cells to the next. A prefix sum along u of

    ends[v, u] + crossings[v, u] - crossings[v + 1, u]

gives the lengths: a crossing ends the run in one row and starts the run in the next. Everything is int64 fixed
point, so the result does not depend on order or threads, and a scan can be taken out again exactly.

`ends` and `crossings` are flat: first the (rows + 1, cols + 2) grid of the rays whose major axis is x, then the
(cols + 1, rows + 2) grid of those whose major axis is y.

What is computed and what is written stand in separate loops: the former are vectorized by the compiler, and the
latter keep many cache misses in flight.
"""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64
from dynmap_cli.kernels.beams import (
    BEAM_ROWS,
    LENGTH,
    START_X,
    START_Y,
    STEP_X,
    STEP_Y,
    PlacedScans,
    cells_of_hits,
    has_pose,
    place_beams,
)
from dynmap_cli.kernels.jit import kernel

FIXED_ONE = 2.0**32
"""Fixed-point value of one cell or one hit: 2e9 passes fit into a cell, rounding is 1e-10 cell."""
STATIC, DYNAMIC, OFFSET_X, OFFSET_Y = range(4)
"""Sums over the hits of a cell."""
HIT_SUMS = 4
_CROSSING, _SLOPE, _SIGNED_UNIT = range(3)
_UNIT, _FROM, _FROM_RIGHT, _TO, _TO_RIGHT, _ROW, _AFTER, _STRIDE = range(8)
_STEEPEST = 1e300
_COLS_AT_ONCE = 16


@kernel
def count_scans(
    scans: PlacedScans,
    weights: F32,
    rows: int,
    cols: int,
    sign: int,
    ends: I64,
    crossings: I64,
    numbers: I32,
    hits: I64,
    n_hit: int,
) -> int:
    """Add (sign 1) or take out (sign -1) scans: alpha, beta and the sums for the hit centroids (Eq. 1.12).

    A beam adds e to the static and 1 - e to the dynamic hits of its end cell, and the length by which it
    passes each earlier cell to the difference grids. A beam without return, or one that is longer than the
    usable range, passes up to the usable range and ends nowhere (zeta = 1 in Eq. 1.1); so does one with a
    negative range, up to its absolute value.

    Parameters
    ----------
    scans : PlacedScans
    weights : (n_scans, n_beams) float32
        e of each beam; NaN counts as static.
    rows, cols : int
        Of the grid.
    sign : int
    ends, crossings : ((rows + 1) * (cols + 2) + (cols + 1) * (rows + 2),) int64
        Difference grids, see above.
    numbers : (rows * cols,) int32
        Number of each cell in which a beam ended, from 1 in the order in which they were met; 0 = none.
    hits : (rows * cols + 1, HIT_SUMS) int64
        By number: static and dynamic hits, and e times the offset of the end points from the corner of the cell,
        cells.
    n_hit : int
        How many cells have a number.

    Returns
    -------
    int
        How many have one now.
    """
    n_scans, n_beams = scans.ranges_m.shape
    beams, runs = np.empty((BEAM_ROWS, n_beams)), np.empty((3, n_beams))
    entries, values = np.empty((8, n_beams), dtype=np.int64), np.empty((3, n_beams), dtype=np.int64)
    cells = np.empty(n_beams, dtype=np.int64)
    for scan in range(n_scans):
        if not has_pose(scans, scan):
            continue
        place_beams(scans, scan, beams)
        cells_of_hits(beams, rows, cols, cells)
        _weigh_hits(beams, weights[scan], sign, values)
        _find_runs(beams, rows, cols, sign, runs, entries)
        n_hit = _add_hits(cells, values, sign, numbers, hits, n_hit)
        _add_ends(entries, ends)
        _add_crossings(runs, entries, crossings)
    return n_hit


@kernel
def _weigh_hits(beams: F64, weights: F32, sign: int, values: I64) -> None:
    """Fixed-point values (3, n_beams): e, and e times the offset of the end point from the corner of its cell."""
    one = sign * FIXED_ONE
    for beam in range(weights.shape[0]):
        x = beams[START_X, beam] + beams[LENGTH, beam] * beams[STEP_X, beam]
        y = beams[START_Y, beam] + beams[LENGTH, beam] * beams[STEP_Y, beam]
        weight = float(weights[beam])
        weight = 1.0 if math.isnan(weight) else weight
        values[0, beam] = int(np.rint(weight * one))
        values[1, beam] = int(np.rint(weight * (x - np.floor(x)) * one))
        values[2, beam] = int(np.rint(weight * (y - np.floor(y)) * one))


@kernel
def _add_hits(cells: I64, values: I64, sign: int, numbers: I32, hits: I64, n_hit: int) -> int:
    """Add the values of the beams that end in a cell; number the cells that are new."""
    one = sign * int(FIXED_ONE)
    for beam in range(cells.shape[0]):
        if cells[beam] >= 0:
            cell = np.uint64(cells[beam])
            if numbers[cell] == 0:
                n_hit += 1
                numbers[cell] = n_hit
            number = np.uint64(numbers[cell])
            static = values[0, beam]
            hits[number, STATIC] += static
            hits[number, DYNAMIC] += one - static
            hits[number, OFFSET_X] += values[1, beam]
            hits[number, OFFSET_Y] += values[2, beam]
    return n_hit


@kernel
def _find_runs(beams: F64, rows: int, cols: int, sign: int, runs: F64, entries: I64) -> None:
    """Work out what each ray writes: where it is cut, its rows, its crossings, its length per cell.

    A ray is cut where it enters its end cell, which is not passed, and to the grid.

    Parameters
    ----------
    beams : (BEAM_ROWS, n_beams) float64
    rows, cols, sign : int
    runs : (3, n_beams) float64
        Where along the major axis the ray crosses into the first row of those it crosses, in ascending order; how
        far on the next crossing is; the fixed-point length per cell, negative if the ray descends.
    entries : (8, n_beams) int64
        Length per cell; for either end its entry and the part of the length that belongs to the entry after it;
        the entries at which the first row that is crossed into, and the row after the last one, begin, and their
        distance. A ray that passes nothing has -1 as the row after the last one.
    """
    y_grid = (rows + 1) * (cols + 2)
    for beam in range(beams.shape[1]):
        x0, y0, length = beams[START_X, beam], beams[START_Y, beam], beams[LENGTH, beam]
        dx, dy = beams[STEP_X, beam], beams[STEP_Y, beam]
        per_x = 1.0 / dx if dx != 0.0 else _STEEPEST
        per_y = 1.0 / dy if dy != 0.0 else _STEEPEST
        left, right, low, high = -x0 * per_x, (cols - x0) * per_x, -y0 * per_y, (rows - y0) * per_y
        enter = max(0.0, min(left, right), min(low, high))
        leave = min(length, max(left, right), max(low, high))
        end_col, end_row = np.floor(x0 + length * dx), np.floor(y0 + length * dy)
        cut_x = ((end_col if dx >= 0.0 else end_col + 1.0) - x0) * per_x
        cut_y = ((end_row if dy >= 0.0 else end_row + 1.0) - y0) * per_y
        is_inside = 0.0 <= end_col < cols and 0.0 <= end_row < rows
        leave = max(cut_x, cut_y) if is_inside else leave

        by_x = abs(dx) >= abs(dy)
        u0, v0 = (x0 if by_x else y0), (y0 if by_x else x0)
        du, dv = (dx if by_x else dy), (dy if by_x else dx)
        per_u, per_v = (per_x if by_x else per_y), (per_y if by_x else per_x)
        n_u, n_v = (cols if by_x else rows), (rows if by_x else cols)
        first_row = np.floor(v0 + enter * dv)
        # Cut by its end cell a ray ends in that cell's row, or in the row before.
        cut_u, cut_v = (cut_x if by_x else cut_y), (cut_y if by_x else cut_x)
        back = (1.0 if dv > 0.0 else -1.0) if cut_v > cut_u else 0.0
        last_row = (end_row if by_x else end_col) - back if is_inside else np.floor(v0 + leave * dv)
        is_passing = leave > enter and min(first_row, last_row) < n_v
        first_row, last_row = min(max(first_row, 0.0), n_v - 1.0), min(max(last_row, 0.0), n_v - 1.0)

        u_from, u_to = min(max(u0 + enter * du, 0.0), n_u), min(max(u0 + leave * du, 0.0), n_u)
        crossed = min(first_row, last_row) + 1.0
        slope = du * per_v
        at = min(max(u0 + (crossed - v0) * slope, min(u_from, u_to)), max(u_from, u_to))
        grid, stride = (0 if by_x else y_grid), n_u + 2
        unit = np.rint(sign * FIXED_ONE * per_u)
        entries[_UNIT, beam] = int(unit)
        entries[_FROM, beam] = grid + int(first_row) * stride + int(u_from)
        entries[_FROM_RIGHT, beam] = int((u_from - np.floor(u_from)) * unit)
        entries[_TO, beam] = grid + int(last_row) * stride + int(u_to)
        entries[_TO_RIGHT, beam] = int((u_to - np.floor(u_to)) * unit)
        runs[_CROSSING, beam], runs[_SLOPE, beam] = at, slope
        runs[_SIGNED_UNIT, beam] = unit if last_row > first_row else -unit
        entries[_ROW, beam] = grid + int(crossed) * stride
        after = grid + (int(max(first_row, last_row)) + 1) * stride
        entries[_AFTER, beam] = after if is_passing else -1
        entries[_STRIDE, beam] = stride


@kernel
def _add_ends(entries: I64, ends: I64) -> None:
    """Write the ends of the rays; the length per cell is split between the cells before and after a position.

    Indices are made unsigned here and below, as they are never counted from the end.
    """
    for beam in range(entries.shape[1]):
        if entries[_AFTER, beam] >= 0:
            unit = entries[_UNIT, beam]
            entry, right = entries[_FROM, beam], entries[_FROM_RIGHT, beam]
            ends[np.uint64(entry)] += unit - right
            ends[np.uint64(entry + 1)] += right
            entry, right = entries[_TO, beam], entries[_TO_RIGHT, beam]
            ends[np.uint64(entry)] -= unit - right
            ends[np.uint64(entry + 1)] -= right


@kernel
def _add_crossings(runs: F64, entries: I64, crossings: I64) -> None:
    """Write the crossings of the rays."""
    for beam in range(runs.shape[1]):
        at, slope, unit = runs[_CROSSING, beam], runs[_SLOPE, beam], runs[_SIGNED_UNIT, beam]
        row, after, stride = entries[_ROW, beam], entries[_AFTER, beam], entries[_STRIDE, beam]
        whole = int(unit)
        while row < after:
            col = np.floor(at)
            right = int((at - col) * unit)
            entry = row + int(col)
            crossings[np.uint64(entry)] += whole - right
            crossings[np.uint64(entry + 1)] += right
            row += stride
            at += slope


@kernel
def add_sums(theirs: I64, first: int, last: int, mine: I64) -> None:
    """Add a part of some sums (n,) to others; what is 0 is not written, so that its memory is never claimed."""
    for index in range(first, last):
        if theirs[index] != 0:
            mine[index] += theirs[index]


@kernel
def sum_along_x(ends: I64, crossings: I64, first: int, last: int, passed: I64) -> None:
    """Add to some rows of `passed` (rows, cols) the lengths of the rays whose major axis is x; 0 is not written."""
    for row in range(first, last):
        length = 0
        for col in range(passed.shape[1]):
            length += ends[row, col] + crossings[row, col] - crossings[row + 1, col]
            if length != 0:
                passed[row, col] += length


@kernel
def sum_along_y(ends: I64, crossings: I64, first: int, last: int, passed: I64) -> None:
    """Add to some columns of `passed` (rows, cols) the lengths of the rays whose major axis is y; likewise."""
    lengths = np.empty(_COLS_AT_ONCE, dtype=np.int64)
    for start in range(first, last, _COLS_AT_ONCE):
        lengths[:] = 0
        stop = min(start + _COLS_AT_ONCE, last)
        for row in range(passed.shape[0]):
            for col in range(start, stop):
                lengths[col - start] += ends[col, row] + crossings[col, row] - crossings[col + 1, row]
                if lengths[col - start] != 0:
                    passed[row, col] += lengths[col - start]


@kernel
def add_hits(theirs: I64, their_cells: I64, numbers: I32, hits: I64, n_hit: int) -> int:
    """Add the sums of cells (n, HIT_SUMS), whose flat indices (n,) are given; the others as for `count_scans`."""
    for k in range(their_cells.shape[0]):
        cell = their_cells[k]
        if numbers[cell] == 0:
            n_hit += 1
            numbers[cell] = n_hit
        for column in range(HIT_SUMS):
            hits[numbers[cell], column] += theirs[k, column]
    return n_hit
