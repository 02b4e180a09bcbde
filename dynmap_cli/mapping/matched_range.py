"""How far returns are matched: as far as they are counted in the map, or farther in the open."""

from __future__ import annotations

import numpy as np

from dynmap_cli.counting.counts import SCANS_PER_CHUNK
from dynmap_cli.domain.mapped import copied_rows
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.scan_matching.matcher import FrontEndParams

_LEAST_NEAR = 0.1
"""Share of the beams of a scan that have to end near, or nothing says how the robot moved."""
_MOST_EMPTY = 0.01
"""Share of the scans that may see less."""


def matched_range_m(log: ScanLog, usable_range_m: float) -> float:
    """Range up to which returns are matched.

    In the open hardly anything stands as near as *usable_range_m*, and where a wheel slips there nothing contradicts
    it. What stands farther, up to where the local map ends (`FrontEndParams.farthest_m`), tells the turn best; indoors
    it is not needed, and few returns are as weak.
    """
    farthest_m = FrontEndParams().farthest_m
    if usable_range_m >= farthest_m:
        return usable_range_m
    n_empty = 0
    for first in range(0, log.n_scans, SCANS_PER_CHUNK):
        ranges_m = copied_rows(log.ranges_m, slice(first, first + SCANS_PER_CHUNK))
        n_near = np.count_nonzero(ranges_m <= usable_range_m, axis=1)
        n_far = np.count_nonzero(ranges_m <= farthest_m, axis=1)
        n_empty += int(np.count_nonzero((n_near < _LEAST_NEAR * log.n_beams) & (n_far > n_near)))
    return farthest_m if n_empty > _MOST_EMPTY * log.n_scans else usable_range_m
