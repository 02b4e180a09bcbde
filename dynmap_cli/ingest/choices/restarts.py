"""Odometry that was started anew while a recording was made: it is at its origin from one pose to the next.

Its driver was restarted, or told to. What it counts then goes on from where the robot was; how far that moved
meanwhile, nobody has counted. Poses are looked at in the order of their stamps: some reach a recorder late. Where the
sweeps then show what they did at first, and not what they did right before, the robot itself was put back to where it
began, as by a simulation that is started anew: its poses are right as they are.
"""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import between, compose, wrap_angle
from dynmap_cli.ingest.choices.robot_frames import last_name
from dynmap_cli.ingest.choices.tracks import Track, moving_tracks, places_of, poses_of, put_poses
from dynmap_cli.ingest.choices.two_robots import alternates
from dynmap_cli.ingest.raw.columns import spans
from dynmap_cli.ingest.raw.laser import most_used
from dynmap_cli.ingest.raw.recording import RawRecording, file_name, sorted_by_stamp

_ORIGIN, _EXACTLY, _LEFT_ORIGIN_M, _TURNED_RAD = 0.01, 1e-6, 0.3, 0.3
_LOOKED_AT, _TIMES_AS_FAST, _LEAST_STEP_S = 5, 3.0, 1e-3
_LOOKED_AFTER, _BACK_SHARE = 20, 0.5
_MOST_LOOKS, _MOST_TOLD, _MISSING = 1000, 4, 2
_LATEST = 2**63 - 1


def join_restarts(recording: RawRecording) -> None:
    """Let poses that start at the origin again go on from where they were; says where, and how far that was.

    Before the first sweep and after the last one no pose is used, so nothing is done.
    """
    told: list[str] = []
    put_back: list[str] = []
    first_ns, last_ns = recording.span_ns if recording.lasers else (-_LATEST, _LATEST)
    for name, source in moving_tracks(recording, lambda parent: "odom" in last_name(parent)):
        returns, leaves = _at_origin(sorted_by_stamp(source.stamps_ns, places_of(source))[1])
        if returns.size:
            stamps_ns, poses = sorted_by_stamp(source.stamps_ns, poses_of(source))
            looks = _jumps_to_origin(poses, returns)
            rows = [
                row
                for row in looks[:_MOST_LOOKS].tolist()
                if first_ns < stamps_ns[row] <= last_ns
                and _is_restart(stamps_ns, poses, row)
                and _goes_on(stamps_ns, poses, row, leaves)
            ]
            if rows and looks.size > _MOST_LOOKS:
                recording.warnings.append(
                    f"{file_name(recording.name)}: {name} was started anew {len(rows)} times in its first "
                    f"{_MOST_LOOKS} of {looks.size} returns to its origin; so many are left as they are"
                )
            elif rows:
                is_back = _are_put_back(recording, stamps_ns, poses, rows)
                for lines, wanted in ((told, False), (put_back, True)):
                    those = [row for row, back in zip(rows, is_back, strict=True) if back is wanted]
                    if those:
                        lines.append(f"{name} from {_jumps_told(recording, stamps_ns, poses, those)}")
                _join(source, stamps_ns, poses, rows, is_back)
        source.give_back()
    if told:
        recording.warnings.append(
            f"{file_name(recording.name)}: the odometry was started anew while it was made, and begins at its origin: "
            f"{'; '.join(told)}; it is taken to go on from where it was. If the robot was carried there, cut the "
            "recording, and build the parts together"
        )
    if put_back:
        recording.warnings.append(
            f"{file_name(recording.name)}: the robot was put back to where it began, with its odometry, as where a "
            f"simulation is started anew: {'; '.join(put_back)}; the scans show that place again, and poses are used "
            "as they are"
        )


