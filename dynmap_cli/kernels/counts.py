"""Counting: where beams end and how far they pass through each cell, exactly and in any order.

A ray with a given major axis passes equal lengths through the cells of a run, so only the crossings of the
minor axis are written, into difference grids (one per major axis); prefix sums at the end give the lengths.
Everything is int64 fixed point, so the result does not depend on order or threads, and a scan can be taken
out again exactly.
"""

from __future__ import annotations

import math

from dynmap_cli.arrays import F32, F64, I32, I64, U8
from dynmap_cli.kernels.jit import kernel

FIXED_ONE = 2.0**32
"""Fixed-point value of one cell or one hit: 2e9 passes fit into a cell, rounding is 1e-10 cell."""


@kernel
def _add_run_boundary(grid: I64, row: int, at: float, unit: int, sign: int) -> None:
    """Let the run of a row start (sign 1) or end (sign -1) at a position along its columns."""
    col = int(math.floor(at))
    here = int(round((col + 1 - at) * unit))
    grid[row, col] += sign * here
    grid[row, col + 1] += sign * (unit - here)


@kernel
def _add_ray(grid: I64, u0: float, v0: float, u1: float, v1: float, sign: int) -> None:
    """Add the lengths of a segment to the difference grid [v, u] of its major axis u; |dv| <= |du|."""
    if u1 < u0:
        u0, v0, u1, v1 = u1, v1, u0, v0
    du, dv = u1 - u0, v1 - v0
    if du <= 0.0:
        return
    unit = int(round(math.sqrt(du * du + dv * dv) / du * FIXED_ONE))
    last_row = grid.shape[0] - 1
    row, end_row = int(math.floor(v0)), int(math.floor(v1))
    row, end_row = min(max(row, 0), last_row), min(max(end_row, 0), last_row)
    _add_run_boundary(grid, row, u0, unit, sign)
    step = 1 if end_row > row else -1
    while row != end_row:
        boundary = row + 1 if step > 0 else row
        at = min(max(u0 + (boundary - v0) / dv * du, u0), u1)
        _add_run_boundary(grid, row, at, unit, -sign)
        row += step
        _add_run_boundary(grid, row, at, unit, sign)
    _add_run_boundary(grid, row, u1, unit, -sign)


@kernel
def _clip(x0: float, dx: float, low: float, high: float, enter: float, leave: float) -> tuple[float, float]:
    """Part [enter, leave] of a segment x0 + t dx that lies in [low, high] along one axis."""
    if dx == 0.0:
        return (enter, leave) if low <= x0 <= high else (1.0, 0.0)
    a, b = (low - x0) / dx, (high - x0) / dx
    if a > b:
        a, b = b, a
    return max(enter, a), min(leave, b)


