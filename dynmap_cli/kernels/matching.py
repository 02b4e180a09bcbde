"""Scan matching against a local map of hit centroids: correlative search, then point-to-line refinement.

The local map is a torus of SIZE x SIZE cells: cell (row & MASK, col & MASK) of the infinite grid. It holds the
key scans of the last few metres; old ones are taken out again exactly (integers), so nothing is ever cleared
or moved. All points of the map have to lie within SIZE cells of one another.
"""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64, U8
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.kernels.jit import kernel

SIZE = 2048
MASK = SIZE - 1
ONE = 1 << 20
"""Fixed-point value of one hit."""
NORMAL_RADIUS = 3
FIELD_RADIUS = 2
HIT = 255
"""Score of a cell in which something was hit; its neighbours have less."""
SCORES: U8 = np.append((HIT * np.exp(-0.35 * np.arange(2 * FIELD_RADIUS**2 + 1))), 0.0).astype(np.uint8)
"""Score of a cell by its squared distance from the nearest hit, cells; the last entry is for none within reach."""
BRIDGE_WEIGHT, LONGEST_BRIDGE_M, _FLAT_M, _MOST_UNEVEN = 0.25, 0.5, 0.03, 2.0
"""Between neighbouring points of a smooth wall the local map holds points of this weight, one for each cell."""
LANES = 8
"""Cells of a row that are added at once."""


@kernel
def thin_points(
    ranges_m: F32,
    rays: Rays,
    geometry: int,
    twist: F64,
    spacing_m: float,
    out: F64,
    out_beams: I32,
) -> int:
    """Write the end points of a scan in the robot frame, leaving out those closer than a spacing to the last.

    The points are where they were seen from the robot's pose at the first beam: the sweep is corrected for the
    motion during it.

    Parameters
    ----------
    ranges_m : (n_beams,) float32
    rays : Rays
    geometry : int
        That of the scan.
    twist : (3,) float64
        Velocity of the robot in its frame: m / s, m / s, rad / s.
    spacing_m : float
    out : (n_beams, 2) float64
    out_beams : (n_beams,) int32
        Number of the beam of each point.

    Returns
    -------
    int
        How many points were written.
    """
    directions, sensor_pose = rays.directions[geometry], rays.sensor_poses[geometry]
    usable_m, beam_interval_s = rays.usable_m[geometry], rays.beam_interval_s[geometry]
    count = 0
    for beam in range(ranges_m.size):
        distance = float(ranges_m[beam])
        if not distance <= usable_m:
            continue
        x = sensor_pose[0] + distance * directions[beam, 0]
        y = sensor_pose[1] + distance * directions[beam, 1]
        if beam_interval_s != 0.0:
            elapsed_s = (beam if beam_interval_s > 0.0 else beam - ranges_m.size + 1) * beam_interval_s
            cos, sin = math.cos(elapsed_s * twist[2]), math.sin(elapsed_s * twist[2])
            x, y = cos * x - sin * y + elapsed_s * twist[0], sin * x + cos * y + elapsed_s * twist[1]
        if count > 0:
            dx, dy = x - out[count - 1, 0], y - out[count - 1, 1]
            if dx * dx + dy * dy < spacing_m * spacing_m:
                continue
        out[count, 0], out[count, 1] = x, y
        out_beams[count] = beam
        count += 1
    return count


@kernel
def _add_to_field(field: U8, row: int, col: int) -> None:
    """Score a cell in which something was hit, and the cells within FIELD_RADIUS of it."""
    for dr in range(-FIELD_RADIUS, FIELD_RADIUS + 1):
        for dc in range(-FIELD_RADIUS, FIELD_RADIUS + 1):
            r, c = (row + dr) & MASK, (col + dc) & MASK
            field[r, c] = max(field[r, c], SCORES[dr * dr + dc * dc])


@kernel
def _take_from_field(field: U8, row: int, col: int) -> None:
    """Score the cells within FIELD_RADIUS of one that is not hit any more by what is left around them."""
    field[row, col] = 0
    for dr in range(-FIELD_RADIUS, FIELD_RADIUS + 1):
        for dc in range(-FIELD_RADIUS, FIELD_RADIUS + 1):
            r, c = (row + dr) & MASK, (col + dc) & MASK
            if field[r, c] == HIT:
                continue
            nearest = SCORES.size - 1
            for dr2 in range(-FIELD_RADIUS, FIELD_RADIUS + 1):
                for dc2 in range(-FIELD_RADIUS, FIELD_RADIUS + 1):
                    if field[(r + dr2) & MASK, (c + dc2) & MASK] == HIT:
                        nearest = min(nearest, dr2 * dr2 + dc2 * dc2)
            field[r, c] = SCORES[nearest]


