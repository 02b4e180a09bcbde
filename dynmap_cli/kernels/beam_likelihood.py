"""The beam model: what each beam says about the cells it passes and the cell it ends in (Eq. 1.1)."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I32
from dynmap_cli.kernels.jit import kernel


@kernel
def beam_log_likelihoods(
    log_pass: F32,
    rows: int,
    cols: int,
    cell: F64,
    poses: F64,
    sensor_m: F64,
    directions: F64,
    lengths_cells: F64,
    hits: B1,
    windows: I32,
    model: F64,
    out: F64,
) -> None:
    r"""Write the logarithm of the likelihood of a scan under Eq. 1.1, for each pose.

    .. math::
        \sum_n \ln\Big( z_{hit} \prod_k (1 - m_k)^{l_k} \, [p\, m_{end} + (1 - p)(1 - m_{end})] + z_{floor} \Big)

    where l_k is the length in cells by which the beam passes cell k. The bracket is the sum of Eq. 1.1 over
    its two cases, c = 1 with probability p; it is 1 for a beam that hit nothing.

    Parameters
    ----------
    log_pass : (n,) float32
        ln(1 - m) of each cell; row-major, the whole map first, then the patches.
    rows, cols : int
        Size of the map.
    cell : (3,) float64
        x and y of the lower left corner of the map, and the edge of a cell, in metres.
    poses : (n_poses, 3) float64
        map_from_robot.
    sensor_m : (2,) float64
        In the robot frame.
    directions : (2, n_beams) float64
        x and y of each beam's unit vector in the robot frame.
    lengths_cells : (n_beams,) float64
    hits : (n_beams,) bool
        False where nothing was hit.
    windows : (n_poses or 1, 5) int32
        See `field_log_likelihoods`.
    model : (4,) float64
        z_hit, z_floor, p, and ln(1 - m) of what lies outside the map.
    out : (n_poses,) float64
    """
    nowhere = np.zeros(5, dtype=np.int32)
    found, since = np.empty(3), np.empty(rows + cols)
    index = np.empty((3, rows + cols), dtype=np.int32)
    for pose in range(poses.shape[0]):
        cos, sin = math.cos(poses[pose, 2]), math.sin(poses[pose, 2])
        x = (poses[pose, 0] - cell[0] + cos * sensor_m[0] - sin * sensor_m[1]) / cell[2]
        y = (poses[pose, 1] - cell[1] + sin * sensor_m[0] + cos * sensor_m[1]) / cell[2]
        is_inside = 0.0 <= x < cols and 0.0 <= y < rows
        window = windows[min(pose, windows.shape[0] - 1)]
        total, product = 0.0, 1.0
        for beam in range(hits.size):
            likelihood = 0.0
            if is_inside:
                dx = cos * directions[0, beam] - sin * directions[1, beam]
                dy = sin * directions[0, beam] + cos * directions[1, beam]
                leave = min(way_out(x, dx, cols), way_out(y, dy, rows))
                length = min(lengths_cells[beam], leave)
                own = window if meets(window, x, y, x + length * dx, y + length * dy) else nowhere
                passed_and_end(log_pass, cols, own, x, y, dx, dy, length, index, since, found)
                passed, end = found[0], found[1]
                if lengths_cells[beam] > leave:
                    passed += found[2] * end + (lengths_cells[beam] - leave) * model[3]
                    end = model[3]
                likelihood = math.exp(passed)
                if hits[beam]:
                    passes = math.exp(end)
                    likelihood *= model[2] * (1.0 - passes) + (1.0 - model[2]) * passes
            product *= model[0] * likelihood + model[1]
            if beam % 32 == 31:
                total, product = total + math.log(product), 1.0
        out[pose] = total + math.log(product)


@kernel
def meets(window: I32, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether the box around a ray touches a window; a window of no rows is touched by nothing."""
    return bool(
        (window[2] > 0)
        & (min(y0, y1) <= window[0] + window[2])
        & (max(y0, y1) >= window[0])
        & (min(x0, x1) <= window[1] + window[3])
        & (max(x0, x1) >= window[1])
    )


@kernel
def way_out(at: float, slope: float, size: int) -> float:
    """How far a ray goes along one axis before it leaves [0, size), with a little to spare."""
    if slope > 0.0:
        return max((size - 1e-6 - at) / slope, 0.0)
    if slope < 0.0:
        return max((at - 1e-6) / -slope, 0.0)
    return math.inf


