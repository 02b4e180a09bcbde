"""Sub-maps keep their numbers when a map is made again from more recordings."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from dynmap_cli.domain.submaps import SubMap

_LEAST_OVERLAP, _TIE_BREAK = 0.3, 1e-3


def keep_numbers(
    submaps: Sequence[SubMap], known: Sequence[SubMap], taken: Collection[int] = ()
) -> tuple[SubMap, ...]:
    """Give each sub-map the number of the known one that it overlaps, and new numbers to the others.

    Pairs are chosen for the largest sum of overlaps, each the common area over the area of the smaller rectangle; of
    pairs that overlap as much those are chosen that are alike. A number that nothing overlaps any more is not given to
    another sub-map.

    Parameters
    ----------
    submaps : sequence of SubMap
    known : sequence of SubMap
        Of the map before; in the same map frame.
    taken : collection of int
        Numbers that were given by hand to other areas.
    """
    own = {row: submap.submap_id for row, submap in enumerate(submaps)}
    kept = _known_numbers(submaps, known) if known else own
    numbers = {row: number for row, number in kept.items() if number not in taken}
    new = max([-1, *numbers.values(), *taken, *(other.submap_id for other in known)]) + 1
    for row in range(len(submaps)):
        if row not in numbers:
            numbers[row], new = new, new + 1
    renumbered = [replace(submap, submap_id=numbers[row]) for row, submap in enumerate(submaps)]
    return tuple(sorted(renumbered, key=lambda submap: submap.submap_id))


def _known_numbers(submaps: Sequence[SubMap], known: Sequence[SubMap]) -> dict[int, int]:
    """Number of the known sub-map that each overlaps, by its place in the sequence; the others are left out."""
    if not submaps:
        return {}
    overlaps = np.array([[_overlap(one, other) for other in known] for one in submaps])
    likeness = np.array([[one.rectangle.likeness(other.rectangle) for other in known] for one in submaps])
    pairs = zip(*linear_sum_assignment(-(overlaps + _TIE_BREAK * likeness)), strict=True)
    return {int(row): known[int(col)].submap_id for row, col in pairs if overlaps[row, col] >= _LEAST_OVERLAP}


def _overlap(one: SubMap, other: SubMap) -> float:
    """Common area of two rectangles over the area of the smaller."""
    return one.rectangle.common_m2(other.rectangle) / min(one.area_m2, other.area_m2)
