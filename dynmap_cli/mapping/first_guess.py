"""Which beams hit something that moves, before any scan is registered: by the odometry of a few seconds.

Rounds of registration and filtering (Fig. 1.2 of the paper) settle at the nearest optimum. A crowd that goes with the
robot, or streams past it, can carry the first registration along, by metres, and poses that go with the crowd keep it
in the map. Over a few seconds odometry is good enough to see who moves, so in a crowd the rounds begin with the E-step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F32, I64
from dynmap_cli.counting.counts import SCANS_PER_CHUNK
from dynmap_cli.counting.em import FilterParams, count_ended, filter_beams
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.domain.mapped import copied_rows, give_back
from dynmap_cli.domain.poses import between
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.files.tables import new_table
from dynmap_cli.scan_matching.sweeps import times_of

_WINDOW_S = 8.0
_CELL_M = 0.2
"""Wide enough for what odometry that is not calibrated yet goes wrong in a window."""
_STATIC_PRIOR = 0.9
"""Dynamic is what less than 20 % of the beams that reach its place are reflected by."""
_REACH_M = 20.0
_FARTHEST_M = 300.0
"""Odometry that goes further in a window has jumped, and says nothing there."""
_CROWD_SHARE = 0.1
_MOST_JUDGED = 24
"""So many windows, spread over the recording, tell whether there is a crowd."""


def crowd_weights(log: ScanLog, usable_m: float, *, threads: int, folder: Path | None = None) -> F32 | None:
    """(n_scans, n_beams) e by the odometry of each window of time, NaN = not known; None where there is no crowd.

    On recordings of offices and halls 1 to 5 % of the beams are called dynamic here, in crowds 15 % and more.

    Parameters
    ----------
    log : ScanLog
    usable_m : float
        Beams are used up to this range, and up to 20 m.
    threads : int
    folder : Path, optional
        Where a large table is kept.
    """
    params = FilterParams(_STATIC_PRIOR, 1, min(usable_m, _REACH_M))
    windows = _windows(log, 0.0)
    every = max(1, -(-len(windows) // _MOST_JUDGED))
    ended, dynamic = np.sum(
        [count_ended(e) for _, e in _judged(log, windows[::every], params, threads)] or [(0, 0)], axis=0
    )
    if dynamic <= _CROWD_SHARE * ended:
        return None
    weights = new_table(log.n_scans, log.n_beams, folder)
    for first in range(0, log.n_scans, SCANS_PER_CHUNK):
        weights[first : first + SCANS_PER_CHUNK] = np.nan
        give_back(weights)
    # Of several windows the one counts in which a beam seems to move most. Where somebody was before a window began
    # is seen in the one that began earlier.
    for begun_s in (0.0, 0.5 * _WINDOW_S):
        for rows, e in _judged(log, _windows(log, begun_s), params, threads):
            weights[rows] = np.fmin(copied_rows(weights, rows), e)
            give_back(weights)
    return weights


def _judged(
    log: ScanLog, windows: Sequence[I64], params: FilterParams, threads: int
) -> Iterator[tuple[I64, F32]]:
    """Rows of each window, and e of their beams, filtered in the frame of its first scan."""
    for rows in windows:
        part = log.select(rows)
        poses = between(part.odometry[0], part.odometry)
        if np.ptp(poses[:, :2], axis=0).max() > _FARTHEST_M:
            continue
        frame = frame_of_scans(part, poses, params.usable_range_m, _CELL_M)
        yield rows, filter_beams(part, poses, frame, params, threads=threads).static_probability


def _windows(log: ScanLog, begun_s: float) -> list[I64]:
    """Ascending rows of the scans of each window of time that have odometry; the first one began some time before.

    Windows end with their drive.
    """
    order = np.argsort(log.arrival_index, kind="stable")
    window = np.floor((times_of(log) + begun_s) / _WINDOW_S)
    known = np.isfinite(log.odometry[order]).all(axis=1)
    order, window = order[known], window[known]
    drive = log.drive_index[order]
    parts = np.split(order, np.flatnonzero((np.diff(window) != 0) | (np.diff(drive) != 0)) + 1)
    return [np.sort(rows) for rows in parts if rows.size]
