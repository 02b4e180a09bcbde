"""Which cells were seen occupied at one time and free at another (paper, 1.3.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dynmap_cli.arrays import B1, F64, I8, I64
from dynmap_cli.counting.evidence import EvidenceParams, SurfaceCells, surface_cells
from dynmap_cli.counting.looks import judged_looks, time_windows
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.progress import Tick, no_tick
from dynmap_cli.segmentation.large_changes import large_changes
from dynmap_cli.segmentation.recurring import occasions, recurring_cells
from dynmap_cli.segmentation.windows import WindowRecord, Windows, windows_of

_MIN_WINDOWS, _MIN_WINDOW_SHARE = 2, 0.1
_STANDING_SHARE = 0.7
Values = TypeVar("Values", bound=np.generic)


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
    windows : Windows
        Those with scans in them.
    """

    surface: SurfaceCells
    record: WindowRecord
    large: B1
    windows: Windows

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
        return self._on_map(found | self.large if self.is_short else found)

    @property
    def standing(self) -> I8:
        """(rows, cols) int8, 1 where a cell is occupied in at least 70 % of the windows that know it."""
        return self._on_map(_stands(self.record).astype(np.int8))

    def recurring(self, explained: list[I64]) -> B1:
        """(rows, cols) cells of what comes back to the same spot, hours apart; none beside cells (n, 2) that change."""
        others = np.concatenate([np.empty((0, 2), dtype=np.int64), *explained])
        found = recurring_cells(
            self.surface, self.record, occasions(self.windows.starts_ns), _stands(self.record), others
        )
        return self._on_map(found)

    @property
    def is_short(self) -> bool:
        """Whether the log is so short that two windows are enough."""
        return self.windows_needed == _MIN_WINDOWS

    def _on_map(self, values: NDArray[Values]) -> NDArray[Values]:
        """(rows, cols) with the values (n,) of the surface cells; 0 elsewhere."""
        found = np.zeros(self.surface.frame.shape, dtype=values.dtype)
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
    *,
    threads: int = 1,
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
    threads : int
    """
    windows = time_windows(log, window_s)
    surface = surface_cells(log, poses, frame, windows, params)
    record = WindowRecord(surface.cells.shape[0])
    for look in judged_looks(log, poses, windows, surface, params, on_window, threads=threads):
        record.add(look.seen, look.states)
    large = large_changes(surface, record, _stands(record))
    return Contradictions(surface, record, large, windows_of(log, poses, windows, window_s))
