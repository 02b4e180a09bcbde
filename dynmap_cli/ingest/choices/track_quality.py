"""What can be told of an odometry before scans are registered: does it cover them, and does it move when they do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.domain.poses import between, wrap_angle
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.ingest.raw.columns import picked, spans

_SAME_POSE = 1e-9
_MOVED_M, _SPAN_S = 0.05, 0.5
_JUMP_M, _JUMP_M_PER_S = 1.0, 20.0
_SCANS_PER_CHUNK = 256
_FAST_QUANTILE, _LEAST_STEP_S = 0.99, 1e-3


@dataclass(frozen=True, slots=True)
class TrackQuality:
    """An odometry at the scans.

    Attributes
    ----------
    covered : float
        Share of the scans with a pose.
    turned_rad : float
        Sum of all turns, either way.
    fastest_mps : float
        Speed between scans which one step in a hundred exceeds.
    moving, frozen : int
        Spans of half a second over which the ranges change by more than 5 cm in the median, as when the robot moves;
        and those of them over which the pose stays exactly the same.
    jumps : int
        Steps that are longer than anything drives.
    """

    covered: float
    turned_rad: float
    fastest_mps: float
    moving: int
    frozen: int
    jumps: int


def quality_of(log: ScanLog) -> TrackQuality | None:
    """Judge the odometry of scans in the order of their recording; None where no two scans have a pose."""
    order = np.argsort(log.arrival_index, kind="stable")
    known = order[log.has_odometry[order]]
    if known.size < 2:
        return None
    poses = picked(log.odometry, known)
    steps_m, turned_rad = _steps_of(poses)
    seconds = np.abs(np.diff(log.stamps_ns[known])) * 1e-9
    # Stamps that are wrong make steps short, and speeds infinite.
    seconds = np.maximum(seconds, max(float(np.median(seconds)), _LEAST_STEP_S))
    speeds_mps = steps_m / seconds
    moving, frozen = _moving_and_frozen(log, known)
    return TrackQuality(
        covered=round(known.size / log.n_scans, 5),
        turned_rad=round(turned_rad, 3),
        fastest_mps=round(float(np.quantile(speeds_mps, _FAST_QUANTILE)), 3),
        moving=moving,
        frozen=frozen,
        jumps=jumps_m(log.stamps_ns[known], poses).size,
    )


def _steps_of(poses: F64) -> tuple[F64, float]:
    """Lengths (n - 1,) of the steps between poses (n, 3), and the sum of their turns; in blocks, to save memory."""
    steps_m = np.empty(poses.shape[0] - 1)
    turned_rad = 0.0
    for rows in spans(steps_m.size):
        steps = between(poses[rows], poses[rows.start + 1 : rows.stop + 1])
        steps_m[rows] = np.hypot(steps[:, 0], steps[:, 1])
        turned_rad += float(np.abs(wrap_angle(steps[:, 2])).sum())
    return steps_m, turned_rad


def jumps_m(stamps_ns: I64, poses: F64) -> F64:
    """Lengths of the steps between poses (n, 3) that are longer than anything drives in their time."""
    found = []
    for rows in spans(max(poses.shape[0] - 1, 0)):
        both = slice(rows.start, rows.stop + 1)
        steps_m = np.hypot(*np.diff(poses[both, :2], axis=0).T)
        gaps_s = np.abs(np.diff(stamps_ns[both])) * 1e-9
        found.append(steps_m[steps_m > _JUMP_M + _JUMP_M_PER_S * gaps_s])
    return np.concatenate(found) if found else np.zeros(0)


def _moving_and_frozen(log: ScanLog, known: I64) -> tuple[int, int]:
    """Count spans in which the ranges change, and those of them in which the pose does not; of the usual geometry."""
    usual = np.argmax(np.bincount(log.geometry_index[known]))
    rows = known[log.geometry_index[known] == usual]
    seconds = np.abs(np.diff(log.stamps_ns[rows])) * 1e-9
    period_s = max(float(np.median(seconds)), _LEAST_STEP_S) if seconds.size else _SPAN_S
    rows = rows[:: max(1, round(_SPAN_S / period_s))]
    moves = _ranges_move(log, rows)
    poses = np.asarray(log.odometry[rows], dtype=np.float64)
    stands = (np.abs(between(poses[:-1], poses[1:])) < _SAME_POSE).all(axis=1)
    return int(np.count_nonzero(moves)), int(np.count_nonzero(moves & stands))


def _ranges_move(log: ScanLog, rows: I64) -> B1:
    """(n - 1,) whether the median beam changes by over 5 cm from one of the rows (n,) to the next."""
    result = np.zeros(rows.size - 1, dtype=bool)
    for start in range(0, result.size, _SCANS_PER_CHUNK):
        part = rows[start : start + _SCANS_PER_CHUNK + 1]
        ranges_m = np.array(log.ranges_m[part])
        ranges_m[~np.isfinite(ranges_m)] = np.nan
        change_m = np.abs(np.diff(ranges_m, axis=0))
        is_known = np.isfinite(change_m)
        # The median is above the bound where more than half of the beams with both ranges are.
        above = np.count_nonzero(change_m > _MOVED_M, axis=1)
        result[start : start + part.size - 1] = 2 * above > np.count_nonzero(is_known, axis=1)
        give_back(log.ranges_m)
    return result
