"""The counting map of scans at given poses (Eq. 1.12-1.15)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, F32, F64, I32, I64, U8
from dynmap_cli.domain.grid import CountingMap, GridFrame, frame_around
from dynmap_cli.domain.poses import between
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import LogError
from dynmap_cli.kernels.counts import FIXED_ONE, count_scans, cut_at_walls, find_end_cells, widen_bounds

SCANS_PER_CHUNK = 1024
_WALL_REFLECTANCE = 0.5
_SHORTEST_STEP_S, _LONGEST_STEP_S = 0.005, 2.0
_JUMP_M, _JUMP_MPS = 100.0, 100.0


@dataclass(frozen=True, slots=True)
class Rays:
    """What the kernels need to know of the lasers.

    Attributes
    ----------
    directions : (n_geometries, n_beams, 2) float64
        Unit vectors of the beams in the robot frame.
    sensor_poses : (n_geometries, 3) float64
        robot_from_sensor.
    usable_m : (n_geometries,) float64
        Beams are used up to this range.
    beam_interval_s : (n_geometries,) float64
        Time from one beam to the next; negative = from the last beam to the first, 0 = not known.
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


def rays_of(log: ScanLog, usable_range_m: float) -> Rays:
    """Directions and usable ranges of a recording's lasers."""
    angles = log.bearings_rad + log.sensor_poses[:, 2:3]
    return Rays(
        directions=np.stack([np.cos(angles), np.sin(angles)], axis=-1),
        sensor_poses=log.sensor_poses.copy(),
        usable_m=np.minimum(log.range_limits_m[:, 1], usable_range_m),
        beam_interval_s=log.beam_interval_s.copy(),
    )


def twists_of(log: ScanLog, poses: F64) -> F64 | None:
    """Velocity (n_scans, 3) during each scan, robot frame, from the step to the next; None where no sweep takes time.

    Zero where the next scan comes more than two seconds later, is of another drive, or has no pose.
    """
    if log.n_scans < 2 or not (log.beam_interval_s != 0.0).any():
        return None
    elapsed_s = np.diff(log.stamps_ns)[:, None] / 1e9
    twists = np.zeros((log.n_scans, 3))
    usable = (elapsed_s > _SHORTEST_STEP_S) & (elapsed_s < _LONGEST_STEP_S)
    usable &= (np.diff(log.drive_index) == 0)[:, None]
    np.divide(between(poses[:-1], poses[1:]), elapsed_s, out=twists[:-1], where=usable)
    return np.nan_to_num(twists)


class Counter:
    """Sums over beams on one grid; scans can be added and taken out again, exactly and in any order."""

    def __init__(self, frame: GridFrame) -> None:
        self.frame = frame
        rows, cols = frame.shape
        self._along_cols = np.zeros((rows + 1, cols + 2), dtype=np.int64)
        self._along_rows = np.zeros((cols + 1, rows + 2), dtype=np.int64)
        self._sums = tuple(np.zeros(frame.shape, dtype=np.int64) for _ in range(4))

    def add(
        self,
        log: ScanLog,
        poses: F64,
        usable_range_m: float,
        *,
        weights: F32 | None = None,
        twists: F64 | None = None,
        sign: int = 1,
    ) -> None:
        """Add scans (sign 1) or take them out (sign -1).

        Parameters
        ----------
        log : ScanLog
        poses : (n_scans, 3) float64
            map_from_robot; scans with NaN are left out.
        usable_range_m : float
        weights : (n_scans, n_beams) float32, optional
            e of each beam; without it all beams are static.
        twists : (n_scans, 3) float64, optional
            Velocity during each scan, see `twists_of`; without it the robot stood still.
        sign : int
        """
        rays, frame = rays_of(log, usable_range_m), self.frame
        for first in range(0, log.n_scans, SCANS_PER_CHUNK):
            part = slice(first, first + SCANS_PER_CHUNK)
            ranges = np.array(log.ranges_m[part])
            count_scans(
                ranges,
                np.ones_like(ranges) if weights is None else np.array(weights[part], dtype=np.float32),
                np.array(log.geometry_index[part]),
                rays.directions,
                rays.sensor_poses,
                rays.usable_m,
                rays.beam_interval_s,
                np.zeros((ranges.shape[0], 3)) if twists is None else np.array(twists[part]),
                np.array(poses[part], dtype=np.float64),
                frame.resolution_m,
                frame.origin_x_m,
                frame.origin_y_m,
                sign,
                self._along_cols,
                self._along_rows,
                *self._sums,
            )

    def merge(self, other: Counter) -> None:
        """Add the sums of another counter on the same grid."""
        self._along_cols += other._along_cols
        self._along_rows += other._along_rows
        for mine, theirs in zip(self._sums, other._sums, strict=True):
            np.add(mine, theirs, out=mine)

    def counting_map(self) -> CountingMap:
        """Turn the sums into hits, passed lengths and centroids."""
        rows, cols = self.frame.shape
        passed = np.cumsum(self._along_cols, axis=1)[:rows, :cols]
        passed += np.cumsum(self._along_rows, axis=1)[:cols, :rows].T
        static, dynamic, offset_x, offset_y = (array / FIXED_ONE for array in self._sums)
        with np.errstate(invalid="ignore", divide="ignore"):
            cells = np.stack([offset_x / static, offset_y / static], axis=-1)
        corners = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1)
        origin = np.array([self.frame.origin_x_m, self.frame.origin_y_m])
        centroids = origin + (corners + cells) * self.frame.resolution_m
        centroids[~np.isfinite(cells)] = np.nan
        return CountingMap(self.frame, static, dynamic, passed / FIXED_ONE, centroids)


