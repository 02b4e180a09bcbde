"""Tells a lost robot from a map that is out of date.

Neither the likelihood nor the share of explained beams tells the two apart: a place with eight new boxes
looks worse than a wrong pose. But people and new objects *shorten* beams; only a wrong pose, or a wall
that was torn down, lets beams pass *through* walls.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.kernels.likelihood import explain_by_states, explain_ends, first_crossings
from dynmap_cli.localization.map_pool import MapPool
from dynmap_cli.localization.particle_filter import Estimate
from dynmap_cli.localization.states import LEAST_SINE, PlacedSweep

OVERSHOOT_M = 0.5
SCANS = 6
LOST_SHARE = 0.12
SPREAD_WEIGHT = 0.02
STAYS_S, FORGOTTEN_S = 5.0, 2.0
CHANGED_SHARE = 0.08
COARSE_CELLS = 4
SEARCH_AFTER = 10
"""Updates in a row that are lost before the whole map is searched; doubled after each search."""
FOUND_AFTER = 30
"""Updates in a row that are not lost after which patience is short again."""


@dataclass(frozen=True, slots=True)
class ScanHealth:
    """How one scan fits the maps from the best pose; shares of the beams with a return.

    Attributes
    ----------
    explained : float
        End near something in the map, in the likeliest states.
    explained_by_other_state : float
        End near something in another state of a sub-map.
    unexplained : float
        The rest.
    through_walls : float
        Went through a static wall and end nowhere near another.
    staying : float
        Unexplained, and something has been seen there for 5 s.
    """

    explained: float
    explained_by_other_state: float
    unexplained: float
    through_walls: float
    staying: float


class NovelPlaces:
    """Remembers where unexplained beams ended, and since when, on a grid four cells wide."""

    def __init__(self, frame: GridFrame) -> None:
        shape = (frame.rows // COARSE_CELLS + 1, frame.cols // COARSE_CELLS + 1)
        self._frame = frame
        self._first_s = np.full(shape, -np.inf)
        self._last_s = np.full(shape, -np.inf)

    def see(self, ends_m: F64, now_s: float) -> int:
        """Note unexplained ends (n, 2); return how many lie where something has stayed."""
        cells = self._frame.to_cells(ends_m)
        inside = ((cells >= 0) & (cells < self._frame.shape)).all(axis=1)
        rows, cols = (cells[inside] // COARSE_CELLS).T
        is_new = now_s - self._last_s[rows, cols] > FORGOTTEN_S
        self._first_s[rows[is_new], cols[is_new]] = now_s
        self._last_s[rows, cols] = now_s
        return int((now_s - self._first_s[rows, cols] >= STAYS_S).sum())


def scan_health(
    placed: PlacedSweep, pool: MapPool, likeliest: Mapping[int, int], novel: NovelPlaces, now_s: float
) -> ScanHealth:
    """Sort the beams of a scan by what explains them.

    Parameters
    ----------
    placed : PlacedSweep
    pool : MapPool
    likeliest : mapping of int to int
        Index of the likeliest state of each sub-map, by the index of the sub-map.
    novel : NovelPlaces
        Takes note of the ends that nothing explains.
    now_s : float
    """
    hits = placed.hits
    n_hits = max(int(hits.sum()), 1)
    now, other = _explained(placed.ends_m[hits], pool, likeliest)
    unexplained = ~(now | other)
    through = _went_through(placed, pool)[hits] & unexplained
    staying = novel.see(placed.ends_m[hits][unexplained & ~through], now_s)
    return ScanHealth(
        explained=float(now.sum()) / n_hits,
        explained_by_other_state=float(other.sum()) / n_hits,
        unexplained=float(unexplained.sum()) / n_hits,
        through_walls=float(through.sum()) / n_hits,
        staying=staying / n_hits,
    )


class Verdict:
    """Judges the last six scans together: tracking, changed or lost."""

    def __init__(self) -> None:
        self._through: deque[float] = deque(maxlen=SCANS)
        self._staying: deque[float] = deque(maxlen=SCANS)

    def judge(self, health: ScanHealth, estimate: Estimate) -> str:
        """Take one more scan into account."""
        self._through.append(health.through_walls)
        self._staying.append(health.staying)
        share = sum(self._through) / len(self._through)
        spread = SPREAD_WEIGHT * math.log(max(estimate.spread_m, 0.05) / 0.05)
        if not estimate.is_one_mode or share + spread > LOST_SHARE:
            return "lost"
        if sum(self._staying) / len(self._staying) > CHANGED_SHARE:
            return "changed"
        return "tracking"


class Patience:
    """Counts lost updates until the whole map has to be searched."""

    def __init__(self) -> None:
        self._lost, self._found, self._patience = 0, 0, SEARCH_AFTER

    def is_over(self, verdict: str) -> bool:
        """Take one more verdict into account."""
        if verdict != "lost":
            self._lost, self._found = 0, self._found + 1
            if self._found >= FOUND_AFTER:
                self._patience = SEARCH_AFTER
            return False
        self._lost, self._found = self._lost + 1, 0
        if self._lost < self._patience:
            return False
        self._lost, self._patience = 0, 2 * self._patience
        return True


def _explained(ends_m: F64, pool: MapPool, likeliest: Mapping[int, int]) -> tuple[B1, B1]:
    """Which ends lie near something in the likeliest states, and which only in other states."""
    now, other = np.empty(len(ends_m), dtype=np.bool_), np.zeros(len(ends_m), dtype=np.bool_)
    explain_ends(ends_m, pool.frame.corner, pool.explained, now)
    for number, state in likeliest.items():
        submap = pool.submaps[number]
        explain_by_states(ends_m, submap.frame.corner, submap.owned, submap.explained, state, now, other)
    return now, other


def _went_through(placed: PlacedSweep, pool: MapPool) -> B1:
    """Which beams overshoot the first static surface on their way."""
    size = pool.frame.resolution_m
    crossings = np.empty((placed.lengths_m.size, 2))
    x = (placed.sensor_m[0] - pool.frame.origin_x_m) / size
    y = (placed.sensor_m[1] - pool.frame.origin_y_m) / size
    first_crossings(
        pool.surfaces,
        float(x),
        float(y),
        placed.directions_rad,
        placed.lengths_m / size,
        LEAST_SINE,
        crossings,
    )
    return np.asarray(crossings[:, 1] * size + OVERSHOOT_M < placed.lengths_m)
