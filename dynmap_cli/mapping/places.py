"""Which local maps stand for a place: a few of the first visits, however often the robot comes back."""

from __future__ import annotations

from itertools import product

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import wrap_angle

SAME_VISIT = 2
"""Maps whose numbers differ by no more are of one visit."""
_RADIUS_M, _HALF_TURN_RAD = 2.0, np.pi / 2
_ENOUGH = 3


def representatives(poses: F64) -> I64:
    """Numbers of the maps that stand for their places, ascending.

    In order of time a map is taken unless enough of those taken at earlier visits lie around it and look the same
    way. Only these are partners of others, so that a place costs the same at each visit, and later visits hang on
    the first ones instead of on each other, which keeps the factor of the pose graph sparse.

    Parameters
    ----------
    poses : (n_maps, 3) float64
    """
    cells: dict[tuple[int, int], list[int]] = {}
    taken = []
    corners = np.floor(poses[:, :2] / _RADIUS_M).astype(np.int64).tolist()
    for number, (col, row) in enumerate(corners):
        around = [
            other
            for place in product((col - 1, col, col + 1), (row - 1, row, row + 1))
            for other in cells.get(place, ())
            if number - other > SAME_VISIT
        ]
        if len(around) >= _ENOUGH:
            delta = poses[around] - poses[number]
            alike = (np.hypot(delta[:, 0], delta[:, 1]) < _RADIUS_M) & (
                np.abs(wrap_angle(delta[:, 2])) < _HALF_TURN_RAD
            )
            if int(alike.sum()) >= _ENOUGH:
                continue
        cells.setdefault((col, row), []).append(number)
        taken.append(number)
    return np.array(taken, dtype=np.int64)
