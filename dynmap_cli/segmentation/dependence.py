"""Which regions change together, by the windows that see both."""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import B1, I64
from dynmap_cli.domain.dependence import depend
from dynmap_cli.segmentation.contradictions import Contradictions


def dependent_regions(found: Contradictions, regions: list[I64], min_cells: int) -> B1:
    """(n, n) whether two regions, (m, 2) cells each, change together, see `depend`.

    A window sees a region occupied or free where it shows *min_cells* of it so, and more than of the other kind. Places
    that one box takes in turn depend on one another as well as the sides of a box; two doors do not.

    Parameters
    ----------
    found : Contradictions
    regions : list of (m, 2) int64
    min_cells : int
    """
    group_of = np.full(found.surface.cells.shape[0], -1, dtype=np.int64)
    for number, cells in enumerate(regions):
        group_of[found.surface.index[cells[:, 0], cells[:, 1]]] = number
    occupied, free = found.record.cells_shown(group_of, len(regions))
    on = ((occupied >= min_cells) & (occupied > free)).astype(np.int64)
    off = ((free >= min_cells) & (free > occupied)).astype(np.int64)
    return depend(on, off)
