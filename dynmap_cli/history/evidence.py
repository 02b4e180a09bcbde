"""The contradicting evidence of one sub-map: what each time window saw of its contested cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.counting.evidence import Evidence, EvidenceParams, surface_cells
from dynmap_cli.counting.looks import time_windows
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.domain.submaps import SubMap


@dataclass(frozen=True, slots=True)
class WindowEvidence:
    """What the scans of a window say of the contested cells of a sub-map.

    Attributes
    ----------
    start_ns, end_ns : int
        Stamps of its first and last scan from which the sub-map is in reach.
    occupied, free : int
        Contested cells that were judged so; of the others it says nothing.
    hits : int
        Beams that ended in a contested cell.
    passed_cells : float
        Length of the beams that crossed the surface in a contested cell, in cells.
    """

    start_ns: int
    end_ns: int
    occupied: int
    free: int
    hits: int
    passed_cells: float


@dataclass(frozen=True, slots=True)
class SubMapEvidence:
    """The evidence of all windows.

    Attributes
    ----------
    windows : tuple of WindowEvidence
        Those that judged a contested cell, in time order.
    occupied, free : (n_contested,) int64
        In how many windows each contested cell was seen so.
    """

    windows: tuple[WindowEvidence, ...]
    occupied: I64
    free: I64


def evidence_of(
    log: ScanLog, poses: F64, submap: SubMap, window_s: float, params: EvidenceParams
) -> SubMapEvidence:
    """Judge the contested cells of a sub-map in each window, as segmentation did on the whole map.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot.
    submap : SubMap
    window_s : float
    params : EvidenceParams
    """
    reach = params.reach_cells(submap.frame.resolution_m)
    rows, cols = submap.frame.shape
    frame = submap.frame.window(-reach, -reach, rows + 2 * reach, cols + 2 * reach)
    windows = _windows_in_reach(log, poses, submap, window_s, params.max_range_m)
    surface = surface_cells(log, poses, frame, windows, params)
    numbers = surface.index[reach : reach + rows, reach : reach + cols][submap.contested]
    occupied, free = (np.zeros(numbers.size, dtype=np.int64) for _ in range(2))
    own = numbers[numbers >= 0]
    evidence, found = Evidence(surface, params), []
    for scans in windows:
        evidence.add(log.select(scans), poses[scans])
        states = np.append(evidence.states(), np.int8(UNKNOWN))[numbers]
        occupied += states == OCCUPIED
        free += states == FREE
        if (states != UNKNOWN).any():
            found.append(
                WindowEvidence(
                    int(log.stamps_ns[scans[0]]),
                    int(log.stamps_ns[scans[-1]]),
                    int((states == OCCUPIED).sum()),
                    int((states == FREE).sum()),
                    int(evidence.hits[own].sum()),
                    float(evidence.crossed[own].sum()),
                )
            )
        evidence.clear()
    return SubMapEvidence(tuple(found), occupied, free)


def _windows_in_reach(
    log: ScanLog, poses: F64, submap: SubMap, window_s: float, max_range_m: float
) -> list[I64]:
    """Scans of each window from which beams may reach the rectangle; windows without are left out."""
    sensor_m = float(np.hypot(log.sensor_poses[:, 0], log.sensor_poses[:, 1]).max(initial=0.0))
    half_diagonal_m = 0.5 * float(np.hypot(*submap.size_m))
    away_m = np.hypot(poses[:, 0] - submap.center_m[0], poses[:, 1] - submap.center_m[1])
    is_near = away_m <= max_range_m + sensor_m + half_diagonal_m + 1.0
    parts = (np.flatnonzero(is_near[window]) + window.start for window in time_windows(log, window_s))
    return [part for part in parts if part.size]