@kernel
def passed_and_end(
    log_pass: F32,
    cols: int,
    window: I32,
    x0: float,
    y0: float,
    dx: float,
    dy: float,
    length: float,
    index: I32,
    since: F64,
    out: F64,
) -> None:
    """Write the sum of log_pass times length over the cells a ray passes, and log_pass where it ends.

    The ray is cut at the lines across the axis a along which it goes farther. Between two of them it lies in
    one cell, or crosses once into a neighbour along the other axis b. First every piece counts for the cell
    in which it stops, then every crossing gives back what lay before it; so no step waits for another one.

    Parameters
    ----------
    log_pass : (n,) float32
        See `beam_log_likelihoods`; all of the ray lies in the map.
    cols : int
        Of the map.
    window : (5,) int32
        The patch to read from, see `field_log_likelihoods`.
    x0, y0, dx, dy, length : float
        Start, direction and length, in cells.
    index : (3, rows + cols) int32
        Scratch.
    since : (rows + cols,) float64
        Scratch.
    out : (3,) float64
        The cell of the end is not among those that are passed; its length comes last.
    """
    is_steep = abs(dy) > abs(dx)
    a0, b0, da, db = (y0, x0, dy, dx) if is_steep else (x0, y0, dx, dy)
    stride = abs(da)
    way, slope = length * stride, db / stride
    first, a_sign = np.int32(a0), np.int32(1) if da > 0.0 else np.int32(-1)
    to_line = first + 1.0 - a0 if da > 0.0 else a0 - first
    n_pieces = max(np.int32(math.ceil(way - to_line)), np.int32(0))
    b_first, b_end = np.int32(b0), np.int32(b0 + slope * way)
    b_sign = np.int32(1) if slope > 0.0 else np.int32(-1)
    n_crossings = abs(b_end - b_first)
    line, per_slope = (b_first + 1 if slope > 0.0 else b_first) - b0, 1.0 / slope if n_crossings else 0.0
    if window[2] == 0:
        a_step, b_step = (np.int32(cols), np.int32(1)) if is_steep else (np.int32(1), np.int32(cols))
        for k in range(n_pieces):
            b = np.int32(b0 + slope * (to_line + k))
            index[0, k] = (first + a_sign * np.int32(k)) * a_step + b * b_step
        for k in range(n_crossings):
            cut = (line + b_sign * k) * per_slope
            piece = np.ceil(max(cut - to_line, 0.0))
            since[k] = cut - max(to_line + (piece - 1.0), 0.0)
            a, b = first + a_sign * np.int32(piece), b_first + b_sign * np.int32(k)
            index[1, k] = a * a_step + b * b_step
            index[2, k] = a * a_step + (b + b_sign) * b_step
    else:
        for k in range(n_pieces):
            b = np.int32(b0 + slope * (to_line + k))
            index[0, k] = pool_index(first + a_sign * np.int32(k), b, is_steep, cols, window)
        for k in range(n_crossings):
            cut = (line + b_sign * k) * per_slope
            piece = np.ceil(max(cut - to_line, 0.0))
            since[k] = cut - max(to_line + (piece - 1.0), 0.0)
            a, b = first + a_sign * np.int32(piece), b_first + b_sign * np.int32(k)
            index[1, k] = pool_index(a, b, is_steep, cols, window)
            index[2, k] = pool_index(a, b + b_sign, is_steep, cols, window)
    end = log_pass[np.uint32(pool_index(first + a_sign * n_pieces, b_end, is_steep, cols, window))]
    total = (to_line - 1.0) * log_pass[np.uint32(index[0, 0])] if n_pieces > 0 else 0.0
    total += sum_at(log_pass, index[0], n_pieces)
    for k in range(n_crossings):
        total += since[k] * (log_pass[np.uint32(index[1, k])] - log_pass[np.uint32(index[2, k])])
    reached = to_line + (n_pieces - 1) if n_pieces > 0 else 0.0
    if n_crossings > 0 and (line + b_sign * (n_crossings - 1)) * per_slope > reached:
        total += since[n_crossings - 1] * end
        reached += since[n_crossings - 1]
    out[0], out[1], out[2] = total / stride, end, (way - reached) / stride


@kernel
def sum_at(values: F32, index: I32, n: np.int32) -> float:
    """Sum of the values at the first n indices."""
    sum_0 = sum_1 = sum_2 = sum_3 = 0.0
    fours = n // 4 * 4
    for k in range(0, fours, 4):
        sum_0 += values[np.uint32(index[k])]
        sum_1 += values[np.uint32(index[k + 1])]
        sum_2 += values[np.uint32(index[k + 2])]
        sum_3 += values[np.uint32(index[k + 3])]
    for k in range(fours, n):
        sum_0 += values[np.uint32(index[k])]
    return (sum_0 + sum_1) + (sum_2 + sum_3)


@kernel
def pool_index(a: np.int32, b: np.int32, is_steep: bool, cols: int, window: I32) -> np.int32:
    """Where the pool holds a cell: in the patch of a window if it lies in it, else in the map."""
    row, col = (a, b) if is_steep else (b, a)
    own_row, own_col = row - window[0], col - window[1]
    inside = (np.uint32(own_row) < np.uint32(window[2])) & (np.uint32(own_col) < np.uint32(window[3]))
    own = window[4] + own_row * window[3] + own_col
    return np.int32(own if inside else row * cols + col)
