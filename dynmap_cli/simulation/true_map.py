"""The map that a perfect mapper would draw of what never changes."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import F64
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, frame_around
from dynmap_cli.simulation.shapes import Shapes

_MARGIN_M = 1.0
_CIRCLE_POINTS = 16


def draw_true_map(shapes: Shapes, path: F64, turn_rad: float, resolution_m: float) -> OccupancyGrid:
    """Draw the static walls; free is what is joined to the robot's path without crossing them.

    Parameters
    ----------
    shapes : Shapes
    path : (n, 2) float64
        Where the robot was, in the world's own axes.
    turn_rad : float
        Turn of the world against the map.
    resolution_m : float
    """
    walls = shapes.segments[shapes.segment_gates[:, 0] < 0]
    pillars = shapes.circles[shapes.circle_gates[:, 0] < 0]
    surface = np.concatenate(
        [*(_along(wall, resolution_m) for wall in walls), *map(_around, pillars), path[:0]]
    )
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[cos, sin], [-sin, cos]])
    surface, path = surface @ turn, path @ turn
    frame = frame_around(np.concatenate([surface, path]), resolution_m, _MARGIN_M)
    cells = np.full(frame.shape, UNKNOWN, dtype=np.int8)
    rows, cols = frame.to_cells(surface).T
    cells[rows, cols] = OCCUPIED
    regions, _ = ndimage.label(cells != OCCUPIED)
    rows, cols = frame.to_cells(path).T
    reached = np.unique(regions[rows, cols])
    cells[np.isin(regions, reached[reached > 0])] = FREE
    return OccupancyGrid(frame, cells)


def _along(segment: F64, resolution_m: float) -> F64:
    """Points on a segment, a tenth of a cell apart."""
    length = np.hypot(segment[2] - segment[0], segment[3] - segment[1])
    share = np.linspace(0.0, 1.0, int(np.ceil(10.0 * length / resolution_m)) + 2)[:, None]
    return np.asarray(segment[:2] + share * (segment[2:] - segment[:2]))


def _around(circle: F64) -> F64:
    """Points on a circle."""
    angles = np.linspace(0.0, 2.0 * np.pi, _CIRCLE_POINTS, endpoint=False)
    return np.asarray(circle[:2] + circle[2] * np.column_stack([np.cos(angles), np.sin(angles)]))
