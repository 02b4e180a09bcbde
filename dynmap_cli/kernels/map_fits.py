"""How a local map, or a single scan, fits on a drawn local map: coarse search, point-to-line steps, verdict."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, U8
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.kernels.jit import kernel
from dynmap_cli.kernels.local_maps import (
    CELL_M,
    COARSE,
    COARSE_M,
    COARSE_MASK,
    FREE_CELL_M,
    FREE_SIDE,
    MASK,
)
from dynmap_cli.kernels.matching import thin_points

MATCHED, SEEN, IN_FREE, RESIDUAL = 0, 1, 2, 3
"""Columns of what is judged."""
_OTHER_SIDE = -0.5
"""Cosine between normals under which two lines are the two sides of a wall, each seen from where the other is not."""


@kernel
def search_coarse(
    points: F32,
    count: int,
    guess: F64,
    half_turn_rad: float,
    reach_cells: int,
    coarse: U8,
    scores: I32,
    out: F64,
) -> int:
    """Find the best places of a local map in the drawn one on the coarse lattice, best first.

    Parameters
    ----------
    points, count
        The map that is moved.
    guess : (3,) float64
        drawn_from_moved at the centre of the lattice.
    half_turn_rad : float
    reach_cells : int
        Coarse cells to each side.
    coarse : (COARSE, COARSE) uint8
    scores : (side, side) int32
        Scratch, side at least 2 * reach_cells + 1.
    out : (n_best, 4) float64
        x, y, yaw and mean score of places at least 1 m or 15 degrees apart.

    Returns
    -------
    int
        How many places were written.
    """
    n_best = out.shape[0]
    found = 0
    stride = max(1, count // 150)
    used = (count + stride - 1) // stride
    side = 2 * reach_cells + 1
    n_angles = int(math.ceil(half_turn_rad / 0.03))
    for a in range(-n_angles, n_angles + 1):
        yaw = guess[2] + a * 0.03
        cos, sin = math.cos(yaw), math.sin(yaw)
        for i in range(side):
            for j in range(side):
                scores[i, j] = 0
        for k in range(0, count, stride):
            col = (
                int(math.floor((guess[0] + cos * points[k, 0] - sin * points[k, 1]) / COARSE_M)) - reach_cells
            )
            row = (
                int(math.floor((guess[1] + sin * points[k, 0] + cos * points[k, 1]) / COARSE_M)) - reach_cells
            )
            c0 = col & COARSE_MASK
            for i in range(side):
                r = (row + i) & COARSE_MASK
                if c0 + side <= COARSE:
                    for j in range(side):
                        scores[i, j] += coarse[r, c0 + j]
                else:
                    for j in range(side):
                        scores[i, j] += coarse[r, (c0 + j) & COARSE_MASK]
        for i in range(side):
            for j in range(side):
                score = scores[i, j] / (255.0 * used)
                if found == n_best and score <= out[found - 1, 3]:
                    continue
                x, y = guess[0] + (j - reach_cells) * COARSE_M, guess[1] + (i - reach_cells) * COARSE_M
                # One entry per place: replace a neighbour that is worse, or give way to a better one.
                place = -1
                worse_than_neighbour = False
                for b in range(found):
                    near = (out[b, 0] - x) ** 2 + (out[b, 1] - y) ** 2 < 1.0 and abs(out[b, 2] - yaw) < 0.26
                    if near:
                        if out[b, 3] >= score:
                            worse_than_neighbour = True
                        else:
                            place = b
                        break
                if worse_than_neighbour:
                    continue
                if place < 0:
                    place = found if found < n_best else n_best - 1
                    found = min(found + 1, n_best)
                while place > 0 and out[place - 1, 3] < score:
                    for b in range(4):
                        out[place, b] = out[place - 1, b]
                    place -= 1
                out[place, 0], out[place, 1], out[place, 2], out[place, 3] = x, y, yaw, score
    return found


@kernel
def _nearest(x_m: float, y_m: float, drawn_points: F32, index: I32) -> int:
    """Drawn point nearest to a place, of those noted in the four cells around it; -1 = none."""
    col, row = int(math.floor(x_m / CELL_M - 0.5)), int(math.floor(y_m / CELL_M - 0.5))
    nearest, best = -1, math.inf
    for r in range(row, row + 2):
        for c in range(col, col + 2):
            other = index[r & MASK, c & MASK]
            if other >= 0 and other != nearest:
                squared = (drawn_points[other, 0] - x_m) ** 2 + (drawn_points[other, 1] - y_m) ** 2
                if squared < best:
                    nearest, best = other, squared
    return nearest


@kernel
def _is_other_side(cos: float, sin: float, normals: F32, k: int, nx: float, ny: float) -> bool:
    """Whether a moved point lies on the other side of the drawn line; unknown where either has no normal."""
    mx, my = float(normals[k, 0]), float(normals[k, 1])
    return (cos * mx - sin * my) * nx + (sin * mx + cos * my) * ny < _OTHER_SIDE


@kernel
def refine_local_map(
    points: F32,
    normals: F32,
    count: int,
    drawn_points: F32,
    drawn_normals: F32,
    index: I32,
    field: U8,
    pose: F64,
    information: F64,
    stride: int,
    polish: int,
) -> float:
    """Refine drawn_from_moved by a small correlative search (polish 0) and point-to-line Gauss-Newton steps.

    Parameters
    ----------
    points, normals, count
        The map that is moved; its lines are matched with those seen from the same side.
    drawn_points, drawn_normals, index, field
        The drawn map.
    pose : (3,) float64
        Start; refined in place.
    information : (3, 3) float64
        Normal equations of the last step in units of a residual of 1 m.
    stride : int
        Every how many points are used.
    polish : int
        1 = the start is within a few centimetres.

    Returns
    -------
    float
        Root mean square of the residuals of matched points, metres.
    """
    if polish == 0:
        best, best_x, best_y, best_yaw = -1, pose[0], pose[1], pose[2]
        sparse = max(stride, count // 150)
        totals = np.empty((5, 5), np.int64)
        for a in range(-4, 5):
            yaw = pose[2] + 0.0075 * a
            cos, sin = math.cos(yaw), math.sin(yaw)
            totals[:] = 0
            for k in range(0, count, sparse):
                col = int(math.floor((pose[0] + cos * points[k, 0] - sin * points[k, 1]) / CELL_M)) - 4
                row = int(math.floor((pose[1] + sin * points[k, 0] + cos * points[k, 1]) / CELL_M)) - 4
                for i in range(5):
                    r = (row + 2 * i) & MASK
                    for j in range(5):
                        totals[i, j] += field[r, (col + 2 * j) & MASK]
            for i in range(5):
                for j in range(5):
                    if totals[i, j] > best:
                        best, best_yaw = totals[i, j], yaw
                        best_x, best_y = pose[0] + (2 * j - 4) * CELL_M, pose[1] + (2 * i - 4) * CELL_M
        pose[0], pose[1], pose[2] = best_x, best_y, best_yaw
    squared = weight_sum = 0.0
    for iteration in range(12):
        scale = 0.06 if polish or iteration > 2 else 0.12
        reach = (2.5 if polish or iteration > 2 else 3.5) * CELL_M
        for i in range(3):
            for j in range(3):
                information[i, j] = 0.0
        gx = gy = gt = squared = weight_sum = 0.0
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        for k in range(0, count, stride):
            px = cos * points[k, 0] - sin * points[k, 1]
            py = sin * points[k, 0] + cos * points[k, 1]
            x, y = pose[0] + px, pose[1] + py
            nearest = _nearest(x, y, drawn_points, index)
            if nearest < 0:
                continue
            ex, ey = x - drawn_points[nearest, 0], y - drawn_points[nearest, 1]
            nx, ny = float(drawn_normals[nearest, 0]), float(drawn_normals[nearest, 1])
            if ex * ex + ey * ey > reach * reach or (nx == 0.0 and ny == 0.0):
                continue
            if _is_other_side(cos, sin, normals, k, nx, ny):
                continue
            residual = nx * ex + ny * ey
            w = 1.0 / (1.0 + (residual / scale) ** 2) ** 2
            turn = -nx * py + ny * px
            information[0, 0] += w * nx * nx
            information[0, 1] += w * nx * ny
            information[1, 1] += w * ny * ny
            information[0, 2] += w * nx * turn
            information[1, 2] += w * ny * turn
            information[2, 2] += w * turn * turn
            gx += w * nx * residual
            gy += w * ny * residual
            gt += w * turn * residual
            squared += w * residual * residual
            weight_sum += w
        information[1, 0], information[2, 0], information[2, 1] = (
            information[0, 1], information[0, 2], information[1, 2]
        )  # fmt: skip
        if weight_sum < 10.0:
            return 1.0
        # A little stiffness keeps directions without information where they are.
        a00, a11, a22 = information[0, 0] + 1.0, information[1, 1] + 1.0, information[2, 2] + 10.0
        a01, a02, a12 = information[0, 1], information[0, 2], information[1, 2]
        det = a00 * (a11 * a22 - a12 * a12) - a01 * (a01 * a22 - a12 * a02) + a02 * (a01 * a12 - a11 * a02)
        dx = (gx * (a11 * a22 - a12 * a12) - a01 * (gy * a22 - a12 * gt) + a02 * (gy * a12 - a11 * gt)) / det
        dy = (a00 * (gy * a22 - a12 * gt) - gx * (a01 * a22 - a12 * a02) + a02 * (a01 * gt - gy * a02)) / det
        dt = (a00 * (a11 * gt - gy * a12) - a01 * (a01 * gt - gy * a02) + gx * (a01 * a12 - a11 * a02)) / det
        pose[0] -= dx
        pose[1] -= dy
        pose[2] -= dt
        if (polish or iteration > 3) and abs(dx) + abs(dy) < 3e-4 and abs(dt) < 3e-5:
            break
    return math.sqrt(squared / weight_sum)


@kernel
def judge_fit(
    points: F32,
    normals: F32,
    count: int,
    drawn_points: F32,
    drawn_normals: F32,
    drawn_free: U8,
    index: I32,
    pose: F64,
    stride: int,
    out: F64,
) -> None:
    """Write which shares of the moved map's points match the drawn map, are seen by it, and lie in its free space.

    What lies on the other side of a line of the drawn map is not seen by it. A corridor laid beside itself, the left
    wall of the one on the right wall of the other, would match as well as where it belongs.

    Parameters
    ----------
    points, normals, count, drawn_points, drawn_normals, index
        As for `refine_local_map`.
    drawn_free : (FREE_SIDE, FREE_SIDE) uint8
    pose : (3,) float64
        drawn_from_moved.
    stride : int
        Every how many points are used.
    out : (3,) float64
        Entries MATCHED, SEEN, IN_FREE, as shares of all points.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    matched = free = 0
    half = FREE_SIDE // 2
    for k in range(0, count, stride):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        nearest = _nearest(x, y, drawn_points, index)
        if nearest >= 0:
            ex, ey = x - drawn_points[nearest, 0], y - drawn_points[nearest, 1]
            nx, ny = float(drawn_normals[nearest, 0]), float(drawn_normals[nearest, 1])
            squared = ex * ex + ey * ey
            across = abs(nx * ex + ny * ey)
            if squared < 0.08**2 or (squared < 0.125**2 and across < 0.08 and (nx != 0.0 or ny != 0.0)):
                matched += not _is_other_side(cos, sin, normals, k, nx, ny)
                continue
        col, row = int(math.floor(x / FREE_CELL_M)) + half, int(math.floor(y / FREE_CELL_M)) + half
        if 0 <= row < FREE_SIDE and 0 <= col < FREE_SIDE and drawn_free[row, col]:
            free += 1
    total = max((count + stride - 1) // stride, 1)
    out[MATCHED] = matched / total
    out[SEEN] = (matched + free) / total
    out[IN_FREE] = free / total


@kernel
def fit_scans(
    ranges_m: F32,
    weights: F32,
    geometry_index: I32,
    rays: Rays,
    twists: F64,
    spacing_m: float,
    drawn_points: F32,
    drawn_normals: F32,
    drawn_free: U8,
    index: I32,
    field: U8,
    poses: F64,
    information: F64,
    judged: F64,
) -> None:
    """Fit single scans on the drawn map, each from a start within a few centimetres.

    Parameters
    ----------
    ranges_m, weights, geometry_index, rays, twists, spacing_m
        Of k scans, as for `collect_local_map`; beams with e < 1/2 are left out.
    drawn_points, drawn_normals, drawn_free, index, field
        The drawn map.
    poses : (k, 3) float64
        drawn_from_robot; refined in place.
    information : (k, 3, 3) float64
        Filled, see `refine_local_map`.
    judged : (k, 4) float64
        Filled with the entries MATCHED, SEEN, IN_FREE and RESIDUAL.
    """
    n_beams = ranges_m.shape[1]
    end_points, beams = np.empty((n_beams, 2)), np.empty(n_beams, np.int32)
    points, normals = np.empty((n_beams, 2), np.float32), np.zeros((n_beams, 2), np.float32)
    one = int(np.int64(1))  # a literal would compile the kernels that are called once more
    for s in range(ranges_m.shape[0]):
        n = thin_points(
            ranges_m[s],
            rays,
            geometry_index[s],
            twists[s],
            spacing_m,
            end_points,
            beams,
        )
        count = int(np.int64(0))
        for k in range(n):
            if not weights[s, beams[k]] < 0.5:
                points[count, 0], points[count, 1] = end_points[k, 0], end_points[k, 1]
                count += 1
        judged[s, RESIDUAL] = refine_local_map(
            points, normals, count, drawn_points, drawn_normals, index, field, poses[s], information[s],
            one, one,
        )  # fmt: skip
        judge_fit(
            points, normals, count, drawn_points, drawn_normals, drawn_free, index, poses[s], one, judged[s]
        )
