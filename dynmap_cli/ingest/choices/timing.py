"""How the sweeps of a laser lie in time: pauses, sweeps that are missing, stamps that go back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.ingest.choices.merging import pauses_ns
from dynmap_cli.ingest.raw.columns import spans, steps_in
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
    backward, least_step_ns = 0, 0
    for steps_ns in steps_in(stamps_ns):
        backward += int(np.count_nonzero(steps_ns < 0))
        least_step_ns = min(least_step_ns, int(steps_ns.min()))
    pauses = pauses_ns(stamps_ns)
    longest_gap_s = int(pauses.max(initial=0)) * 1e-9
    period_s = float(np.median(pauses, overwrite_input=True)) * 1e-9 if pauses.size else 0.0
    steady, gaps, missing = 0, 0, 0
    for rows in spans(pauses.size):
        pauses_s: F64 = pauses[rows].astype(np.float64) * 1e-9
        steady += int(np.count_nonzero(np.abs(pauses_s / period_s - 1.0) <= _STEADY_PERIODS))
        long_s = pauses_s[pauses_s > _GAP_PERIODS * period_s]
        gaps += long_s.size
        missing += int((np.round(long_s / period_s) - 1.0).sum())
    is_steady = pauses.size > 0 and steady / pauses.size >= _STEADY_SHARE
    return Timing(
        rate_hz=round(1.0 / period_s, 3) if period_s > 0.0 else 0.0,
        is_steady=is_steady,
        longest_gap_s=round(longest_gap_s, 3),
        gaps=gaps if is_steady else 0,
        missing=missing if is_steady else 0,
        backward=backward,
        most_backward_s=round(-(least_step_ns * 1e-9), 3),
    )
