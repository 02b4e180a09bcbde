"""Which doors and boxes visibly changed in a simulated recording: from the truth, by none of the program's rules.

For every cell on which beams ended that truly hit an object, and every scan, the beam towards the middle of the cell
is looked up: it ended there on the object, or well behind. What windows of half a minute say is counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.domain.poses import compose
from dynmap_cli.domain.scans import ScanLog, end_points
from dynmap_cli.evaluation.truth import Truth

CELL_M, WINDOW_S, REACH_M, BEHIND_M = 0.05, 30.0, 12.0, 0.3
LEAST_CELLS, LEAST_HITS, LEAST_PASSES = 6, 3, 5
_SCANS_AT_ONCE = 4096


@dataclass(frozen=True, slots=True)
class Change:
    """An object that was seen in a place, and the place without it.

    Attributes
    ----------
    name : str
    often_m, once_m : (n, 2) float64
        Cells, frame of the truth, that were seen so in two windows each, and in one each.
    """

    name: str
    often_m: F64
    once_m: F64

    @property
    def is_seen_often(self) -> bool:
        """Whether it visibly changed, by two windows of either kind."""
        return self.often_m.shape[0] >= LEAST_CELLS

    @property
    def is_seen_once(self) -> bool:
        """Whether it visibly changed, by one window of either kind."""
        return self.once_m.shape[0] >= LEAST_CELLS


def visible_changes(log: ScanLog, truth: Truth) -> list[Change]:
    """What changed before the eyes of the robot, object by object.

    Parameters
    ----------
    log : ScanLog
        Scans of the recording of this truth, one for one; one laser.
    truth : Truth
    """
    window = (log.stamps_ns - log.stamps_ns[0]) // round(WINDOW_S * 1e9)
    found = []
    for number, thing in enumerate(truth.objects):
        states = truth.object_states[:, number]
        hit = (truth.beam_class == truth.first_object + number) & (log.ranges_m <= REACH_M)
        scan = np.nonzero(hit)[0]
        if scan.size == 0 or np.unique(states).size < 2:
            continue
        points = end_points(log, truth.trajectory.poses, hit)
        cells = np.floor(points / CELL_M).astype(np.int64)
        often, once = [], []
        for state in np.unique(states[scan]):
            own = states[scan] == state
            places, occupied = _occupied_windows(cells[own], window[scan[own]])
            away = np.flatnonzero(states != state)
            free = _free_windows(log, truth, places, away, window[away])
            often.append(places[(occupied >= 2) & (free >= 2)])
            once.append(places[(occupied >= 1) & (free >= 1)])
        centres = [(np.concatenate(kind) + 0.5) * CELL_M for kind in (often, once)]
        found.append(Change(thing.name, *centres))
    return found


def _occupied_windows(cells: I64, window: I64) -> tuple[I64, I64]:
    """Cells (n, 2) that were hit, and in how many windows (n,) often enough."""
    keys, hits = np.unique(np.column_stack([cells, window]), axis=0, return_counts=True)
    keys = keys[hits >= LEAST_HITS]
    return np.unique(keys[:, :2], axis=0, return_counts=True)


def _free_windows(log: ScanLog, truth: Truth, cells: I64, scans: I64, window: I64) -> I64:
    """In how many windows (n,) beams of some scans went well beyond each cell, and none hit anything near it."""
    passes, stops = (
        np.zeros((cells.shape[0], int(window.max(initial=-1)) + 1), dtype=np.int64) for _ in range(2)
    )
    middle = (cells + 0.5) * CELL_M
    for first in range(0, scans.size, _SCANS_AT_ONCE):
        part = slice(first, first + _SCANS_AT_ONCE)
        passed, stopped = _sight(log, truth, middle, scans[part])
        for seen, counts in ((passed, passes), (stopped, stops)):
            row, col = np.nonzero(seen)
            np.add.at(counts, (col, window[part][row]), 1)
    return np.asarray(((passes >= LEAST_PASSES) & (stops == 0)).sum(axis=1))


def _sight(log: ScanLog, truth: Truth, points: F64, scans: I64) -> tuple[B1, B1]:
    """Whether each scan saw beyond each point, and whether its beam ended near it; (n_scans, n_points) each."""
    (sensor,) = log.sensor_poses
    bearings = log.bearings_rad[0]
    poses = compose(truth.trajectory.poses[scans], sensor)
    offset = points[None, :, :] - poses[:, None, :2]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - poses[:, None, 2]
    bearing = (bearing + np.pi) % (2.0 * np.pi) - np.pi
    step = float(bearings[1] - bearings[0])
    beam = np.clip(np.rint((bearing - bearings[0]) / step).astype(np.int64), 0, bearings.size - 1)
    meets = (np.abs(bearing - bearings[beam]) * distance <= CELL_M / 2.0) & (distance <= REACH_M)
    beyond = log.ranges_m[scans[:, None], beam] - distance
    return meets & (beyond >= BEHIND_M), meets & (np.abs(beyond) < 1.5 * CELL_M)
