"""Objects: groups of varying cells that switch together, and what each visit saw of them.

A second reading of the evidence from which the patches are learned. A sub-map with n things that move on their own
takes up to 2^n states, each of which has to be seen to be known; the things themselves are n, and every visit that sees
one of them says something of it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.clustering.local_maps import Vectors
from dynmap_cli.domain.patches import OFF, ON, UNKNOWN_STATE, ChangingObject

_ON_SHARE, _OFF_SHARE, _LEAST_KNOWN_SHARE = 0.6, 0.4, 0.25
_TOGETHER = 0.6
"""Cells switch together if, of the maps in which one of them is on, so many see both on; and likewise off."""
_ROUNDS = 5


def find_objects(vectors: Vectors, is_mixed: B1, min_cells: int) -> tuple[ChangingObject, ...]:
    """Group the cells that vary, and judge each group in each visit.

    Parameters
    ----------
    vectors : Vectors
        One per visit.
    is_mixed : (n,) bool
        Visits during which something changed: they form no group, and know no state.
    min_cells : int
        Fewer cells are no object.

    Returns
    -------
    tuple of ChangingObject
        Numbered from the lowest row of the sub-map upwards; no cell belongs to two.
    """
    group = group_cells(vectors, is_mixed, min_cells)
    found = []
    for number in range(int(group.max(initial=-1)) + 1):
        cells = np.zeros(vectors.cells.shape, dtype=bool)
        cells[vectors.cells] = group == number
        states = states_of(vectors.values[:, group == number], min_cells)
        states[is_mixed] = UNKNOWN_STATE
        found.append(ChangingObject(number, cells, dict(enumerate(states.tolist()))))
    return tuple(found)


def states_of(values: F64, min_cells: int) -> npt.NDArray[np.object_]:
    """State of an object in each visit (n,), from the values (n, n_cells) of its cells.

    On if at least 60 % of the known cells are occupied, off if at most 40 % are; unknown between, and where neither a
    quarter of the cells is known nor *min_cells* of them, which make a change.
    """
    known = ~np.isnan(values)
    count = known.sum(axis=1)
    share = np.where(known, values, 0.0).sum(axis=1) / np.maximum(count, 1)
    states = np.full(values.shape[0], UNKNOWN_STATE, dtype=object)
    is_known = count >= min(_LEAST_KNOWN_SHARE * values.shape[1], min_cells)
    states[is_known & (share >= _ON_SHARE)] = ON
    states[is_known & (share <= _OFF_SHARE)] = OFF
    return states


def group_cells(vectors: Vectors, is_mixed: B1, min_cells: int) -> I64:
    """Number of the object that each varying cell (n_cells,) belongs to, from 0; -1 = none.

    Within each group of touching cells, the cell that most maps know leads; those that switch as it does follow it, and
    the pattern of the majority is followed until nothing changes.
    """
    pure = vectors.values[~is_mixed]
    group = np.full(vectors.component.size, -1, dtype=np.int64)
    count = 0
    for component in range(vectors.n_components):
        free = vectors.component == component
        while int(free.sum()) >= min_cells:
            members = _followers(pure, free)
            if int(members.sum()) >= min_cells:
                group[members] = count
                count += 1
            free &= ~members
    return group


def _followers(values: F64, free: B1) -> B1:
    """Cells (n_cells,) that switch as one, among those that are free; one at least."""
    known = (~np.isnan(values)).sum(axis=0)
    leader = int(np.where(free, known, -1).argmax())
    pattern = values[:, leader]
    members = np.zeros_like(free)
    for _ in range(_ROUNDS):
        found = free & _switch_together(values, pattern)
        found[leader] = True
        if (found == members).all():
            break
        members = found
        pattern = _majority(values[:, members])
    return members


def _majority(values: F64) -> F64:
    """What most of the known cells (n, n_cells) show in each map, (n,): 1 or 0; NaN = unknown, or as many of either."""
    on, off = (values == 1.0).sum(axis=1), (values == 0.0).sum(axis=1)
    return np.where(on > off, 1.0, np.where(off > on, 0.0, np.nan))


def _switch_together(values: F64, pattern: F64) -> B1:
    """Whether each cell (n_cells,) is on and off in the maps in which the pattern (n,) is."""
    both = ~np.isnan(values) & ~np.isnan(pattern)[:, None]
    together = both.any(axis=0)
    for state in (1.0, 0.0):
        here, there = both & (values == state), both & (pattern == state)[:, None]
        either, shared = (here | there).sum(axis=0), (here & there).sum(axis=0)
        together &= shared >= _TOGETHER * either
    return np.asarray(together)
