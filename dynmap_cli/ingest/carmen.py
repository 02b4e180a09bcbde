"""CARMEN text logs: FLASER, RLASER, ROBOTLASER1, ROBOTLASER2 and ODOM lines.

First pose of FLASER = laser, second = robot, both in the odometry frame:
`FLASER n r1..rn x y theta odom_x odom_y odom_theta ipc_timestamp host logger_timestamp`,
`ODOM x y theta tv rv accel ipc_timestamp host logger_timestamp`,
`ROBOTLASER1 type start_angle fov resolution max_range accuracy remission_mode n r1..rn n_remission ..
laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv forward_safety side_safety turn_axis
ipc_timestamp host logger_timestamp`.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import between
from dynmap_cli.files.trajectory import parse_stamp
from dynmap_cli.ingest.raw import RawLaser, RawOdometry, RawRecording, ScanShape, Topic

_OLD_LASERS = (b"FLASER", b"RLASER")
_NEW_LASERS = (b"ROBOTLASER1", b"ROBOTLASER2")
_TAIL_WORDS = 3
_NEW_HEADER, _NEW_POSES = 8, 11
_NO_STAMP_STEP_NS = 10**9
_SHORTEST_M = 0.01
_FLICKER_M, _FLICKER_RAD = 1e-3, 1e-3


def read_carmen(path: Path, name: str) -> RawRecording:
    """Read a CARMEN log; lines that do not parse are counted, not fatal."""
    recording = RawRecording(name, "CARMEN text")
    reader = _Reader(recording)
    counts: Counter[str] = Counter()
    with path.open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        for line in stream:
            word = line[:12].split(None, 1)[0] if line.strip() else b"#"
            if word.startswith(b"#"):
                continue
            counts[word.decode("ascii", "replace")] += 1
            try:
                reader.take(word, line)
            except (ValueError, IndexError, DeprecationWarning):
                recording.dropped[f"{word.decode('ascii', 'replace')} line that does not parse"] += 1
    recording.topics = [Topic(word, "line", count) for word, count in sorted(counts.items())]
    reader.finish()
    return recording


class _Reader:
    """Takes lines one after the other and keeps the poses of lasers until all are read."""

    def __init__(self, recording: RawRecording) -> None:
        self.recording = recording
        self.laser_poses: dict[str, list[F64]] = {}

    def take(self, word: bytes, line: bytes) -> None:
        """Read one line, if it is of a known kind."""
        if word in _OLD_LASERS:
            self._take_old_laser(word.decode(), line)
        elif word in _NEW_LASERS:
            self._take_new_laser(word.decode(), line)
        elif word == b"ODOM":
            head, stamp_ns = _numbers_and_stamp(line, 4)
            self._odometry("ODOM", stamp_ns, head[:3])
        else:
            return
        self.recording.n_read += 1

    def _take_old_laser(self, word: str, line: bytes) -> None:
        """Read a FLASER or RLASER line; the beams of 180 readings start at -90 deg."""
        values, stamp_ns = _numbers_and_stamp(line, 7)
        n_beams = int(values[0])
        if n_beams < 1 or values.size != n_beams + 7:
            msg = "beam count"
            raise ValueError(msg)
        self._sweep(word, stamp_ns, values[1 : n_beams + 1], flaser_shape(n_beams), values[n_beams + 1 :])

    def _take_new_laser(self, word: str, line: bytes) -> None:
        """Read a ROBOTLASER line, which states its geometry."""
        values, stamp_ns = _numbers_and_stamp(line, _NEW_HEADER + 1 + _NEW_POSES)
        n_beams = int(values[_NEW_HEADER - 1])
        n_remission = int(values[_NEW_HEADER + n_beams])
        first_pose = _NEW_HEADER + n_beams + 1 + n_remission
        if n_beams < 1 or n_remission < 0 or values.size != first_pose + _NEW_POSES:
            msg = "beam count"
            raise ValueError(msg)
        start_rad, fov_rad, step_rad, reach_m = values[1:5]
        if step_rad == 0.0:
            step_rad = fov_rad / max(n_beams - 1, 1)
        shape = ScanShape(
            float(start_rad),
            float(step_rad),
            n_beams,
            _SHORTEST_M,
            float(reach_m) if reach_m > 0 else math.inf,
        )
        self._sweep(
            word,
            stamp_ns,
            values[_NEW_HEADER : _NEW_HEADER + n_beams],
            shape,
            values[first_pose : first_pose + 6],
        )

    def _sweep(self, word: str, stamp_ns: int, ranges_m: F64, shape: ScanShape, poses: F64) -> None:
        """Keep a sweep with the poses of laser and robot."""
        laser = self.recording.lasers.setdefault(word, RawLaser(word))
        laser.add(stamp_ns, stamp_ns, ranges_m.astype(np.float32), shape)
        self.laser_poses.setdefault(word, []).append(poses[:6])
        self._odometry(word, stamp_ns, poses[3:6])

    def _odometry(self, word: str, stamp_ns: int, pose: F64) -> None:
        """Keep an odometry pose."""
        track = self.recording.odometry.setdefault(word, RawOdometry(word))
        track.stamps_ns.append(stamp_ns)
        track.poses.append((float(pose[0]), float(pose[1]), float(pose[2])))

    def finish(self) -> None:
        """Find how the lasers are mounted, and replace stamps that were lost."""
        for word, laser in self.recording.lasers.items():
            poses = np.array(self.laser_poses[word])
            laser.robot_from_sensor = mounting(poses[:, 3:6], poses[:, 0:3])
            if laser.robot_from_sensor is None:
                self.recording.warnings.append(
                    f"{word}: laser and robot pose differ by no fixed amount; laser taken to be at the robot's centre"
                )
        replace_lost_stamps(self.recording)


def _numbers_and_stamp(line: bytes, least: int) -> tuple[F64, int]:
    """Numbers of a line before `ipc_timestamp host logger_timestamp`, and the first of these in nanoseconds."""
    head, stamp, _host, _logger = line.rsplit(None, _TAIL_WORDS)
    values = np.fromstring(head.partition(b" ")[2], dtype=np.float64, sep=" ")
    if values.size < least - 1 or not np.isfinite(values[-3:]).all():
        msg = "too few numbers"
        raise ValueError(msg)
    return values, parse_stamp(stamp.decode("ascii"))


def flaser_shape(n_beams: int) -> ScanShape:
    """Directions of FLASER readings, which the line does not state.

    SICK LMS: 180 or 181 readings 1 deg apart, 360 or 361 readings 0.5 deg apart, 400 or 401 readings 0.25 deg
    apart over 100 deg; the last reading of the odd counts is the one some drivers leave out. Others are spread
    over 180 deg.
    """
    full = {180: 181, 360: 361, 400: 401}.get(n_beams, n_beams)
    fov_rad = math.radians(100.0 if full == 401 else 180.0)
    return ScanShape(-fov_rad / 2.0, fov_rad / max(full - 1, 1), n_beams, _SHORTEST_M, math.inf)


def mounting(robots: F64, lasers: F64) -> F64 | None:
    """robot_from_sensor (3,) from poses of robot and laser (n, 3); None where it is not fixed."""
    offsets = between(robots, lasers)
    middle = np.median(offsets, axis=0)
    spread = np.abs(offsets - middle)
    if np.quantile(spread[:, :2], 0.95) > _FLICKER_M or np.quantile(spread[:, 2], 0.95) > _FLICKER_RAD:
        return None
    return np.where(np.abs(middle) < 1e-6, 0.0, middle)


def replace_lost_stamps(recording: RawRecording) -> None:
    """Give sweeps one second each where all stamps are equal; order is all that is left then."""
    for word, laser in recording.lasers.items():
        if laser.n_scans < 2 or len(set(laser.stamps_ns)) > 1:
            continue
        stamps = [number * _NO_STAMP_STEP_NS for number in range(laser.n_scans)]
        laser.stamps_ns, laser.logged_ns = stamps, list(stamps)
        recording.odometry[word].stamps_ns = list(stamps)
        recording.odometry.pop("ODOM", None)
        recording.warnings.append(
            f"{word}: all time stamps are the same, so sweeps keep their order and are put 1 s apart; "
            "times and speeds mean nothing"
        )
