"""Odometry that was started anew while a recording was made: it is at its origin from one pose to the next.

Its driver was restarted, or told to. What it counts then goes on from where the robot was; how far that moved
meanwhile, nobody has counted.
"""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import between, compose
from dynmap_cli.ingest.choices.robot_frames import last_name
from dynmap_cli.ingest.choices.two_robots import poses_of
from dynmap_cli.ingest.raw.columns import spans
from dynmap_cli.ingest.raw.recording import RawOdometry, RawRecording, RawTransform, file_name

_ORIGIN, _EXACTLY, _LEFT_ORIGIN_M, _TURNED_RAD = 0.01, 1e-6, 0.3, 0.3
_LOOKED_AT, _TIMES_AS_FAST, _LEAST_STEP_S = 5, 3.0, 1e-3
_MOST_LOOKS, _MOST_RESTARTS, _MISSING = 200, 4, 2


def join_restarts(recording: RawRecording) -> None:
    """Let poses that start at the origin again go on from where they were; says where, and how far that was."""
    sources: list[tuple[str, RawOdometry | RawTransform]] = [*recording.odometry.items()]
    sources += [
        (f"{parent} -> {child}", found)
        for (parent, child), found in recording.transforms.items()
        if not found.is_static and "odom" in last_name(parent)
    ]
    told = []
    for name, source in sources:
        places = (source.poses if isinstance(source, RawOdometry) else source.values)[:, :2]
        looks = _returns_to_origin(places)
        if 0 < looks.size <= _MOST_LOOKS:
            poses = poses_of(source)
            rows = [row for row in looks.tolist() if _is_restart(source.stamps_ns, poses, row)]
            rows = rows if len(rows) <= _MOST_RESTARTS else []
            for row in rows:
                x_m, y_m, yaw_rad = poses[row - 1]
                jump = f"{np.hypot(x_m, y_m):.2f} m and {np.degrees(yaw_rad):.0f} deg"
                told.append(f"{name} from {jump} {_when(recording, int(source.stamps_ns[row]))}")
            if rows:
                _go_on(source, poses, rows)
        source.give_back()
    if told:
        recording.warnings.append(
            f"{file_name(recording.name)}: the odometry was started anew while it was made, and begins at its origin: "
            f"{'; '.join(told)}; it is taken to go on from where it was. If the robot was carried there, cut the "
            "recording, and build the parts together"
        )


def _returns_to_origin(places: F64) -> I64:
    """Numbers (m,) of places (n, 2) at the origin, of which the one before is elsewhere."""
    found = [np.zeros(0, dtype=np.int64)]
    for rows in spans(max(places.shape[0] - 1, 0), places):
        x_m, y_m = places[rows.start : rows.stop + 1].T
        is_here = (np.abs(x_m) < _ORIGIN) & (np.abs(y_m) < _ORIGIN)
        found.append(rows.start + 1 + np.flatnonzero(is_here[1:] & ~is_here[:-1]))
    return np.concatenate(found)


def _is_restart(stamps_ns: I64, poses: F64, row: int) -> bool:
    """Whether a pose is the origin exactly, or is by far too fast at it, and the one before was away from it."""
    x_m, y_m, yaw_rad = poses[row - 1]
    is_away = np.hypot(x_m, y_m) > _LEFT_ORIGIN_M
    if np.abs(poses[row]).max() < _EXACTLY:
        return bool(is_away or abs(yaw_rad) > _TURNED_RAD)
    if not is_away or abs(poses[row, 2]) >= _ORIGIN:
        return False
    around = slice(max(row - _LOOKED_AT, 0), row + _LOOKED_AT)
    steps_m = np.hypot(*np.diff(poses[around, :2], axis=0).T)
    speeds = steps_m / np.maximum(np.abs(np.diff(stamps_ns[around])) * 1e-9, _LEAST_STEP_S)
    own = row - 1 - around.start
    return bool(speeds[own] > _TIMES_AS_FAST * np.delete(speeds, own).max(initial=0.0))


def _go_on(source: RawOdometry | RawTransform, poses: F64, rows: list[int]) -> None:
    """Put the poses from each of the rows on behind the one before it, moved on as before where nothing is missing."""
    joined, stamps_ns = poses.copy(), source.stamps_ns
    for row in rows:
        start = joined[row - 1]
        if row > 1 and stamps_ns[row] - stamps_ns[row - 1] < _MISSING * (
            stamps_ns[row - 1] - stamps_ns[row - 2]
        ):
            start = compose(start, between(joined[row - 2], start))
        joined[row:] = compose(start, poses[row:])
    if isinstance(source, RawOdometry):
        source.poses = joined
        return
    values = source.values.copy()
    half_rad = (joined[:, 2] - poses[:, 2]) / 2.0
    x, y, z, w = values[:, 3:].T
    turn_z, turn_w = np.sin(half_rad), np.cos(half_rad)
    values[:, :2] = joined[:, :2]
    values[:, 3:] = np.column_stack(
        [turn_w * x - turn_z * y, turn_w * y + turn_z * x, turn_w * z + turn_z * w, turn_w * w - turn_z * z]
    )
    source.values = values


def _when(recording: RawRecording, stamp_ns: int) -> str:
    """The time of a pose, from the first sweep on."""
    first_ns = recording.span_ns[0] if recording.lasers else stamp_ns
    return f"at t = {(stamp_ns - first_ns) * 1e-9:.1f} s"
