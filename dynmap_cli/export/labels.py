"""The labels of a run, found again for each message of its recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynmap_cli.arrays import B1, F32, F64
from dynmap_cli.domain.mapped import copied_rows
from dynmap_cli.domain.patches import PatchSet
from dynmap_cli.domain.scans import ScanLog, end_points

DYNAMIC_BELOW = 0.5
UNKNOWN = np.float32(0.5)
"""What a label says of a beam that hit what was seen too little to tell: even odds, and kept."""
LABEL_SUFFIX = "/static_probability"
_REFLECTS = 0.2
_SUPPORT_M = 0.075


class BeamLabels:
    """Static probability of each beam, and which beams are removed; rows are found by stamp and ranges.

    Two lasers may stamp alike, and a recording may hold a sweep twice, so the ranges decide.

    Parameters
    ----------
    log : ScanLog
    static_probability : (n_scans, n_beams) float32
    is_unknown, is_kept : (n_scans, n_beams) bool, optional
        Beams that were seen too little to tell, and beams that are kept however small e is; none without them.
    """

    def __init__(
        self, log: ScanLog, static_probability: F32, is_unknown: B1 | None = None, is_kept: B1 | None = None
    ) -> None:
        self._log, self._static_probability = log, static_probability
        self._is_unknown, self._is_kept = is_unknown, is_kept
        self._n_beams = np.isfinite(log.bearings_rad).sum(axis=1)
        self._rows: dict[int, list[int]] = {}
        for row, stamp_ns in enumerate(log.stamps_ns.tolist()):
            self._rows.setdefault(stamp_ns, []).append(row)
        self.was_found = np.zeros(log.n_scans, dtype=bool)

    @property
    def missing(self) -> int:
        """Sweeps that were not found in recordings of the run of which others were, or all if none was."""
        recordings = self._log.recording_index
        is_there = np.isin(recordings, recordings[self.was_found]) if self.was_found.any() else True
        return int((~self.was_found & is_there).sum())

    @property
    def drives(self) -> tuple[str, ...]:
        """Names of the recordings of each drive of which sweeps were found."""
        numbers = np.unique(self._log.drive_index[self.was_found]).tolist()
        return tuple(", ".join(self._log.recordings_of(number)) for number in numbers)

    def row_of(self, stamp_ns: int, ranges_m: F32) -> int | None:
        """Row of the sweep with this stamp and these ranges (n_beams,), None where the run has none."""
        for row in self._rows.get(stamp_ns, ()):
            if self._n_beams[self._log.geometry_index[row]] != ranges_m.size:
                continue
            kept = copied_rows(self._log.ranges_m, row)[: ranges_m.size]
            if np.array_equal(kept[np.isfinite(kept)], ranges_m[np.isfinite(kept)]):
                self.was_found[row] = True
                return row
        return None

    def removed(self, row: int, n_beams: int) -> B1:
        """(n_beams,) whether each beam of a sweep is removed."""
        is_removed = copied_rows(self._static_probability, row)[:n_beams] < DYNAMIC_BELOW
        return (
            is_removed if self._is_kept is None else is_removed & ~copied_rows(self._is_kept, row)[:n_beams]
        )

    def n_ended(self, row: int, n_beams: int) -> int:
        """How many beams of a sweep have an end point."""
        return int(np.count_nonzero(np.isfinite(copied_rows(self._static_probability, row)[:n_beams])))

    def static_probability(self, row: int, n_beams: int) -> F32:
        """(n_beams,) e of each beam of a sweep, 1/2 = unknown, NaN where it has no end point."""
        e: F32 = copied_rows(self._static_probability, row)[:n_beams]
        if self._is_unknown is not None:
            e[copied_rows(self._is_unknown, row)[:n_beams]] = UNKNOWN
        return e


def hits_known_state(log: ScanLog, poses: F64, chosen: B1, patch_sets: Sequence[PatchSet]) -> B1:
    """(n_scans, n_beams) which of the chosen beams end where a state of some sub-map reflects.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot.
    chosen : (n_scans, n_beams) bool
        Beams that have an end point.
    patch_sets : sequence of PatchSet
    """
    points = end_points(log, poses, chosen)
    found = np.zeros(points.shape[0], dtype=bool)
    for patch_set in patch_sets:
        found |= _ends_on(points, patch_set)
    result = np.zeros(chosen.shape, dtype=bool)
    result[chosen] = found
    return result


def _ends_on(points_m: F64, patch_set: PatchSet) -> B1:
    """(n,) whether a point lies in, or beside, a cell that reflects in some state."""
    values = np.stack([np.nan_to_num(patch.reflectance) for patch in patch_set.patches])
    frame, reflects = patch_set.frame, np.asarray(values.max(axis=0) >= _REFLECTS)
    found = np.zeros(points_m.shape[0], dtype=bool)
    reach = max(1, round(_SUPPORT_M / frame.resolution_m))
    base = frame.to_cells(points_m)
    for step in np.ndindex(2 * reach + 1, 2 * reach + 1):
        cells = base + np.array(step) - reach
        inside = ((cells >= 0) & (cells < np.array(frame.shape))).all(axis=1)
        found[inside] |= reflects[cells[inside, 0], cells[inside, 1]]
    return found
