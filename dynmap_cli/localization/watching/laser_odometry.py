"""Odometry from the laser: each scan is matched against the robot's own scans before it, as by the front end of `map`.

Point to line on a local map of hit centroids (Eq. 1.11): unlike a fit in a smoothed field, it does not drag the pose
along corridors. The odometry is the prior.
"""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.counting.counts import rays_of
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.registration import LOST
from dynmap_cli.localization.particles.motion import Motion, motion_sigmas, step_between, turn_drive_turn
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.scan_matching.calibration import Calibration
from dynmap_cli.scan_matching.matcher import FrontEndParams, Matched, ScanMatcher
from dynmap_cli.scan_matching.sweeps import Sweeps

SIGMA_M, SIGMA_RAD = 0.005, 0.001
"""Noise of a step that was matched, however many beams matched: their errors are not independent."""
LOOSE = Calibration(turn_noise_rad=0.01, turn_noise_share=0.3, shift_noise_m=0.03, shift_noise_share=0.3)
"""Of odometry that nobody has calibrated."""
PARAMS = FrontEndParams(n_keys=500, reach_m=50.0, wide_turn_rad=0.15)
"""The local map holds whole rooms, so that who drives about in them does not drift. The wide search is for scans that
do not fit: updates turn by little."""
CARRIED_M, CARRIED_RAD = 0.5, 0.35
"""A scan that fits only so far from where the odometry leads fits by chance, or the robot was carried."""


class LaserOdometry:
    """The scans of some updates in a row, and where they were made, in a frame of their own."""

    def __init__(self, log: ScanLog, settings: LocalizationSettings) -> None:
        self._log, self._settings = log, settings
        self._matcher = ScanMatcher(rays_of(log, settings.laser_max_range), LOOSE, PARAMS)
        self._count = 0
        # Room for all scans: what is never written to takes no memory.
        self._found, self._has_motion = Matched.empty(log.n_scans), np.zeros(log.n_scans, dtype=np.uint8)
        self._sweeps = Sweeps(
            table_m=log.ranges_m,
            weights=None,
            rows=np.zeros(log.n_scans, dtype=np.int64),
            geometry_index=np.zeros(log.n_scans, dtype=np.int32),
            odometry=np.zeros((log.n_scans, 3)),
            times_s=np.zeros(log.n_scans),
            drive_index=np.zeros(log.n_scans, dtype=np.int32),
        )

    def match(self, scan: int, motion: Motion) -> Motion | None:
        """Match one more scan; the motion to it from the one before, None if it fits nowhere."""
        row, log, sweeps, found = self._count, self._log, self._sweeps, self._found
        sweeps.rows[row] = scan
        sweeps.geometry_index[row] = log.geometry_index[scan]
        sweeps.times_s[row] = log.stamps_ns[scan] * 1e-9
        sweeps.odometry[row] = motion.step
        self._has_motion[row] = motion.measured
        self._matcher.match(row, row + 1, sweeps, sweeps.odometry, self._has_motion, found)
        self._count += 1
        if row == 0:
            return motion
        step = step_between(found.poses[row - 1], found.poses[row])
        away = step_between(motion.step, step)
        is_carried = math.hypot(away[0], away[1]) > CARRIED_M or abs(float(away[2])) > CARRIED_RAD
        if is_carried or bool(found.flags[row] & LOST):
            return None
        return Motion(step, measured=True, sigmas=self._sigmas(row, step, motion))

    def _sigmas(self, row: int, step: F64, motion: Motion) -> F64:
        """Noise along and across the way and of the yaw: of odometry and match together.

        Along a bare corridor the match says nothing, and what the odometry says is all that is known.
        """
        direction, length, _ = turn_drive_turn(step, 0.0)
        heading = self._found.poses[row - 1, 2] + direction
        cos, sin = math.cos(heading), math.sin(heading)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        first, along, across, last = motion_sigmas(motion, self._settings)
        before = np.diag(
            [1.0 / along**2, 1.0 / (across**2 + (length * first) ** 2), 1.0 / (first**2 + last**2)]
        )
        covariance = np.linalg.inv(turn.T @ self._found.information[row] @ turn + before)
        return np.asarray(np.hypot(np.sqrt(np.diag(covariance)), (SIGMA_M, SIGMA_M, SIGMA_RAD)))
