"""The front end: poses by matching each scan against the key scans before it (Eq. 1.11)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, U8
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.kernels.registration import KEY, LOST, WIDE
from dynmap_cli.progress import Tick, no_tick
from dynmap_cli.scan_matching.calibration import Calibration
from dynmap_cli.scan_matching.matcher import FrontEndParams, Matched, ScanMatcher
from dynmap_cli.scan_matching.sweeps import Sweeps

_SCANS_PER_CALL = 250


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

    @property
    def fixes_position(self) -> B1:
        """(n_scans,) where the match knows both directions; along a bare corridor it knows one."""
        spread = np.linalg.eigvalsh(self.information[:, :2, :2])
        return np.asarray(spread[:, 0] > 0.05 * np.maximum(spread[:, 1], 1e-9))


def register(
    sweeps: Sweeps,
    rays: Rays,
    motion: F64,
    calibration: Calibration,
    params: FrontEndParams,
    tick: Tick = no_tick,
    twists: F64 | None = None,
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
    twists : (n_scans, 3) float64, optional
        Velocity during each scan, robot frame; without it, what *motion* says, or like the step before.
    """
    n_scans = sweeps.n_scans
    matcher, found = ScanMatcher(rays, calibration, params), Matched.empty(n_scans, sweeps.folder)
    if twists is not None:
        found.twists[:] = twists
    has_motion: U8 = np.asarray(np.isfinite(motion).all(axis=1)).astype(np.uint8)
    for first in range(0, n_scans, _SCANS_PER_CALL):
        last = min(first + _SCANS_PER_CALL, n_scans)
        matcher.match(first, last, sweeps, motion, has_motion, found)
        tick(last - first)
        give_back(found.information)
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
