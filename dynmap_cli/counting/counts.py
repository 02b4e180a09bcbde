"""The counting map of scans at given poses (Eq. 1.12-1.15)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64, U8
from dynmap_cli.domain.grid import CountingMap, GridFrame, mark_around
from dynmap_cli.domain.mapped import copied_rows, sparse_zeros
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.domain.sweep_motion import series_of, sweep_durations_s, sweep_times_s, sweep_twists
from dynmap_cli.kernels.beams import PlacedScans, Rays, cut_at_walls, find_end_cells
from dynmap_cli.kernels.counts import (
    DYNAMIC,
    FIXED_ONE,
    HIT_SUMS,
    OFFSET_X,
    OFFSET_Y,
    STATIC,
    add_hits,
    add_sums,
    count_scans,
    sum_along_x,
    sum_along_y,
)

SCANS_PER_CHUNK = 1024
_LEAST_PER_THREAD = 100
N_BANDS = 8
_BYTES_PER_CELL, _MOST_BYTES_AT_ONCE = 24, 1 << 29
_WALL_REFLECTANCE = 0.5


def rays_of(log: ScanLog, usable_range_m: float) -> Rays:
    """Directions and usable ranges of a recording's lasers."""
    # Where a geometry has fewer beams, ranges are NaN and no beam is there; its direction is any.
    angles = np.nan_to_num(log.bearings_rad) + log.sensor_poses[:, 2:3]
    return Rays(
        directions=np.stack([np.cos(angles), np.sin(angles)], axis=-1),
        sensor_poses=log.sensor_poses.copy(),
        usable_m=np.minimum(log.range_limits_m[:, 1], usable_range_m),
        beam_interval_s=log.beam_interval_s.copy(),
    )


def twists_of(log: ScanLog, poses: F64) -> F64 | None:
    """Velocity (n_scans, 3) during each scan, robot frame, see `sweep_twists`; None where no sweep takes time."""
    if log.n_scans < 2 or not (log.beam_interval_s != 0.0).any():
        return None
    durations_s = sweep_durations_s(log.beam_interval_s, log.bearings_rad)[log.geometry_index]
    series = series_of(log.sensor_poses, log.geometry_index, log.drive_index)
    return sweep_twists(sweep_times_s(log), poses, durations_s, series)


