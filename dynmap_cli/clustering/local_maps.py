"""One local map per observation sequence, laid over one another (paper, 1.3.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from dynmap_cli.arrays import B1, F32, F64, I8, I64
from dynmap_cli.counting.counts import twists_of
from dynmap_cli.counting.em import FilterParams, filter_beams
from dynmap_cli.counting.evidence import Evidence, EvidenceParams, SurfaceCells, surface_cells
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, GridFrame
from dynmap_cli.domain.scans import ScanLog

MAX_SHIFT_CELLS, _ALIGN_ROUNDS, _MIN_GAIN_CELLS = 2, 2, 3.0
_QUARTERS = 4
_LEAST_SHARE = 0.06
_EIGHT = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True, slots=True)
class LocalMaps:
    """The local maps of one sub-map, one per observation sequence.

    Attributes
    ----------
    states : (n, rows, cols) int8
        OCCUPIED, FREE or UNKNOWN.
    reflectance : (n, rows, cols) float32
        Counting-map value m after the EM (Eq. 1.15); NaN = unknown.
    is_mixed : (n,) bool
        Whether a state changed while it was watched.
    """

    states: I8
    reflectance: F32
    is_mixed: B1


def build_local_maps(
    log: ScanLog,
    poses: F64,
    frame: GridFrame,
    sequences: Sequence[I64],
    evidence: EvidenceParams,
    filtering: FilterParams,
    min_cells: int,
) -> LocalMaps:
    """Build the local map of each sequence with the EM of the paper's section 1.2, at the given poses.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot.
    frame : GridFrame
        The rectangle of the sub-map.
    sequences : sequence of (n,) int64
        Scans of each.
    evidence : EvidenceParams
    filtering : FilterParams
    min_cells : int
        A sequence is mixed if a group of so many cells turns over.
    """
    states = np.full((len(sequences), *frame.shape), UNKNOWN, dtype=np.int8)
    reflectance = np.full((len(sequences), *frame.shape), np.nan, dtype=np.float32)
    is_mixed = np.zeros(len(sequences), dtype=bool)
    if not sequences:
        return LocalMaps(states, reflectance, is_mixed)
    surface = surface_cells(log, poses, frame, sequences, evidence)
    rows, cols = surface.cells[:, 0], surface.cells[:, 1]
    for number, scans in enumerate(sequences):
        part, part_poses = log.select(scans), poses[scans]
        total, is_mixed[number] = _watch(part, part_poses, surface, evidence, min_cells)
        states[number, rows, cols] = total.states()
        filtered = filter_beams(part, part_poses, frame, filtering, twists=twists_of(part, part_poses))
        reflectance[number] = filtered.counting_map.reflectance
    return LocalMaps(states, reflectance, is_mixed)


def _watch(
    log: ScanLog, poses: F64, surface: SurfaceCells, params: EvidenceParams, min_cells: int
) -> tuple[Evidence, bool]:
    """Evidence of a sequence, and whether what came before contradicts what came after some moment in it."""
    bounds = np.linspace(0, log.n_scans, _QUARTERS + 1).astype(int)
    quarters = []
    for first, last in pairwise(bounds.tolist()):
        quarters.append(Evidence(surface, params))
        quarters[-1].add(log.select(slice(first, last)), poses[first:last])
    is_mixed = False
    for cut in range(1, _QUARTERS):
        before, after = (_sum(part, surface, params).states() for part in (quarters[:cut], quarters[cut:]))
        turned = np.zeros(surface.frame.shape, dtype=bool)
        opposite = ((before == OCCUPIED) & (after == FREE)) | ((before == FREE) & (after == OCCUPIED))
        turned[surface.cells[opposite, 0], surface.cells[opposite, 1]] = True
        is_mixed |= bool((component_sizes(turned) >= min_cells).any())
    return _sum(quarters, surface, params), is_mixed


def _sum(parts: Sequence[Evidence], surface: SurfaceCells, params: EvidenceParams) -> Evidence:
    """What several parts have seen together."""
    total = Evidence(surface, params)
    for part in parts:
        total.merge(part)
    return total


def _grown(cells: B1) -> B1:
    """Cells (rows, cols) and the eight around each; many times faster than the dilation of SciPy."""
    wide = cells.copy()
    wide[:, 1:] |= cells[:, :-1]
    wide[:, :-1] |= cells[:, 1:]
    grown = wide.copy()
    grown[1:] |= wide[:-1]
    grown[:-1] |= wide[1:]
    return grown


def component_labels(cells: B1) -> tuple[I64, int]:
    """Groups of cells that touch, or that lie one cell apart: (rows, cols) 0 = none, 1...; how many."""
    labels, count = ndimage.label(_grown(cells), structure=_EIGHT)
    return np.where(cells, labels, 0).astype(np.int64), int(count)


def component_sizes(cells: B1) -> I64:
    """Number of cells of each group."""
    labels, count = component_labels(cells)
    return np.bincount(labels[cells], minlength=count + 1)[1:]


def _in_groups(cells: B1, min_cells: int) -> B1:
    """Those cells that belong to *min_cells* or more that touch."""
    labels, count = ndimage.label(cells, structure=_EIGHT)
    is_large = np.bincount(labels.ravel(), minlength=count + 1) >= min_cells
    is_large[0] = False
    return np.asarray(is_large[labels])


def without_specks(states: I8, min_cells: int) -> I8:
    """Local map (rows, cols) without occupied groups of fewer cells: one is no change, many would look like one."""
    labels, count = component_labels(states == OCCUPIED)
    small = np.bincount(labels.ravel(), minlength=count + 1) < min_cells
    return np.where((labels > 0) & small[labels], UNKNOWN, states).astype(np.int8)


def align(maps: LocalMaps) -> LocalMaps:
    """Shift each map by up to two cells to where most of its occupied cells are occupied in the others too.

    Errors of the poses are nearly constant over a visit, so they show as a shift of its map. Only what stands
    in both counts: a cell that is free in one map and occupied in another is a change, and no reason to move.
    A map moves only where that makes clearly more cells agree.
    """
    occupied = (maps.states == OCCUPIED).astype(np.float64)
    count = occupied.shape[0]
    if count < 2:
        return maps
    shifts, total = [(0, 0)] * count, occupied.sum(axis=0)
    for _ in range(_ALIGN_ROUNDS):
        for k, grid in enumerate(occupied):
            others = total - shifted(grid, shifts[k], 0.0)
            shifts[k] = _best_shift(grid, _distinct(others))
            total = others + shifted(grid, shifts[k], 0.0)
    states = np.stack([shifted(m, s, UNKNOWN) for m, s in zip(maps.states, shifts, strict=True)])
    values = np.stack([shifted(m, s, np.nan) for m, s in zip(maps.reflectance, shifts, strict=True)])
    return LocalMaps(states, values, maps.is_mixed)


def _distinct(counts: F64) -> F64:
    """Counts relative to the largest within reach of a shift: where a surface is most often, however rare it is."""
    largest = ndimage.maximum_filter(counts, size=2 * MAX_SHIFT_CELLS + 1, mode="constant")
    return np.asarray(counts / np.maximum(largest, 1.0))


def _best_shift(occupied: F64, others: F64) -> tuple[int, int]:
    """Rows and columns by which occupied cells (0 or 1) best meet those of the other maps (share of the maps)."""
    rows, cols = np.nonzero(occupied)
    padded = np.pad(others, MAX_SHIFT_CELLS)
    reach = range(-MAX_SHIFT_CELLS, MAX_SHIFT_CELLS + 1)
    candidates = sorted(((row, col) for row in reach for col in reach), key=lambda s: math.hypot(*s))
    best, best_score = (0, 0), -math.inf
    for shift in candidates:
        score = float(padded[rows + MAX_SHIFT_CELLS + shift[0], cols + MAX_SHIFT_CELLS + shift[1]].sum())
        if score > best_score + (_MIN_GAIN_CELLS if best_score > -math.inf else 0.0):
            best, best_score = shift, score
    return best


def shifted(grid: npt.NDArray[Any], shift: tuple[int, int], fill: float) -> npt.NDArray[Any]:
    """Move the content of a grid up by some rows and right by some columns; what comes in has the value *fill*."""
    rows, cols = shift
    moved = np.full_like(grid, fill)
    height, width = grid.shape
    to_row, to_col = max(rows, 0), max(cols, 0)
    from_row, from_col = max(-rows, 0), max(-cols, 0)
    n_rows, n_cols = max(height - abs(rows), 0), max(width - abs(cols), 0)
    moved[to_row : to_row + n_rows, to_col : to_col + n_cols] = grid[
        from_row : from_row + n_rows, from_col : from_col + n_cols
    ]
    return moved


@dataclass(frozen=True, slots=True)
class Vectors:
    """Local maps as vectors over the cells that vary.

    Attributes
    ----------
    values : (n, n_cells) float64
        1 occupied, 0 free, NaN = unknown (xi of Eq. 1.18).
    component : (n_cells,) int64
        Which group of touching cells each cell belongs to, from 0.
    n_components : int
    cells : (rows, cols) bool
        Where these cells lie in the sub-map.
    """

    values: F64
    component: I64
    n_components: int
    cells: B1


def varying_vectors(maps: LocalMaps, owned: B1, contested: B1, min_cells: int) -> Vectors:
    """Keep the cells that some maps saw occupied and others free.

    Both in at least 6 % of the maps that know the cell: a rare state of which one map saw a part varies in that part,
    too. What a map says of a cell counts where it says the same of *min_cells* touching cells that some maps
    contradict: an object appears and vanishes as a whole, noise does not. Mixed maps do not count. Groups are left out
    that have fewer than *min_cells* cells, or lie where segmentation saw no contradiction.

    Parameters
    ----------
    maps : LocalMaps
    owned, contested : (rows, cols) bool
        Of the sub-map.
    min_cells : int
    """
    states = (
        np.stack([without_specks(state, min_cells) for state in maps.states])
        if maps.states.size
        else maps.states
    )
    pure = states[~maps.is_mixed]
    is_occupied, is_free = pure == OCCUPIED, pure == FREE
    known = is_occupied.sum(axis=0) + is_free.sum(axis=0)
    disputed = is_occupied.any(axis=0) & is_free.any(axis=0)
    occupied, free = (
        sum(
            (_in_groups(cells & disputed, min_cells) for cells in seen),
            start=np.zeros(owned.shape, dtype=np.int64),
        )
        for seen in (is_occupied, is_free)
    )
    least = np.maximum(1, np.ceil(_LEAST_SHARE * known))
    labels, n_labels = component_labels((occupied >= least) & (free >= least) & owned)
    cells = labels > 0
    sizes = np.bincount(labels[cells], minlength=n_labels + 1)
    near_contested = ndimage.binary_dilation(contested, structure=_EIGHT, iterations=MAX_SHIFT_CELLS)
    touching = np.bincount(labels[cells & near_contested], minlength=n_labels + 1)
    kept = (sizes >= min_cells) & (touching > 0)
    cells &= kept[labels]
    _, component = np.unique(labels[cells], return_inverse=True)
    states = states[:, cells]
    values = np.where(states == UNKNOWN, np.nan, states.astype(np.float64))
    return Vectors(values, component.astype(np.int64), int(kept[1:].sum()), cells)
