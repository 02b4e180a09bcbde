"""Who stood for a while, and what was seen too little to tell: looks and watches where beams alone cannot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, F32, F64, I32, I64, U8
from dynmap_cli.counting.counts import end_cells_in_chunks
from dynmap_cli.counting.em import FilteredMap, count_with, expectation_of, expected_log_likelihood
from dynmap_cli.counting.evidence import EvidenceParams, SurfaceCells
from dynmap_cli.counting.looks import Watch, Watched, count_watches
from dynmap_cli.domain.grid import CountingMap, GridFrame
from dynmap_cli.domain.mapped import copied_rows, give_back, sparse_zeros
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.em import add_to_cells
from dynmap_cli.kernels.standing import count_kept, judge_beams, number_cells

Counts: TypeAlias = I64 | I32 | F64
_LEAST_FREE_LOOKS, _LEAST_FREE_LOOKS_OF_WATCH = 3, 1
_LARGEST_THING_M, _LEAST_BODY_M, _LOOKS_THAT_TELL = 1.2, 0.4, 8
_STILL_PRIOR = 0.55
_PRIOR_OF_THINGS, _LEAST_EXPECTATION = float(np.float32(0.9)), float(np.float32(0.01))
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
    threads: int = 1,
    out: tuple[F32, B1] | None = None,
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
    threads : int
    out : (n_scans, n_beams) float32 and bool, optional
        Where e and what is unknown are to be written; e may take the place of the one that is given.
    """
    frame = filtered.counting_map.frame
    evidence = EvidenceParams(max_range_m=usable_range_m, silent_pass=False)
    watched = count_watches(log, poses, frame, params.look_s, params.watch_s, evidence, threads=threads)
    ends = _EndCells.of(filtered.counting_map, watched.looks.surface)
    by_beams = filtered.static_probability
    judged, is_unknown = out or (np.empty_like(by_beams), np.zeros(by_beams.shape, dtype=bool))
    sums, bounds = np.zeros(ends.cells.size), _bounds_of_places(ends, watched, params)

    def cells_of(scans: slice) -> Iterator[tuple[slice, I32]]:
        for rows, cells in end_cells_in_chunks(log, poses, frame, usable_range_m, twists=twists, scans=scans):
            number_cells(cells, ends.numbers, cells)
            yield rows, cells

    for rows, cells, verdict in _judged_beams(by_beams, cells_of, bounds, ends, watched, params):
        e, open_still = np.empty(cells.shape, dtype=np.float32), np.empty(cells.shape, dtype=bool)
        judge_beams(
            cells,
            copied_rows(by_beams, rows),
            *bounds,
            verdict.of_places,
            verdict.of_things,
            verdict.can_be_open,
            _PRIOR_OF_THINGS,
            _LEAST_EXPECTATION,
            e,
            open_still,
        )
        add_to_cells(cells, e, sums)
        judged[rows], is_unknown[rows] = e, open_still
        give_back(judged)
        give_back(is_unknown)
    hits = filtered.counting_map.static_at_hits + filtered.counting_map.dynamic_at_hits
    mean = np.divide(sums, hits, out=np.ones_like(hits), where=hits > 0)
    counted = count_with(filtered.counting_map, mean)
    return replace(
        filtered,
        counting_map=counted,
        static_probability=judged,
        log_likelihood=expected_log_likelihood(counted),
        is_unknown=is_unknown,
    )


