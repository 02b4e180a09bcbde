"""Was a cell seen occupied or free? Hits against beams that crossed the surface; grazing beams say nothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, F64, I8, I32, I64
from dynmap_cli.counting.counts import SCANS_PER_CHUNK, rays_of, twists_of
from dynmap_cli.domain.grid import UNKNOWN, GridFrame, mark_around
from dynmap_cli.domain.mapped import copied_rows, sparse_zeros
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.beams import PlacedScans
from dynmap_cli.kernels.regions import MOST_HITS, add_evidence, add_hit_moments, judge_cells, surface_normals

_NORMAL_RADIUS_M, _MAX_SPREAD_RATIO = 0.15, 0.3


@dataclass(frozen=True, slots=True)
class EvidenceParams:
    """What counts as evidence.

    Attributes
    ----------
    max_range_m : float
        Beams are used up to this range; longer ones pass up to it.
    silent_pass : bool
        Whether beams without return pass up to it, too; else they say nothing.
    min_crossing_rad : float
        A pass counts where the angle between beam and local surface is at least this.
    beyond_m : float
        ... and where the beam ends at least this far beyond the cell.
    occupied_share, occupied_hits : float
        A cell is occupied from this hit share and this many hits on.
    free_share, free_cells : float
        It is free if the largest hit share around it is below this and beams crossed it by so many cells.
    support_cells : int
        How far "around" reaches, cells.
    """

    max_range_m: float = 12.0
    silent_pass: bool = True
    min_crossing_rad: float = float(np.deg2rad(20.0))
    beyond_m: float = 0.3
    occupied_share: float = 0.4
    occupied_hits: float = 3.0
    free_share: float = 0.15
    free_cells: float = 5.0
    support_cells: int = 1

    def reach_cells(self, resolution_m: float) -> int:
        """How far around a cell that lies which its evidence depends on."""
        return self.support_cells + max(self.support_cells, _normal_radius(resolution_m))


def _normal_radius(resolution_m: float) -> int:
    """Cells from which the hits that give a normal come."""
    return max(1, round(_NORMAL_RADIUS_M / resolution_m))


@dataclass(frozen=True, slots=True)
class SurfaceCells:
    """The cells that may have been occupied at some time, numbered; others can never be contradicted.

    Attributes
    ----------
    frame : GridFrame
    cells : (n, 2) int64
        Row and column of each.
    index : (rows, cols) int32
        Number of each cell; elsewhere -d, where d >= 1 is the distance (of rows or columns, whichever is more)
        to the nearest of them.
    neighbours : (n, k) int32
        Numbers of the cells around each and its own; -1 = none of them.
    normals : (n, 2) float64
        Normal of the line of hits around each, (0, 0) = no line.
    """

    frame: GridFrame
    cells: I64
    index: I32
    neighbours: I32
    normals: F64


def surface_cells(
    log: ScanLog, poses: F64, frame: GridFrame, windows: Sequence[slice | I64], params: EvidenceParams
) -> SurfaceCells:
    """Number the cells of a frame that have hits enough in some window, with the hit cells around them.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot; scans with NaN are left out.
    frame : GridFrame
    windows : sequence of slice or (n,) int64
        Scans of each time window.
    params : EvidenceParams
    """
    # Beams end in few cells: only those get rows, in the order in which they are met.
    numbers = sparse_zeros(frame.shape, np.int32)
    moments = np.zeros((numbers.size + 1, 3))
    window_counts, n_hit = np.zeros((numbers.size + 1, 3), dtype=np.int32), 0
    for number, window in enumerate(windows):
        for scans in _chunks(log.select(window), poses[window], frame, params):
            n_hit = add_hit_moments(scans, *frame.shape, number, numbers, moments, window_counts, n_hit)
    cells = _candidates(numbers, window_counts[: n_hit + 1, MOST_HITS] >= params.occupied_hits, params)
    normals = np.empty((cells.shape[0], 2))
    radius = _normal_radius(frame.resolution_m)
    surface_normals(cells, numbers, moments, radius, _MAX_SPREAD_RATIO, normals)
    del numbers, moments, window_counts
    index = _minus_distance(cells, frame.shape)
    index[cells[:, 0], cells[:, 1]] = np.arange(cells.shape[0], dtype=np.int32)
    return SurfaceCells(frame, cells, index, _neighbours(cells, index, params.support_cells), normals)


def _candidates(numbers: I32, has_many: B1, params: EvidenceParams) -> I64:
    """(n, 2) cells with a number near cells whose number has hits enough in some window, row by row."""
    rows, cols = numbers.shape
    row, col = np.divmod(np.flatnonzero(numbers), cols)
    hit_enough = has_many[numbers[row, col]]
    near: B1 = sparse_zeros((rows, cols), np.bool_)
    mark_around(near, row[hit_enough], col[hit_enough], params.support_cells)
    is_near = near[row, col]
    return np.stack([row[is_near], col[is_near]], axis=-1)


def _chunks(log: ScanLog, poses: F64, frame: GridFrame, params: EvidenceParams) -> Iterator[PlacedScans]:
    """What the kernels want to know of the beams, some scans at a time."""
    rays = rays_of(log, params.max_range_m)
    twists = twists_of(log, poses)
    if twists is None:
        twists = np.zeros((log.n_scans, 3))
    else:
        twists[-1] = twists[-2]
    for first in range(0, log.n_scans, SCANS_PER_CHUNK):
        part = slice(first, first + SCANS_PER_CHUNK)
        ranges = copied_rows(log.ranges_m, part)
        if not params.silent_pass:
            ranges[ranges == np.inf] = np.nan
        yield PlacedScans(
            ranges,
            np.array(log.geometry_index[part]),
            rays,
            twists[part],
            np.array(poses[part], dtype=np.float64),
            frame.resolution_m,
            frame.origin_x_m,
            frame.origin_y_m,
        )


def _minus_distance(cells: I64, shape: tuple[int, int]) -> I32:
    """(rows, cols) minus the chessboard distance to the nearest of some cells."""
    if cells.shape[0] == 0:
        return np.full(shape, -max(shape), dtype=np.int32)
    others = np.ones(shape, dtype=bool)
    others[cells[:, 0], cells[:, 1]] = False
    distance: I32 = ndimage.distance_transform_cdt(others, metric="chessboard")
    return np.negative(distance, out=distance)


def _neighbours(cells: I64, index: I32, reach: int) -> I32:
    """Numbers of the cells within *reach* of each, (n, (2 reach + 1)^2); -1 = none."""
    rows, cols = index.shape
    around = np.full((cells.shape[0], (2 * reach + 1) ** 2), -1, dtype=np.int32)
    for k, (up, right) in enumerate(product(range(-reach, reach + 1), repeat=2)):
        row, col = cells[:, 0] + up, cells[:, 1] + right
        is_inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        around[is_inside, k] = np.maximum(index[row[is_inside], col[is_inside]], -1)
    return around


class Evidence:
    """Hits and crossed lengths of the surface cells, from some of the scans."""

    def __init__(self, surface: SurfaceCells, params: EvidenceParams) -> None:
        self.surface, self.params = surface, params
        count = surface.cells.shape[0]
        self.hits, self.crossed = np.zeros(count), np.zeros(count)
        self._touched, self._n_touched = np.empty(count, dtype=np.int64), 0

    def add(self, log: ScanLog, poses: F64) -> None:
        """Add scans with their poses map_from_robot, (n_scans, 3)."""
        sine = float(np.sin(self.params.min_crossing_rad))
        for scans in _chunks(log, poses, self.surface.frame, self.params):
            self._n_touched = add_evidence(
                scans,
                self.surface.index.ravel(),
                *self.surface.frame.shape,
                self.surface.normals,
                sine,
                self.params.beyond_m,
                self.hits,
                self.crossed,
                self._touched,
                self._n_touched,
            )

    def merge(self, other: Evidence) -> None:
        """Add what another one on the same cells has seen."""
        theirs = other._touched[: other._n_touched]
        new = theirs[(self.hits[theirs] == 0) & (self.crossed[theirs] == 0)]
        self._touched[self._n_touched : self._n_touched + new.size] = new
        self._n_touched += new.size
        self.hits[theirs] += other.hits[theirs]
        self.crossed[theirs] += other.crossed[theirs]

    def judge(self) -> tuple[I64, I8]:
        """Numbers (m,) of the cells that were seen, and their states (m,): OCCUPIED, FREE or UNKNOWN."""
        states = np.empty(self._n_touched, dtype=np.int8)
        rule = self.params
        judge_cells(
            self.hits,
            self.crossed,
            self.surface.neighbours,
            self._touched,
            self._n_touched,
            rule.occupied_share,
            rule.occupied_hits,
            rule.free_share,
            rule.free_cells,
            states,
        )
        return self._touched[: self._n_touched].copy(), states

    def states(self) -> I8:
        """State of every surface cell, (n,) int8."""
        seen, states = self.judge()
        everywhere = np.full(self.hits.size, UNKNOWN, dtype=np.int8)
        everywhere[seen] = states
        return everywhere

    def clear(self) -> None:
        """Forget everything; costs as much as was touched."""
        seen = self._touched[: self._n_touched]
        self.hits[seen] = 0.0
        self.crossed[seen] = 0.0
        self._n_touched = 0
