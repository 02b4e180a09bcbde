"""Evidence of what was seen where and when: hits, beams that cross a surface, and the tri-state of cells."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F64, I8, I32, I64
from dynmap_cli.kernels.beams import (
    BEAM_ROWS,
    IS_HIT,
    LENGTH,
    START_X,
    START_Y,
    STEP_X,
    STEP_Y,
    PlacedScans,
    has_pose,
    place_beams,
)
from dynmap_cli.kernels.jit import kernel

HITS, OFFSET_X, OFFSET_Y = range(3)
"""Columns of the moments of the end points in a cell."""
LAST_WINDOW, WINDOW_HITS, MOST_HITS = range(3)
"""Columns of their counts in windows."""


@kernel
def add_hit_moments(
    scans: PlacedScans,
    rows: int,
    cols: int,
    window: int,
    numbers: I32,
    moments: F64,
    window_counts: I32,
    n_hit: int,
) -> int:
    """Add the end points of the scans of a window: how many lie in each cell, and the sums of their places.

    Parameters
    ----------
    scans : PlacedScans
    rows, cols : int
        Of the grid.
    window : int
        Number of the window; one after the other, from 0.
    numbers : (rows, cols) int32
        Number of each cell in which a beam ended, from 1 in the order in which they were met; 0 = none.
    moments : (rows * cols + 1, 3) float64
        By number: end points, and the sums of their offsets from the corner of the cell, cells.
    window_counts : (rows * cols + 1, 3) int32
        By number: last window in which a beam ended in the cell, end points in it in that window, and in the window
        that has most of them.
    n_hit : int
        How many cells have a number.

    Returns
    -------
    int
        How many have one now.
    """
    n_scans, n_beams = scans.ranges_m.shape
    beams = np.empty((BEAM_ROWS, n_beams))
    for scan in range(n_scans):
        if not has_pose(scans, scan):
            continue
        place_beams(scans, scan, beams)
        for beam in range(n_beams):
            if beams[IS_HIT, beam] == 0.0:
                continue
            x = beams[START_X, beam] + beams[LENGTH, beam] * beams[STEP_X, beam]
            y = beams[START_Y, beam] + beams[LENGTH, beam] * beams[STEP_Y, beam]
            if 0.0 <= x < cols and 0.0 <= y < rows:
                col, row = int(x), int(y)
                number = numbers[row, col]
                if number == 0:
                    n_hit += 1
                    numbers[row, col] = number = n_hit
                    window_counts[number, LAST_WINDOW] = window
                moments[number, HITS] += 1.0
                moments[number, OFFSET_X] += x - col
                moments[number, OFFSET_Y] += y - row
                if window_counts[number, LAST_WINDOW] != window:
                    window_counts[number, LAST_WINDOW] = window
                    window_counts[number, WINDOW_HITS] = 0
                window_counts[number, WINDOW_HITS] += 1
                most = max(window_counts[number, MOST_HITS], window_counts[number, WINDOW_HITS])
                window_counts[number, MOST_HITS] = most
    return n_hit


@kernel
def surface_normals(
    cells: I64,
    numbers: I32,
    moments: F64,
    radius_cells: int,
    max_spread_ratio: float,
    out: F64,
) -> None:
    """Write the normal of the line through the hits around each cell, (0, 0) where they form no line.

    The line is that of the hit centroids within `radius_cells`, weighted with their hits; it counts as a
    line if the smaller eigenvalue of their scatter is at most `max_spread_ratio` of the larger one.

    Parameters
    ----------
    cells : (n, 2) int64
        Row and column.
    numbers, moments
        As `add_hit_moments` leaves them.
    radius_cells : int
    max_spread_ratio : float
    out : (n, 2) float64
        Unit normal (x, y).
    """
    rows, cols = numbers.shape
    for k in range(cells.shape[0]):
        row, col = cells[k, 0], cells[k, 1]
        weight = mean_x = mean_y = xx = xy = yy = 0.0
        for r in range(max(row - radius_cells, 0), min(row + radius_cells + 1, rows)):
            for c in range(max(col - radius_cells, 0), min(col + radius_cells + 1, cols)):
                number = numbers[r, c]
                if number > 0:
                    w = moments[number, HITS]
                    x, y = c - col + moments[number, OFFSET_X] / w, r - row + moments[number, OFFSET_Y] / w
                    weight += w
                    mean_x += w * x
                    mean_y += w * y
                    xx += w * x * x
                    xy += w * x * y
                    yy += w * y * y
        out[k, 0] = out[k, 1] = 0.0
        if weight <= 0.0:
            continue
        mean_x, mean_y = mean_x / weight, mean_y / weight
        xx, xy, yy = xx / weight - mean_x**2, xy / weight - mean_x * mean_y, yy / weight - mean_y**2
        middle, reach = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
        if reach <= 0.0 or middle - reach > max_spread_ratio * (middle + reach):
            continue
        along = 0.5 * math.atan2(2.0 * xy, xx - yy)
        out[k, 0], out[k, 1] = -math.sin(along), math.cos(along)


@kernel
def add_evidence(
    scans: PlacedScans,
    index: I32,
    rows: int,
    cols: int,
    normals: F64,
    min_crossing_sine: float,
    beyond_m: float,
    hits: F64,
    crossed: F64,
    touched: I64,
    n_touched: int,
) -> int:
    """Add scans: end points per numbered cell, and the length of the beams that cross its surface.

    A pass is evidence only where the beam meets the local surface steeply enough and ends at least
    `beyond_m` further on: along a wall that never changed, beams slide through its cells and end on the same
    wall. A beam without return, or longer than the usable range, passes up to the usable range.

    Parameters
    ----------
    scans : PlacedScans
    index : (rows * cols,) int32
        Number of each cell of interest, row by row; for the others -d, where d >= 1 is the distance (of rows or
        columns, whichever is more) to the nearest one of interest.
    rows, cols : int
    normals : (n, 2) float64
        Normal of the surface in each cell of interest, (0, 0) = none.
    min_crossing_sine : float
        Sine of the smallest angle between beam and surface.
    beyond_m : float
    hits : (n,) float64
    crossed : (n,) float64
        Length in cells.
    touched : (n,) int64
        Numbers of the cells that are not zero any more, the first `n_touched` entries.
    n_touched : int

    Returns
    -------
    int
        The new `n_touched`.
    """
    beyond = beyond_m / scans.resolution_m
    n_scans, n_beams = scans.ranges_m.shape
    beams = np.empty((BEAM_ROWS, n_beams))
    for scan in range(n_scans):
        if not has_pose(scans, scan):
            continue
        place_beams(scans, scan, beams)
        for beam in range(n_beams):
            if math.isnan(scans.ranges_m[scan, beam]):
                continue
            x0, y0 = beams[START_X, beam], beams[START_Y, beam]
            dx, dy, stop = beams[STEP_X, beam], beams[STEP_Y, beam], beams[LENGTH, beam]
            if beams[IS_HIT, beam] > 0.0:
                x, y = x0 + stop * dx, y0 + stop * dy
                if 0.0 <= x < cols and 0.0 <= y < rows:
                    cell = index[int(y) * cols + int(x)]
                    if cell >= 0:
                        if hits[cell] == 0.0 and crossed[cell] == 0.0:
                            touched[n_touched] = cell
                            n_touched += 1
                        hits[cell] += 1.0
                stop -= beyond
            # The part [start, stop] of the beam that lies in the grid, in cells from the sensor.
            start = 0.0
            if dx != 0.0:
                near, far = -x0 / dx, (cols - x0) / dx
                start, stop = max(start, min(near, far)), min(stop, max(near, far))
            elif not 0.0 <= x0 < cols:
                continue
            if dy != 0.0:
                near, far = -y0 / dy, (rows - y0) / dy
                start, stop = max(start, min(near, far)), min(stop, max(near, far))
            elif not 0.0 <= y0 < rows:
                continue
            if stop <= start:
                continue
            # From a cell that is d >= 2 cells away from the nearest one of interest, the beam leaps d - 1 cells along
            # its major axis at once; beside and in those of interest it goes from edge to edge.
            col = min(max(int(x0 + start * dx), 0), cols - 1)
            row = min(max(int(y0 + start * dy), 0), rows - 1)
            step_col, step_row = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
            edge_col, edge_row = int(dx > 0.0), int(dy > 0.0)
            per_col, per_row = (1.0 / dx if dx != 0.0 else 0.0), (1.0 / dy if dy != 0.0 else 0.0)
            per_cell = 1.0 / max(abs(dx), abs(dy))
            at = start
            while at < stop:
                cell = index[row * cols + col]
                if cell < -1:
                    at += (-cell - 1) * per_cell
                    col = min(max(int(x0 + at * dx), 0), cols - 1)
                    row = min(max(int(y0 + at * dy), 0), rows - 1)
                    continue
                leaving_x = (col + edge_col - x0) * per_col if dx != 0.0 else math.inf
                leaving_y = (row + edge_row - y0) * per_row if dy != 0.0 else math.inf
                leaving = min(leaving_x, leaving_y)
                if cell >= 0:
                    nx, ny = normals[cell, 0], normals[cell, 1]
                    passed = min(leaving, stop) - at
                    is_crossing = abs(dx * nx + dy * ny) >= min_crossing_sine or (nx == 0.0 and ny == 0.0)
                    if is_crossing and passed > 1e-9:
                        if hits[cell] == 0.0 and crossed[cell] == 0.0:
                            touched[n_touched] = cell
                            n_touched += 1
                        crossed[cell] += passed
                at, is_x = leaving, leaving_x < leaving_y
                # Selected, not branched: a wrong guess costs more than the arithmetic.
                col += step_col if is_x else 0
                row += 0 if is_x else step_row
                if col < 0 or col >= cols or row < 0 or row >= rows:
                    break
    return n_touched


@kernel
def judge_cells(
    hits: F64,
    crossed: F64,
    neighbours: I32,
    touched: I64,
    n_touched: int,
    occupied_share: float,
    occupied_hits: float,
    free_share: float,
    free_cells: float,
    out: I8,
) -> None:
    """Write what was seen in each touched cell: 1 occupied, 0 free, -1 neither.

    With the hit share h = hits / (hits + crossed), a cell is occupied if h is large and there are hits
    enough, free if the largest h of the cells around it is small and enough beams crossed it.

    Parameters
    ----------
    hits, crossed : (n,) float64
    neighbours : (n, k) int32
        Numbers of the cells around each cell and its own, -1 = a cell that no beam ended in.
    touched : (n,) int64
    n_touched : int
    occupied_share, free_share : float
        Bounds on h.
    occupied_hits : float
    free_cells : float
        Least length of the beams that crossed, cells.
    out : (n,) int8
        Entry k is that of cell touched[k].
    """
    for k in range(n_touched):
        cell = touched[k]
        out[k] = -1
        if hits[cell] >= occupied_hits and hits[cell] >= occupied_share * (hits[cell] + crossed[cell]):
            out[k] = 1
        elif crossed[cell] >= free_cells:
            largest = 0.0
            for n in range(neighbours.shape[1]):
                other = neighbours[cell, n]
                if other >= 0 and hits[other] > 0.0:
                    largest = max(largest, hits[other] / (hits[other] + crossed[other]))
            if largest < free_share:
                out[k] = 0


@kernel
def segment_is_blocked(x0: float, y0: float, x1: float, y1: float, blocking: I8) -> bool:
    """Whether the segment between two points crosses a blocking cell; its two end cells do not count.

    Coordinates are in cells; blocking is (rows, cols) int8, 1 = blocks.
    """
    rows, cols = blocking.shape
    dx, dy = x1 - x0, y1 - y0
    col, row = int(math.floor(x0)), int(math.floor(y0))
    end_col, end_row = int(math.floor(x1)), int(math.floor(y1))
    step_col, step_row = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    next_x = ((col + (dx > 0)) - x0) / dx if dx != 0.0 else math.inf
    next_y = ((row + (dy > 0)) - y0) / dy if dy != 0.0 else math.inf
    delta_x = abs(1.0 / dx) if dx != 0.0 else math.inf
    delta_y = abs(1.0 / dy) if dy != 0.0 else math.inf
    for _ in range(abs(end_col - col) + abs(end_row - row) - 1):
        if next_x < next_y:
            col += step_col
            next_x += delta_x
        else:
            row += step_row
            next_y += delta_y
        if 0 <= row < rows and 0 <= col < cols and blocking[row, col] == 1:
            return True
    return False