@dataclass(frozen=True, slots=True)
class _EndCells:
    """The cells in which beams end, numbered; nothing else has to be known of a map to judge beams.

    Attributes
    ----------
    frame : GridFrame
    cells : (n,) int64
        Flat index row * cols + col of each, ascending.
    numbers : (n_cells,) int32
        1 + number of each cell of the frame; 0 = no beam ends there.
    of_surface : (m,) int32
        Number of each surface cell; -1 = no beam ends there.
    """

    frame: GridFrame
    cells: I64
    numbers: I32
    of_surface: I32

    @classmethod
    def of(cls, counted: CountingMap, surface: SurfaceCells) -> _EndCells:
        """Number those of a map."""
        frame, cells = counted.frame, counted.hit_cells
        numbers = sparse_zeros(frame.rows * frame.cols, np.int32)
        numbers[cells] = np.arange(1, cells.size + 1, dtype=np.int32)
        flat = surface.cells[:, 0] * frame.cols + surface.cells[:, 1]
        return cls(frame, cells, numbers, numbers[flat] - 1)

    def values(self, by_surface: F64, elsewhere: float) -> F32:
        """(n,) values of the surface cells."""
        values = np.full(self.cells.size, elsewhere, dtype=np.float32)
        is_end = self.of_surface >= 0
        values[self.of_surface[is_end]] = by_surface[is_end]
        return values


@dataclass(frozen=True, slots=True)
class _Verdict:
    """What watches say of the beams that end in each cell; all (n,), by the numbers of the end cells.

    Attributes
    ----------
    of_places, of_things : float32
        The least e that a watch gave to the place, and to the thing.
    can_be_open : uint8
        1 on things of which no watch saw enough.
    """

    of_places: F32
    of_things: F32
    can_be_open: U8

    def with_other(self, other: _Verdict) -> _Verdict:
        """Both together."""
        return _Verdict(
            np.minimum(self.of_places, other.of_places),
            np.minimum(self.of_things, other.of_things),
            self.can_be_open & other.can_be_open,
        )


def _judged_beams(
    by_beams: F32,
    cells_of: Callable[[slice], Iterator[tuple[slice, I32]]],
    bounds: tuple[F32, F32],
    ends: _EndCells,
    watched: Watched,
    params: LookParams,
) -> Iterator[tuple[slice, I32, _Verdict]]:
    """Rows of some scans after the other, their end cells, and what all watches say that have them.

    Watches come in the order of their scans, and each overlaps the one before at most. Their end cells are held.

    Parameters
    ----------
    by_beams : (n_scans, n_beams) float32
        e of the beam counts; rows that were given out may change.
    cells_of : callable
        Gives rows and numbers of the end cells of some scans, in parts.
    bounds : (n,) float32, twice
        Least and largest e in each cell.
    ends : _EndCells
    watched : Watched
    params : LookParams
    """
    shape = ends.cells.shape
    if not watched.watches:
        nothing = _Verdict(
            np.ones(shape, np.float32), np.ones(shape, np.float32), np.zeros(shape, dtype=np.uint8)
        )
        yield from ((rows, cells, nothing) for rows, cells in cells_of(slice(0, by_beams.shape[0])))
        return
    # Parts end where watches begin and end, so that each has the same watches as a whole.
    edges = sorted({edge for one in watched.watches for edge in (one.scans.start, one.scans.stop)})
    held: list[tuple[slice, I32]] = []
    last, before = 0, None
    for number, watch in enumerate(watched.watches):
        for first, end in pairwise(edges):
            if last <= first < watch.scans.stop:
                held += cells_of(slice(first, end))
        last = watch.scans.stop
        hits = np.zeros(shape)
        for rows, cells in held:
            count_kept(cells, copied_rows(by_beams, rows), *bounds, hits)
        verdict = _verdict_of(hits, ends, watch, watched, params)
        both = verdict.with_other(before[1]) if before else verdict
        is_last = number + 1 == len(watched.watches)
        done = last if is_last else watched.watches[number + 1].scans.start
        while held and held[0][0].start < done:
            rows, cells = held.pop(0)
            yield rows, cells, both if before and rows.stop <= before[0] else verdict
        before = last, verdict


def _bounds_of_places(ends: _EndCells, watched: Watched, params: LookParams) -> tuple[F32, F32]:
    """(n,) least e of beams whose end surface is rarely crossed, if that counts, and largest e by all looks."""
    looks, surface = watched.looks, watched.looks.surface
    least = np.zeros(ends.cells.size, dtype=np.float32)
    if params.crossing_prior:
        share = _largest_share(watched.hits, watched.crossed, surface)
        least = ends.values(expectation_of(share, params.crossing_prior), 0.0)
    of_looks = _by_share(looks.occupied, looks.free, surface, _LEAST_FREE_LOOKS, params.look_prior)
    return least, ends.values(of_looks, 1.0)


