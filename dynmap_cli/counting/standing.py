"""Who stood for a while, and what was seen too little to tell: looks and watches where beams alone cannot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, F32, F64, I32, I64
from dynmap_cli.counting.counts import end_cells_in_chunks
from dynmap_cli.counting.em import FilteredMap, count_with, expectation_of, expected_log_likelihood
from dynmap_cli.counting.evidence import EvidenceParams, SurfaceCells
from dynmap_cli.counting.looks import Watch, Watched, count_watches
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.em import add_to_cells, look_up

Counts: TypeAlias = I64 | I32 | F64
_LEAST_FREE_LOOKS, _LEAST_FREE_LOOKS_OF_WATCH = 3, 1
_LARGEST_THING_M, _LEAST_BODY_M, _LOOKS_THAT_TELL = 1.2, 0.4, 8
_STILL_PRIOR = 0.55
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
    in_place: bool = False,
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
    in_place : bool
        Whether the e that are given may be overwritten by those that are returned.
    """
    frame = filtered.counting_map.frame
    evidence = EvidenceParams(max_range_m=usable_range_m, silent_pass=False)
    watched = count_watches(log, poses, frame, params.look_s, params.watch_s, evidence)
    chunks = end_cells_in_chunks(log, poses, frame, usable_range_m, twists=twists)
    judged = filtered.static_probability if in_place else np.empty_like(filtered.static_probability)
    is_unknown, sums = np.zeros(judged.shape, dtype=bool), np.zeros(frame.shape)
    for rows, beams in _judged_beams(filtered.static_probability, chunks, watched, params):
        judged[rows], is_unknown[rows] = beams.e, beams.is_open
        add_to_cells(beams.cells, beams.e, sums.ravel())
    hits = filtered.counting_map.static_hits + filtered.counting_map.dynamic_hits
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
class _Beams:
    """The beams of some scans while they are judged; all (n_scans, n_beams).

    Attributes
    ----------
    cells : int32
        End cells, -1 = none.
    e : float32
        By the beam counts and all looks, finally by everything.
    of_places, of_things : float32
        The least e that a watch gave to the place, and to the thing.
    is_open : bool
        Kept, and on things of which no watch saw enough; finally, unknown.
    """

    cells: I32
    e: F32
    of_places: F32
    of_things: F32
    is_open: B1

    def rows(self, rows: slice) -> _Beams:
        """Views of some scans."""
        return _Beams(
            self.cells[rows], self.e[rows], self.of_places[rows], self.of_things[rows], self.is_open[rows]
        )

    def then(self, others: Sequence[_Beams]) -> _Beams:
        """These scans and those that follow."""
        parts = [self, *others]
        return _Beams(
            np.concatenate([part.cells for part in parts]),
            np.concatenate([part.e for part in parts]),
            np.concatenate([part.of_places for part in parts]),
            np.concatenate([part.of_things for part in parts]),
            np.concatenate([part.is_open for part in parts]),
        )

    def judged(self) -> _Beams:
        """With the final e, and open only where unknown."""
        e = np.minimum(self.e, self.of_places)
        np.minimum(e, np.minimum(self.of_things, _PRIOR_OF_THINGS), out=e, where=self.is_open)
        is_unknown = self.is_open & (e >= 0.5)
        np.maximum(e, _LEAST_EXPECTATION, out=e)
        return replace(self, e=e, is_open=is_unknown)


def _judged_beams(
    by_beams: F32, chunks: Iterator[tuple[slice, I32]], watched: Watched, params: LookParams
) -> Iterator[tuple[slice, _Beams]]:
    """Rows of some scans after the other, and their beams as looks and watches judge them.

    A scan is held until the last watch that has it was seen; watches come in the order of their scans.

    Parameters
    ----------
    by_beams : (n_scans, n_beams) float32
        e of the beam counts; rows that were given out may change.
    chunks : iterator of slice and (m, n_beams) int32
        Rows and end cells of all scans.
    watched : Watched
    params : LookParams
    """
    grids = _grids_of_places(watched, params)
    fresh = (
        (rows, _judge_places(by_beams[rows], cells, grids, is_watched=bool(watched.watches)))
        for rows, cells in chunks
    )
    if not watched.watches:
        yield from ((rows, beams.judged()) for rows, beams in fresh)
        return
    first, last, held = (
        0,
        0,
        _judge_places(by_beams[:0], np.empty((0, by_beams.shape[1]), np.int32), grids, is_watched=True),
    )
    followers = [watch.scans.start for watch in watched.watches[1:]]
    for watch, done in zip(watched.watches, [*followers, by_beams.shape[0]], strict=True):
        more = []
        while last < watch.scans.stop:
            rows, beams = next(fresh)
            more.append(beams)
            last = rows.stop
        held = held.then(more) if more else held
        _judge_things(
            held.rows(slice(watch.scans.start - first, watch.scans.stop - first)), watch, watched, params
        )
        yield slice(first, done), held.rows(slice(done - first)).judged()
        first, held = done, held.rows(slice(done - first, None))


