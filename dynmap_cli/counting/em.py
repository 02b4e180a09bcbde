"""The EM filter at fixed poses (Eq. 1.6-1.15): which beams hit something static, and the map without the others."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from dynmap_cli.arrays import B1, F32, F64
from dynmap_cli.counting.counts import SCANS_PER_CHUNK, count_beams, count_up_to_walls, end_cells_in_chunks
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, CountingMap, GridFrame, OccupancyGrid
from dynmap_cli.domain.mapped import copied_rows, give_back, sparse_zeros
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.kernels.em import look_up, static_probability

_MAX_ITERATIONS, _TOLERANCE = 20_000, 1e-12
_OCCUPIED_REFLECTANCE, _FREE_PASSED_CELLS = 0.2, 0.5


@dataclass(frozen=True, slots=True)
class FilterParams:
    """How the filter works.

    Attributes
    ----------
    static_prior : float
        p(c = 1) in (0.5, 1). It *is* the threshold on the hit share: a beam is dynamic iff the hit share of
        its end cell (or of the cells that support it) is under 2 (1 - p).
    support_cells : int
        Cells around the end cell whose reflectance may support it; 0 = the paper to the letter.
    usable_range_m : float
    em : str
        "closed" or "iterative".
    stop_at_walls : bool
        Whether a beam without return passes only up to the first wall that others see; the paper lets it pass on.
    """

    static_prior: float = 0.95
    support_cells: int = 1
    usable_range_m: float = 30.0
    em: Literal["closed", "iterative"] = "closed"
    stop_at_walls: bool = True


@dataclass(frozen=True, slots=True)
class FilteredMap:
    """Result of the filter at fixed poses.

    Attributes
    ----------
    counting_map : CountingMap
        Counts with the final e of each beam.
    static_probability : (n_scans, n_beams) float32
        e of each beam; NaN where it has no end point.
    log_likelihood : float
        Eq. 1.7, without the prior's constant.
    is_unknown : (n_scans, n_beams) bool
        Beams whose e is the prior's word only: what they hit was seen too little to tell.
    """

    counting_map: CountingMap
    static_probability: F32
    log_likelihood: float
    is_unknown: B1

    @property
    def unknown_share(self) -> float:
        """Share of the beams with an end point that nothing is known of."""
        unknown = 0
        for first in range(0, self.is_unknown.shape[0], SCANS_PER_CHUNK):
            unknown += int(self.is_unknown[first : first + SCANS_PER_CHUNK].sum())
            give_back(self.is_unknown)
        return unknown / max(count_ended(self.static_probability)[0], 1)

    @property
    def dynamic_share(self) -> float:
        """Share of the beams with an end point that are called dynamic (e < 1/2)."""
        ended, dynamic = count_ended(self.static_probability)
        return dynamic / max(ended, 1)


def count_ended(static_probability: F32) -> tuple[int, int]:
    """How many beams have an end point, and how many of them are called dynamic (e < 1/2)."""
    ended = dynamic = 0
    for first in range(0, static_probability.shape[0], SCANS_PER_CHUNK):
        part = copied_rows(static_probability, slice(first, first + SCANS_PER_CHUNK))
        ended += int(np.count_nonzero(np.isfinite(part)))
        dynamic += int(np.count_nonzero(part < 0.5))
    return ended, dynamic


def filter_beams(
    log: ScanLog,
    poses: F64,
    frame: GridFrame,
    params: FilterParams,
    *,
    twists: F64 | None = None,
    threads: int = 1,
    out: F32 | None = None,
) -> FilteredMap:
    """Run the EM to its fixed point at given poses.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot; scans with NaN are left out.
    frame : GridFrame
    params : FilterParams
    twists : (n_scans, 3) float64, optional
        Velocity during each scan, to correct sweeps for it; without it the robot stood still.
    threads : int
    out : (n_scans, n_beams) float32, optional
        Where e of each beam is to be written, which may be mapped from a file.
    """
    count = count_up_to_walls if params.stop_at_walls else count_beams
    raw = count(log, poses, frame, params.usable_range_m, twists=twists, threads=threads)
    reflectance = fixed_point(raw.static_at_hits, raw.passed_at_hits, params)
    expectation = _e_step(raw, reflectance, params)
    weights = sparse_zeros(frame.rows * frame.cols, np.float32)
    weights[raw.hit_cells] = expectation
    beams = np.empty(log.ranges_m.shape, dtype=np.float32) if out is None else out

    def fill(scans: slice) -> None:
        for part, cells in end_cells_in_chunks(
            log, poses, frame, params.usable_range_m, twists=twists, scans=scans
        ):
            look_up(cells, weights, beams[part])
            give_back(beams)

    starts = range(0, log.n_scans, SCANS_PER_CHUNK)
    with ThreadPoolExecutor(max_workers=threads) as pool:
        list(pool.map(fill, (slice(first, min(first + SCANS_PER_CHUNK, log.n_scans)) for first in starts)))
    counted = count_with(raw, expectation.astype(np.float64))
    unknown = np.zeros(beams.shape, dtype=bool)
    return FilteredMap(counted, beams, expected_log_likelihood(counted), unknown)


def fixed_point(hits: F64, passed_cells: F64, params: FilterParams) -> F64:
    r"""Reflectance m of each cell at which E-step and M-step agree, started from e = p.

    At fixed poses the cells decouple. With the hit share h = hits / (hits + passed length), m = h e and
    Eq. 1.10 give

    .. math::
        m^* = \max\left(0, \frac{p h - (1 - p)}{2 p - 1}\right)

    In mode "iterative" the two steps are repeated instead until nothing moves.

    Parameters
    ----------
    hits, passed_cells : (n,) float64
        All end points in each cell, and passed length in cells.
    params : FilterParams

    Returns
    -------
    (n,) float64
        NaN where nothing was seen.
    """
    seen = hits + passed_cells
    hit_share = np.full(hits.shape, np.nan)
    np.divide(hits, seen, out=hit_share, where=seen > 0)
    if params.em == "closed":
        return _fixed_point_of_share(hit_share, params.static_prior)
    return _iterate(hit_share.ravel(), params.static_prior).reshape(hits.shape)


def expectation_of(hit_share: F64, prior: float) -> F64:
    """E (Eq. 1.10) at the fixed point of a hit share, (rows, cols); 1/2 where the share is 2 (1 - prior)."""
    expectation = np.empty(hit_share.size)
    static_probability(_fixed_point_of_share(hit_share, prior).ravel(), prior, expectation)
    return expectation.reshape(hit_share.shape)


def _fixed_point_of_share(hit_share: F64, prior: float) -> F64:
    """Closed form of the fixed point, see `fixed_point`."""
    return np.asarray(np.clip((prior * hit_share - (1.0 - prior)) / (2.0 * prior - 1.0), 0.0, 1.0))


def em_step(reflectance: F64, hit_share: F64, static_prior: float) -> F64:
    """One E-step (Eq. 1.10) and M-step (Eq. 1.15, m = h e) of each cell; (n,) float64 in and out."""
    expectation = np.empty_like(reflectance)
    static_probability(reflectance, static_prior, expectation)
    return hit_share * expectation


def _iterate(hit_share: F64, static_prior: float) -> F64:
    """Repeat both steps from e = p until no m moves."""
    reflectance = hit_share * static_prior
    for _ in range(_MAX_ITERATIONS):
        before, reflectance = reflectance, em_step(reflectance, hit_share, static_prior)
        if np.nanmax(np.abs(reflectance - before), initial=0.0) < _TOLERANCE:
            break
    return reflectance


def count_with(raw: CountingMap, expectation_at_hits: F64) -> CountingMap:
    """Split the hits of each cell into static and dynamic ones, where all beams of a cell share one e, (n,)."""
    hits = raw.static_at_hits + raw.dynamic_at_hits
    static = hits * np.nan_to_num(expectation_at_hits)
    centroids = np.where((static > 0)[:, None], raw.centroids_at_hits_m, np.nan)
    return CountingMap(raw.frame, raw.passed_cells, raw.hit_cells, static, hits - static, centroids)


def all_static(counts: CountingMap) -> CountingMap:
    """The map that all beams draw when none of them is filtered."""
    return count_with(counts, np.ones(counts.hit_cells.size))


def expected_log_likelihood(counts: CountingMap) -> float:
    r"""Eq. 1.7 in its sum over cells, \sum_j \alpha_j \ln m_j + \beta_j \ln(1 - m_j), without the constant gamma.

    Cells in which no beam ended have m = 0 and say nothing.
    """
    alpha, beta = counts.static_at_hits, counts.dynamic_at_hits + counts.passed_at_hits
    reflectance = counts.reflectance_at_hits
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.where(alpha > 0, alpha * np.log(reflectance), 0.0)
        terms += np.where(beta > 0, beta * np.log1p(-reflectance), 0.0)
    return float(terms.sum())


def occupancy(counts: CountingMap) -> OccupancyGrid:
    """Trinary map: occupied where enough beams are reflected, free where beams passed, else unknown.

    Beams graze along walls and jitter by a cell, so a wall cell is hit by fewer than all beams that meet it; a
    cell counts as occupied from m = 0.2 on.
    """
    cells = np.full(counts.frame.shape, UNKNOWN, dtype=np.int8)
    cells[counts.passed_cells > _FREE_PASSED_CELLS] = FREE
    is_occupied = (counts.reflectance_at_hits >= _OCCUPIED_REFLECTANCE) & (counts.static_at_hits >= 1.0)
    cells.reshape(-1)[counts.hit_cells[is_occupied]] = OCCUPIED
    return OccupancyGrid(counts.frame, cells)


def _e_step(raw: CountingMap, reflectance: F64, params: FilterParams) -> F32:
    """(n,) e of the beams that end in each cell, from the largest m among the cells that support it."""
    support = _largest_around(raw, np.nan_to_num(reflectance), params.support_cells)
    expectation = np.empty(support.size)
    static_probability(support, params.static_prior, expectation)
    return expectation.astype(np.float32)


def _largest_around(counts: CountingMap, values: F64, reach: int) -> F64:
    """(n,) largest of some values that are at least 0 in the cells within *reach* of each in which beams ended."""
    cells, n_cols = counts.hit_cells, counts.frame.cols
    largest = values.copy()
    for up, right in product(range(-reach, reach + 1), repeat=2) if cells.size else ():
        beside = cells + (up * n_cols + right)
        found = np.minimum(np.searchsorted(cells, beside), cells.size - 1)
        cols = cells % n_cols + right
        is_there = (cells[found] == beside) & (cols >= 0) & (cols < n_cols)
        np.maximum(largest, values[found], out=largest, where=is_there)
    return largest
