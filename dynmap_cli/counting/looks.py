"""Looks: the scans of a few seconds are one observation of a place, however many beams they send there.

The hit share of beams cannot tell a person who stands for a while from glass: both reflect a part of all beams. Looks
can. Glass is never seen free, for in each look some beams come back; where somebody stood, the looks before and after
saw beams cross the place and end well behind it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import F32, F64, I8, I64
from dynmap_cli.counting.counts import end_cells, only_returns
from dynmap_cli.counting.em import FilteredMap, count_with, expectation_of, expected_log_likelihood
from dynmap_cli.counting.evidence import Evidence, EvidenceParams, SurfaceCells, surface_cells
from dynmap_cli.domain.grid import FREE, OCCUPIED, GridFrame
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.em import look_up
from dynmap_cli.progress import Tick, no_tick

_LEAST_FREE_LOOKS = 3


@dataclass(frozen=True, slots=True)
class Looks:
    """In how many looks each cell was seen occupied, and free; the others said nothing of it.

    Attributes
    ----------
    surface : SurfaceCells
        The cells.
    occupied, free : (n,) int64
    n_looks : int
    """

    surface: SurfaceCells
    occupied: I64
    free: I64
    n_looks: int


def time_windows(log: ScanLog, window_s: float) -> list[slice]:
    """Runs of scans of one recording that lie in the same window; windows count from its first scan."""
    if log.n_scans == 0:
        return []
    window_ns = round(window_s * 1e9)
    starts = np.flatnonzero(np.diff(log.recording_index, prepend=-1))
    first = np.repeat(log.stamps_ns[starts], np.diff(starts, append=log.n_scans))
    number = (log.stamps_ns - first) // window_ns
    cuts = np.flatnonzero((np.diff(number) != 0) | (np.diff(log.recording_index) != 0)) + 1
    edges = [0, *cuts.tolist(), log.n_scans]
    return [slice(first, last) for first, last in pairwise(edges)]


def count_looks(
    log: ScanLog,
    poses: F64,
    frame: GridFrame,
    look_s: float,
    params: EvidenceParams,
    on_look: Tick = no_tick,
) -> Looks:
    """Judge each cell in each look, and count.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot; scans with NaN are left out.
    frame : GridFrame
    look_s : float
        Length of a look.
    params : EvidenceParams
    on_look : Tick
    """
    windows = time_windows(log, look_s)
    surface = surface_cells(log, poses, frame, windows, params)
    occupied, free = (np.zeros(surface.cells.shape[0], dtype=np.int64) for _ in range(2))
    for seen, states in judged_looks(log, poses, windows, surface, params, on_look):
        occupied[seen] += states == OCCUPIED
        free[seen] += states == FREE
    return Looks(surface, occupied, free, len(windows))


def judged_looks(
    log: ScanLog,
    poses: F64,
    windows: Sequence[slice],
    surface: SurfaceCells,
    params: EvidenceParams,
    on_look: Tick = no_tick,
) -> Iterator[tuple[I64, I8]]:
    """For each window the numbers (m,) of the cells that were seen in it, and their states (m,)."""
    evidence = Evidence(surface, params)
    for window in windows:
        evidence.add(log.select(window), poses[window])
        yield evidence.judge()
        evidence.clear()
        on_look()


def filter_by_looks(
    filtered: FilteredMap,
    log: ScanLog,
    poses: F64,
    *,
    look_s: float,
    look_prior: float,
    usable_range_m: float,
    twists: F64 | None = None,
) -> FilteredMap:
    """Lower e where the end cell was seen free in at least three looks and occupied in few.

    The share of looks that saw the place occupied takes the part that the hit share has for beams (Eq. 1.10 at its
    fixed point). Free looks rule out glass and fences, so the prior may be lower than that of beams. Beams without
    return say nothing here: a dark wall returns none.

    Parameters
    ----------
    filtered : FilteredMap
        By the hit share of beams.
    log : ScanLog
    poses : (n_scans, 3) float64
    look_s : float
    look_prior : float
        In (0.5, 1): a beam is dynamic where fewer than 2 (1 - prior) of the looks saw its end cell, and the
        cells around it, occupied.
    usable_range_m : float
    twists : (n_scans, 3) float64, optional
        As given to the filter.
    """
    counts = filtered.counting_map
    evidence = EvidenceParams(max_range_m=usable_range_m)
    looks = count_looks(only_returns(log), poses, counts.frame, look_s, evidence)
    by_looks = expectation_of(_occupied_share(looks), look_prior)
    hits = counts.static_hits + counts.dynamic_hits
    by_beams = np.divide(counts.static_hits, hits, out=np.ones_like(hits), where=hits > 0)
    counted = count_with(counts, np.minimum(by_beams, by_looks))
    cells = end_cells(log, poses, counts.frame, usable_range_m, twists=twists)
    beams = np.empty(cells.shape, dtype=np.float32)
    look_up(cells, by_looks.astype(np.float32).ravel(), beams)
    e: F32 = np.minimum(filtered.static_probability, beams)
    return replace(
        filtered,
        counting_map=counted,
        static_probability=e,
        log_likelihood=expected_log_likelihood(counted),
    )


def _occupied_share(looks: Looks) -> F64:
    """(rows, cols) largest share of looks that saw the cell, or one beside it, occupied; 1 where it was rarely free."""
    known, shape = looks.occupied + looks.free, looks.surface.frame.shape
    row, col = looks.surface.cells.T
    share = np.full(shape, -1.0)
    share[row, col] = np.where(known > 0, looks.occupied / np.maximum(known, 1), -1.0)
    around = ndimage.maximum_filter(share, size=3, mode="constant", cval=-1.0)
    is_free = np.zeros(shape, dtype=bool)
    is_free[row, col] = looks.free >= _LEAST_FREE_LOOKS
    return np.where(is_free, around, 1.0)
