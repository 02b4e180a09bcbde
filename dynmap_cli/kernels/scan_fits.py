"""How well one scan fits a likelihood field at one pose, and which way it fits better."""

from __future__ import annotations

import math

from dynmap_cli.arrays import F32, F64
from dynmap_cli.kernels.jit import kernel


@kernel
def scan_normal_equations(
    field: F32, floor: float, sigma_cells: float, pose_cells: F64, ends_cells: F64, scratch: F64, out: F64
) -> None:
    r"""Write negative log-likelihood, its gradient and a Gauss-Newton matrix of the ends of a scan in a field.

    Between the cells the likelihood is a cubic B-spline with the cells as coefficients: it has no steps and no kinks,
    and lies, as it must, half-way between two cells that share a wall. The matrix is that of the distance d to
    what an end belongs to, w (grad d)(grad d)^T / sigma^2, with the direction of the gradient of the field and the
    share w of the likelihood that is not `floor`.

    Parameters
    ----------
    field : (rows, cols) float32
        Likelihood of an end in each cell, above 0; the outermost cells stand for everything outside.
    floor : float
        Likelihood of an end far from everything.
    sigma_cells : float
        How far ends scatter around the map, in cells.
    pose_cells : (3,) float64
        Column and row coordinate of the robot in cells, and yaw in radians.
    ends_cells : (2, n_beams) float64
        x and y of the ends in the robot frame, in cells.
    scratch : (2, 2, 4) float64
        For the weights of columns and rows, and their derivatives.
    out : (10,) float64
        The cost; its gradient in x, y, yaw; the upper triangle of the matrix, row by row.
    """
    rows, cols = field.shape
    cos, sin = math.cos(pose_cells[2]), math.sin(pose_cells[2])
    out[:] = 0.0
    for beam in range(ends_cells.shape[1]):
        turned_x = cos * ends_cells[0, beam] - sin * ends_cells[1, beam]
        turned_y = sin * ends_cells[0, beam] + cos * ends_cells[1, beam]
        x = min(max(pose_cells[0] + turned_x - 0.5, 1.0), cols - 2.001)
        y = min(max(pose_cells[1] + turned_y - 0.5, 1.0), rows - 2.001)
        col, row = int(x), int(y)
        _spline_weights(x - col, scratch[0])
        _spline_weights(y - row, scratch[1])
        value = by_x = by_y = 0.0
        for above in range(4):
            along = change = 0.0
            for right in range(4):
                cell = field[row - 1 + above, col - 1 + right]
                along += scratch[0, 0, right] * cell
                change += scratch[0, 1, right] * cell
            value += scratch[1, 0, above] * along
            by_x += scratch[1, 0, above] * change
            by_y += scratch[1, 1, above] * along
        g_x, g_y = -by_x / value, -by_y / value
        g_yaw = g_y * turned_x - g_x * turned_y
        out[0] -= math.log(value)
        out[1] += g_x
        out[2] += g_y
        out[3] += g_yaw
        steep = g_x * g_x + g_y * g_y
        if steep > 0.0:
            scale = max(1.0 - floor / value, 0.0) / (sigma_cells * sigma_cells * steep)
            out[4] += scale * g_x * g_x
            out[5] += scale * g_x * g_y
            out[6] += scale * g_x * g_yaw
            out[7] += scale * g_y * g_y
            out[8] += scale * g_y * g_yaw
            out[9] += scale * g_yaw * g_yaw


@kernel
def _spline_weights(t: float, out: F64) -> None:
    """Weights (2, 4) of four neighbours for a place *t* in [0, 1) between the inner two, and their derivatives."""
    s = 1.0 - t
    out[0, 0] = s * s * s / 6.0
    out[0, 1] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
    out[0, 2] = (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0
    out[0, 3] = t * t * t / 6.0
    out[1, 0] = -0.5 * s * s
    out[1, 1] = -2.0 * t + 1.5 * t * t
    out[1, 2] = 2.0 * s - 1.5 * s * s
    out[1, 3] = 0.5 * t * t
