"""Spots that are taken and left: their cells say one thing together (sub-maps whose cells never coincide)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1
from dynmap_cli.clustering.local_maps import LocalMaps
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN

_LEAST_TAKEN_CELLS, _LEAST_EMPTY_SHARE = 3, 0.8
_GROWTH_CELLS = 3
_EIGHT = np.ones((3, 3), dtype=bool)


def join_spots(maps: LocalMaps, recurring: B1 | None) -> LocalMaps:
    """Give all cells of a spot one state: occupied where a map shows three of them so, free where it shows none.

    Parameters
    ----------
    maps : LocalMaps
    recurring : (rows, cols) bool or None
        Cells of spots.
    """
    if recurring is None:
        return maps
    grown = ndimage.maximum_filter(recurring, size=2 * _GROWTH_CELLS + 1, mode="constant")
    labels, count = ndimage.label(grown, structure=_EIGHT)
    states = maps.states.copy()
    for spot in range(1, count + 1):
        cells = recurring & (labels == spot)
        seen = maps.states[:, cells]
        occupied, free = (seen == OCCUPIED).sum(axis=1), (seen == FREE).sum(axis=1)
        is_empty = (occupied == 0) & (free >= _LEAST_EMPTY_SHARE * seen.shape[1])
        together = np.where(occupied >= _LEAST_TAKEN_CELLS, OCCUPIED, np.where(is_empty, FREE, UNKNOWN))
        states[:, cells] = together[:, None].astype(np.int8)
    return replace(maps, states=states)