def _are_put_back(recording: RawRecording, stamps_ns: I64, poses: F64, rows: list[int]) -> list[bool]:
    """Whether the sweep after each return to the origin is like the first one there, and unlike that right before."""
    laser = most_used(recording.lasers.values())
    if laser is None or np.abs(poses[0]).max() >= _ORIGIN:
        return [False] * len(rows)
    order = np.argsort(laser.stamps_ns, kind="stable")
    first, *after = np.searchsorted(laser.stamps_ns[order], stamps_ns[[0, *rows]]).tolist()
    is_back = []
    for later in after:
        if not first < later < order.size:
            is_back.append(False)
            continue
        numbers = order[[later, later - 1, first, first]]
        ranges_m = np.full((1, 4, int(laser.lengths_counted[0][-1])), np.nan, dtype=np.float32)
        laser.fill(ranges_m[0], numbers)
        is_back.append(bool(alternates(ranges_m, laser.shape_index[numbers][None])[0]))
    return is_back


def _jumps_told(recording: RawRecording, stamps_ns: I64, poses: F64, rows: list[int]) -> str:
    """From where poses returned to the origin, and when; of many only the first ones."""
    told = []
    for row in rows[:_MOST_TOLD]:
        x_m, y_m, yaw_rad = poses[row - 1]
        jump = f"{np.hypot(x_m, y_m):.2f} m and {np.degrees(yaw_rad):.0f} deg"
        told.append(f"{jump} {_when(recording, int(stamps_ns[row]))}")
    if len(rows) > _MOST_TOLD:
        last = _when(recording, int(stamps_ns[rows[-1]]))
        told.append(f"{len(rows) - _MOST_TOLD} times more, the last {last}")
    return ", ".join(told)


def _at_origin(places: F64) -> tuple[I64, I64]:
    """Numbers of places (n, 2) at the origin of which the one before is elsewhere, and the other way round."""
    returns, leaves = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for rows in spans(max(places.shape[0] - 1, 0), places):
        x_m, y_m = places[rows.start : rows.stop + 1].T
        is_here = (np.abs(x_m) < _ORIGIN) & (np.abs(y_m) < _ORIGIN)
        returns.append(rows.start + 1 + np.flatnonzero(is_here[1:] & ~is_here[:-1]))
        leaves.append(rows.start + 1 + np.flatnonzero(~is_here[1:] & is_here[:-1]))
    return np.concatenate(returns), np.concatenate(leaves)


def _jumps_to_origin(poses: F64, returns: I64) -> I64:
    """Those returns at which the heading is zero as well, and the pose before was well away."""
    before, here = poses[returns - 1], poses[returns]
    is_away = np.hypot(before[:, 0], before[:, 1]) > _LEFT_ORIGIN_M
    is_turned = np.abs(before[:, 2]) > _TURNED_RAD
    is_exact = np.abs(here).max(axis=1) < _EXACTLY
    is_jump = (is_away & (np.abs(here[:, 2]) < _ORIGIN)) | (is_turned & is_exact)
    return np.asarray(returns[is_jump])


def _is_restart(stamps_ns: I64, poses: F64, row: int) -> bool:
    """Whether a pose is by far too fast at the origin, or exactly at it where the motion before does not lead to it.

    The motion before leads to it if, gone on with at the same speed, it ends no farther from it than the longest of
    the steps around.
    """
    if np.hypot(*poses[row - 1, :2]) > _LEFT_ORIGIN_M and _is_too_fast(stamps_ns, poses, row):
        return True
    if np.abs(poses[row]).max() >= _EXACTLY:
        return False
    before = poses[max(row - 2, 0) : row]
    step = before[-1] - before[0]
    step[2] = wrap_angle(step[2])
    elapsed_ns = stamps_ns[row - 1] - stamps_ns[max(row - 2, 0)]
    share = (stamps_ns[row] - stamps_ns[row - 1]) / elapsed_ns if elapsed_ns else 0.0
    ahead = before[-1] + share * step
    first = max(row - _LOOKED_AT, 0)
    steps = np.diff(poses[first : row + _LOOKED_AT], axis=0)
    usual = np.delete(steps, row - 1 - first, axis=0)
    usual_m = np.hypot(usual[:, 0], usual[:, 1]).max(initial=0.0)
    usual_rad = np.abs(wrap_angle(usual[:, 2])).max(initial=0.0)
    is_off_m = np.hypot(ahead[0], ahead[1]) > usual_m + _EXACTLY
    return bool(is_off_m or abs(wrap_angle(ahead[2])) > usual_rad + _EXACTLY)