def _grids_of_places(watched: Watched, params: LookParams) -> tuple[F32 | None, F32]:
    """(rows, cols) least e of beams whose end surface is rarely crossed, if that counts, and largest e by all looks."""
    looks, surface = watched.looks, watched.looks.surface
    least = None
    if params.crossing_prior:
        share = _largest_share(watched.hits, watched.crossed, surface)
        least = _on_grid(expectation_of(share, params.crossing_prior), surface, 0.0)
    of_looks = _by_share(looks.occupied, looks.free, surface, _LEAST_FREE_LOOKS, params.look_prior)
    return least, _on_grid(of_looks, surface, 1.0)


def _judge_places(by_beams: F32, cells: I32, grids: tuple[F32 | None, F32], *, is_watched: bool) -> _Beams:
    """Beams of some scans, with e from that of the beam counts, and from all looks at the place."""
    least, most = grids
    e = by_beams.copy()
    if least is not None:
        np.maximum(e, _look_up(cells, least), out=e)
    _lower(e, cells, most)
    return _Beams(cells, e, np.ones_like(e), np.ones_like(e), np.asarray(e >= 0.5) & is_watched)


def _judge_things(beams: _Beams, watch: Watch, watched: Watched, params: LookParams) -> None:
    """Lower e of the beams on things that came, went or shifted in a watch; say on which things too little was seen.

    A thing is what the kept beams of a watch end on, connected, and no larger than what moves in buildings. If it was
    seen in one watch only, and in fewer looks than people stand still for, it may be a pillar or a person:
    its beams are unknown. But people who stand shift their weight, so that some looks see parts of them free; the share
    of the looks that do, mean over the hits, decides like the share of looks. Posts and legs of tables are too
    thin for that: their cells are half free anyhow. A wall is static by its size, even if it was seen once.

    Parameters
    ----------
    beams : _Beams
        Of the scans of the watch; changed in place.
    watch : Watch
    watched : Watched
    params : LookParams
    """
    total, surface = watched.looks.occupied, watched.looks.surface
    hits = np.zeros(surface.frame.shape)
    add_to_cells(beams.cells, (beams.e >= 0.5).astype(np.float32), hits.ravel())
    labels, extents_m = _things(hits, surface.frame)
    is_thing, thing_of = extents_m <= _LARGEST_THING_M, labels[tuple(surface.cells.T)]
    by_share = _by_share(watch.occupied, watch.free, surface, _LEAST_FREE_LOOKS_OF_WATCH, params.watch_prior)
    by_share = np.where(is_thing[thing_of], by_share, 1.0)
    _lower(beams.of_places, beams.cells, _on_grid(by_share, surface, 1.0))
    most, elsewhere = (np.zeros(extents_m.size, dtype=np.int64) for _ in range(2))
    np.maximum.at(most, thing_of, watch.occupied)
    np.maximum.at(elsewhere, thing_of, total - watch.occupied)
    can_be = is_thing & (most < _LOOKS_THAT_TELL) & (elsewhere == 0)
    np.logical_and(
        beams.is_open, _look_up(beams.cells, can_be[labels].astype(np.float32)) > 0, out=beams.is_open
    )
    free_share = watch.free / np.maximum(watch.free + watch.occupied, 1)
    still = 1.0 - _mean_over_hits(_on_grid(free_share, surface, 0.0), hits, labels, extents_m.size)
    by_thing = np.where(extents_m >= _LEAST_BODY_M, expectation_of(still, _STILL_PRIOR), 1.0)
    _lower(beams.of_things, beams.cells, by_thing[labels].astype(np.float32))


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


def _things(hits: F64, frame: GridFrame) -> tuple[I32, F64]:
    """Number the things that beams end on: connected cells with hits; everything else is 0.

    Returns
    -------
    (rows, cols) int32
    (n + 1,) float64
        Extent of each thing, m; that of 0 is infinite.
    """
    labels, _ = ndimage.label(ndimage.binary_dilation(hits > 0, _AROUND), _AROUND)
    labels[hits == 0] = 0
    boxes = ndimage.find_objects(labels)
    widths = [max(rows.stop - rows.start, cols.stop - cols.start) for rows, cols in boxes]
    return labels, np.array([np.inf, *widths]) * frame.resolution_m


def _mean_over_hits(grid: F32, hits: F64, labels: I32, n_things: int) -> F64:
    """(n_things,) mean of the values of a grid over the hits of each thing."""
    n_hits = np.bincount(labels.ravel(), weights=hits.ravel(), minlength=n_things)
    sums = np.bincount(labels.ravel(), weights=(hits * grid).ravel(), minlength=n_things)
    return np.asarray(sums / np.maximum(n_hits, 1.0))


def _lower(e: F32, cells: I32, grid: F32) -> None:
    """Bring e down to the value of each beam's end cell, in place."""
    np.minimum(e, _look_up(cells, grid), out=e)


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
