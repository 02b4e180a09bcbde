"""What each time window saw of the cells that may have been occupied at some time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, I8, I64, U8
from dynmap_cli.domain.grid import FREE, OCCUPIED
from dynmap_cli.domain.scans import ScanLog

_MOST_APART = 1.5


@dataclass(frozen=True, slots=True)
class Windows:
    """When the windows were, and where the robot was.

    Attributes
    ----------
    starts_ns : (n,) int64
        Stamp of the first scan of each.
    follows : (n,) bool
        Whether it begins where the one before it ended.
    places_m : (n, 2) float64
        Median x, y of the robot; inf where no pose is known.
    """

    starts_ns: I64
    follows: B1
    places_m: F64

    @property
    def count(self) -> int:
        """How many there are."""
        return self.starts_ns.size


def windows_of(log: ScanLog, poses: F64, windows: Sequence[slice], window_s: float) -> Windows:
    """Say when windows of scans were, and where the robot was; poses (n_scans, 3) are map_from_robot."""
    starts = np.array([log.stamps_ns[window.start] for window in windows], dtype=np.int64)
    since_s = np.diff(starts) * 1e-9
    follows = np.zeros(starts.size, dtype=bool)
    follows[1:] = (since_s > 0.0) & (since_s <= _MOST_APART * window_s)
    places = np.full((starts.size, 2), np.inf)
    for number, window in enumerate(windows):
        known = poses[window, :2][np.isfinite(poses[window]).all(axis=1)]
        if known.size:
            places[number] = np.median(known, axis=0)
    return Windows(starts, follows, places)


class WindowRecord:
    """What each window saw of the surface cells: one bit per cell and kind, and the last window of either kind.

    Attributes
    ----------
    occupied, free : (n,) int64
        In how many windows each cell was seen so.
    last_occupied, last_free : (n,) int32
        The last window that saw it so, -1 = none.
    """

    def __init__(self, n_cells: int) -> None:
        self.occupied, self.free = (np.zeros(n_cells, dtype=np.int64) for _ in range(2))
        self.last_occupied, self.last_free = (np.full(n_cells, -1, dtype=np.int32) for _ in range(2))
        self._bits: list[tuple[U8, U8]] = []

    def add(self, seen: I64, states: I8) -> None:
        """Count the states (m,) of the cells *seen* (m,) in the next window."""
        occupied, free = seen[states == OCCUPIED], seen[states == FREE]
        self.occupied[occupied] += 1
        self.free[free] += 1
        self.last_occupied[occupied] = self.last_free[free] = len(self._bits)
        self._bits.append((self._packed(occupied), self._packed(free)))

    def window(self, number: int) -> tuple[B1, B1]:
        """Whether each cell was seen occupied, and free, in a window."""
        count = self.occupied.size
        occupied, free = (np.unpackbits(bits, count=count).astype(bool) for bits in self._bits[number])
        return occupied, free

    def _packed(self, cells: I64) -> U8:
        """Numbers of cells as bits."""
        mask = np.zeros(self.occupied.size, dtype=bool)
        mask[cells] = True
        return np.packbits(mask)

    def cells_shown(self, group_of: I64, n_groups: int) -> I64:
        """How many cells of each group each window saw occupied, and free: (2, n_windows, n_groups).

        Parameters
        ----------
        group_of : (n,) int64
            Number of the group of each cell, -1 = none.
        n_groups : int
        """
        cells = np.flatnonzero(group_of >= 0)
        shown = np.zeros((2, len(self._bits), n_groups), dtype=np.int64)
        for number in range(len(self._bits)):
            for kind, seen in enumerate(self.window(number)):
                shown[kind, number] = np.bincount(group_of[cells[seen[cells]]], minlength=n_groups)
        return shown