class Counter:
    """Sums over beams on one grid; scans can be added and taken out again, exactly and in any order."""

    def __init__(self, frame: GridFrame) -> None:
        self.frame = frame
        rows, cols = frame.shape
        self._shapes = (rows + 1, cols + 2), (cols + 1, rows + 2)
        n_lengths = sum(height * width for height, width in self._shapes)
        # Rays cross everything that was seen, but begin, end and hit something in few places.
        self._crossings = np.zeros(n_lengths, dtype=np.int64)
        self._ends = sparse_zeros(n_lengths, np.int64)
        self._numbers = sparse_zeros(rows * cols, np.int32)
        self._hits, self._n_hit = np.zeros((rows * cols + 1, HIT_SUMS), dtype=np.int64), 0

    def add(
        self,
        log: ScanLog,
        poses: F64,
        usable_range_m: float,
        *,
        weights: F32 | None = None,
        twists: F64 | None = None,
        only_returns: bool = False,
        walls: U8 | None = None,
        sign: int = 1,
    ) -> None:
        """Add scans (sign 1) or take them out (sign -1).

        Parameters
        ----------
        log : ScanLog
        poses : (n_scans, 3) float64
            map_from_robot; scans with NaN are left out.
        usable_range_m : float
        weights : (n_scans, n_beams) float32, optional
            e of each beam; without it all beams are static.
        twists : (n_scans, 3) float64, optional
            Velocity during each scan, see `twists_of`; without it the robot stood still.
        only_returns : bool
            Leave out beams without return.
        walls : (rows, cols) uint8, optional
            1 where a beam without return cannot have passed; without it they pass up to the usable range.
        sign : int
        """
        rays, frame = rays_of(log, usable_range_m), self.frame
        for part, scans in _chunks(log, rays, poses, frame, twists):
            ranges = scans.ranges_m
            is_silent = ranges == np.inf
            if only_returns:
                ranges[is_silent] = np.nan
            elif walls is not None and is_silent.any():
                reach = np.empty_like(ranges)
                cut_at_walls(scans, walls, reach)
                np.copyto(ranges, reach, where=is_silent)
            self._n_hit = count_scans(
                scans,
                np.ones_like(ranges) if weights is None else np.array(weights[part], dtype=np.float32),
                *frame.shape,
                sign,
                self._ends,
                self._crossings,
                self._numbers,
                self._hits,
                self._n_hit,
            )

    def merge(self, other: Counter, threads: int = 1) -> None:
        """Add the sums of another counter on the same grid."""
        for mine, theirs in ((self._ends, other._ends), (self._crossings, other._crossings)):
            _in_bands(threads, mine.size, partial(add_sums, theirs), mine)
        cells, hits = other._hits_of_cells()
        self._n_hit = add_hits(hits, cells, self._numbers, self._hits, self._n_hit)

    def counting_map(self, threads: int = 1) -> CountingMap:
        """Turn the sums into hits, passed lengths and centroids."""
        frame = self.frame
        rows, cols = frame.shape
        lengths = np.zeros((rows, cols), dtype=np.int64)
        _in_bands(threads, rows, partial(sum_along_x, *self._grids(0)), lengths)
        _in_bands(threads, cols, partial(sum_along_y, *self._grids(1)), lengths)
        cells, hits = self._hits_of_cells()
        static = hits[:, STATIC]
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = hits[:, OFFSET_X] / static, hits[:, OFFSET_Y] / static
        row, col = np.divmod(cells, cols)
        return CountingMap(
            frame,
            _scaled(lengths),
            cells,
            static / FIXED_ONE,
            hits[:, DYNAMIC] / FIXED_ONE,
            np.stack(
                [
                    frame.origin_x_m + (col + x) * frame.resolution_m,
                    frame.origin_y_m + (row + y) * frame.resolution_m,
                ],
                axis=-1,
            ),
        )

    def _hits_of_cells(self) -> tuple[I64, I64]:
        """(n,) cells in which beams ended, in ascending order, and their sums (n, HIT_SUMS)."""
        cells = np.flatnonzero(self._numbers)
        hits = self._hits[self._numbers[cells]]
        is_hit = (hits[:, STATIC] != 0) | (hits[:, DYNAMIC] != 0)
        return cells[is_hit], hits[is_hit]

    def _grids(self, axis: int) -> tuple[I64, I64]:
        """Ends and crossings of the rays whose major axis is x (0) or y (1)."""
        size = self._shapes[0][0] * self._shapes[0][1]
        part = slice(size, None) if axis else slice(size)
        shape = self._shapes[axis]
        return self._ends[part].reshape(shape), self._crossings[part].reshape(shape)


def _scaled(lengths: I64) -> F64:
    """(rows, cols) cells for fixed-point lengths, whose memory they take; rounding can leave a length below 0."""
    scaled = lengths.view(np.float64)
    for row in range(lengths.shape[0]):
        scaled[row] = np.maximum(lengths[row], 0) / FIXED_ONE
    return scaled


def _chunks(
    log: ScanLog, rays: Rays, poses: F64, frame: GridFrame, twists: F64 | None, within: slice | None = None
) -> Iterator[tuple[slice, PlacedScans]]:
    """Some scans at a time, as rows of the log and as what the kernels want to know of them."""
    begin, end = (within.start, within.stop) if within else (0, log.n_scans)
    for first in range(begin, end, SCANS_PER_CHUNK):
        part = slice(first, min(first + SCANS_PER_CHUNK, end))
        yield (
            part,
            PlacedScans(
                copied_rows(log.ranges_m, part),
                np.array(log.geometry_index[part]),
                rays,
                np.zeros((part.stop - first, 3)) if twists is None else np.array(twists[part]),
                np.array(poses[part], dtype=np.float64),
                frame.resolution_m,
                frame.origin_x_m,
                frame.origin_y_m,
            ),
        )


def _in_bands(threads: int, size: int, work: Callable[..., None], *out: I64 | F64) -> None:
    """Let threads work on an equal part (first, last) of a size each; they write to different parts of `out`."""
    bounds = np.linspace(0, size, N_BANDS + 1).astype(int).tolist()
    with ThreadPoolExecutor(max_workers=threads) as pool:
        list(pool.map(lambda first, last: work(first, last, *out), bounds[:-1], bounds[1:]))