@kernel
def refresh_line(sums: I64, lines: F32, field: U8, row: int, col: int) -> None:
    """Set the normal of the line through the centroids around a cell; (0, 0) where there is no line."""
    lines[row, col, 2] = 0.0
    lines[row, col, 3] = 0.0
    total = sx = sy = sxx = sxy = syy = 0.0
    cells = 0
    for dr in range(-NORMAL_RADIUS, NORMAL_RADIUS + 1):
        for dc in range(-NORMAL_RADIUS, NORMAL_RADIUS + 1):
            r, c = (row + dr) & MASK, (col + dc) & MASK
            if field[r, c] == HIT:
                hits = sums[r, c, 0]
                weight = min(float(hits) / ONE, 4.0)
                x = dc + float(sums[r, c, 1]) / hits
                y = dr + float(sums[r, c, 2]) / hits
                total += weight
                sx += weight * x
                sy += weight * y
                sxx += weight * x * x
                sxy += weight * x * y
                syy += weight * y * y
                cells += 1
    if cells < 3:
        return
    mx, my = sx / total, sy / total
    cxx, cxy, cyy = sxx / total - mx * mx, sxy / total - mx * my, syy / total - my * my
    mean, half = 0.5 * (cxx + cyy), math.sqrt(0.25 * (cxx - cyy) ** 2 + cxy * cxy)
    if mean - half > 0.25 * (mean + half) or mean + half < 0.3:
        return
    angle = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
    lines[row, col, 2] = -math.sin(angle)
    lines[row, col, 3] = math.cos(angle)


@kernel
def _steps_to_next(points: F64, count: int, k: int, cell_m: float) -> int:
    """In how many steps of about a cell to go from a point to the next one; 1 where there may be no wall in between.

    Between two points there is a wall if they lie on one line with those before and after, at about even distances.
    """
    if k < 1 or k + 2 >= count:
        return 1
    x, y = points[k, 0], points[k, 1]
    dx, dy = points[k + 1, 0] - x, points[k + 1, 1] - y
    gap = math.sqrt(dx * dx + dy * dy)
    if gap < 3.0 * cell_m or gap > LONGEST_BRIDGE_M:
        return 1
    for other, near in ((k - 1, k), (k + 2, k + 1)):
        ox, oy = points[other, 0] - points[near, 0], points[other, 1] - points[near, 1]
        length = math.sqrt(ox * ox + oy * oy)
        if not gap < _MOST_UNEVEN * length < _MOST_UNEVEN * _MOST_UNEVEN * gap:
            return 1
        ahead = 1.0 if other > near else -1.0
        if ahead * (dx * ox + dy * oy) < 0.0 or abs(dx * oy - dy * ox) > _FLAT_M * gap:
            return 1
    return int(math.ceil(gap / cell_m))


