"""Observation sequences: the stretches of a log in which the robot is at a sub-map (Eq. 1.16, 1.17)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.scans import ScanLog


@dataclass(frozen=True, slots=True)
class SequenceParams:
    """Where sequences are cut.

    Attributes
    ----------
    near_m : float
        The robot is in a sub-map within this distance of its rectangle. The literal reading, inside, loses
        every door: the rectangle of a door is never entered.
    length_s : float
        A longer stay becomes several sequences.
    gap_s : float
        Shorter absences end no sequence.
    min_scans : int
    """

    near_m: float = 2.0
    length_s: float = 30.0
    gap_s: float = 2.0
    min_scans: int = 8


def distance_to(frame: GridFrame, points_m: F64) -> F64:
    """Distance of points (n, 2) from a rectangle, metres; 0 inside, NaN for NaN."""
    low = np.array([frame.origin_x_m, frame.origin_y_m])
    high = low + np.array([frame.cols, frame.rows]) * frame.resolution_m
    outside = np.maximum(np.maximum(low - points_m, points_m - high), 0.0)
    return np.asarray(np.hypot(outside[:, 0], outside[:, 1]))


def cut_sequences(log: ScanLog, poses: F64, frame: GridFrame, params: SequenceParams) -> list[I64]:
    """Scans of each observation sequence of a rectangle, in time order.

    A sequence starts on entering (within `near_m`), and ends on leaving, after `length_s`, and with the
    recording.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot.
    frame : GridFrame
        The rectangle.
    params : SequenceParams

    Returns
    -------
    list of (n,) int64
        Indices of scans.
    """
    near = np.flatnonzero(distance_to(frame, poses[:, :2]) <= params.near_m)
    if near.size == 0:
        return []
    stamps, recording = log.stamps_ns[near], log.recording_index[near]
    left = (np.diff(stamps) > params.gap_s * 1e9) & ~_is_next_scan(near)
    stays = np.split(near, np.flatnonzero(left | (np.diff(recording) != 0)) + 1)
    sequences = [part for stay in stays for part in _cut_by_time(log.stamps_ns[stay], stay, params.length_s)]
    return [part for part in sequences if part.size >= params.min_scans]


def _is_next_scan(scans: I64) -> B1:
    """Whether nothing was recorded between neighbours; then nobody left, the laser was slow."""
    return np.asarray(np.diff(scans) == 1)


def _cut_by_time(stamps_ns: I64, scans: I64, length_s: float) -> list[I64]:
    """Parts of a stay, a new one each *length_s* seconds."""
    number = (stamps_ns - stamps_ns[0]) // round(length_s * 1e9)
    return np.split(scans, np.flatnonzero(np.diff(number)) + 1)