def count_beams(
    log: ScanLog,
    poses: F64,
    frame: GridFrame,
    usable_range_m: float,
    *,
    weights: F32 | None = None,
    twists: F64 | None = None,
    only_returns: bool = False,
    walls: U8 | None = None,
    threads: int = 1,
) -> CountingMap:
    """Counting map of all scans; the same bytes for any number of threads.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot; scans with NaN are left out.
    frame : GridFrame
        Beams are clipped to it.
    usable_range_m : float
        Longer beams, and beams without return, pass up to this range and end nowhere.
    weights : (n_scans, n_beams) float32, optional
        e of each beam; NaN counts as 1.
    twists : (n_scans, 3) float64, optional
        Velocity during each scan, see `twists_of`; without it the robot stood still.
    only_returns : bool
    walls : (rows, cols) uint8, optional
        As for `Counter.add`.
    threads : int
    """
    # Each counter has a grid of its own: on a huge one they would take more memory than they save time.
    n_counters = _MOST_BYTES_AT_ONCE // (_BYTES_PER_CELL * frame.rows * frame.cols)
    n_counters = max(1, min(threads, log.n_scans // _LEAST_PER_THREAD, n_counters))
    n_parts = n_counters * math.ceil(log.n_scans / (n_counters * SCANS_PER_CHUNK))
    bounds = np.linspace(0, log.n_scans, n_parts + 1).astype(int).tolist()
    parts = iter([slice(*pair) for pair in pairwise(bounds)])

    def count() -> Counter:
        counter = Counter(frame)
        for part in parts:
            counter.add(
                log.select(part),
                poses[part],
                usable_range_m,
                weights=None if weights is None else weights[part],
                twists=None if twists is None else twists[part],
                only_returns=only_returns,
                walls=walls,
            )
        return counter

    with ThreadPoolExecutor(max_workers=n_counters) as pool:
        counts = [done.result() for done in [pool.submit(count) for _ in range(n_counters)]]
    total = counts.pop(0)
    while counts:
        total.merge(counts.pop(), threads)
    return total.counting_map(threads)


def count_up_to_walls(
    log: ScanLog,
    poses: F64,
    frame: GridFrame,
    usable_range_m: float,
    *,
    twists: F64 | None = None,
    threads: int = 1,
) -> CountingMap:
    """Counting map in which beams without return pass only up to the first wall that other beams see.

    A dark or grazing surface returns nothing; taken at its word such a beam would be free space through walls.
    The arguments are those of `count_beams`.
    """
    count = partial(count_beams, log, poses, frame, usable_range_m, twists=twists, threads=threads)
    if not _has_silent_beams(log):
        return count()
    return count(walls=_walls_of(count(only_returns=True)))


def _has_silent_beams(log: ScanLog) -> bool:
    """Whether any beam has no return."""
    return any(
        bool((copied_rows(log.ranges_m, slice(first, first + SCANS_PER_CHUNK)) == np.inf).any())
        for first in range(0, log.n_scans, SCANS_PER_CHUNK)
    )


def _walls_of(counts: CountingMap) -> U8:
    """1 (rows, cols) in and beside cells that reflect half of the beams."""
    rows, cols = counts.frame.shape
    walls: U8 = sparse_zeros((rows, cols), np.uint8)
    reflecting = counts.hit_cells[counts.reflectance_at_hits >= _WALL_REFLECTANCE]
    row, col = np.divmod(reflecting, cols)
    mark_around(walls, row, col, 1)
    return walls


def end_cells(log: ScanLog, poses: F64, frame: GridFrame, usable_range_m: float) -> I32:
    """Flat index row * cols + col of each beam's end cell, (n_scans, n_beams) int32; -1 where it has none."""
    cells = np.empty(log.ranges_m.shape, dtype=np.int32)
    for part, found in end_cells_in_chunks(log, poses, frame, usable_range_m):
        cells[part] = found
    return cells


def end_cells_in_chunks(
    log: ScanLog,
    poses: F64,
    frame: GridFrame,
    usable_range_m: float,
    *,
    twists: F64 | None = None,
    scans: slice | None = None,
) -> Iterator[tuple[slice, I32]]:
    """Rows of some scans at a time, of all or of *scans*, and what `end_cells` has for them."""
    for part, placed in _chunks(log, rays_of(log, usable_range_m), poses, frame, twists, scans):
        cells = np.empty(placed.ranges_m.shape, dtype=np.int32)
        find_end_cells(placed, *frame.shape, cells)
        yield part, cells
