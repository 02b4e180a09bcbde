"""Local maps of a few key scans: hit centroids with normals and a mask of free space.

A local map is drawn on a torus of SIZE x SIZE cells of CELL_M (fine) and COARSE x COARSE cells of 4 CELL_M, one
map at a time; drawing is undone cell by cell.
"""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64, U8
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.kernels.jit import kernel
from dynmap_cli.kernels.matching import SCORES, thin_points

CELL_M = 0.05
SIZE, MASK = 2048, 2047
COARSE, COARSE_MASK, COARSE_M = 512, 511, 0.2
FREE_CELL_M, FREE_SIDE = 0.1, 300
"""The free-space mask covers 30 m x 30 m around the anchor in cells of 10 cm."""
REACH = 3
"""Drawn points are found up to this many fine cells away."""


@kernel
def collect_local_map(
    ranges_m: F32,
    weights: F32,
    geometry_index: I32,
    rays: Rays,
    twists: F64,
    anchor_from_robot: F64,
    spacing_m: float,
    sums: I64,
    points: F32,
    normals: F32,
    free: U8,
) -> int:
    """Collect the hit centroids, normals and free space of some key scans.

    Parameters
    ----------
    ranges_m, weights, geometry_index, rays, twists
        As for `register_scans`, each of these k scans.
    anchor_from_robot : (k, 3) float64
    spacing_m : float
        Points closer to the last one are left out.
    sums : (side, side, 3) int64
        Zero scratch of fine cells around the anchor; zero again on return.
    points, normals : (n, 2) float32
        Filled; a normal looks to the side from which the line was seen; (0, 0) = no line there.
    free : (FREE_SIDE, FREE_SIDE) uint8
        Filled: 1 where beams passed and nothing was hit in the cell or next to it.

    Returns
    -------
    int
        Number of points.
    """
    side = sums.shape[0]
    half = side // 2
    one = 1 << 20
    n_beams = ranges_m.shape[1]
    end_points, beams = np.empty((n_beams, 2)), np.empty(n_beams, np.int32)
    touched, seen_from = np.empty((points.shape[0], 2), np.int32), np.empty((points.shape[0], 2))
    count = 0
    for row in range(FREE_SIDE):
        for col in range(FREE_SIDE):
            free[row, col] = 0
    half_free = FREE_SIDE // 2
    for s in range(ranges_m.shape[0]):
        sensor_x, sensor_y = rays.sensor_poses[geometry_index[s], 0], rays.sensor_poses[geometry_index[s], 1]
        cos, sin = math.cos(anchor_from_robot[s, 2]), math.sin(anchor_from_robot[s, 2])
        x0, y0 = anchor_from_robot[s, 0], anchor_from_robot[s, 1]
        n = thin_points(
            ranges_m[s],
            rays,
            geometry_index[s],
            twists[s],
            spacing_m,
            end_points,
            beams,
        )
        sx = x0 + cos * sensor_x - sin * sensor_y
        sy = y0 + sin * sensor_x + cos * sensor_y
        for k in range(n):
            e = float(weights[s, beams[k]])
            weight = 1.0 if math.isnan(e) else e
            x_m = x0 + cos * end_points[k, 0] - sin * end_points[k, 1]
            y_m = y0 + sin * end_points[k, 0] + cos * end_points[k, 1]
            # Free up to 20 cm before the end point, in steps of a mask cell.
            length = math.sqrt((x_m - sx) ** 2 + (y_m - sy) ** 2)
            step_x, step_y = (x_m - sx) / length, (y_m - sy) / length
            free_x, free_y = sx / FREE_CELL_M + half_free, sy / FREE_CELL_M + half_free
            for _ in range(int((length - 0.2) / FREE_CELL_M)):
                if not (0.0 <= free_x < FREE_SIDE and 0.0 <= free_y < FREE_SIDE):
                    break
                free[int(free_y), int(free_x)] = 1
                free_x += step_x
                free_y += step_y
            if weight < 0.5:
                continue
            x, y = x_m / CELL_M, y_m / CELL_M
            col, row = int(math.floor(x)) + half, int(math.floor(y)) + half
            if not (0 <= row < side and 0 <= col < side):
                continue
            if sums[row, col, 0] == 0:
                if count == points.shape[0]:
                    continue
                touched[count, 0], touched[count, 1] = row, col
                seen_from[count, 0], seen_from[count, 1] = sx, sy
                count += 1
            sums[row, col, 0] += int(round(weight * one))
            sums[row, col, 1] += int(round(weight * (x - math.floor(x)) * one))
            sums[row, col, 2] += int(round(weight * (y - math.floor(y)) * one))
    for k in range(count):
        row, col = touched[k, 0], touched[k, 1]
        hits = sums[row, col, 0]
        points[k, 0] = (col - half + float(sums[row, col, 1]) / hits) * CELL_M
        points[k, 1] = (row - half + float(sums[row, col, 2]) / hits) * CELL_M
        normals[k, 0] = normals[k, 1] = 0.0
        total = mx = my = mxx = mxy = myy = 0.0
        cells = 0
        for dr in range(-3, 4):
            for dc in range(-3, 4):
                r, c = row + dr, col + dc
                if 0 <= r < side and 0 <= c < side and sums[r, c, 0] > 0:
                    w = min(float(sums[r, c, 0]) / one, 4.0)
                    x = dc + float(sums[r, c, 1]) / sums[r, c, 0]
                    y = dr + float(sums[r, c, 2]) / sums[r, c, 0]
                    total += w
                    mx += w * x
                    my += w * y
                    mxx += w * x * x
                    mxy += w * x * y
                    myy += w * y * y
                    cells += 1
        if cells >= 3:
            mx, my = mx / total, my / total
            cxx, cxy, cyy = mxx / total - mx * mx, mxy / total - mx * my, myy / total - my * my
            mean, spread = 0.5 * (cxx + cyy), math.sqrt(0.25 * (cxx - cyy) ** 2 + cxy * cxy)
            if mean - spread <= 0.25 * (mean + spread) and mean + spread >= 0.3:
                angle = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
                nx, ny = -math.sin(angle), math.cos(angle)
                if nx * (seen_from[k, 0] - points[k, 0]) + ny * (seen_from[k, 1] - points[k, 1]) < 0.0:
                    nx, ny = -nx, -ny
                normals[k, 0], normals[k, 1] = nx, ny
        col = int(math.floor(points[k, 0] / FREE_CELL_M)) + half_free
        row = int(math.floor(points[k, 1] / FREE_CELL_M)) + half_free
        for r in range(max(row - 1, 0), min(row + 2, FREE_SIDE)):
            for c in range(max(col - 1, 0), min(col + 2, FREE_SIDE)):
                free[r, c] = 0
    for k in range(count):
        for i in range(3):
            sums[touched[k, 0], touched[k, 1], i] = 0
    return count


