"""What weighs particles by one scan: the sensor model that the settings choose, and how much it counts."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from dynmap_cli.arrays import F64, I32
from dynmap_cli.localization.beam_model import beams_of, scan_beam_log_likelihoods
from dynmap_cli.localization.map_pool import MapPool
from dynmap_cli.localization.sensor import Sweep, pose_ends, scan_log_likelihoods, temper
from dynmap_cli.localization.settings import LocalizationSettings


@dataclass(frozen=True, slots=True)
class Weighing:
    """One scan under the sensor model of the settings.

    Attributes
    ----------
    sweep : Sweep
        The beams of the scan; under the beam model those that weigh.
    ends_m : (n, 2) float64
        Ends of at most `max_beams` beams with a return, in the robot frame.
    exponent : float
        Under which the product over the beams is worth as many as are independent.
    """

    pool: MapPool
    settings: LocalizationSettings
    sweep: Sweep
    ends_m: F64
    exponent: float

    def log_likelihoods(
        self, poses: F64, windows: I32 | None = None, executor: ThreadPoolExecutor | None = None
    ) -> F64:
        """(n_poses,) logarithm of the likelihood of the scan, not tempered; *windows* as in the kernels."""
        if self.settings.sensor == "beam":
            return scan_beam_log_likelihoods(self.pool, poses, self.sweep, self.settings, windows, executor)
        return scan_log_likelihoods(self.pool.pool, self.pool.frame, poses, self.ends_m, windows, executor)


def weighing_of(sweep: Sweep, pool: MapPool, settings: LocalizationSettings) -> Weighing:
    """Choose the beams of a scan that weigh particles."""
    ends = pose_ends(sweep, settings.max_beams)
    if settings.sensor == "beam":
        sweep = beams_of(sweep, settings.max_beams)
        return Weighing(pool, settings, sweep, ends, temper(sweep.ranges_m.size, settings))
    return Weighing(pool, settings, sweep, ends, temper(ends.shape[0], settings))
