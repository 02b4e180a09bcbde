"""Odometry whose positions go another way than its headings say: axes exchanged, a sign, a driver a quarter turn off.

A robot mostly drives along its x axis. Where its odometry says otherwise, the sweeps tell which way it went, for some
drive sideways. But along a bare corridor only people tell it, who walk as they like, or noise. So the sweeps must show
steps as long as those of the odometry, and lie better on one another as they show it, or nothing is said.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I64
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.domain.poses import between, compose, wrap_angle
from dynmap_cli.ingest.choices.frames import Mounting
from dynmap_cli.ingest.choices.merging import Columns
from dynmap_cli.ingest.choices.odometry_sources import Odometry
from dynmap_cli.ingest.raw.columns import counts_of
from dynmap_cli.ingest.raw.laser import ScanShape
from dynmap_cli.ingest.raw.recording import RawRecording
from dynmap_cli.ingest.seen_motion.agreement import agreement_at
from dynmap_cli.ingest.seen_motion.laid_sweeps import share_nearer
from dynmap_cli.ingest.seen_motion.pairs import SweepPairs
from dynmap_cli.ingest.seen_motion.range_flow import C128, LEAST_BEAMS, range_flow
from dynmap_cli.ingest.seen_motion.turns import ScanTurns

_SPAN_S, _LEAST_PERIOD_S = 0.2, 1e-3
_MOST_LOOKED_AT, _MOST_PAIRS, _LEAST_PAIRS = 1000, 200, 25
_STEPS_M, _MOST_TURN_RAD = (0.03, 0.5), 0.1
_ALONG, _ALONG_RAD = 0.8, np.radians(30.0)
_OFF_RAD, _FITS_RAD, _CLEARLY = np.radians(30.0), np.radians(15.0), 0.4
_MOST_RATIO, _MOSTLY = 1.5, 0.7
_LAID_M, _MOST_TIMES, _TELLING = 0.2, 10, 0.3
_QUARTER_RAD, _SNAP_RAD = np.pi / 2.0, np.radians(5.0)
_OTHER_Y, _OTHER_YAW = np.array([1.0, -1.0, 1.0]), np.array([1.0, 1.0, -1.0])


def mend_heading(
    odometry: Odometry, columns: Columns, turns: ScanTurns, mounting: Mounting, recording: RawRecording
) -> Odometry:
    """Bring positions and headings of an odometry together where the sweeps clearly tell how; says so.

    Parameters
    ----------
    odometry : Odometry
    columns : Columns
        Its first laser is the one that is looked at.
    turns : ScanTurns
        Of that laser, as the robot turned.
    mounting : Mounting
        Of that laser.
    recording : RawRecording
        Gets the warning.
    """
    counts = counts_of(columns.geometry_index, len(columns.geometries))
    counts[[laser != 0 for laser, _ in columns.geometries]] = 0
    usual = int(np.argmax(counts))
    has_beams = columns.geometries[usual][1].n_beams >= LEAST_BEAMS
    own = np.flatnonzero((columns.geometry_index == usual) & has_beams)
    numbers, apart = _pairs(columns.stamps_ns[own], odometry.poses[own])
    first, second = odometry.poses[own[numbers]], odometry.poses[own[numbers + apart]]
    if numbers.size < _LEAST_PAIRS or _drives_along(first, second):
        return odometry
    few = np.unique(np.linspace(0, numbers.size - 1, min(_MOST_PAIRS, numbers.size)).astype(np.int64))
    motions, is_known = _motions_by_sweeps(columns, own[numbers[few]], own[numbers[few] + apart], mounting)
    few, motions = few[is_known], motions[is_known]
    numbers, first, second = numbers[few], first[few], second[few]
    moved = motions[:, 0] + 1j * motions[:, 1]
    if numbers.size < _LEAST_PAIRS or not _is_as_fast(moved, first, second):
        return odometry
    off_rad = _off_rad(moved, first, second)
    as_is_rad = float(np.median(np.abs(off_rad)))
    if as_is_rad < _OFF_RAD:
        return odometry
    turned = agreement_at(turns, columns.stamps_ns, odometry.poses)
    signs = _OTHER_YAW if turned.opposite_rad < turned.same_rad else _OTHER_Y
    poses, left_rad, told = _brought_together(odometry.poses, moved, first, second, signs)
    is_simple = left_rad < min(_FITS_RAD, _CLEARLY * as_is_rad)
    times = int(np.clip(round(_LAID_M / float(np.median(np.abs(moved)))), 1, _MOST_TIMES))
    is_there = numbers + times * apart < own.size
    numbers, motions = numbers[is_there], motions[is_there]
    rows, others = own[numbers], own[numbers + times * apart]
    seen = (poses[rows], poses[others]) if is_simple else (0.0 * motions, times * motions)
    if not _lie_better(columns, rows, others, mounting, seen, odometry.poses):
        return odometry
    what = (
        f"odometry {odometry.source}: its positions go {np.degrees(as_is_rad):.0f} deg off the way that its headings "
        f"and the scans show, in the median of {off_rad.size} steps"
    )
    if not is_simple:
        recording.warnings.append(
            f"{what}, and nothing simple mends that; if the map comes out bent, pass --odom none"
        )
        return odometry
    recording.warnings.append(
        f"{what}, as where a driver exchanges axes; mended, {np.degrees(left_rad):.0f} deg are left: changed are "
        f"{' and '.join(told)}"
    )
    return replace(odometry, poses=poses)


def _brought_together(
    poses: F64, moved: C128, first: F64, second: F64, signs: F64
) -> tuple[F64, float, list[str]]:
    """Poses (n, 3) turned, and mirrored by signs (3,) where that is clearly better; what is left, and what is changed.

    Steps go from the poses first (m, 3) to second, and as the sweeps show x + iy = moved (m,) in the robot's frame.
    """
    off_rad, told = _off_rad(moved, first, second), []
    mirrored_rad = _off_rad(moved, first * signs, second * signs)
    poses = poses.copy()
    if _left_rad(mirrored_rad) < _CLEARLY * _left_rad(off_rad):
        off_rad, poses = mirrored_rad, poses * signs
        told.append("the sign of its headings" if signs is _OTHER_YAW else "the sign of its y")
    turn_rad = _snapped(_middle_rad(off_rad))
    poses[:, 2] = wrap_angle(poses[:, 2] - turn_rad)
    if turn_rad:
        told.append(f"its headings by {np.degrees(float(wrap_angle(np.array(-turn_rad)))):+.0f} deg")
    return poses, _left_rad(off_rad), told


def _is_as_fast(moved: C128, first: F64, second: F64) -> bool:
    """Whether the sweeps mostly show steps, moved (m,), as long as those between poses (m, 3).

    People who walk past, and noise, are as fast as they like.
    """
    ratio = np.abs(moved) / np.hypot(*(second - first)[:, :2].T)
    is_near = (ratio > 1.0 / _MOST_RATIO) & (ratio < _MOST_RATIO)
    return bool(np.mean(is_near) > _MOSTLY)


def _lie_better(
    columns: Columns, rows: I64, others: I64, mounting: Mounting, seen: tuple[F64, F64], poses: F64
) -> bool:
    """Whether sweeps (m,) lie clearly better on others by robot poses seen before and after than by poses (n, 3)."""
    before, after, bearings_rad = _sweeps(columns, rows, others, mounting)
    pairs = SweepPairs(before.astype(np.float32), after.astype(np.float32), bearings_rad)
    by_seen, by_poses = (
        between(*(compose(pose, mounting.robot_from_sensor) for pose in both))
        for both in (seen, (poses[rows], poses[others]))
    )
    return share_nearer(pairs, by_seen, by_poses) > _TELLING


def _off_rad(moved: C128, first: F64, second: F64) -> F64:
    """Angles (m,) from the steps between poses (m, 3), in the frame of the robot, to those that the sweeps show."""
    steps = (second[:, 0] - first[:, 0]) + 1j * (second[:, 1] - first[:, 1])
    return np.asarray(np.angle(moved * np.conj(steps * np.exp(-1j * first[:, 2]))))


def _pairs(stamps_ns: I64, poses: F64) -> tuple[I64, int]:
    """Numbers (m,) of sweeps a short and straight step before others, and how many sweeps later these are."""
    n_sweeps = stamps_ns.size
    if n_sweeps <= _LEAST_PAIRS:
        return np.zeros(0, dtype=np.int64), 1
    looks = np.linspace(0, n_sweeps - 2, min(_MOST_LOOKED_AT, n_sweeps - 1)).astype(np.int64)
    period_s = max(float(np.median(stamps_ns[looks + 1] - stamps_ns[looks])) * 1e-9, _LEAST_PERIOD_S)
    apart = min(max(1, round(_SPAN_S / period_s)), n_sweeps - 1)
    looks = np.minimum(looks, n_sweeps - 1 - apart)
    steps = poses[looks + apart] - poses[looks]
    step_m = np.hypot(steps[:, 0], steps[:, 1])
    is_straight = np.abs(wrap_angle(steps[:, 2])) < _MOST_TURN_RAD
    return looks[(step_m > _STEPS_M[0]) & (step_m < _STEPS_M[1]) & is_straight], apart


def _drives_along(first: F64, second: F64) -> bool:
    """Whether a robot drives along its x axis, more forward than back, by poses (m, 3) before and after steps."""
    steps = (second[:, 0] - first[:, 0]) + 1j * (second[:, 1] - first[:, 1])
    return _is_ahead(steps * np.exp(-1j * (first[:, 2] + wrap_angle(second[:, 2] - first[:, 2]) / 2.0)))


def _is_ahead(steps: C128) -> bool:
    """Whether steps (m,) in the frame of the robot lie along its x axis, more of them forward than back."""
    axis = np.sum(np.abs(steps) * np.exp(2j * np.angle(steps))) / np.sum(np.abs(steps))
    is_along = np.abs(axis) > _ALONG and abs(np.angle(axis)) / 2.0 < _ALONG_RAD
    return bool(is_along and steps.real.sum() > 0.0)


def _middle_rad(angles_rad: F64) -> float:
    """The angle from which angles (m,) differ least: the median around their mean direction."""
    mean_rad = float(np.angle(np.exp(1j * angles_rad).sum()))
    return mean_rad + float(np.median(wrap_angle(angles_rad - mean_rad)))


def _left_rad(angles_rad: F64) -> float:
    """Median difference of angles (m,) from their middle."""
    return float(np.median(np.abs(wrap_angle(angles_rad - _middle_rad(angles_rad)))))


def _snapped(angle_rad: float) -> float:
    """A quarter turn or none where an angle is nearly that: axes are exchanged, hardly ever turned a little."""
    quarter_rad = round(angle_rad / _QUARTER_RAD) * _QUARTER_RAD
    return quarter_rad if abs(angle_rad - quarter_rad) < _SNAP_RAD else angle_rad


def _motions_by_sweeps(columns: Columns, rows: I64, others: I64, mounting: Mounting) -> tuple[F64, B1]:
    """How the robot moved between sweeps, x, y, turn (m, 3) in its frame before, and where (m,) that is known."""
    moved, turned_rad, is_known = range_flow(*_sweeps(columns, rows, others, mounting))
    x, y, yaw_rad = mounting.robot_from_sensor
    moved = moved * np.exp(1j * yaw_rad) - (np.exp(1j * turned_rad) - 1.0) * complex(x, y)
    return np.column_stack([moved.real, moved.imag, turned_rad]), is_known


def _sweeps(columns: Columns, rows: I64, others: I64, mounting: Mounting) -> tuple[F64, F64, F64]:
    """Ranges (m, n_beams) of sweeps of one geometry before and after, and bearings (n_beams,) as seen from above."""
    _, shape = columns.geometries[int(columns.geometry_index[rows[0]])]
    before, after = (_returns(columns.ranges_m[picked, : shape.n_beams], shape) for picked in (rows, others))
    give_back(columns.ranges_m)
    return before, after, shape.bearings_rad * (-1.0 if mounting.is_upside_down else 1.0)


def _returns(ranges_m: F32, shape: ScanShape) -> F64:
    """Ranges (m, n_beams), NaN where they are no returns."""
    values = np.asarray(ranges_m, dtype=np.float64)
    values[~((values > shape.range_min_m) & (values > 0.0) & (values < shape.range_max_m))] = np.nan
    return values
