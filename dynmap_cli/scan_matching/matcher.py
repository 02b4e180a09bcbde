"""Scans are matched against a local map of the key scans before them (Eq. 1.11)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64, U8
from dynmap_cli.files.tables import new_table
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.kernels.matching import SIZE
from dynmap_cli.kernels.registration import register_scans
from dynmap_cli.scan_matching.calibration import Calibration
from dynmap_cli.scan_matching.sweeps import Sweeps

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

    @property
    def farthest_m(self) -> float:
        """Range up to which returns are matched: beyond it a scan could meet itself around the torus of the local map.

        Two points seen from key scans `reach_m` apart are at most 2 `farthest_m` + `reach_m` from one another.
        """
        return (SIZE * self.cell_m - self.reach_m) / 2

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
class Matched:
    """What matching fills, one row per scan; see `register_scans`.

    Attributes
    ----------
    poses : (n_scans, 3) float64
    shares : (n_scans,) float64
    information : (n_scans, 3, 3) float64
    twists : (n_scans, 3) float64
        NaN = not known yet.
    flags : (n_scans,) uint8
    """

    poses: F64
    shares: F64
    information: F64
    twists: F64
    flags: U8

    @classmethod
    def empty(cls, n_scans: int, folder: Path | None = None) -> Matched:
        """Rows of zeros; what takes most memory is mapped from a file on the disk of *folder* where they are many."""
        return cls(
            np.zeros((n_scans, 3)),
            np.zeros(n_scans),
            new_table(n_scans, 9, folder, np.float64).reshape(n_scans, 3, 3),
            np.full((n_scans, 3), np.nan),
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
            self._rays,
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
