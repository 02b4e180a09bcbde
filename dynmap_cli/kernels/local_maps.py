"""Local maps of a few key scans: hit centroids with normals and a mask of free space; how two of them fit.

A local map is drawn on a torus of SIZE x SIZE cells of CELL_M (fine) and COARSE x COARSE cells of 4 CELL_M, one
map at a time; drawing is undone cell by cell.
"""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64, U8
from dynmap_cli.kernels.jit import kernel
from dynmap_cli.kernels.matching import thin_points

CELL_M = 0.05
SIZE, MASK = 2048, 2047
COARSE, COARSE_MASK, COARSE_M = 512, 511, 0.2
FREE_CELL_M, FREE_SIDE = 0.1, 300
"""The free-space mask covers 30 m x 30 m around the anchor in cells of 10 cm."""
REACH = 3
"""Drawn points are found up to this many fine cells away."""
MATCHED, SEEN, IN_FREE, RESIDUAL = 0, 1, 2, 3


@kernel
def collect_local_map(
    ranges_m: F32,
    weights: F32,
    geometry_index: I32,
    directions: F64,
    sensor_poses: F64,
    usable_m: F64,
    beam_interval_s: F64,
    twists: F64,
    scans: I64,
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
    ranges_m, weights, geometry_index, directions, sensor_poses, usable_m, beam_interval_s, twists
        As for `register_scans`.
    scans : (k,) int64
    anchor_from_robot : (k, 3) float64
    spacing_m : float
        Points closer to the last one are left out.
    sums : (side, side, 3) int64
        Zero scratch of fine cells around the anchor; zero again on return.
    points, normals : (n, 2) float32
        Filled; a normal of (0, 0) = no line there.
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
    touched = np.empty((points.shape[0], 2), np.int32)
    count = 0
    for row in range(FREE_SIDE):
        for col in range(FREE_SIDE):
            free[row, col] = 0
    half_free = FREE_SIDE // 2
    for s in range(scans.size):
        scan = scans[s]
        geometry = geometry_index[scan]
        cos, sin = math.cos(anchor_from_robot[s, 2]), math.sin(anchor_from_robot[s, 2])
        x0, y0 = anchor_from_robot[s, 0], anchor_from_robot[s, 1]
        n = thin_points(
            ranges_m[scan],
            directions[geometry],
            sensor_poses[geometry],
            usable_m[geometry],
            beam_interval_s[geometry],
            twists[scan],
            spacing_m,
            end_points,
            beams,
        )
        sx = x0 + cos * sensor_poses[geometry, 0] - sin * sensor_poses[geometry, 1]
        sy = y0 + sin * sensor_poses[geometry, 0] + cos * sensor_poses[geometry, 1]
        for k in range(n):
            e = float(weights[scan, beams[k]])
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
                normals[k, 0], normals[k, 1] = -math.sin(angle), math.cos(angle)
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
                value = int(255.0 * math.exp(-0.35 * (dr * dr + dc * dc))) if draw else 0
                r, c = (row + dr) & MASK, (col + dc) & MASK
                field[r, c] = max(int(field[r, c]), value) if draw else 0
        col, row = int(math.floor(points[k, 0] / COARSE_M)), int(math.floor(points[k, 1] / COARSE_M))
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                value = (255 if dr == 0 and dc == 0 else 120) if draw else 0
                r, c = (row + dr) & COARSE_MASK, (col + dc) & COARSE_MASK
                coarse[r, c] = max(int(coarse[r, c]), value) if draw else 0


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
def refine_local_map(
    points: F32,
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
    points, count
        The map that is moved.
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
        for a in range(-4, 5):
            yaw = pose[2] + 0.0075 * a
            cos, sin = math.cos(yaw), math.sin(yaw)
            for dy in range(-4, 5, 2):
                for dx in range(-4, 5, 2):
                    total = 0
                    for k in range(0, count, sparse):
                        col = (
                            int(math.floor((pose[0] + cos * points[k, 0] - sin * points[k, 1]) / CELL_M)) + dx
                        )
                        row = (
                            int(math.floor((pose[1] + sin * points[k, 0] + cos * points[k, 1]) / CELL_M)) + dy
                        )
                        total += field[row & MASK, col & MASK]
                    if total > best:
                        best, best_yaw = total, yaw
                        best_x, best_y = pose[0] + dx * CELL_M, pose[1] + dy * CELL_M
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

    Parameters
    ----------
    points, count, drawn_points, drawn_normals, index
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
                matched += 1
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
    directions: F64,
    sensor_poses: F64,
    usable_m: F64,
    beam_interval_s: F64,
    twists: F64,
    scans: I64,
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
    ranges_m, weights, geometry_index, directions, sensor_poses, usable_m, beam_interval_s, twists,
    spacing_m
        As for `collect_local_map`; beams with e < 1/2 are left out.
    scans : (k,) int64
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
    points = np.empty((n_beams, 2), np.float32)
    for s in range(scans.size):
        scan = scans[s]
        geometry = geometry_index[scan]
        n = thin_points(
            ranges_m[scan],
            directions[geometry],
            sensor_poses[geometry],
            usable_m[geometry],
            beam_interval_s[geometry],
            twists[scan],
            spacing_m,
            end_points,
            beams,
        )
        count = 0
        for k in range(n):
            if not weights[scan, beams[k]] < 0.5:
                points[count, 0], points[count, 1] = end_points[k, 0], end_points[k, 1]
                count += 1
        judged[s, RESIDUAL] = refine_local_map(
            points, count, drawn_points, drawn_normals, index, field, poses[s], information[s], 1, 1
        )
        judge_fit(points, count, drawn_points, drawn_normals, drawn_free, index, poses[s], 1, judged[s])