def _verdict_of(hits: F64, ends: _EndCells, watch: Watch, watched: Watched, params: LookParams) -> _Verdict:
    """Which things came, went or shifted in a watch, and of which things too little was seen.

    A thing is what the kept beams of a watch end on, connected, and no larger than what moves in buildings. If it was
    seen in one watch only, and in fewer looks than people stand still for, it may be a pillar or a person:
    its beams are unknown. But people who stand shift their weight, so that some looks see parts of them free; the share
    of the looks that do, mean over the hits, decides like the share of looks. Posts and legs of tables are too
    thin for that: their cells are half free anyhow. A wall is static by its size, even if it was seen once.

    Parameters
    ----------
    hits : (n,) float64
        How many kept beams of the watch end in each cell.
    ends : _EndCells
    watch : Watch
    watched : Watched
    params : LookParams
    """
    total, surface = watched.looks.occupied, watched.looks.surface
    labels, extents_m = _things(hits, ends)
    is_thing = extents_m <= _LARGEST_THING_M
    thing_of = np.where(ends.of_surface >= 0, np.append(labels, 0)[ends.of_surface], 0)
    by_share = _by_share(watch.occupied, watch.free, surface, _LEAST_FREE_LOOKS_OF_WATCH, params.watch_prior)
    by_share = np.where(is_thing[thing_of], by_share, 1.0)
    most, elsewhere = (np.zeros(extents_m.size, dtype=np.int64) for _ in range(2))
    np.maximum.at(most, thing_of, watch.occupied)
    np.maximum.at(elsewhere, thing_of, total - watch.occupied)
    can_be = is_thing & (most < _LOOKS_THAT_TELL) & (elsewhere == 0)
    free_share = watch.free / np.maximum(watch.free + watch.occupied, 1)
    still = 1.0 - _mean_over_hits(ends.values(free_share, 0.0), hits, labels, extents_m.size)
    by_thing = np.where(extents_m >= _LEAST_BODY_M, expectation_of(still, _STILL_PRIOR), 1.0)
    return _Verdict(
        ends.values(by_share, 1.0), by_thing[labels].astype(np.float32), can_be[labels].astype(np.uint8)
    )


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


def _things(hits: F64, ends: _EndCells) -> tuple[I32, F64]:
    """Number the things that beams end on: connected cells with hits; everything else is 0.

    Returns
    -------
    (n,) int32
    (n_things + 1,) float64
        Extent of each thing, m; that of 0 is infinite.
    """
    labels = np.zeros(hits.size, dtype=np.int32)
    is_hit = hits > 0
    row, col = np.divmod(ends.cells[is_hit], ends.frame.cols)
    if row.size == 0:
        return labels, np.array([np.inf])
    # Only the rectangle that holds them, and what can be grown into.
    row, col = row - (row.min() - 1), col - (col.min() - 1)
    grown = np.zeros((row.max() + 2, col.max() + 2), dtype=bool)
    grown[row, col] = True
    grid, _ = ndimage.label(ndimage.binary_dilation(grown, _AROUND), _AROUND)
    labels[is_hit] = found = grid[row, col]
    grid[:] = 0
    grid[row, col] = found
    boxes = ndimage.find_objects(grid)
    widths = [max(rows.stop - rows.start, cols.stop - cols.start) for rows, cols in boxes]
    return labels, np.array([np.inf, *widths]) * ends.frame.resolution_m


def _mean_over_hits(values: F32, hits: F64, labels: I32, n_things: int) -> F64:
    """(n_things,) mean of some values over the hits of each thing."""
    n_hits = np.bincount(labels, weights=hits, minlength=n_things)
    sums = np.bincount(labels, weights=hits * values, minlength=n_things)
    return np.asarray(sums / np.maximum(n_hits, 1.0))
