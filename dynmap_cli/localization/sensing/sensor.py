"""The sensor model: a likelihood field, tempered because neighbouring beams err together."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I32, I64
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.poses import between
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.likelihood import field_log_likelihoods
from dynmap_cli.kernels.sweeps import place_beams
from dynmap_cli.localization.sensing.pose_chunks import weigh_in_chunks
from dynmap_cli.localization.settings import LocalizationSettings

SOON, LONGEST_STEP_S = 8, 2.0
"""The velocity during a scan is that to the next of its kind, which is one of so many and not later than this."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """The beams of one scan, seen from the robot.

    Attributes
    ----------
    sensor : (2,) float64
        Position of the sensor in the robot frame, metres.
    directions_rad : (n,) float64
        Direction of each beam in the robot frame.
    ranges_m : (n,) float64
        Distances; +inf = nothing within reach.
    reach_m : float
        How far the sensor sees.
    """

    sensor: F64
    directions_rad: F64
    ranges_m: F64
    reach_m: float

    @property
    def n_returns(self) -> int:
        """How many beams hit something."""
        return int(np.count_nonzero(np.isfinite(self.ranges_m)))

    def ends_m(self, beams: B1 | I64) -> F64:
        """(m, 2) end points of some beams, which must have hit something, in the robot frame."""
        angles = self.directions_rad[beams]
        ends, scratch = np.empty((angles.size, 2)), np.empty(angles.size)
        x, y = self.sensor.tolist()
        place_beams(angles, self.ranges_m[beams], np.array([x, y, 0.0]), scratch, ends)
        return ends


def sweep_of(log: ScanLog, scan: int, max_range_m: float) -> Sweep:
    """Take the beams of a scan that measured something; ends beyond *max_range_m* are left out.

    Where beams are made one after another, each is put where it would be seen from at the stamp, by the odometry.
    """
    geometry = int(log.geometry_index[scan])
    ranges = np.asarray(log.ranges_m[scan], dtype=np.float64)
    bearings = log.bearings_rad[geometry]
    sensor = log.sensor_poses[geometry]
    usable = np.isfinite(bearings) & ((ranges <= max_range_m) | (ranges == np.inf))
    reach = min(float(log.range_limits_m[geometry, 1]), max_range_m)
    directions, ranges = bearings[usable] + sensor[2], ranges[usable]
    twist = _twist(log, scan) if log.beam_interval_s[geometry] != 0.0 else None
    if twist is not None:
        interval_s, n_beams = float(log.beam_interval_s[geometry]), int(np.isfinite(bearings).sum())
        beams = np.flatnonzero(usable) - (0 if interval_s > 0.0 else n_beams - 1)
        elapsed_s: F64 = np.asarray(log.first_beam_s[geometry] + interval_s * beams, dtype=np.float64)
        directions, ranges = _seen_at_once(directions, ranges, sensor[:2], twist, elapsed_s)
    return Sweep(sensor[:2].copy(), directions, ranges, reach)


def _twist(log: ScanLog, scan: int) -> F64 | None:
    """Velocity (3,) from a scan to the next one of the same kind, in the robot frame; None where nobody knows it."""
    after = np.flatnonzero(log.geometry_index[scan + 1 : scan + 1 + SOON] == log.geometry_index[scan])
    if not after.size:
        return None
    following = scan + 1 + int(after[0])
    seconds = float(log.stamps_ns[following] - log.stamps_ns[scan]) * 1e-9
    step = between(log.odometry[scan], log.odometry[following])
    if log.drive_index[following] != log.drive_index[scan] or not 0.0 < seconds < LONGEST_STEP_S:
        return None
    return step / seconds if bool(np.isfinite(step).all()) else None


def _seen_at_once(
    directions_rad: F64, ranges_m: F64, sensor: F64, twist: F64, elapsed_s: F64
) -> tuple[F64, F64]:
    """Directions and ranges of beams that were made some time (n,) after the stamp, from where the sensor was then."""
    turns = directions_rad + twist[2] * elapsed_s
    hits = np.isfinite(ranges_m)
    yaw, lengths = twist[2] * elapsed_s[hits], ranges_m[hits]
    cos, sin = np.cos(yaw), np.sin(yaw)
    x = twist[0] * elapsed_s[hits] + (cos - 1.0) * sensor[0] - sin * sensor[1] + lengths * np.cos(turns[hits])
    y = twist[1] * elapsed_s[hits] + sin * sensor[0] + (cos - 1.0) * sensor[1] + lengths * np.sin(turns[hits])
    ranges, directions = ranges_m.copy(), turns.copy()
    ranges[hits], directions[hits] = np.hypot(x, y), np.arctan2(y, x)
    return directions, ranges


def pose_ends(sweep: Sweep, max_beams: int) -> F64:
    """(n, 2) ends of at most *max_beams* beams with a return, evenly spread, in the robot frame."""
    hits = np.flatnonzero(np.isfinite(sweep.ranges_m))
    if hits.size > max_beams:
        hits = hits[evenly(hits.size, max_beams)]
    return sweep.ends_m(hits)


def evenly(n: int, count: int) -> I64:
    """Indices of *count* of n things, the first and the last among them, with nearly equal gaps."""
    return np.asarray((np.arange(count) * (n - 1) + (count - 1) // 2) // max(count - 1, 1))


def end_log_likelihood(distance_m: F64 | F32, sigma_m: float, settings: LocalizationSettings) -> F32:
    """Logarithm of the likelihood of an end at this distance from the map (likelihood field of AMCL)."""
    distance = np.minimum(distance_m, settings.laser_likelihood_max_dist)
    hit = settings.z_hit * np.exp(-0.5 * (distance / sigma_m) ** 2)
    return np.log(hit + settings.z_rand / settings.laser_max_range).astype(np.float32)


def best_log_likelihood(settings: LocalizationSettings) -> float:
    """The value of an end exactly on the map."""
    return math.log(settings.z_hit + settings.z_rand / settings.laser_max_range)


def least_log_likelihood(settings: LocalizationSettings) -> float:
    """The value of an end far from the map, or of a beam that passed through something solid."""
    return math.log(settings.z_rand / settings.laser_max_range)


def temper(n_beams: int, settings: LocalizationSettings) -> float:
    """Exponent under which the product over *n_beams* is worth `independent_beams`."""
    return min(1.0, settings.independent_beams / max(n_beams, 1))


def scan_log_likelihoods(
    pool: F32,
    frame: GridFrame,
    poses: F64,
    ends_m: F64,
    windows: I32 | None = None,
    executor: ThreadPoolExecutor | None = None,
) -> F64:
    """Sum of the field's values at the ends of a scan, for each pose.

    Parameters
    ----------
    pool : (n,) float32
        Fields of the map and of the patches, see `MapPool`.
    frame : GridFrame
        Of the map's field.
    poses : (n_poses, 3) float64
        map_from_robot.
    ends_m : (n_beams, 2) float64
        In the robot frame.
    windows : (n_poses, 5) int32, optional
        The patch each pose reads from; none = all read from the map.
    executor : ThreadPoolExecutor, optional
        Shares long lists of poses among threads.

    Returns
    -------
    (n_poses,) float64
    """
    ends = np.ascontiguousarray((ends_m / frame.resolution_m).T, dtype=np.float32)

    def weigh(some: F64, their_windows: I32, out: F64) -> None:
        index = np.empty(ends.shape[1], dtype=np.int32)
        field_log_likelihoods(
            pool, frame.rows, frame.cols, frame.corner, some, ends, their_windows, index, out
        )

    return weigh_in_chunks(weigh, poses, windows, executor)