@kernel
def insert_points(
    points: F64,
    weights: F64,
    count: int,
    pose: F64,
    sign: int,
    cell_m: float,
    sums: I64,
    lines: F32,
    stale: U8,
    field: U8,
) -> None:
    """Add the points of a scan to the local map (sign 1) or take them out again (sign -1).

    Beams that meet a wall aslant leave gaps between their ends. Gaps of one scan lie between those of the next one
    while the ends of the same beams meet, so that a robot on its way along a bare corridor would seem to stand. With
    bridges over the gaps a scan meets the wall wherever it lies on it (Censi, An ICP variant using a point-to-line
    metric, 2008: the line through two neighbouring points).

    Parameters
    ----------
    points : (n, 2) float64
        Robot frame; the first *count* are used.
    weights : (n,) float64
        e of each point's beam.
    count : int
    pose : (3,) float64
        map_from_robot; the very same numbers when the scan is taken out.
    sign : int
    cell_m : float
    sums : (SIZE, SIZE, 3) int64
        Hits and sums of the offsets within the cell, fixed point.
    lines : (SIZE, SIZE, 4) float32
        Hit centroid of each cell, as offset within it, and normal of the line through its surroundings.
    stale : (SIZE, SIZE) uint8
        1 where the normal has to be found again; `point_to_line` does so where it needs one.
    field : (SIZE, SIZE) uint8
        Score for the correlative search.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for k in range(count):
        n_steps = _steps_to_next(points, count, k, cell_m)
        for step in range(n_steps):
            px, py, weight = points[k, 0], points[k, 1], weights[k]
            if step > 0:
                along = step / n_steps
                px += along * (points[k + 1, 0] - px)
                py += along * (points[k + 1, 1] - py)
                weight = BRIDGE_WEIGHT * min(weight, weights[k + 1])
            x = (pose[0] + cos * px - sin * py) / cell_m
            y = (pose[1] + sin * px + cos * py) / cell_m
            col, row = int(math.floor(x)), int(math.floor(y))
            r, c = row & MASK, col & MASK
            before = sums[r, c, 0]
            sums[r, c, 0] += sign * int(round(weight * ONE))
            sums[r, c, 1] += sign * int(round(weight * (x - col) * ONE))
            sums[r, c, 2] += sign * int(round(weight * (y - row) * ONE))
            hits = sums[r, c, 0]
            if hits > 0:
                lines[r, c, 0] = float(sums[r, c, 1]) / hits
                lines[r, c, 1] = float(sums[r, c, 2]) / hits
            if before <= 0 < hits:
                _add_to_field(field, r, c)
            elif hits <= 0 < before:
                _take_from_field(field, r, c)
            for dr in range(-NORMAL_RADIUS, NORMAL_RADIUS + 1):
                for dc in range(-NORMAL_RADIUS, NORMAL_RADIUS + 1):
                    stale[(r + dr) & MASK, (c + dc) & MASK] = 1


@kernel
def add_window(field: U8, row: int, col: int, n_rows: int, step_rows: int, n_cols: int, scores: I32) -> None:
    """Add a window of a torus of scores to sums; whole runs of LANES cells, for the processor adds that many at once.

    Parameters
    ----------
    field : (size, size) uint8
        The torus; its size is a power of two.
    row, col : int
        First cell of the window.
    n_rows, step_rows : int
        Rows row, row + step, ... are added.
    n_cols : int
    scores : (n, m) int32
        n at least n_rows, m at least n_cols rounded up to whole runs; what lies beyond n_cols means nothing.
    """
    mask = field.shape[0] - 1
    c0 = col & mask
    whole = (n_cols + LANES - 1) // LANES * LANES
    for i in range(n_rows):
        r = (row + i * step_rows) & mask
        # The first condition always holds; it tells the compiler that no index counts from the end.
        if c0 >= 0 and c0 + whole <= field.shape[0]:
            for j in range(whole):
                scores[i, j] += field[r, c0 + j]
        else:
            for j in range(n_cols):
                scores[i, j] += field[r, (c0 + j) & mask]


@kernel
def correlate(
    points: F64,
    count: int,
    pose: F64,
    half_turn_rad: float,
    step_rad: float,
    reach_cells: int,
    step_cells: int,
    cell_m: float,
    field: U8,
    scores: I32,
    costs: F64,
    out: F64,
) -> float:
    """Find the best pose on a lattice around a start by summing the score field at all points.

    Parameters
    ----------
    points, count
        As for `insert_points`.
    pose : (3,) float64
        Centre of the lattice.
    half_turn_rad, step_rad : float
        Turns -half, -half + step, ... are tried.
    reach_cells, step_cells : int
        Shifts -reach, -reach + step, ... are tried along x and y.
    cell_m : float
    field : (SIZE, SIZE) uint8
    scores : (side, width) int32
        Scratch; side at least 2 * (reach // step) + 1, width at least 2 * reach + LANES.
    costs : (2,) float64
        Loss of mean score (0 to 1) per squared metre of shift, and per squared radian of turn.
    out : (3,) float64
        Best pose.

    Returns
    -------
    float
        Mean score of the points at the best pose, 0 to 1, without the costs.
    """
    side = 2 * (reach_cells // step_cells) + 1
    first = -(reach_cells // step_cells) * step_cells
    width = 1 - 2 * first
    best, best_score = -1e9, 0.0
    for turn in range(int(math.floor(2.0 * half_turn_rad / step_rad + 1e-9)) + 1):
        angle = -half_turn_rad + turn * step_rad
        cos, sin = math.cos(pose[2] + angle), math.sin(pose[2] + angle)
        scores[:side, :] = 0
        for k in range(count):
            col = int(math.floor((pose[0] + cos * points[k, 0] - sin * points[k, 1]) / cell_m))
            row = int(math.floor((pose[1] + sin * points[k, 0] + cos * points[k, 1]) / cell_m))
            add_window(field, row + first, col + first, side, step_cells, width, scores)
        for i in range(side):
            for j in range(side):
                dx, dy = (first + j * step_cells) * cell_m, (first + i * step_cells) * cell_m
                score = scores[i, j * step_cells] / (255.0 * max(count, 1))
                value = score - costs[0] * (dx * dx + dy * dy) - costs[1] * angle * angle
                if value > best:
                    best, best_score = value, score
                    out[0], out[1], out[2] = pose[0] + dx, pose[1] + dy, pose[2] + angle
    return best_score
