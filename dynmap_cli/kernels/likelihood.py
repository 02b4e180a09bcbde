"""Likelihood fields: what a scan says about many poses."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F32, F64, I32
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
