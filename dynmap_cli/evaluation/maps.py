"""A map against a reference: alignment, differing cells, occupied cells with a tolerance of one cell."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage, optimize, signal

from dynmap_cli.arrays import B1, F64, I8
from dynmap_cli.domain.grid import OCCUPIED, UNKNOWN, OccupancyGrid
from dynmap_cli.domain.poses import inverse, transform_points
from dynmap_cli.evaluation.scores import Score, ratio

COARSE_CELL_M, COARSE_TURN_DEG = 0.2, 2.0
"""Steps of the search over all shifts and turns."""
_STARTS, _FARTHEST_M, _MOST_POINTS, _LEAST_CELLS = 3, 0.3, 4000, 10
_ONE_CELL = 1.5
"""A neighbour, also a diagonal one, is nearer than this many cells."""


def occupied_points(grid: OccupancyGrid) -> F64:
    """(n, 2) centres of the occupied cells."""
    return grid.frame.to_points(np.argwhere(grid.cells == OCCUPIED))


def align_maps(estimate: OccupancyGrid, reference: OccupancyGrid) -> F64:
    """Pose reference_from_estimate at which the occupied cells fit best.

    Coarse: correlation of both maps for every turn, over all shifts. Fine: the truncated squared distance of the
    occupied cells to the nearest one of the reference, from the best few of the coarse poses.
    """
    points, targets = occupied_points(estimate), occupied_points(reference)
    if min(points.shape[0], targets.shape[0]) < _LEAST_CELLS:
        return np.zeros(3)
    distance_m = _Distance(reference)
    sample = points[:: math.ceil(points.shape[0] / _MOST_POINTS)]

    def cost(pose: F64) -> float:
        away = np.minimum(distance_m.at(transform_points(pose, sample)), _FARTHEST_M)
        return float((away**2).mean())

    starts = [np.zeros(3), *_coarse_poses(points, targets)]
    steps = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.02]])
    found = [
        optimize.minimize(
            cost,
            start,
            method="Nelder-Mead",
            options={"initial_simplex": start + steps, "xatol": 1e-5, "fatol": 1e-10, "maxiter": 600},
        )
        for start in starts
    ]
    return np.asarray(min(found, key=lambda result: result.fun).x, dtype=np.float64)


def _coarse_poses(points: F64, targets: F64) -> list[F64]:
    """Turn by turn, the shift with the highest correlation; the best few poses."""
    low = targets.min(axis=0)
    image = _raster(targets, low, np.ptp(targets, axis=0))
    blurred = np.minimum(ndimage.gaussian_filter(image, 1.0), 1.0)
    found: list[tuple[float, F64]] = []
    for yaw in np.radians(np.arange(-180.0, 180.0, COARSE_TURN_DEG)):
        turned = transform_points(np.array([0.0, 0.0, yaw]), points)
        start = turned.min(axis=0)
        mine = _raster(turned, start, np.ptp(turned, axis=0))
        score = signal.fftconvolve(blurred, mine[::-1, ::-1])
        row, col = np.unravel_index(int(np.argmax(score)), score.shape)
        shift = np.array([col - mine.shape[1] + 1, row - mine.shape[0] + 1]) * COARSE_CELL_M
        pose = np.array([*(low + shift - start), yaw])
        found.append((float(score[row, col]), pose))
    found.sort(key=lambda entry: -entry[0])
    return [pose for _, pose in found[:_STARTS]]


def _raster(points: F64, low: F64, size_m: F64) -> F64:
    """1 where there is a point, on coarse cells from *low* on."""
    cols, rows = (np.floor(size_m / COARSE_CELL_M).astype(int) + 1).tolist()
    cells = np.floor((points - low) / COARSE_CELL_M).astype(int)
    image = np.zeros((rows, cols))
    image[np.minimum(cells[:, 1], rows - 1), np.minimum(cells[:, 0], cols - 1)] = 1.0
    return image


class _Distance:
    """Distance from any point to the nearest occupied cell, metres."""

    def __init__(self, grid: OccupancyGrid) -> None:
        self._frame = grid.frame
        margin = math.ceil(_FARTHEST_M / grid.frame.resolution_m) + 1
        self._margin = margin
        occupied = np.pad(grid.cells == OCCUPIED, margin)
        self._field_m = ndimage.distance_transform_edt(~occupied) * grid.frame.resolution_m

    def at(self, points: F64) -> F64:
        """(n,) distances, bilinear between cells; far outside the map those at its border."""
        frame = self._frame
        col = (points[:, 0] - frame.origin_x_m) / frame.resolution_m - 0.5 + self._margin
        row = (points[:, 1] - frame.origin_y_m) / frame.resolution_m - 0.5 + self._margin
        return np.asarray(ndimage.map_coordinates(self._field_m, [row, col], order=1, mode="nearest"))


def look_up_cells(grid: OccupancyGrid, points: F64) -> I8:
    """(n,) value of the cell under each point, unknown outside."""
    rows, cols = grid.frame.to_cells(points).T
    inside = (rows >= 0) & (rows < grid.frame.rows) & (cols >= 0) & (cols < grid.frame.cols)
    values = np.full(points.shape[0], UNKNOWN, dtype=np.int8)
    values[inside] = grid.cells[rows[inside], cols[inside]]
    return values


def score_map(name: str, estimate: OccupancyGrid, reference: OccupancyGrid) -> Score:
    """Share of differing cells, precision and recall of the occupied ones, after alignment.

    Recall is over all occupied cells of the reference, and once more over those around which the map knows
    anything: a wall that nobody saw is missing from the first only. A map without a wall has coverage 0.
    """
    pose = align_maps(estimate, reference)
    back = inverse(pose)
    known = np.argwhere(reference.cells != UNKNOWN)
    centres = reference.frame.to_points(known)
    theirs = reference.cells[known[:, 0], known[:, 1]]
    mine = look_up_cells(estimate, transform_points(back, centres))
    both = mine != UNKNOWN
    tolerance_m = _ONE_CELL * max(estimate.frame.resolution_m, reference.frame.resolution_m)
    walls = transform_points(pose, occupied_points(estimate))
    asked = _is_seen(reference, walls)
    hit = _Distance(reference).at(walls) < tolerance_m
    true_walls = transform_points(back, occupied_points(reference))
    found = _Distance(estimate).at(true_walls) < tolerance_m
    seen = _is_seen(estimate, true_walls)
    values = {
        "shift_x_m": float(pose[0]),
        "shift_y_m": float(pose[1]),
        "turn_deg": math.degrees(float(pose[2])),
        "known_share_of_reference": ratio(int(both.sum()), both.size),
        "differing_share": ratio(int((mine != theirs)[both].sum()), int(both.sum())),
        "occupied_precision": ratio(int((hit & asked).sum()), int(asked.sum())),
        "occupied_outside_reference": ratio(int((~asked).sum()), int(asked.size)),
        "occupied_recall": ratio(int(found.sum()), found.size),
        "occupied_recall_where_seen": ratio(int((found & seen).sum()), int(seen.sum())),
    }
    return Score(name, 1.0 if walls.size else 0.0, values)


def _is_seen(grid: OccupancyGrid, points: F64) -> B1:
    """Whether the map knows the cell under a point or one beside it."""
    near = ndimage.binary_dilation(grid.cells != UNKNOWN, np.ones((3, 3), dtype=bool))
    return np.asarray(look_up_cells(OccupancyGrid(grid.frame, near.astype(np.int8)), points) == 1)