@kernel
def moved(pose: F64, twist: F64, elapsed_s: float) -> tuple[float, float]:
    """Position of the robot a short time after the first beam of a scan."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = elapsed_s * twist[0], elapsed_s * twist[1]
    return pose[0] + cos * dx - sin * dy, pose[1] + sin * dx + cos * dy


@kernel
def count_scans(
    ranges_m: F32,
    weights: F32,
    geometry_index: I32,
    directions: F64,
    sensor_poses: F64,
    usable_m: F64,
    beam_interval_s: F64,
    twists: F64,
    poses: F64,
    resolution_m: float,
    origin_x_m: float,
    origin_y_m: float,
    sign: int,
    along_cols: I64,
    along_rows: I64,
    static_hits: I64,
    dynamic_hits: I64,
    offset_x: I64,
    offset_y: I64,
) -> None:
    """Add (sign 1) or take out (sign -1) scans: alpha, beta and the sums for the hit centroids (Eq. 1.12).

    A beam adds e to `static_hits` and 1 - e to `dynamic_hits` of its end cell, and the length by which it
    passes each earlier cell to the difference grids. A beam without return, or one that is longer than the
    usable range, passes up to the usable range and ends nowhere (zeta = 1 in Eq. 1.1); so does one with a
    negative range, up to its absolute value.

    Parameters
    ----------
    ranges_m : (n_scans, n_beams) float32
        +inf = nothing within reach, negative = nothing up to this distance, NaN = skipped.
    weights : (n_scans, n_beams) float32
        e of each beam; NaN counts as static.
    geometry_index : (n_scans,) int32
    directions : (n_geometries, n_beams, 2) float64
        Unit vectors of the beams in the robot frame.
    sensor_poses : (n_geometries, 3) float64
    usable_m : (n_geometries,) float64
    beam_interval_s : (n_geometries,) float64
        Time from one beam to the next; negative = the sweep ran from the last beam to the first, 0 = not known.
    twists : (n_scans, 3) float64
        Velocity of the robot during each scan, in its frame; sweeps are corrected for it.
    poses : (n_scans, 3) float64
        map_from_robot; rows with NaN are skipped.
    resolution_m, origin_x_m, origin_y_m : float
        Frame of the grid.
    sign : int
    along_cols : (rows + 1, cols + 2) int64
    along_rows : (cols + 1, rows + 2) int64
        Difference grids of the rays whose major axis is x, and y.
    static_hits, dynamic_hits, offset_x, offset_y : (rows, cols) int64
        Hits, and e times the offset of the end points from the corner of the cell, cells.
    """
    rows, cols = static_hits.shape
    for scan in range(ranges_m.shape[0]):
        geometry = geometry_index[scan]
        yaw = poses[scan, 2]
        if not math.isfinite(poses[scan, 0] + poses[scan, 1] + yaw):
            continue
        cos, sin = math.cos(yaw), math.sin(yaw)
        sensor_x, sensor_y = sensor_poses[geometry, 0], sensor_poses[geometry, 1]
        robot_x, robot_y = poses[scan, 0], poses[scan, 1]
        x0 = (robot_x + cos * sensor_x - sin * sensor_y - origin_x_m) / resolution_m
        y0 = (robot_y + sin * sensor_x + cos * sensor_y - origin_y_m) / resolution_m
        interval_s = beam_interval_s[geometry]
        for beam in range(ranges_m.shape[1]):
            if interval_s != 0.0:
                elapsed_s = (beam if interval_s > 0.0 else beam - ranges_m.shape[1] + 1) * interval_s
                robot_x, robot_y = moved(poses[scan], twists[scan], elapsed_s)
                cos, sin = (
                    math.cos(yaw + elapsed_s * twists[scan, 2]),
                    math.sin(yaw + elapsed_s * twists[scan, 2]),
                )
                x0 = (robot_x + cos * sensor_x - sin * sensor_y - origin_x_m) / resolution_m
                y0 = (robot_y + sin * sensor_x + cos * sensor_y - origin_y_m) / resolution_m
            distance = float(ranges_m[scan, beam])
            if math.isnan(distance):
                continue
            is_hit = 0.0 <= distance <= usable_m[geometry]
            length = min(abs(distance), usable_m[geometry]) / resolution_m
            direction_x, direction_y = directions[geometry, beam, 0], directions[geometry, beam, 1]
            dx = length * (cos * direction_x - sin * direction_y)
            dy = length * (sin * direction_x + cos * direction_y)
            end_col, end_row = int(math.floor(x0 + dx)), int(math.floor(y0 + dy))
            if is_hit and 0 <= end_row < rows and 0 <= end_col < cols:
                weight = float(weights[scan, beam])
                if math.isnan(weight):
                    weight = 1.0
                static = int(round(weight * FIXED_ONE))
                static_hits[end_row, end_col] += sign * static
                dynamic_hits[end_row, end_col] += sign * (int(FIXED_ONE) - static)
                offset_x[end_row, end_col] += sign * int(round(weight * (x0 + dx - end_col) * FIXED_ONE))
                offset_y[end_row, end_col] += sign * int(round(weight * (y0 + dy - end_row) * FIXED_ONE))
            # The end cell is not passed: the ray is cut where it enters it.
            cut = 0.0
            if dx != 0.0:
                cut = max(cut, ((end_col if dx > 0 else end_col + 1) - x0) / dx)
            if dy != 0.0:
                cut = max(cut, ((end_row if dy > 0 else end_row + 1) - y0) / dy)
            enter, leave = _clip(x0, dx, 0.0, float(cols), 0.0, min(cut, 1.0))
            enter, leave = _clip(y0, dy, 0.0, float(rows), enter, leave)
            if leave <= enter:
                continue
            ax, ay = x0 + enter * dx, y0 + enter * dy
            bx, by = x0 + leave * dx, y0 + leave * dy
            ax, bx = min(max(ax, 0.0), float(cols)), min(max(bx, 0.0), float(cols))
            ay, by = min(max(ay, 0.0), float(rows)), min(max(by, 0.0), float(rows))
            if abs(dx) >= abs(dy):
                _add_ray(along_cols, ax, ay, bx, by, sign)
            else:
                _add_ray(along_rows, ay, ax, by, bx, sign)


@kernel
def find_end_cells(
    ranges_m: F32,
    geometry_index: I32,
    directions: F64,
    sensor_poses: F64,
    usable_m: F64,
    beam_interval_s: F64,
    twists: F64,
    poses: F64,
    resolution_m: float,
    origin_x_m: float,
    origin_y_m: float,
    rows: int,
    cols: int,
    out: I32,
) -> None:
    """Write the flat index row * cols + col of the cell each beam ends in, -1 where it ends in none.

    The arguments are those of `count_scans`; out is (n_scans, n_beams) int32.
    """
    for scan in range(ranges_m.shape[0]):
        geometry = geometry_index[scan]
        yaw = poses[scan, 2]
        cos, sin = math.cos(yaw), math.sin(yaw)
        sensor_x, sensor_y = sensor_poses[geometry, 0], sensor_poses[geometry, 1]
        robot_x, robot_y = poses[scan, 0], poses[scan, 1]
        x0 = (robot_x + cos * sensor_x - sin * sensor_y - origin_x_m) / resolution_m
        y0 = (robot_y + sin * sensor_x + cos * sensor_y - origin_y_m) / resolution_m
        interval_s = beam_interval_s[geometry]
        for beam in range(ranges_m.shape[1]):
            if interval_s != 0.0:
                elapsed_s = (beam if interval_s > 0.0 else beam - ranges_m.shape[1] + 1) * interval_s
                robot_x, robot_y = moved(poses[scan], twists[scan], elapsed_s)
                cos, sin = (
                    math.cos(yaw + elapsed_s * twists[scan, 2]),
                    math.sin(yaw + elapsed_s * twists[scan, 2]),
                )
                x0 = (robot_x + cos * sensor_x - sin * sensor_y - origin_x_m) / resolution_m
                y0 = (robot_y + sin * sensor_x + cos * sensor_y - origin_y_m) / resolution_m
            out[scan, beam] = -1
            distance = float(ranges_m[scan, beam])
            if not (0.0 <= distance <= usable_m[geometry]) or not math.isfinite(x0 + y0 + yaw):
                continue
            length = distance / resolution_m
            direction_x, direction_y = directions[geometry, beam, 0], directions[geometry, beam, 1]
            col = int(math.floor(x0 + length * (cos * direction_x - sin * direction_y)))
            row = int(math.floor(y0 + length * (sin * direction_x + cos * direction_y)))
            if 0 <= row < rows and 0 <= col < cols:
                out[scan, beam] = row * cols + col


@kernel
def widen_bounds(
    ranges_m: F32,
    geometry_index: I32,
    directions: F64,
    sensor_poses: F64,
    usable_m: F64,
    poses: F64,
    bounds: F64,
) -> None:
    """Widen bounds until they hold all end points of some scans.

    Parameters
    ----------
    ranges_m, geometry_index, directions, sensor_poses, usable_m, poses
        As for `count_scans`.
    bounds : (4,) float64
        Least x and y, largest x and y, map frame, metres.
    """
    for scan in range(ranges_m.shape[0]):
        geometry = geometry_index[scan]
        x0, y0, yaw = poses[scan, 0], poses[scan, 1], poses[scan, 2]
        if not math.isfinite(x0 + y0 + yaw):
            continue
        cos, sin = math.cos(yaw), math.sin(yaw)
        for beam in range(ranges_m.shape[1]):
            distance = float(ranges_m[scan, beam])
            if not (0.0 <= distance <= usable_m[geometry]):
                continue
            local_x = sensor_poses[geometry, 0] + distance * directions[geometry, beam, 0]
            local_y = sensor_poses[geometry, 1] + distance * directions[geometry, beam, 1]
            x, y = x0 + cos * local_x - sin * local_y, y0 + sin * local_x + cos * local_y
            bounds[0], bounds[1] = min(bounds[0], x), min(bounds[1], y)
            bounds[2], bounds[3] = max(bounds[2], x), max(bounds[3], y)


@kernel
def cut_at_walls(
    ranges_m: F32,
    geometry_index: I32,
    directions: F64,
    sensor_poses: F64,
    usable_m: F64,
    beam_interval_s: F64,
    twists: F64,
    poses: F64,
    resolution_m: float,
    origin_x_m: float,
    origin_y_m: float,
    is_wall: U8,
    out: F32,
) -> None:
    """Write how far beams without return pass before they meet a wall that others see; NaN for all other beams.

    Parameters
    ----------
    ranges_m ... origin_y_m
        As for `count_scans`.
    is_wall : (rows, cols) uint8
        1 where a beam cannot have passed.
    out : (n_scans, n_beams) float32
        Minus the distance in metres.
    """
    rows, cols = is_wall.shape
    for scan in range(ranges_m.shape[0]):
        geometry = geometry_index[scan]
        yaw = poses[scan, 2]
        cos, sin = math.cos(yaw), math.sin(yaw)
        sensor_x, sensor_y = sensor_poses[geometry, 0], sensor_poses[geometry, 1]
        robot_x, robot_y = poses[scan, 0], poses[scan, 1]
        x0 = (robot_x + cos * sensor_x - sin * sensor_y - origin_x_m) / resolution_m
        y0 = (robot_y + sin * sensor_x + cos * sensor_y - origin_y_m) / resolution_m
        interval_s = beam_interval_s[geometry]
        for beam in range(ranges_m.shape[1]):
            if interval_s != 0.0:
                elapsed_s = (beam if interval_s > 0.0 else beam - ranges_m.shape[1] + 1) * interval_s
                robot_x, robot_y = moved(poses[scan], twists[scan], elapsed_s)
                cos, sin = (
                    math.cos(yaw + elapsed_s * twists[scan, 2]),
                    math.sin(yaw + elapsed_s * twists[scan, 2]),
                )
                x0 = (robot_x + cos * sensor_x - sin * sensor_y - origin_x_m) / resolution_m
                y0 = (robot_y + sin * sensor_x + cos * sensor_y - origin_y_m) / resolution_m
            out[scan, beam] = math.nan
            if not (ranges_m[scan, beam] > usable_m[geometry]) or not math.isfinite(x0 + y0 + yaw):
                continue
            direction_x, direction_y = directions[geometry, beam, 0], directions[geometry, beam, 1]
            dx = cos * direction_x - sin * direction_y
            dy = sin * direction_x + cos * direction_y
            length = usable_m[geometry] / resolution_m
            t = 0.0
            while t < length:
                col, row = int(math.floor(x0 + t * dx)), int(math.floor(y0 + t * dy))
                if 0 <= row < rows and 0 <= col < cols and is_wall[row, col]:
                    break
                t += 0.7
            out[scan, beam] = -max(min(t, length) - 1.0, 0.0) * resolution_m
