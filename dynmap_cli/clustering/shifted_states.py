"""States that are one and the same, seen from poses that are off by a cell or two.

Maps are laid over one another before it is known which of them show the same state, by what stands in most of them; a
map of a rare state may then lie beside the others of its state. Once the states are known, two that contradict each
other nowhere when one of them is shifted are recognised as one.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from dynmap_cli.arrays import I8, I64
from dynmap_cli.clustering.local_maps import MAX_SHIFT_CELLS, LocalMaps, component_sizes, shifted
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN


def lay_over_same_state(maps: LocalMaps, patch: I64, min_cells: int) -> LocalMaps | None:
    """Shift the maps of each state onto those of a more frequent one that is the same; None where there is none.

    Parameters
    ----------
    maps : LocalMaps
    patch : (n,) int64
        State of each map, the most frequent is 0; -1 = none.
    min_cells : int
        Fewer cells that touch contradict nothing.
    """
    seen = [_majority(maps.states[patch == state]) for state in range(int(patch.max(initial=-1)) + 1)]
    moves: dict[int, tuple[int, int]] = {}
    for rare in range(len(seen) - 1, 0, -1):
        for frequent in range(rare):
            shift = _shift_between(seen[rare], seen[frequent], min_cells)
            if shift is not None:
                moves[rare] = shift
                break
    if not moves:
        return None
    states, reflectance = maps.states.copy(), maps.reflectance.copy()
    for number in np.flatnonzero(np.isin(patch, list(moves))):
        shift = moves[int(patch[number])]
        states[number] = shifted(states[number], shift, UNKNOWN)
        reflectance[number] = shifted(reflectance[number], shift, np.nan)
    return LocalMaps(states, reflectance, maps.is_mixed)


def _majority(states: I8) -> I8:
    """What most of the maps (n, rows, cols) that know a cell show there, (rows, cols); as many of either = unknown."""
    occupied, free = (states == OCCUPIED).sum(axis=0), (states == FREE).sum(axis=0)
    result = np.full(states.shape[1:], UNKNOWN, dtype=np.int8)
    result[occupied > free] = OCCUPIED
    result[free > occupied] = FREE
    return result


def _shift_between(one: I8, other: I8, min_cells: int) -> tuple[int, int] | None:
    """Shift (rows, columns) with which one state is the other one; None = there is none, or none is needed.

    What is occupied in one and free in the other, either way, then meets what is occupied in both: of the shifts in
    which more than half of it does and nothing is left that contradicts, the one in which most does.
    """
    first, second = (one == OCCUPIED) & (other == FREE), (other == OCCUPIED) & (one == FREE)
    if not (component_sizes(first | second) >= min_cells).any():
        return None
    reach = range(-MAX_SHIFT_CELLS, MAX_SHIFT_CELLS + 1)
    least = (np.count_nonzero(first) + np.count_nonzero(second)) // 2 + 1
    candidates = []
    for shift in sorted(product(reach, reach), key=lambda s: math.hypot(*s)):
        met = np.count_nonzero(shifted(first, shift, False) & (other == OCCUPIED))
        met += np.count_nonzero(second & (shifted(one, shift, UNKNOWN) == OCCUPIED))
        if met >= least:
            candidates.append((met, shift))
    for _, shift in sorted(candidates, key=lambda candidate: -candidate[0]):
        moved = shifted(one, shift, UNKNOWN)
        left = ((moved == OCCUPIED) & (other == FREE)) | ((moved == FREE) & (other == OCCUPIED))
        if not (component_sizes(left) >= min_cells).any():
            return shift
    return None
