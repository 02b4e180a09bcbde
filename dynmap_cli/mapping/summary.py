"""What was found of path, map and moving beams, as numbers and as sentences."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.counting.em import count_ended
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.mapping.back_end import Graph
from dynmap_cli.mapping.graph_files import rejected_by_reason
from dynmap_cli.mapping.registrar import Registrar
from dynmap_cli.mapping.rounds import FilterMap
from dynmap_cli.mapping.warnings import (
    warn_of_bent_path,
    warn_of_carries,
    warn_of_contradictions,
    warn_of_corridors,
    warn_of_lost_scans,
    warn_of_missing_loops,
    warn_of_odometry,
    warn_of_wheels,
)
from dynmap_cli.scan_matching.odometry import corrected_motion
from dynmap_cli.scan_matching.sweeps import times_of
from dynmap_cli.scan_matching.wheel_faults import without_steps


def _path_length_m(log: ScanLog, poses: F64) -> float:
    """Distance travelled in the drives, along the order in which the sweeps were made."""
    order = np.argsort(log.arrival_index, kind="stable")
    steps = np.linalg.norm(np.diff(poses[order, :2], axis=0), axis=1)
    return float(steps[np.diff(log.drive_index[order]) == 0].sum())


def summarize(log: ScanLog, result: FilterMap, usable_range_m: float) -> dict[str, Any]:
    """What was found, as numbers and as sentences."""
    filtered = result.filtered
    frame = filtered.counting_map.frame
    ended, _ = count_ended(filtered.static_probability)
    summary: dict[str, Any] = {
        "scans": log.n_scans,
        "drives": log.n_drives,
        "path_m": round(_path_length_m(log, result.trajectory.poses), 2),
        "rounds": len(result.rounds),
        "dynamic_share": round(filtered.dynamic_share, 5),
        "unknown_share": round(filtered.unknown_share, 5),
        "log_likelihood": round(filtered.log_likelihood, 3),
        "size_m": [round(frame.cols * frame.resolution_m, 2), round(frame.rows * frame.resolution_m, 2)],
    }
    in_drives = f" in {log.n_drives} drives" if log.n_drives > 1 else ""
    lines = [
        f"{log.n_scans} scans along {summary['path_m']:.1f} m{in_drives}, map of "
        f"{summary['size_m'][0]:.1f} m x {summary['size_m'][1]:.1f} m",
        f"{100 * filtered.dynamic_share:.2f} % of {ended} beams with a return hit something that moves",
    ]
    if filtered.unknown_share > 0.0:
        lines.append(
            f"{100 * filtered.unknown_share:.2f} % hit small things that were seen too little to tell"
        )
    if result.matched_range_m > usable_range_m:
        lines.append(
            f"returns were matched up to {result.matched_range_m:.0f} m, as many scans see hardly anything within "
            f"{usable_range_m:g} m"
        )
    if result.graph is not None:
        found, said = _registration_summary(log, result, result.graph)
        summary |= found
        lines += said
    return {**summary, "lines": lines}


def _registration_summary(log: ScanLog, result: FilterMap, graph: Graph) -> tuple[dict[str, Any], list[str]]:
    """What became of odometry, scans and loops."""
    rejected, n_loops = rejected_by_reason(graph), len(graph.loops)
    found = {
        "lost_scans": sum(int(drive.front.is_lost.sum()) for drive in result.drives if drive.front),
        "loops": n_loops,
        "rejected_loops": rejected,
        "contradictions": round(graph.contradictions, 4),
        "calibrations": [_rounded(asdict(drive.calibration)) for drive in result.drives],
        "wheel_faults": [_rounded(asdict(fault)) for drive in result.drives for fault in drive.wheel_faults],
        "carried_s": [_carried_s(drive) for drive in result.drives],
    }
    lines: list[str] = []
    warnings: list[str] = []
    for number, drive in enumerate(result.drives):
        whose = f"{', '.join(log.recordings_of(number))}: " if log.n_drives > 1 else ""
        lines += [whose + sentence for sentence in _drive_lines(drive)]
        poses = result.trajectory.poses[log.drive_index == number]
        warnings += [whose + sentence for sentence in _drive_warnings(drive, poses, n_loops)]
    reasons = ", ".join(f"{count} for {reason}" for reason, count in rejected.items())
    lines.append(
        f"{n_loops} loops closed, {len(graph.rejected)} rejected" + (f": {reasons}" if reasons else "")
    )
    warnings += [*warn_of_missing_loops(graph.poses, n_loops), *warn_of_contradictions(graph.contradictions)]
    return found, lines + [f"warning: {sentence}" for sentence in warnings]


def _drive_lines(drive: Registrar) -> list[str]:
    """How the odometry and the sweeps of a drive are to be read."""
    lines = [drive.calibration.sentence()] if drive.log.has_odometry.any() else []
    lines += [mounting.sentence() for mounting in drive.mountings]
    if drive.believed_share < 1.0:
        lines.append(
            f"poses by scans of different lasers are {1.0 / np.sqrt(drive.believed_share):.1f} times as far from one "
            "another as the matches say; each scan is believed that much less against the odometry"
        )
    if drive.calibration.sweep == "last to first":
        lines.append("sweeps run from the last beam to the first")
    if drive.calibration.is_revolution:
        lines.append(
            "a sweep takes a whole turn of the laser, the time until the next sweep; with the much shorter time "
            "that the recording states, the scans would not fit one another"
        )
    return lines


def _drive_warnings(drive: Registrar, poses: F64, n_loops: int) -> list[str]:
    """What is doubtful about one drive, whose final poses (n_scans, 3) are given in the order of its log."""
    if drive.front is None:
        return []
    log, front = drive.log, drive.front
    has_odometry = bool(log.has_odometry.any())
    order = np.argsort(log.arrival_index, kind="stable")
    motion = corrected_motion(log.odometry[order], times_of(log), drive.calibration)
    believed = without_steps(motion, [fault.steps for fault in drive.wheel_faults])
    return [
        *warn_of_carries(_carried_s(drive)),
        *warn_of_odometry(drive.calibration),
        *warn_of_wheels(drive.wheel_faults),
        *warn_of_corridors(front.poses, front.information, has_odometry=has_odometry),
        *warn_of_bent_path(believed, poses[order], n_loops),
        *warn_of_lost_scans(int(front.is_lost.sum()), log.n_scans, has_odometry=has_odometry),
    ]


def _carried_s(drive: Registrar) -> list[tuple[float, float]]:
    """From when to when the robot seems to have been carried, seconds since the first sweep of the drive."""
    times_s = times_of(drive.log)
    return [
        (round(float(times_s[carry.last_before]), 3), round(float(times_s[carry.first_after]), 3))
        for carry in drive.carries
    ]


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    """The same with at most six decimals."""
    return {key: round(value, 6) if isinstance(value, float) else value for key, value in values.items()}
