"""Slow plain twin of the fit of a scan, one end and one cell at a time."""

from __future__ import annotations

import itertools
import math

import numpy as np


def plain_scan_fit(field, floor, sigma_cells, pose, ends):
    """Cost, gradient and matrix of the ends of a scan, by the basis function of the cubic B-spline and its slope."""
    rows, cols = field.shape
    cost, gradient, matrix = 0.0, np.zeros(3), np.zeros((3, 3))
    for ex, ey in ends.T:
        dx = math.cos(pose[2]) * ex - math.sin(pose[2]) * ey
        dy = math.sin(pose[2]) * ex + math.cos(pose[2]) * ey
        x = min(max(pose[0] + dx - 0.5, 1), cols - 2.001)
        y = min(max(pose[1] + dy - 0.5, 1), rows - 2.001)
        value = by_x = by_y = 0.0
        for row, col in itertools.product(range(rows), range(cols)):
            value += _spline(y - row)[0] * _spline(x - col)[0] * float(field[row, col])
            by_x += _spline(y - row)[0] * _spline(x - col)[1] * float(field[row, col])
            by_y += _spline(y - row)[1] * _spline(x - col)[0] * float(field[row, col])
        slope = -np.array([by_x, by_y, by_y * dx - by_x * dy]) / value
        cost -= math.log(value)
        gradient += slope
        steep = slope[0] ** 2 + slope[1] ** 2
        if steep > 0:
            matrix += (1 - floor / value) / sigma_cells**2 * np.outer(slope, slope) / steep
    return np.concatenate([[cost], gradient, matrix[np.triu_indices(3)]])


def _spline(t):
    """Cubic B-spline and its slope."""
    a, sign = abs(t), math.copysign(1.0, t)
    if a >= 2:
        return 0.0, 0.0
    if a >= 1:
        return (2 - a) ** 3 / 6, -sign * (2 - a) ** 2 / 2
    return (4 - 6 * a**2 + 3 * a**3) / 6, sign * (-12 * a + 9 * a**2) / 6
