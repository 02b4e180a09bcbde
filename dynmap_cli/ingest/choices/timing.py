"""How the sweeps of a laser lie in time: pauses, sweeps that are missing, stamps that go back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.ingest.choices.merging import period_s_of
from dynmap_cli.ingest.raw.laser import RawLaser

_GAP_PERIODS = 1.5
_STEADY_SHARE, _STEADY_PERIODS = 0.9, 0.5


@dataclass(frozen=True, slots=True)
class Timing:
    """The sweeps of one laser in time; sweeps that share a stamp, as repeated ones do, are at one time.

    Attributes
    ----------
    rate_hz : float
        One over the median time between sweeps; 0 with fewer than two.
    is_steady : bool
        Nine tenths of the times between sweeps are within half the median of it; a recorder that keeps a sweep only
        where the robot moved is not, and nothing is missing then.
    longest_gap_s : float
        Longest pause between two sweeps.
    gaps, missing : int
        Pauses of over 1.5 median times between sweeps of a steady laser, and how many sweeps would fit into them.
    backward : int
        Sweeps stamped before the one recorded before them.
    most_backward_s : float
        By how much at most.
    """

    rate_hz: float
    is_steady: bool
    longest_gap_s: float
    gaps: int
    missing: int
    backward: int
    most_backward_s: float


def timing_of(laser: RawLaser) -> Timing:
    """Measure the times of a laser's sweeps."""
    stamps_ns = laser.stamps_ns
    steps_s: F64 = np.diff(stamps_ns).astype(np.float64) * 1e-9
    pauses_s: F64 = np.diff(np.unique(stamps_ns)).astype(np.float64) * 1e-9
    period_s = period_s_of(stamps_ns)
    is_steady, missing = False, np.zeros(0)
    if period_s > 0.0:
        off = np.abs(pauses_s / period_s - 1.0)
        is_steady = bool(np.mean(off <= _STEADY_PERIODS) >= _STEADY_SHARE)
    if is_steady:
        missing = np.round(pauses_s[pauses_s > _GAP_PERIODS * period_s] / period_s) - 1.0
    return Timing(
        rate_hz=round(1.0 / period_s, 3) if period_s > 0.0 else 0.0,
        is_steady=is_steady,
        longest_gap_s=round(float(pauses_s.max(initial=0.0)), 3),
        gaps=missing.size,
        missing=int(missing.sum()),
        backward=int(np.count_nonzero(steps_s < 0.0)),
        most_backward_s=round(-float(steps_s.min(initial=0.0)), 3),
    )
