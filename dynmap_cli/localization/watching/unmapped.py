"""Rooms that the map does not show: what leads the robot there, what weighs particles, and what speaks for its pose.

Nothing corrects the odometry there. So the laser goes along (`LaserOdometry`), in a frame of its own: only its steps
are used, and what the robot has drawn itself never speaks for a place in the map.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.poses import compose
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.localization.beliefs.states import place_sweep
from dynmap_cli.localization.particles.motion import Motion
from dynmap_cli.localization.sensing.map_pool import MapPool
from dynmap_cli.localization.sensing.sensor import Sweep
from dynmap_cli.localization.sensing.weighing import Weighing
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.watching.health import SETTLED_AFTER, ScanHealth, ends_off_map
from dynmap_cli.localization.watching.laser_odometry import LaserOdometry

LEAST_JUDGED = 0.85
"""Share of the beams of which the map must be able to say whether they fit; below, the laser goes along."""
BEFORE = 10
"""Updates before that from which on it is matched."""
STAYS = 20
"""Updates without such a scan after which the robot is back in the map."""
EDGE_M = 0.5
"""Ends so near to where the map ends say nothing along its edge; and shorter gaps are no edge."""


class Unmapped:
    """One drive, as far as it leads out of the map."""

    def __init__(self, log: ScanLog, pool: MapPool, settings: LocalizationSettings) -> None:
        self._log, self._pool, self._settings = log, pool, settings
        self._laser: LaserOdometry | None = None
        self._before: deque[tuple[int, Motion]] = deque(maxlen=BEFORE)
        self._judged = self._settled = 0
        self._at: F64 | None = None
        self._edge: B1 | None = None

    def improved(self, scan: int, motion: Motion) -> Motion:
        """The motion from the last update to a scan, better where the laser goes along and its scans match."""
        self._before.append((scan, motion))
        return motion if self._laser is None else self._match(self._laser, scan, motion)

    def weighed(self, weighing: Weighing, motion: Motion) -> Weighing:
        """A scan without the ends of which the map knows nothing, if the laser has led to it.

        A likelihood field takes them for ends far from everything, and so draws poses back from the edge of the map to
        where fewer beams end beyond it. Ends near the edge would do so, too. All are taken as from the pose that is
        expected, so that every particle is weighed by the same ones.
        """
        if motion.sigmas is None or self._at is None or self._settings.sensor == "beam":
            return weighing
        ends, sensor = weighing.ends_m, weighing.sweep.sensor
        x, y = (ends - sensor).T
        beams = Sweep(sensor, np.arctan2(y, x), np.hypot(x, y), weighing.sweep.reach_m)
        placed = place_sweep(beams, compose(self._at, motion.step))
        rows, cols = np.clip(
            self._pool.frame.to_cells(placed.ends_m), 0, np.array(self._pool.frame.shape) - 1
        ).T
        if self._edge is None:
            self._edge = near_edges(self._pool)
        return replace(weighing, ends_m=ends[~(ends_off_map(placed, self._pool) | self._edge[rows, cols])])

    def excused(self, health: ScanHealth) -> ScanHealth:
        """The health of a scan, of which only walls that beams go through speak against the pose.

        It is so once the robot came from where it was settled, scan by scan, to where the map shows too little: its
        own scans explain the others.
        """
        if self._laser is None or self._settled < SETTLED_AFTER:
            return health
        return replace(health, unexplained=health.through, opened=0.0, off_map=0.0)

    def watch(self, health: ScanHealth, settled_at: F64 | None, *, is_in_doubt: bool) -> None:
        """Note how an update went; begin where the map can judge too few beams, and end where that is over.

        Only particles that agree on a place are led by the laser: others need their noise to find together.

        Parameters
        ----------
        health : ScanHealth
        settled_at : (3,) float64 or None
            The pose if the particles agree on a place.
        is_in_doubt : bool
        """
        self._at = settled_at
        self._settled = 0 if is_in_doubt else self._settled + 1
        self._judged = 0 if health.judged < LEAST_JUDGED else self._judged + 1
        if self._judged >= STAYS:
            self._laser = None
        elif self._judged == 0 and self._laser is None and settled_at is not None:
            self._laser = LaserOdometry(self._log, self._settings)
            for scan, motion in self._before:
                self._match(self._laser, scan, motion)

    def jumped(self) -> None:
        """The robot was found elsewhere: it was not where it seemed to be settled."""
        self._laser, self._settled, self._at = None, 0, None

    def _match(self, laser: LaserOdometry, scan: int, motion: Motion) -> Motion:
        """Match a scan with those before it; a robot whose scan fits nowhere may have been carried."""
        found = laser.match(scan, motion)
        if found is None:
            self._settled = 0
            return motion
        return found


def near_edges(pool: MapPool) -> B1:
    """(rows, cols) cells near where what is free in the map borders on what it does not know (Yamauchi 1997)."""
    known = pool.free | pool.explained
    for submap in pool.submaps:
        rows = slice(submap.row, submap.row + submap.frame.rows)
        known[rows, submap.col : submap.col + submap.frame.cols] |= submap.owned
    reach = math.ceil(EDGE_M / pool.frame.resolution_m)
    borders, count = ndimage.label(~known & ndimage.binary_dilation(pool.free), np.ones((3, 3)))
    is_long = np.bincount(borders.ravel(), minlength=count + 1) >= reach
    is_long[0] = False
    return np.asarray(ndimage.maximum_filter(is_long[borders], 2 * reach + 1))
