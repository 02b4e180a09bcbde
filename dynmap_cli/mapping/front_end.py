"""The front end: poses by matching each scan against the key scans before it (Eq. 1.11)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I32, I64, U8
from dynmap_cli.counting.counts import Rays
from dynmap_cli.domain.mapped import copied_rows
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.matching import SIZE
from dynmap_cli.kernels.registration import KEY, LOST, WIDE, register_scans
from dynmap_cli.mapping.odometry import Calibration
from dynmap_cli.progress import Tick, no_tick

_SCANS_PER_CALL = 250
_RING_CAPACITY = 512


@dataclass(frozen=True, slots=True)
class FrontEndParams:
    """What steers the front end; insensitive to halving or doubling.

    Attributes
    ----------
    cell_m, spacing_m : float
        Cell of the local map, and thinning of the points.
    sigma_m : float
        Noise of a point across its line.
    key_shift_m, key_turn_rad : float
        A scan enters the local map after this motion.
    n_keys : int
        Key scans in the local map.
    reach_m : float
        Key scans farther away than this leave it.
    independent_share : float
        Share of the points that counts as independent.
    wide_turn_rad : float
        Correlative search where the turn is less sure than this (two standard deviations).
    good_share, lost_share : float
        Matched share under which the correlative search helps, and under which a scan is lost.
    """

    cell_m: float = 0.05
    spacing_m: float = 0.03
    sigma_m: float = 0.02
    key_shift_m: float = 0.15
    key_turn_rad: float = 0.15
    n_keys: int = 80
    reach_m: float = 20.0
    independent_share: float = 1.0
    wide_turn_rad: float = 0.08
    good_share: float = 0.75
    lost_share: float = 0.5

    def numbers(self, calibration: Calibration) -> F64:
        """The table that the kernel reads."""
        return np.array(
            [
                self.cell_m,
                self.spacing_m,
                self.sigma_m,
                calibration.shift_noise_m,
                calibration.shift_noise_share,
                calibration.turn_noise_rad,
                calibration.turn_noise_share,
                self.key_shift_m,
                self.key_turn_rad,
                float(self.n_keys),
                self.reach_m,
                self.independent_share,
                self.wide_turn_rad,
                self.good_share,
                self.lost_share,
                1.0 if calibration.reversible else 0.0,
            ]
        )


@dataclass(frozen=True, slots=True)
class Sweeps:
    """The columns of a recording that matching needs, in the order in which the sweeps were made.

    Ranges and weights stay where they are, which may be in files, and are read for some sweeps at a time.

    Attributes
    ----------
    table_m : (n, n_beams) float32
        Ranges in the order of the log, also of other sweeps.
    weights : (n, n_beams) float32 or None
        e of each beam, likewise; None = not known yet.
    rows : (n_scans,) int64
        Where each sweep is in them.
    geometry_index : (n_scans,) int32
    odometry : (n_scans, 3) float64
    times_s : (n_scans,) float64
        Ascending.
    drive_index : (n_scans,) int32
        Ascending.
    """

    table_m: F32
    weights: F32 | None
    rows: I64
    geometry_index: I32
    odometry: F64
    times_s: F64
    drive_index: I32

    @property
    def n_scans(self) -> int:
        """Number of sweeps."""
        return int(self.rows.size)

    @property
    def n_beams(self) -> int:
        """Beams of the widest geometry."""
        return int(self.table_m.shape[1])

    def read(self, scans: slice | I64) -> tuple[F32, F32]:
        """Ranges of some sweeps, and their weights (k, n_beams): NaN = not known yet, 0 where called dynamic.

        Beams that are called dynamic weigh nothing: a cell of the local map is one that was hit, however little it
        was, so that the trails of a crowd would attract scans.
        """
        rows = self.rows[scans]
        ranges_m: F32 = copied_rows(self.table_m, rows)
        if self.weights is None:
            return ranges_m, np.full_like(ranges_m, np.nan)
        weights: F32 = copied_rows(self.weights, rows)
        weights[weights < 0.5] = 0.0
        return ranges_m, weights

    def part(self, first: int, last: int) -> Sweeps:
        """The sweeps first..last - 1 only."""
        scans = slice(first, last)
        return Sweeps(
            self.table_m,
            self.weights,
            self.rows[scans],
            self.geometry_index[scans],
            self.odometry[scans],
            self.times_s[scans],
            self.drive_index[scans],
        )


def sweeps_of(log: ScanLog, weights: F32 | None) -> Sweeps:
    """Columns in the order in which the sweeps were made; *weights* are in the order of the log."""
    order = np.argsort(log.arrival_index, kind="stable").astype(np.int64)
    return Sweeps(
        table_m=log.ranges_m,
        weights=weights,
        rows=order,
        geometry_index=np.array(log.geometry_index[order]),
        odometry=np.array(log.odometry[order]),
        times_s=times_of(log),
        drive_index=np.array(log.drive_index[order]),
    )


def times_of(log: ScanLog) -> F64:
    """(n_scans,) ascending seconds since the first scan, in the order in which the sweeps were made."""
    order = np.argsort(log.arrival_index, kind="stable")
    return np.asarray(np.maximum.accumulate((log.stamps_ns[order] - log.stamps_ns[0]) / 1e9))


@dataclass(frozen=True, slots=True)
class Registered:
    """Result of the front end, in the order of the sweeps.

    Attributes
    ----------
    poses : (n_scans, 3) float64
        map_from_robot; the first scan is at the origin.
    shares : (n_scans,) float64
        Matched share of each scan.
    information : (n_scans, 3, 3) float64
        What the match knows about each pose, map frame.
    twists : (n_scans, 3) float64
        Velocity during each scan, robot frame.
    is_key, is_lost, is_wide : (n_scans,) bool
    """

    poses: F64
    shares: F64
    information: F64
    twists: F64
    is_key: B1
    is_lost: B1
    is_wide: B1


@dataclass(frozen=True, slots=True)
class Matched:
    """What matching fills, one row per scan; see `register_scans`.

    Attributes
    ----------
    poses : (n_scans, 3) float64
    shares : (n_scans,) float64
    information : (n_scans, 3, 3) float64
    twists : (n_scans, 3) float64
    flags : (n_scans,) uint8
    """

    poses: F64
    shares: F64
    information: F64
    twists: F64
    flags: U8

    @classmethod
    def empty(cls, n_scans: int) -> Matched:
        """Rows of zeros."""
        return cls(
            np.zeros((n_scans, 3)),
            np.zeros(n_scans),
            np.zeros((n_scans, 3, 3)),
            np.zeros((n_scans, 3)),
            np.zeros(n_scans, dtype=np.uint8),
        )


class ScanMatcher:
    """The local map of the last key scans, against which scan after scan is matched."""

    def __init__(self, rays: Rays, calibration: Calibration, params: FrontEndParams) -> None:
        self._rays, self._numbers = rays, params.numbers(calibration)
        self._sums = np.zeros((SIZE, SIZE, 3), dtype=np.int64)
        self._lines = np.zeros((SIZE, SIZE, 4), dtype=np.float32)
        self._stale = np.zeros((SIZE, SIZE), dtype=np.uint8)
        self._field = np.zeros((SIZE, SIZE), dtype=np.uint8)
        self._ring, self._state = np.zeros(_RING_CAPACITY, dtype=np.int64), np.zeros(3, dtype=np.int64)
        self._ring_points = np.zeros((_RING_CAPACITY, rays.directions.shape[1], 2))
        self._ring_weights = np.zeros(self._ring_points.shape[:2])
        self._ring_counts = np.zeros(_RING_CAPACITY, dtype=np.int64)
        self._laser_index = rays.laser_index
        self._last_keys = np.full(self._laser_index.max() + 1, -1, dtype=np.int64)

    def match(
        self, first: int, last: int, sweeps: Sweeps, motion: F64, has_motion: U8, found: Matched
    ) -> None:
        """Match the scans from *first* to before *last*; those before them have been matched.

        Parameters
        ----------
        sweeps : Sweeps
        motion : (n_scans, 3) float64
            Steps of the odometry.
        has_motion : (n_scans,) uint8
            0 where it says nothing: constant velocity is used.
        found : Matched
            Its rows are filled.
        """
        register_scans(
            first,
            last,
            *sweeps.read(slice(first, last)),
            sweeps.geometry_index,
            self._rays.directions,
            self._rays.sensor_poses,
            self._rays.usable_m,
            self._rays.beam_interval_s,
            sweeps.times_s,
            motion,
            has_motion,
            self._numbers,
            self._sums,
            self._lines,
            self._stale,
            self._field,
            self._laser_index,
            self._last_keys,
            self._ring,
            self._ring_points,
            self._ring_weights,
            self._ring_counts,
            self._state,
            found.poses,
            found.shares,
            found.information,
            found.twists,
            found.flags,
        )


def register(
    sweeps: Sweeps,
    rays: Rays,
    motion: F64,
    calibration: Calibration,
    params: FrontEndParams,
    tick: Tick = no_tick,
) -> Registered:
    """Register all scans one after another.

    Parameters
    ----------
    sweeps : Sweeps
    rays : Rays
    motion : (n_scans, 3) float64
        Corrected odometry steps; rows with NaN: constant velocity is used.
    calibration : Calibration
        Noise of the motion, and whether its sign is missing.
    params : FrontEndParams
    tick : callable
        Told the number of scans done.
    """
    n_scans = sweeps.n_scans
    matcher, found = ScanMatcher(rays, calibration, params), Matched.empty(n_scans)
    has_motion: U8 = np.asarray(np.isfinite(motion).all(axis=1)).astype(np.uint8)
    for first in range(0, n_scans, _SCANS_PER_CALL):
        last = min(first + _SCANS_PER_CALL, n_scans)
        matcher.match(first, last, sweeps, motion, has_motion, found)
        tick(last - first)
    flags = found.flags
    return Registered(
        found.poses,
        found.shares,
        found.information,
        found.twists,
        (flags & KEY) > 0,
        (flags & LOST) > 0,
        (flags & WIDE) > 0,
    )
