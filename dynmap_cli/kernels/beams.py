"""Where the beams of a scan start, point and end, in cells of a grid."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64, U8
from dynmap_cli.kernels.jit import kernel

START_X, START_Y, STEP_X, STEP_Y, LENGTH, IS_HIT = range(6)
"""Rows of a table of beams: start in cells, unit vector, length in cells, 1 where something reflected."""
BEAM_ROWS = 6


@kernel
def moved(pose: F64, twist: F64, elapsed_s: float) -> tuple[float, float]:
    """Position of the robot a short time after the first beam of a scan."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    dx, dy = elapsed_s * twist[0], elapsed_s * twist[1]
    return pose[0] + cos * dx - sin * dy, pose[1] + sin * dx + cos * dy


class Rays(NamedTuple):
    """What the kernels need to know of the lasers; a geometry is what a laser's sweeps have in common.

    Attributes
    ----------
    directions : (n_geometries, n_beams, 2) float64
        Unit vectors of the beams in the robot frame.
    sensor_poses : (n_geometries, 3) float64
        robot_from_sensor.
    usable_m : (n_geometries,) float64
        Longer beams end nowhere and are cut here.
    beam_interval_s : (n_geometries,) float64
        Time from one beam to the next; negative = the sweep ran from the last beam to the first, 0 = not known.
    """

    directions: F64
    sensor_poses: F64
    usable_m: F64
    beam_interval_s: F64

    @property
    def laser_index(self) -> I64:
        """(n_geometries,) which laser a geometry belongs to: those at one place on the robot are one."""
        _, laser = np.unique(self.sensor_poses, axis=0, return_inverse=True)
        return laser.reshape(-1).astype(np.int64)


class PlacedScans(NamedTuple):
    """Scans, and where in a grid they were taken; one argument of the kernels that draw or read a grid.

    Attributes
    ----------
    ranges_m : (n_scans, n_beams) float32
        +inf = nothing within reach, negative = nothing up to this distance, NaN = says nothing.
    geometry_index : (n_scans,) int32
    rays : Rays
    twists : (n_scans, 3) float64
        Velocity of the robot during each scan, in its frame; sweeps are corrected for it.
    poses : (n_scans, 3) float64
        map_from_robot at the first beam made; scans with NaN are left out.
    resolution_m, origin_x_m, origin_y_m : float
        Frame of the grid.
    """

    ranges_m: F32
    geometry_index: I32
    rays: Rays
    twists: F64
    poses: F64
    resolution_m: float
    origin_x_m: float
    origin_y_m: float


@kernel
def has_pose(scans: PlacedScans, scan: int) -> bool:
    """Whether it is known where a scan was taken."""
    return math.isfinite(scans.poses[scan, 0] + scans.poses[scan, 1] + scans.poses[scan, 2])


@kernel
def place_beams(scans: PlacedScans, scan: int, beams: F64) -> None:
    """Fill the table (BEAM_ROWS, n_beams) of the beams of a scan; what says nothing has length 0 and is no hit."""
    geometry, pose = scans.geometry_index[scan], scans.poses[scan]
    ranges_m, twist, directions = scans.ranges_m[scan], scans.twists[scan], scans.rays.directions[geometry]
    sensor_pose, usable_m = scans.rays.sensor_poses[geometry], scans.rays.usable_m[geometry]
    beam_interval_s = scans.rays.beam_interval_s[geometry]
    resolution_m, origin_x_m, origin_y_m = scans.resolution_m, scans.origin_x_m, scans.origin_y_m
    n_beams = ranges_m.shape[0]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    sensor_x, sensor_y = sensor_pose[0], sensor_pose[1]
    start_x = (pose[0] + cos * sensor_x - sin * sensor_y - origin_x_m) / resolution_m
    start_y = (pose[1] + sin * sensor_x + cos * sensor_y - origin_y_m) / resolution_m
    for beam in range(n_beams):
        direction_x, direction_y = directions[beam, 0], directions[beam, 1]
        beams[START_X, beam] = start_x
        beams[START_Y, beam] = start_y
        beams[STEP_X, beam] = cos * direction_x - sin * direction_y
        beams[STEP_Y, beam] = sin * direction_x + cos * direction_y
        distance = float(ranges_m[beam])
        length = min(abs(distance), usable_m) / resolution_m
        beams[LENGTH, beam] = 0.0 if math.isnan(distance) else length
        beams[IS_HIT, beam] = 1.0 if 0.0 <= distance <= usable_m else 0.0
    if beam_interval_s == 0.0:
        return
    for beam in range(n_beams):
        elapsed_s = (beam if beam_interval_s > 0.0 else beam - n_beams + 1) * beam_interval_s
        x, y = moved(pose, twist, elapsed_s)
        yaw = pose[2] + elapsed_s * twist[2]
        cos_now, sin_now = math.cos(yaw), math.sin(yaw)
        direction_x, direction_y = directions[beam, 0], directions[beam, 1]
        beams[START_X, beam] = (x + cos_now * sensor_x - sin_now * sensor_y - origin_x_m) / resolution_m
        beams[START_Y, beam] = (y + sin_now * sensor_x + cos_now * sensor_y - origin_y_m) / resolution_m
        beams[STEP_X, beam] = cos_now * direction_x - sin_now * direction_y
        beams[STEP_Y, beam] = sin_now * direction_x + cos_now * direction_y


