"""Likelihood fields and surfaces: what a scan says about many poses, and which surfaces its beams cross."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I32, I64, U8
from dynmap_cli.kernels.jit import kernel


@kernel
def field_log_likelihoods(
    pool: F32,
    rows: int,
    cols: int,
    cell: F64,
    poses: F64,
    ends_cells: F32,
    windows: I32,
    index: I32,
    out: F64,
) -> None:
    """Write the sum over all beams of the field's value at the beam's end, for each pose.

    The first rows * cols numbers of the pool are the field of the whole map, whose outermost cells hold
    the value of everything outside; behind them lie the fields of the patches. A pose reads ends inside
    its own window from its own patch, all others from the map.

    Parameters
    ----------
    pool : (n,) float32
        Logarithm of the likelihood of an end in each cell; row-major fields, one after another.
    rows, cols : int
        Size of the map's field.
    cell : (3,) float64
        x and y of the lower left corner of the map's field, and the edge of a cell, in metres.
    poses : (n_poses, 3) float64
        map_from_robot, metres and radians.
    ends_cells : (2, n_beams) float32
        x and y of the ends in the robot frame, in cells.
    windows : (n_poses or 1, 5) int32
        First row, first column, rows and columns of each pose's patch, and where its field starts in the
        pool; rows 0 = none. One row stands for all poses.
    index : (n_beams,) int32
        Scratch.
    out : (n_poses,) float64
        Sums.
    """
    n_beams = ends_cells.shape[1]
    fours = n_beams // 4 * 4
    width, zero = np.int32(cols), np.float32(0.0)
    last_col, last_row = np.float32(cols - 1), np.float32(rows - 1)
    for pose in range(poses.shape[0]):
        x0 = np.float32((poses[pose, 0] - cell[0]) / cell[2])
        y0 = np.float32((poses[pose, 1] - cell[1]) / cell[2])
        cos, sin = np.float32(math.cos(poses[pose, 2])), np.float32(math.sin(poses[pose, 2]))
        own = min(pose, windows.shape[0] - 1)
        patch_rows, patch_cols = windows[own, 2], windows[own, 3]
        if patch_rows == 0:
            for beam in range(n_beams):
                x = x0 + cos * ends_cells[0, beam] - sin * ends_cells[1, beam]
                y = y0 + sin * ends_cells[0, beam] + cos * ends_cells[1, beam]
                row = np.int32(min(max(y, zero), last_row))
                index[beam] = row * width + np.int32(min(max(x, zero), last_col))
        else:
            first_row, first_col, start = windows[own, 0], windows[own, 1], windows[own, 4]
            for beam in range(n_beams):
                x = x0 + cos * ends_cells[0, beam] - sin * ends_cells[1, beam]
                y = y0 + sin * ends_cells[0, beam] + cos * ends_cells[1, beam]
                row = np.int32(min(max(y, zero), last_row))
                col = np.int32(min(max(x, zero), last_col))
                own_row, own_col = np.int32(row - first_row), np.int32(col - first_col)
                inside = (own_row >= 0) & (own_row < patch_rows) & (own_col >= 0) & (own_col < patch_cols)
                in_patch = np.int32(start + own_row * patch_cols + own_col)
                index[beam] = in_patch if inside else np.int32(row * width + col)
        sum_0 = sum_1 = sum_2 = sum_3 = 0.0
        for beam in range(0, fours, 4):
            sum_0 += pool[np.uint32(index[beam])]
            sum_1 += pool[np.uint32(index[beam + 1])]
            sum_2 += pool[np.uint32(index[beam + 2])]
            sum_3 += pool[np.uint32(index[beam + 3])]
        for beam in range(fours, n_beams):
            sum_0 += pool[np.uint32(index[beam])]
        out[pose] = (sum_0 + sum_1) + (sum_2 + sum_3)


@kernel
def own_cells(points_m: F64, cell: F64, owned: B1, cells: I64, inside: B1) -> None:
    """Write the cell of a grid that each point lies in, clipped to the grid, and whether it is an own cell.

    Parameters
    ----------
    points_m : (n, 2) float64
    cell : (3,) float64
        x and y of the grid's lower left corner, and the edge of a cell, in metres.
    owned : (rows, cols) bool
    cells : (n, 2) int64
        Row and column.
    inside : (n,) bool
    """
    rows, cols = owned.shape
    for k in range(points_m.shape[0]):
        col = math.floor((points_m[k, 0] - cell[0]) / cell[2])
        row = math.floor((points_m[k, 1] - cell[1]) / cell[2])
        is_in = 0 <= row < rows and 0 <= col < cols
        cells[k, 0] = min(max(row, 0), rows - 1)
        cells[k, 1] = min(max(col, 0), cols - 1)
        inside[k] = is_in and owned[cells[k, 0], cells[k, 1]]


@kernel
def explain_ends(ends_m: F64, cell: F64, explained: B1, out: B1) -> None:
    """Write whether the cell of each end is an explained one; ends outside the grid count for its border.

    Parameters
    ----------
    ends_m : (n, 2) float64
    cell : (3,) float64
        x and y of the grid's lower left corner, and the edge of a cell, in metres.
    explained : (rows, cols) bool
    out : (n,) bool
    """
    rows, cols = explained.shape
    for k in range(ends_m.shape[0]):
        col = math.floor((ends_m[k, 0] - cell[0]) / cell[2])
        row = math.floor((ends_m[k, 1] - cell[1]) / cell[2])
        out[k] = explained[min(max(row, 0), rows - 1), min(max(col, 0), cols - 1)]


@kernel
def explain_by_states(
    ends_m: F64, cell: F64, owned: B1, explained: B1, state: int, now: B1, other: B1
) -> None:
    """Overwrite, for ends in own cells of a sub-map, whether one state explains them, and whether only others do.

    Parameters
    ----------
    ends_m : (n, 2) float64
    cell : (3,) float64
        As for `explain_ends`, of the sub-map.
    owned : (rows, cols) bool
    explained : (n_states, rows, cols) bool
    state : int
    now, other : (n,) bool
    """
    rows, cols = owned.shape
    for k in range(ends_m.shape[0]):
        col = math.floor((ends_m[k, 0] - cell[0]) / cell[2])
        row = math.floor((ends_m[k, 1] - cell[1]) / cell[2])
        if 0 <= row < rows and 0 <= col < cols and owned[row, col]:
            now[k] = explained[state, row, col]
            other[k] = explained[:, row, col].any() and not now[k]


@kernel
def place_beams(directions_rad: F64, lengths_m: F64, pose: F64, out_rad: F64, out_m: F64) -> None:
    """Write the directions and the ends of beams that start at a pose (3,).

    Parameters
    ----------
    directions_rad, lengths_m : (n,) float64
        Seen from the pose.
    pose : (3,) float64
    out_rad : (n,) float64
    out_m : (n, 2) float64
    """
    for k in range(directions_rad.size):
        out_rad[k] = directions_rad[k] + pose[2]
        out_m[k, 0] = pose[0] + lengths_m[k] * math.cos(out_rad[k])
        out_m[k, 1] = pose[1] + lengths_m[k] * math.sin(out_rad[k])


@kernel
def first_crossings(
    surfaces: U8,
    x_cells: float,
    y_cells: float,
    directions_rad: F64,
    lengths_cells: F64,
    least_sine: float,
    out: F64,
) -> None:
    """Write where each beam enters a grid and where it first crosses a surface in it.

    A beam that slides along a surface crosses nothing: only cells whose surface it meets at an angle
    with a sine of at least *least_sine* count.

    Parameters
    ----------
    surfaces : (rows, cols) uint8
        0 = nothing solid, 1 to 180 = solid, direction of the surface in degrees plus one,
        255 = solid from all sides.
    x_cells, y_cells : float
        The sensor, in cells of this grid (may lie outside).
    directions_rad : (n,) float64
        Direction of each beam in the map frame.
    lengths_cells : (n,) float64
        How far each beam is followed, cells; finite.
    least_sine : float
    out : (n, 2) float64
        Distance at which the beam enters the grid, and the cell with its first crossing; cells,
        +inf where it does not within its length.
    """
    rows, cols = surfaces.shape
    for beam in range(directions_rad.size):
        out[beam, 0] = math.inf
        out[beam, 1] = math.inf
        dx, dy = math.cos(directions_rad[beam]), math.sin(directions_rad[beam])
        enter, leave = 0.0, lengths_cells[beam]
        if dx != 0.0:
            a, b = -x_cells / dx, (cols - x_cells) / dx
            enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
        elif not 0.0 <= x_cells < cols:
            continue
        if dy != 0.0:
            a, b = -y_cells / dy, (rows - y_cells) / dy
            enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
        elif not 0.0 <= y_cells < rows:
            continue
        if enter >= leave:
            continue
        out[beam, 0] = enter
        col = min(max(int(math.floor(x_cells + dx * enter)), 0), cols - 1)
        row = min(max(int(math.floor(y_cells + dy * enter)), 0), rows - 1)
        step_col, step_row = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        delta_x = abs(1.0 / dx) if dx != 0.0 else math.inf
        delta_y = abs(1.0 / dy) if dy != 0.0 else math.inf
        next_x = ((col + (dx > 0)) - x_cells) / dx if dx != 0.0 else math.inf
        next_y = ((row + (dy > 0)) - y_cells) / dy if dy != 0.0 else math.inf
        at = enter
        while at < leave and 0 <= col < cols and 0 <= row < rows:
            code = surfaces[row, col]
            if code != 0:
                along = math.radians(code - 1.0)
                if code == 255 or abs(dx * math.sin(along) - dy * math.cos(along)) >= least_sine:
                    out[beam, 1] = at
                    break
            if next_x < next_y:
                col += step_col
                at = next_x
                next_x += delta_x
            else:
                row += step_row
                at = next_y
                next_y += delta_y