def _is_too_fast(stamps_ns: I64, poses: F64, row: int) -> bool:
    """Whether the step to a pose is by far faster than those around it."""
    around = slice(max(row - _LOOKED_AT, 0), row + _LOOKED_AT)
    steps_m = np.hypot(*np.diff(poses[around, :2], axis=0).T)
    speeds = steps_m / np.maximum(np.diff(stamps_ns[around]) * 1e-9, _LEAST_STEP_S)
    own = row - 1 - around.start
    return bool(speeds[own] > _TIMES_AS_FAST * np.delete(speeds, own).max(initial=0.0))


def _goes_on(stamps_ns: I64, poses: F64, row: int, leaves: I64) -> bool:
    """Whether the poses after one at the origin go on from there, and none of them jumps back to those before it."""
    after = int(np.searchsorted(leaves, row, side="right"))
    if after < leaves.size:
        left = int(leaves[after])
        step_m = np.hypot(*(poses[left, :2] - poses[left - 1, :2]))
        if _jumps_back(poses, row, left):
            return False
        if step_m > _LEFT_ORIGIN_M and _is_too_fast(stamps_ns, poses, left):
            return False
    return not _jumps_back(poses, row, row + 1)


def _jumps_back(poses: F64, row: int, first: int) -> bool:
    """Whether one of some poses from *first* on is nearer the one before *row* than its own, and jumps as far."""
    jump = _apart(poses[row], poses[row - 1])
    after = poses[first - 1 : first + _LOOKED_AFTER]
    steps = _apart(after[1:], after[:-1])
    is_old = _apart(after[1:], poses[row - 1]) < steps
    is_elsewhere = np.abs(after[1:]).max(axis=1, initial=0.0) > _ORIGIN
    return bool((is_old & is_elsewhere & (steps > _BACK_SHARE * jump)).any())


def _apart(first: F64, second: F64) -> F64:
    """How far poses (..., 3) are apart, a radian counted as a metre."""
    apart = first - second
    return np.asarray(np.hypot(apart[..., 0], apart[..., 1]) + np.abs(wrap_angle(apart[..., 2])))


def _join(source: Track, stamps_ns: I64, poses: F64, rows: list[int], is_back: list[bool]) -> None:
    """Put the poses from each of the rows on behind the one before it, moved on as before where nothing is missing.

    Where the robot itself was put back, they go on from the origin.

    *stamps_ns* (n,) ascend and *poses* (n, 3) are theirs; *rows* are numbers of them.
    """
    starts = np.zeros((len(rows) + 1, 3))
    for number, row in enumerate(rows):
        if is_back[number]:
            continue
        start = compose(starts[number], poses[row - 1])
        if row > 1 and stamps_ns[row] - stamps_ns[row - 1] < _MISSING * (
            stamps_ns[row - 1] - stamps_ns[row - 2]
        ):
            start = compose(start, between(poses[row - 2], poses[row - 1]))
        starts[number + 1] = start
    part = np.searchsorted(stamps_ns[rows], source.stamps_ns, side="right")
    is_moved = part > 0
    raw = poses_of(source)
    joined = raw.copy()
    joined[is_moved] = compose(starts[part[is_moved]], raw[is_moved])
    put_poses(source, joined)


def _when(recording: RawRecording, stamp_ns: int) -> str:
    """The time of a pose, from the first sweep on."""
    first_ns = recording.span_ns[0] if recording.lasers else stamp_ns
    return f"at t = {(stamp_ns - first_ns) * 1e-9:.1f} s"
