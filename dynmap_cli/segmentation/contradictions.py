"""Which cells were seen occupied at one time and free at another (paper, 1.3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, I8, I64
from dynmap_cli.counting.evidence import EvidenceParams
from dynmap_cli.counting.looks import count_looks
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.progress import Tick, no_tick

_MIN_WINDOWS, _MIN_WINDOW_SHARE = 2, 0.1
_STANDING_SHARE = 0.7


@dataclass(frozen=True, slots=True)
class Contradictions:
    """In how many time windows each cell was seen occupied, and free.

    Attributes
    ----------
    frame : GridFrame
    occupied, free : (rows, cols) int64
        Numbers of windows; the others said nothing of the cell.
    n_windows : int
        Windows with scans in them.
    """

    frame: GridFrame
    occupied: I64
    free: I64
    n_windows: int

    @property
    def windows_needed(self) -> int:
        """How often a cell must be seen in either state.

        Two windows rule out people who stand. On a long log a fixed two lets noise in, hence 10 % of the
        windows that usually (median) know a cell which was occupied at some time.
        """
        known = (self.occupied + self.free)[(self.occupied > 0) & (self.occupied + self.free >= _MIN_WINDOWS)]
        usual = float(np.median(known)) if known.size else 0.0
        return max(_MIN_WINDOWS, int(np.ceil(_MIN_WINDOW_SHARE * usual)))

    @property
    def contested(self) -> B1:
        """(rows, cols) whether a cell was seen occupied and free often enough."""
        return np.asarray(np.minimum(self.occupied, self.free) >= self.windows_needed)

    @property
    def standing(self) -> I8:
        """(rows, cols) int8, 1 where a cell is occupied in at least 70 % of the windows that know it."""
        known = self.occupied + self.free
        return ((self.occupied > 0) & (self.occupied >= _STANDING_SHARE * known)).astype(np.int8)


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
    looks = count_looks(log, poses, frame, window_s, params, on_window)
    occupied, free = (np.zeros(frame.shape, dtype=np.int64) for _ in range(2))
    row, col = looks.surface.cells.T
    occupied[row, col] = looks.occupied
    free[row, col] = looks.free
    return Contradictions(frame, occupied, free, looks.n_looks)
