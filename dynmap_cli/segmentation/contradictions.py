"""Which cells were seen occupied at one time and free at another (paper, 1.3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, I8, I32, I64
from dynmap_cli.counting.evidence import EvidenceParams, SurfaceCells, surface_cells
from dynmap_cli.counting.looks import judged_looks, time_windows
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.progress import Tick, no_tick
from dynmap_cli.segmentation.large_changes import large_changes
from dynmap_cli.segmentation.recurring import occasions, recurring_cells
from dynmap_cli.segmentation.windows import WindowRecord

_MIN_WINDOWS, _MIN_WINDOW_SHARE = 2, 0.1
_STANDING_SHARE = 0.7
_FARTHER = 1.5


@dataclass(frozen=True, slots=True)
class Contradictions:
    """In which time windows each cell was seen occupied, and free.

    Attributes
    ----------
    surface : SurfaceCells
        The cells that may have been occupied.
    record : WindowRecord
        Of these cells.
    large : (n,) bool
        Of these cells: those that only one window saw so, of things larger than a person.
    occasion : (n_windows,) int32
        Number of the hour of each window with scans in it.
    places_m : (n_windows, 2) float64
        Where the robot was in each window: median x, y.
    """

    surface: SurfaceCells
    record: WindowRecord
    large: B1
    occasion: I32
    places_m: F64

    @property
    def windows_needed(self) -> int:
        """How often a cell must be seen in either state.

        Two windows rule out people who stand. On a long log a fixed two lets noise in, hence 10 % of the
        windows that usually (median) know a cell which was occupied at some time.
        """
        windows = self.record.occupied + self.record.free
        known = windows[(self.record.occupied > 0) & (windows >= _MIN_WINDOWS)]
        usual = float(np.median(known)) if known.size else 0.0
        return max(_MIN_WINDOWS, int(np.ceil(_MIN_WINDOW_SHARE * usual)))

    @property
    def occupied(self) -> I64:
        """(rows, cols) in how many windows each cell was seen occupied."""
        return self._on_map(self.record.occupied)

    @property
    def free(self) -> I64:
        """(rows, cols) in how many windows each cell was seen free."""
        return self._on_map(self.record.free)

    @property
    def contested(self) -> B1:
        """(rows, cols) whether a cell was seen occupied and free often enough; large things once on a short log."""
        found = np.minimum(self.record.occupied, self.record.free) >= self.windows_needed
        return self._on_map(found | self.large if self._is_short else found).astype(bool)

    @property
    def standing(self) -> I8:
        """(rows, cols) int8, 1 where a cell is occupied in at least 70 % of the windows that know it."""
        return self._on_map(_stands(self.record)).astype(np.int8)

    def changed_as_one(self, groups: list[I64], min_cells: int) -> list[I64]:
        """Groups of contested cells, (n, 2) each, of which windows enough saw *min_cells* at once in either state.

        The cells of an object appear and vanish together. Where a surface is ragged, or the poses blur it, cells
        contradict one another one by one.

        What is thin vanishes from afar: the spot of a beam grows, and most of it goes past. So some window must see
        half as many cells free from not much farther than they were seen occupied.
        """
        group_of = np.full(self.surface.cells.shape[0], -1, dtype=np.int64)
        needed = np.full(len(groups), self.windows_needed, dtype=np.int64)
        for number, cells in enumerate(groups):
            own = self.surface.index[cells[:, 0], cells[:, 1]]
            group_of[own] = number
            if self._is_short and self.large[own].any():
                needed[number] = 1
        occupied, free = self.record.cells_shown(group_of, len(groups))
        is_occupied, is_free = occupied >= min_cells, free >= min_cells
        away = np.column_stack(
            [self._distances_m(cells) for cells in groups] or [np.empty((self.n_windows, 0))]
        )
        near = away <= _FARTHER * np.where(is_occupied, away, 0.0).max(axis=0, initial=0.0)
        kept = np.minimum(is_occupied.sum(axis=0), is_free.sum(axis=0)) >= needed
        kept &= (near & (2 * free >= min_cells)).any(axis=0)
        return [cells for cells, is_kept in zip(groups, kept.tolist(), strict=True) if is_kept]

    def recurring(self, explained: list[I64]) -> B1:
        """(rows, cols) cells of what comes back to the same spot, hours apart; none beside cells (n, 2) that change."""
        others = np.concatenate([np.empty((0, 2), dtype=np.int64), *explained])
        found = recurring_cells(self.surface, self.record, self.occasion, _stands(self.record), others)
        return self._on_map(found).astype(bool)

    def _distances_m(self, cells: I64) -> F64:
        """(n_windows,) from the robot to the middle of some cells (n, 2)."""
        frame = self.surface.frame
        middle = (cells.mean(axis=0)[::-1] + 0.5) * frame.resolution_m + [frame.origin_x_m, frame.origin_y_m]
        return np.asarray(np.linalg.norm(self.places_m - middle, axis=1))

    @property
    def n_windows(self) -> int:
        """Windows with scans in them."""
        return self.occasion.size

    @property
    def _is_short(self) -> bool:
        """Whether the log is so short that two windows are enough."""
        return self.windows_needed == _MIN_WINDOWS

    def _on_map(self, values: B1 | I64) -> I64:
        """(rows, cols) with the values (n,) of the surface cells; 0 elsewhere."""
        found = np.zeros(self.surface.frame.shape, dtype=np.int64)
        found[self.surface.cells[:, 0], self.surface.cells[:, 1]] = values
        return found


def _stands(record: WindowRecord) -> B1:
    """(n,) whether cells are occupied in most of the windows that know them."""
    return np.asarray(
        (record.occupied > 0) & (record.occupied >= _STANDING_SHARE * (record.occupied + record.free))
    )


def find_contradictions(
    log: ScanLog,
    poses: F64,
    frame: GridFrame,
    window_s: float,
    params: EvidenceParams,
    on_window: Tick = no_tick,
) -> Contradictions:
    """Judge each cell in each time window, and count.

    Contradiction is a statement about time: within a window the scans are one observation.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot; scans with NaN are left out.
    frame : GridFrame
    window_s : float
    params : EvidenceParams
    on_window : Tick
    """
    windows = time_windows(log, window_s)
    surface = surface_cells(log, poses, frame, windows, params)
    record = WindowRecord(surface.cells.shape[0])
    for look in judged_looks(log, poses, windows, surface, params, on_window):
        record.add(look.seen, look.states)
    occasion = occasions(np.array([log.stamps_ns[window.start] for window in windows], dtype=np.int64))
    large = large_changes(surface, record, _stands(record))
    return Contradictions(surface, record, large, occasion, _places_m(poses, windows))


def _places_m(poses: F64, windows: Sequence[slice]) -> F64:
    """(n_windows, 2) median x, y of the poses of each window, inf where none is known."""
    places = np.full((len(windows), 2), np.inf)
    for number, window in enumerate(windows):
        known = poses[window, :2][np.isfinite(poses[window]).all(axis=1)]
        if known.size:
            places[number] = np.median(known, axis=0)
    return places