@kernel
def cells_of_hits(beams: F64, rows: int, cols: int, out: I64) -> None:
    """Write the flat index row * cols + col of the cell each beam ends in, -1 where it ends in none."""
    for beam in range(beams.shape[1]):
        col = np.floor(beams[START_X, beam] + beams[LENGTH, beam] * beams[STEP_X, beam])
        row = np.floor(beams[START_Y, beam] + beams[LENGTH, beam] * beams[STEP_Y, beam])
        within = 0 <= row < rows and 0 <= col < cols and beams[IS_HIT, beam] > 0.0
        out[beam] = int(row * cols + col) if within else -1


@kernel
def find_end_cells(scans: PlacedScans, rows: int, cols: int, out: I32) -> None:
    """Write the flat index row * cols + col of the cell each beam ends in, -1 where it ends in none.

    *rows*, *cols* are those of the grid; *out* is (n_scans, n_beams) int32.
    """
    n_scans, n_beams = scans.ranges_m.shape
    beams, cells = np.empty((BEAM_ROWS, n_beams)), np.empty(n_beams, dtype=np.int64)
    for scan in range(n_scans):
        out[scan] = -1
        if not has_pose(scans, scan):
            continue
        place_beams(scans, scan, beams)
        cells_of_hits(beams, rows, cols, cells)
        for beam in range(cells.size):
            out[scan, beam] = cells[beam]


@kernel
def widen_bounds(ranges_m: F32, geometry_index: I32, rays: Rays, poses: F64, bounds: F64) -> None:
    """Widen bounds until they hold all end points of some scans.

    Parameters
    ----------
    ranges_m, geometry_index, rays, poses
        As in `PlacedScans`.
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
            if not (0.0 <= distance <= rays.usable_m[geometry]):
                continue
            local_x = rays.sensor_poses[geometry, 0] + distance * rays.directions[geometry, beam, 0]
            local_y = rays.sensor_poses[geometry, 1] + distance * rays.directions[geometry, beam, 1]
            x, y = x0 + cos * local_x - sin * local_y, y0 + sin * local_x + cos * local_y
            bounds[0], bounds[1] = min(bounds[0], x), min(bounds[1], y)
            bounds[2], bounds[3] = max(bounds[2], x), max(bounds[3], y)


@kernel
def cut_at_walls(scans: PlacedScans, is_wall: U8, out: F32) -> None:
    """Write how far beams without return pass before they meet a wall that others see; NaN for all other beams.

    Parameters
    ----------
    scans : PlacedScans
    is_wall : (rows, cols) uint8
        1 where a beam cannot have passed.
    out : (n_scans, n_beams) float32
        Minus the distance in metres.
    """
    rows, cols = is_wall.shape
    n_scans, n_beams = scans.ranges_m.shape
    beams = np.empty((BEAM_ROWS, n_beams))
    for scan in range(n_scans):
        out[scan] = math.nan
        if not has_pose(scans, scan):
            continue
        place_beams(scans, scan, beams)
        usable_m = scans.rays.usable_m[scans.geometry_index[scan]]
        for beam in range(n_beams):
            if not (scans.ranges_m[scan, beam] > usable_m):
                continue
            x0, y0 = beams[START_X, beam], beams[START_Y, beam]
            dx, dy, length = beams[STEP_X, beam], beams[STEP_Y, beam], beams[LENGTH, beam]
            t = 0.0
            while t < length:
                col, row = int(math.floor(x0 + t * dx)), int(math.floor(y0 + t * dy))
                if 0 <= row < rows and 0 <= col < cols and is_wall[row, col]:
                    break
                t += 0.7
            out[scan, beam] = -max(min(t, length) - 1.0, 0.0) * scans.resolution_m