def count_beams(
    log: ScanLog,
    poses: F64,
    frame: GridFrame,
    usable_range_m: float,
    *,
    weights: F32 | None = None,
    twists: F64 | None = None,
    threads: int = 1,
) -> CountingMap:
    """Counting map of all scans; the same bytes for any number of threads.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot; scans with NaN are left out.
    frame : GridFrame
        Beams are clipped to it.
    usable_range_m : float
        Longer beams, and beams without return, pass up to this range and end nowhere.
    weights : (n_scans, n_beams) float32, optional
        e of each beam; NaN counts as 1.
    twists : (n_scans, 3) float64, optional
        Velocity during each scan, see `twists_of`; without it the robot stood still.
    threads : int
    """
    bounds = np.linspace(0, log.n_scans, max(1, min(threads, log.n_scans // SCANS_PER_CHUNK)) + 1).astype(int)

    def count(first: int, last: int) -> Counter:
        counter = Counter(frame)
        part = slice(first, last)
        counter.add(
            log.select(part),
            poses[part],
            usable_range_m,
            weights=None if weights is None else weights[part],
            twists=None if twists is None else twists[part],
        )
        return counter

    with ThreadPoolExecutor(max_workers=len(bounds) - 1) as pool:
        total, *others = pool.map(count, bounds[:-1].tolist(), bounds[1:].tolist())
    for other in others:
        total.merge(other)
    return total.counting_map()


def count_up_to_walls(
    log: ScanLog,
    poses: F64,
    frame: GridFrame,
    usable_range_m: float,
    *,
    twists: F64 | None = None,
    threads: int = 1,
) -> CountingMap:
    """Counting map in which beams without return pass only up to the first wall that other beams see.

    A dark or grazing surface returns nothing; taken at its word such a beam would be free space through walls.
    The arguments are those of `count_beams`.
    """
    silent = np.asarray(log.ranges_m == np.inf)
    if not silent.any():
        return count_beams(log, poses, frame, usable_range_m, twists=twists, threads=threads)
    seen = count_beams(only_returns(log), poses, frame, usable_range_m, twists=twists, threads=threads)
    reflectance = np.nan_to_num(seen.reflectance)
    walls: B1 = ndimage.binary_dilation(reflectance >= _WALL_REFLECTANCE, np.ones((3, 3), dtype=bool))
    moving = np.zeros((log.n_scans, 3)) if twists is None else twists
    reach = _reach_of_silent_beams(log, poses, frame, usable_range_m, walls.astype(np.uint8), moving)
    cut = replace(log, ranges_m=np.where(silent, reach, log.ranges_m))
    return count_beams(cut, poses, frame, usable_range_m, twists=twists, threads=threads)


def only_returns(log: ScanLog) -> ScanLog:
    """The same scans, in which beams without return say nothing."""
    silent = np.asarray(log.ranges_m == np.inf)
    return replace(log, ranges_m=np.where(silent, np.float32(np.nan), log.ranges_m)) if silent.any() else log


def _reach_of_silent_beams(
    log: ScanLog, poses: F64, frame: GridFrame, usable_range_m: float, walls: U8, twists: F64
) -> F32:
    """Minus the distance (n_scans, n_beams) that each beam without return passes; NaN for the others."""
    rays = rays_of(log, usable_range_m)
    reach = np.empty(log.ranges_m.shape, dtype=np.float32)
    for first in range(0, log.n_scans, SCANS_PER_CHUNK):
        part = slice(first, first + SCANS_PER_CHUNK)
        cut_at_walls(
            np.array(log.ranges_m[part]),
            np.array(log.geometry_index[part]),
            rays.directions,
            rays.sensor_poses,
            rays.usable_m,
            rays.beam_interval_s,
            np.array(twists[part]),
            np.array(poses[part], dtype=np.float64),
            frame.resolution_m,
            frame.origin_x_m,
            frame.origin_y_m,
            walls,
            reach[part],
        )
    return reach


def end_cells(
    log: ScanLog, poses: F64, frame: GridFrame, usable_range_m: float, *, twists: F64 | None = None
) -> I32:
    """Flat index row * cols + col of each beam's end cell, (n_scans, n_beams) int32; -1 where it has none."""
    rays = rays_of(log, usable_range_m)
    twists = np.zeros((log.n_scans, 3)) if twists is None else twists
    cells = np.empty(log.ranges_m.shape, dtype=np.int32)
    for first in range(0, log.n_scans, SCANS_PER_CHUNK):
        part = slice(first, first + SCANS_PER_CHUNK)
        find_end_cells(
            np.array(log.ranges_m[part]),
            np.array(log.geometry_index[part]),
            rays.directions,
            rays.sensor_poses,
            rays.usable_m,
            rays.beam_interval_s,
            np.array(twists[part]),
            np.array(poses[part], dtype=np.float64),
            frame.resolution_m,
            frame.origin_x_m,
            frame.origin_y_m,
            *frame.shape,
            cells[part],
        )
    return cells


def frame_of_scans(log: ScanLog, poses: F64, usable_range_m: float, resolution_m: float) -> GridFrame:
    """Frame that holds every pose and every end point, and beams without return up to the farthest hit.

    Raises
    ------
    LogError
        If the path jumps, or they lie too far apart for a grid.
    """
    _refuse_jumps(log, poses)
    rays = rays_of(log, usable_range_m)
    known = poses[np.isfinite(poses).all(axis=1), :2]
    bounds = np.concatenate([known.min(axis=0, initial=np.inf), known.max(axis=0, initial=-np.inf)])
    for first in range(0, log.n_scans, SCANS_PER_CHUNK):
        part = slice(first, first + SCANS_PER_CHUNK)
        widen_bounds(
            np.array(log.ranges_m[part]),
            np.array(log.geometry_index[part]),
            rays.directions,
            rays.sensor_poses,
            rays.usable_m,
            np.array(poses[part], dtype=np.float64),
            bounds,
        )
    corners = bounds.reshape(2, 2) if known.size else known
    try:
        return frame_around(corners, resolution_m, 2 * resolution_m)
    except ValueError as err:
        msg = (
            f"{', '.join(log.recordings)}: {err}. Check odometry, tf and --laser-pose with `dynmap check`, "
            "or choose a larger map.resolution_m."
        )
        raise LogError(msg) from err


def _refuse_jumps(log: ScanLog, poses: F64) -> None:
    """Refuse a path that no robot drives; a grid around both ends of a jump would be nearly empty, and huge."""
    order = np.argsort(log.arrival_index, kind="stable")
    known = order[np.isfinite(poses[order]).all(axis=1)]
    steps_m = np.hypot(*np.diff(poses[known, :2], axis=0).T)
    gaps_s = np.abs(np.diff(log.stamps_ns[known])) * 1e-9
    jumps = np.flatnonzero(steps_m > _JUMP_M + _JUMP_MPS * gaps_s)
    if jumps.size:
        first = jumps[0]
        msg = (
            f"{', '.join(log.recordings)}: the path jumps by {steps_m[first]:.4g} m between two scans that are "
            f"{gaps_s[first]:.3g} s apart, at most {_JUMP_M:g} m and {_JUMP_MPS:g} m/s are taken for a drive. "
            "Check the odometry with `dynmap check`; pass --odom to choose another one, or none."
        )
        raise LogError(msg)
