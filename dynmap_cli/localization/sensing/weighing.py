"""What weighs particles by one scan: the sensor model that the settings choose, and how much it counts."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64, I32
from dynmap_cli.localization.sensing.beam_model import beams_of, scan_beam_log_likelihoods
from dynmap_cli.localization.sensing.map_pool import MapPool
from dynmap_cli.localization.sensing.sensor import Sweep, pose_ends, scan_log_likelihoods, temper
from dynmap_cli.localization.settings import LocalizationSettings

LEAST_EFFECTIVE = 20.0
"""Particles that should still count after the beam model has weighed them."""
_MOST_HALVINGS = 8


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

    def tempered(self, log_likelihoods: F64, weights: F64) -> F64:
        """Log-likelihoods (n,) or (n, n_states) under the exponent; the beam model's under less if few would be left.

        It is so sharp that of particles from a start nearly none fits, and the best of them would be all that is
        left. So its exponent is halved until the weights of enough particles count (annealing, Deutscher et al. 2000).
        """
        found = np.asarray(self.exponent * log_likelihoods)
        if self.settings.sensor != "beam":
            return found
        enough = min(LEAST_EFFECTIVE, 0.5 * _effective(weights))
        for _ in range(_MOST_HALVINGS):
            best = found if found.ndim == 1 else found.max(axis=1)
            if _effective(weights * np.exp(best - best.max())) >= enough:
                break
            found = 0.5 * found
        return found


def _effective(weights: F64) -> float:
    """Effective sample size of weights (n,) of any sum."""
    return float(np.square(weights.sum()) / np.square(weights).sum())


def weighing_of(sweep: Sweep, pool: MapPool, settings: LocalizationSettings) -> Weighing:
    """Choose the beams of a scan that weigh particles."""
    ends = pose_ends(sweep, settings.max_beams)
    if settings.sensor == "beam":
        sweep = beams_of(sweep, settings.max_beams)
        return Weighing(pool, settings, sweep, ends, temper(sweep.ranges_m.size, settings))
    return Weighing(pool, settings, sweep, ends, temper(ends.shape[0], settings))
