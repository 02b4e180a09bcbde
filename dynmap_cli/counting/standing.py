"""Who stood for a while, and what was seen too little to tell: looks and watches where beams alone cannot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, F32, F64, I32, I64
from dynmap_cli.counting.counts import end_cells, only_returns
from dynmap_cli.counting.em import FilteredMap, count_with, expectation_of, expected_log_likelihood
from dynmap_cli.counting.evidence import EvidenceParams, SurfaceCells
from dynmap_cli.counting.looks import Watched, count_watches
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.em import add_to_cells, look_up

Counts: TypeAlias = I64 | I32 | F64
_LEAST_FREE_LOOKS, _LEAST_FREE_LOOKS_OF_WATCH = 3, 1
_LARGEST_THING_M, _LOOKS_THAT_TELL = 1.2, 8
_PRIOR_OF_THINGS, _LEAST_EXPECTATION = np.float32(0.9), np.float32(0.01)
_AROUND = np.ones((3, 3))


@dataclass(frozen=True, slots=True)
class LookParams:
    """What looks and watches decide.

    Each prior lies in (0.5, 1): a beam is dynamic where a share of less than 2 (1 - prior) was seen occupied.

    Attributes
    ----------
    look_s : float
        Scans of this many seconds are one look at a place.
    look_prior : float
        For the share of all looks at the end cell and those beside it.
    watch_s : float
        Looks within this time are one watch; 0 = no watches.
    watch_prior : float
        For the share of the looks of a watch.
    crossing_prior : float
        For the share of the beams that end in the cell among those that end there or cross its surface; what only
        grazing beams contradict stays static. 0 = the share of all beams that pass decides alone.
    """

    look_s: float = 5.0
    look_prior: float = 0.8
    watch_s: float = 300.0
    watch_prior: float = 0.6
    crossing_prior: float = 0.9


def filter_by_looks(
    filtered: FilteredMap,
    log: ScanLog,
    poses: F64,
    params: LookParams,
    *,
    usable_range_m: float,
    twists: F64 | None = None,
) -> FilteredMap:
    """Lower e where the end cell was seen free in several looks and occupied in few.

    The share of looks that saw the place occupied takes the part that the hit share has for beams (Eq. 1.10 at its
    fixed point). Free looks rule out glass and fences, so the prior may be lower than that of beams. Beams without
    return say nothing here: a dark wall returns none.

    Over all looks the share has to be small, for a door or a box that was there half of the time belongs to the
    map. Within one watch it may be large, for things that stand free and are no larger than what moves in
    buildings: what comes or goes while the robot is about moved. A door hangs on a wall, and is not such a thing.

    So that e can be believed, it is 0.9 at most on small things that were seen too little to tell (that many of them
    are static in simulated worlds), and 0.01 at least: poses, edges and glass leave so much doubt.

    Parameters
    ----------
    filtered : FilteredMap
        By the hit share of beams.
    log : ScanLog
    poses : (n_scans, 3) float64
    params : LookParams
    usable_range_m : float
    twists : (n_scans, 3) float64, optional
        As given to the filter.
    """
    frame = filtered.counting_map.frame
    evidence = EvidenceParams(max_range_m=usable_range_m)
    watched = count_watches(only_returns(log), poses, frame, params.look_s, params.watch_s, evidence)
    cells = end_cells(log, poses, frame, usable_range_m, twists=twists)
    e = _judge_beams(filtered.static_probability, cells, watched, params)
    is_unknown = _seen_too_little(e, cells, watched)
    np.minimum(e, _PRIOR_OF_THINGS, out=e, where=is_unknown)
    np.maximum(e, _LEAST_EXPECTATION, out=e)
    counts = filtered.counting_map
    counted = count_with(counts, _mean_by_cell(e, cells, counts.static_hits + counts.dynamic_hits))
    return replace(
        filtered,
        counting_map=counted,
        static_probability=e,
        log_likelihood=expected_log_likelihood(counted),
        is_unknown=is_unknown,
    )


def _judge_beams(by_beams: F32, cells: I32, watched: Watched, params: LookParams) -> F32:
    """(n_scans, n_beams) e from that of the beam counts, all looks, and the watches that the scan is in."""
    looks, surface = watched.looks, watched.looks.surface
    e = by_beams.copy()
    if params.crossing_prior:
        share = _largest_share(watched.hits, watched.crossed, surface)
        np.maximum(
            e, _look_up(cells, _on_grid(expectation_of(share, params.crossing_prior), surface, 0.0)), out=e
        )
    of_looks = _by_share(looks.occupied, looks.free, surface, _LEAST_FREE_LOOKS, params.look_prior)
    np.minimum(e, _look_up(cells, _on_grid(of_looks, surface, 1.0)), out=e)
    before = e.copy()
    for watch in watched.watches:
        part, ends = e[watch.scans], cells[watch.scans]
        of_watch = _by_share(
            watch.occupied, watch.free, surface, _LEAST_FREE_LOOKS_OF_WATCH, params.watch_prior
        )
        labels, extents_m = _things(before[watch.scans], ends, surface.frame)
        of_things = np.where((extents_m <= _LARGEST_THING_M)[labels], _on_grid(of_watch, surface, 1.0), 1.0)
        np.minimum(part, _look_up(ends, of_things.astype(np.float32)), out=part)
    return e


def _by_share(occupied: Counts, free: Counts, surface: SurfaceCells, least_free: int, prior: float) -> F64:
    """(n,) e from the largest share of looks that saw the cell, or one beside it, occupied; 1 where rarely free."""
    around = _largest_share(occupied, free, surface)
    return np.where(free >= least_free, expectation_of(around, prior), 1.0)


def _largest_share(hits: Counts, others: Counts, surface: SurfaceCells) -> F64:
    """(n,) largest hits / (hits + others) of each cell and those beside it; -1 where nothing is known."""
    known = hits + others
    share = np.full(hits.size + 1, -1.0)
    np.divide(hits, known, out=share[:-1], where=known > 0)
    return np.asarray(share[surface.neighbours].max(axis=1, initial=-1.0))


def _seen_too_little(e: F32, cells: I32, watched: Watched) -> B1:
    """Which beams, (n_scans, n_beams), end on what may be a pillar or a person: too little was seen of it.

    These are kept beams on a thing - connected end cells of a watch, no larger than what moves in buildings - that was
    seen in one watch only, in fewer looks than people stand still for. A wall is static by its size, even if
    it was seen once.

    Parameters
    ----------
    e : (n_scans, n_beams) float32
    cells : (n_scans, n_beams) int32
    watched : Watched
    """
    total, surface = watched.looks.occupied, watched.looks.surface
    is_unknown = np.asarray(e >= 0.5) & bool(watched.watches)
    for watch in watched.watches:
        part, ends = is_unknown[watch.scans], cells[watch.scans]
        labels, extents_m = _things(e[watch.scans], ends, surface.frame)
        thing_of = labels[tuple(surface.cells.T)]
        most, elsewhere = (np.zeros(extents_m.size, dtype=np.int64) for _ in range(2))
        np.maximum.at(most, thing_of, watch.occupied)
        np.maximum.at(elsewhere, thing_of, total - watch.occupied)
        is_open = (extents_m <= _LARGEST_THING_M) & (most < _LOOKS_THAT_TELL) & (elsewhere == 0)
        part &= _look_up(ends, is_open[labels].astype(np.float32)) > 0
    return is_unknown


def _things(e: F32, cells: I32, frame: GridFrame) -> tuple[I32, F64]:
    """Number the things that beams called static end on: connected cells; everything else is 0.

    Parameters
    ----------
    e, cells : (n_scans, n_beams)
    frame : GridFrame

    Returns
    -------
    (rows, cols) int32
    (n + 1,) float64
        Extent of each thing, m; that of 0 is infinite.
    """
    hits = np.zeros(frame.shape)
    add_to_cells(cells, (e >= 0.5).astype(np.float32), hits.ravel())
    labels, _ = ndimage.label(ndimage.binary_dilation(hits > 0, _AROUND), _AROUND)
    labels[hits == 0] = 0
    boxes = ndimage.find_objects(labels)
    widths = [max(rows.stop - rows.start, cols.stop - cols.start) for rows, cols in boxes]
    return labels, np.array([np.inf, *widths]) * frame.resolution_m


def _on_grid(by_cell: F64, surface: SurfaceCells, elsewhere: float) -> F32:
    """(rows, cols) values of the surface cells."""
    grid = np.full(surface.frame.shape, elsewhere, dtype=np.float32)
    grid[tuple(surface.cells.T)] = by_cell
    return grid


def _look_up(cells: I32, grid: F32) -> F32:
    """(n_scans, n_beams) value of each beam's end cell, NaN where it has none."""
    beams = np.empty(cells.shape, dtype=np.float32)
    look_up(cells, grid.ravel(), beams)
    return beams


def _mean_by_cell(e: F32, cells: I32, hits: F64) -> F64:
    """(rows, cols) mean e of the beams that end in each cell."""
    total = np.zeros(hits.shape)
    add_to_cells(cells, e, total.ravel())
    return np.divide(total, hits, out=np.ones_like(hits), where=hits > 0)
