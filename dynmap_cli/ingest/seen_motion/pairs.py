"""Pairs of sweeps of one laser, and the rows of what is known at the times of sweeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F32, F64, I64


@dataclass(frozen=True, slots=True)
class SweepPairs:
    """Two sweeps each, which a motion of the laser may lay on one another.

    Attributes
    ----------
    before_m, after_m : (n, n_beams) float32
        Ranges; NaN = no return.
    bearings_rad : (n_beams,) float64
        Where the beams point, evenly spread, at least two.
    """

    before_m: F32
    after_m: F32
    bearings_rad: F64


def rows_at(stamps_ns: I64, at_ns: I64) -> I64:
    """Rows (m,) of the stamps (n,), ascending, at or after each of the times."""
    return np.minimum(np.searchsorted(stamps_ns, at_ns), stamps_ns.size - 1)