@kernel
def draw_local_map(points: F32, count: int, draw: int, index: I32, field: U8, coarse: U8) -> None:
    """Draw the points of a local map on the torus (draw 1), or wipe them off (draw 0).

    Parameters
    ----------
    points : (n, 2) float32
        The first *count* are drawn.
    index : (SIZE, SIZE) int32
        Number of the point that is nearest to each cell's centre, of those within REACH cells; -1 = none.
    field : (SIZE, SIZE) uint8
        255 at points, less within two cells.
    coarse : (COARSE, COARSE) uint8
        The same in coarse cells, less within one cell.
    """
    for k in range(count):
        col, row = int(math.floor(points[k, 0] / CELL_M)), int(math.floor(points[k, 1] / CELL_M))
        for dr in range(-REACH, REACH + 1):
            for dc in range(-REACH, REACH + 1):
                r, c = (row + dr) & MASK, (col + dc) & MASK
                other = index[r, c]
                if draw and other >= 0:
                    x_m, y_m = (col + dc + 0.5) * CELL_M, (row + dr + 0.5) * CELL_M
                    ours = (points[k, 0] - x_m) ** 2 + (points[k, 1] - y_m) ** 2
                    theirs = (points[other, 0] - x_m) ** 2 + (points[other, 1] - y_m) ** 2
                    if theirs <= ours:
                        continue
                index[r, c] = k if draw else -1
        for dr in range(-2, 3):
            for dc in range(-2, 3):
                r, c = (row + dr) & MASK, (col + dc) & MASK
                field[r, c] = max(field[r, c], SCORES[dr * dr + dc * dc]) if draw else 0
        col, row = int(math.floor(points[k, 0] / COARSE_M)), int(math.floor(points[k, 1] / COARSE_M))
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                value = (255 if dr == 0 and dc == 0 else 120) if draw else 0
                r, c = (row + dr) & COARSE_MASK, (col + dc) & COARSE_MASK
                coarse[r, c] = max(int(coarse[r, c]), value) if draw else 0
