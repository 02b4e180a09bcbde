"""What can be told of an odometry before scans are registered: does it cover them, and does it move when they do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.domain.poses import between, wrap_angle
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.ingest.raw.columns import counts_of, known_rows, picked, spans

_SAME_POSE = 1e-9
_MOVED_M, _SPAN_S = 0.05, 0.5
_JUMP_M, _JUMP_M_PER_S = 1.0, 20.0
_SCANS_PER_CHUNK = 64
"""The rows lie far apart, and the system maps some 300 kB around each that is read from a file."""
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
    known = np.argsort(log.arrival_index, kind="stable")
    has_pose = picked(known_rows(log.odometry), known)
    if not has_pose.all():
        known = known[has_pose]
    if known.size < 2:
        return None
    poses, stamps_ns = picked(log.odometry, known), picked(log.stamps_ns, known)
    speeds_mps, turned_rad = _steps_of(poses)
    # Stamps that are wrong make steps short, and speeds infinite.
    least_s = max(float(np.median(_seconds_of(stamps_ns), overwrite_input=True)), _LEAST_STEP_S)
    for rows in spans(speeds_mps.size, stamps_ns):
        seconds = np.abs(np.diff(stamps_ns[rows.start : rows.stop + 1])) * 1e-9
        speeds_mps[rows] /= np.maximum(seconds, least_s)
    fastest_mps = float(np.quantile(speeds_mps, _FAST_QUANTILE, overwrite_input=True))
    del speeds_mps
    moving, frozen = _moving_and_frozen(log, known)
    return TrackQuality(
        covered=round(known.size / log.n_scans, 5),
        turned_rad=round(turned_rad, 3),
        fastest_mps=round(fastest_mps, 3),
        moving=moving,
        frozen=frozen,
        jumps=jumps_m(stamps_ns, poses).size,
    )


def _seconds_of(stamps_ns: I64) -> F64:
    """(n - 1,) times between stamps (n,), whichever comes first; in blocks, to save memory."""
    seconds = np.empty(max(stamps_ns.size - 1, 0))
    for rows in spans(seconds.size, stamps_ns):
        seconds[rows] = np.abs(np.diff(stamps_ns[rows.start : rows.stop + 1])) * 1e-9
    return seconds


def _steps_of(poses: F64) -> tuple[F64, float]:
    """Lengths (n - 1,) of the steps between poses (n, 3), and the sum of their turns; in blocks, to save memory."""
    steps_m = np.empty(poses.shape[0] - 1)
    turned_rad = 0.0
    for rows in spans(steps_m.size, poses):
        steps = between(poses[rows], poses[rows.start + 1 : rows.stop + 1])
        steps_m[rows] = np.hypot(steps[:, 0], steps[:, 1])
        turned_rad += float(np.abs(wrap_angle(steps[:, 2])).sum())
    return steps_m, turned_rad


def jumps_m(stamps_ns: I64, poses: F64) -> F64:
    """Lengths of the steps between poses (n, 3) that are longer than anything drives in their time."""
    found = []
    for rows in spans(max(poses.shape[0] - 1, 0), stamps_ns, poses):
        both = slice(rows.start, rows.stop + 1)
        steps_m = np.hypot(*np.diff(poses[both, :2], axis=0).T)
        gaps_s = np.abs(np.diff(stamps_ns[both])) * 1e-9
        found.append(steps_m[steps_m > _JUMP_M + _JUMP_M_PER_S * gaps_s])
    return np.concatenate(found) if found else np.zeros(0)


def known_jumps_m(stamps_ns: I64, poses: F64) -> F64:
    """The same of those of the poses (n, 3) that are known."""
    is_known = known_rows(poses)
    if is_known.all():
        return jumps_m(stamps_ns, poses)
    return jumps_m(stamps_ns[is_known], poses[is_known])


def _moving_and_frozen(log: ScanLog, known: I64) -> tuple[int, int]:
    """Count spans in which the ranges change, and those of them in which the pose does not; of the usual geometry."""
    geometry = picked(log.geometry_index, known)
    is_usual = geometry == np.argmax(counts_of(geometry, log.sensor_poses.shape[0]))
    rows = known if is_usual.all() else known[is_usual]
    seconds = _seconds_of(picked(log.stamps_ns, rows))
    period_s = (
        max(float(np.median(seconds, overwrite_input=True)), _LEAST_STEP_S) if seconds.size else _SPAN_S
    )
    del seconds
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
