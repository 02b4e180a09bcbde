"""Sub-maps keep their numbers when a map is made again from more recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from dynmap_cli.arrays import F64
from dynmap_cli.domain.submaps import SubMap

_LEAST_OVERLAP = 0.3


def keep_numbers(submaps: Sequence[SubMap], known: Sequence[SubMap]) -> tuple[SubMap, ...]:
    """Give each sub-map the number of the known one that it overlaps, and new numbers to the others.

    Pairs are chosen for the largest sum of overlaps, each the common area over the area of the smaller rectangle. A
    number that nothing overlaps any more is not given to another sub-map.

    Parameters
    ----------
    submaps : sequence of SubMap
    known : sequence of SubMap
        Of the map before; in the same map frame.
    """
    if not known:
        return tuple(submaps)
    overlaps = np.array([[_overlap(one, other) for other in known] for one in submaps])
    numbers = dict.fromkeys(range(len(submaps)), -1)
    if submaps:
        for row, col in zip(*linear_sum_assignment(-overlaps), strict=True):
            if overlaps[row, col] >= _LEAST_OVERLAP:
                numbers[int(row)] = known[int(col)].submap_id
    new = max(other.submap_id for other in known) + 1
    for row, number in numbers.items():
        if number < 0:
            numbers[row], new = new, new + 1
    renumbered = [replace(submap, submap_id=numbers[row]) for row, submap in enumerate(submaps)]
    return tuple(sorted(renumbered, key=lambda submap: submap.submap_id))


def _overlap(one: SubMap, other: SubMap) -> float:
    """Common area of two rectangles over the area of the smaller."""
    low = np.maximum(_corner(one), _corner(other))
    high = np.minimum(_corner(one) + one.size_m, _corner(other) + other.size_m)
    common = float(np.prod(np.maximum(high - low, 0.0)))
    return common / min(one.area_m2, other.area_m2)


def _corner(submap: SubMap) -> F64:
    """Lower left corner of the rectangle, metres."""
    return np.array([submap.frame.origin_x_m, submap.frame.origin_y_m])
