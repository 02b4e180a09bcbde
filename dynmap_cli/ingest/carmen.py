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
import re
from collections import Counter
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynmap_cli.arrays import F32, F64
from dynmap_cli.domain.poses import between, wrap_angle
from dynmap_cli.ingest.decimals import parse_decimals, parse_numbers
from dynmap_cli.ingest.plausible import are_coordinates, is_sweep, stamp_of_word, to_ranges_m
from dynmap_cli.ingest.raw import RawOdometry, RawRecording, Topic
from dynmap_cli.ingest.raw_laser import ScanShape
from dynmap_cli.ingest.text_lines import text_lines

_OLD_LASERS = (b"FLASER", b"RLASER")
_NEW_LASERS = (b"ROBOTLASER1", b"ROBOTLASER2")
_KIND = re.compile(rb"[A-Za-z_][A-Za-z0-9_]{0,31}")
_ODOM_WORDS = 10
_BATCH, _BATCH_BYTES = 256, 1 << 22
_NO_STAMP_STEP_NS = 10**9
_SHORTEST_M = 0.01
_SICK_REACH_M = 80.0
_FLICKER_M, _FLICKER_RAD = 1e-3, 1e-3


def read_carmen(path: Path, name: str, folder: Path | None = None) -> RawRecording:
    """Read a CARMEN log; lines that do not parse are counted, not fatal."""
    reader = _Reader(RawRecording(name, "CARMEN text", folder=folder))
    for line in text_lines(path, reader.recording.drop_broken):
        words = line.split(None, 1)
        if words and not words[0].startswith(b"#"):
            reader.take(words[0], line)
    reader.finish()
    return reader.recording


class _Sweep(NamedTuple):
    """A laser line whose ranges are not parsed yet.

    Attributes
    ----------
    word : str
        First word of the line.
    stamp_ns : int
    shape : ScanShape
    text : bytes
        Ranges, in new lines followed by the count of remissions and these.
    n_numbers : int
        How many numbers *text* should hold.
    poses : tuple of 6 floats
        Laser, robot.
    """

    word: str
    stamp_ns: int
    shape: ScanShape
    text: bytes
    n_numbers: int
    poses: tuple[float, ...]


class _Reader:
    """Takes lines one after the other; parses the ranges of many sweeps at a time."""

    def __init__(self, recording: RawRecording) -> None:
        self.recording = recording
        self.counts: Counter[str] = Counter()
        self.waiting: list[_Sweep] = []
        self.waiting_bytes = 0
        self.laser_poses: dict[str, list[tuple[float, ...]]] = {}

    def take(self, word: bytes, line: bytes) -> None:
        """Read one line, if it is of a known kind."""
        name = _name_of(word)
        if not name:
            self.recording.dropped["line of no known kind"] += 1
            return
        self.counts[name] += 1
        try:
            if word in _OLD_LASERS:
                self._wait(_old_laser(name, line))
            elif word in _NEW_LASERS:
                self._wait(_new_laser(name, line))
            elif word == b"ODOM":
                self._odometry(name, *_odometry_of(line))
                self.recording.n_read += 1
        except (ValueError, IndexError):
            self._lost(name)

    def _wait(self, sweep: _Sweep) -> None:
        """Put a sweep by until there are enough to parse."""
        self.waiting.append(sweep)
        self.waiting_bytes += len(sweep.text)
        if len(self.waiting) >= _BATCH or self.waiting_bytes >= _BATCH_BYTES:
            self._parse_waiting()

    def _parse_waiting(self) -> None:
        """Parse the ranges of all waiting sweeps; one by one where some are malformed."""
        waiting, self.waiting, self.waiting_bytes = self.waiting, [], 0
        try:
            values = to_ranges_m(parse_decimals(b" ".join(sweep.text for sweep in waiting)))
            ends = np.cumsum([sweep.n_numbers for sweep in waiting]) if waiting else np.zeros(1, np.int64)
            if values.size != ends[-1]:
                msg = "a line has more or fewer numbers than it says"
                raise ValueError(msg)
            parts = np.split(values, ends[:-1])
        except ValueError:
            parts = [_numbers_or_nothing(sweep.text) for sweep in waiting]
        for sweep, part in zip(waiting, parts, strict=False):
            if part.size == sweep.n_numbers:
                self._sweep(sweep, part[: sweep.shape.n_beams])
            else:
                self._lost(sweep.word)

    def _sweep(self, sweep: _Sweep, ranges_m: F32) -> None:
        """Keep a sweep with the poses of laser and robot."""
        self.recording.laser(sweep.word).add(sweep.stamp_ns, sweep.stamp_ns, ranges_m, sweep.shape)
        self.laser_poses.setdefault(sweep.word, []).append(sweep.poses)
        self._odometry(sweep.word, sweep.stamp_ns, sweep.poses[3:])
        self.recording.n_read += 1

    def _odometry(self, word: str, stamp_ns: int, pose: tuple[float, ...]) -> None:
        """Keep an odometry pose."""
        track = self.recording.odometry.get(word)
        if track is None:
            track = self.recording.odometry[word] = RawOdometry(word)
        track.add(stamp_ns, (pose[0], pose[1], pose[2]))

    def _lost(self, word: str) -> None:
        """Count a line that does not parse."""
        self.recording.drop_broken(f"{word} line that does not parse")

    def finish(self) -> None:
        """Parse the rest, find how the lasers are mounted, and replace stamps that were lost."""
        self._parse_waiting()
        self.recording.topics = [Topic(word, "line", count) for word, count in sorted(self.counts.items())]
        for word, laser in self.recording.lasers.items():
            poses = np.array(self.laser_poses[word])
            laser.robot_from_sensor = mounting(poses[:, 3:6], poses[:, 0:3])
            if laser.robot_from_sensor is None:
                self.recording.warnings.append(
                    f"{word}: laser and robot pose of a line differ by no fixed amount, as in logs whose first pose "
                    "was corrected; the second one is used"
                )
        replace_lost_stamps(self.recording)


@lru_cache(maxsize=64)
def _name_of(word: bytes) -> str:
    """Name of a kind of line; "" where the first word is none."""
    return word.decode("ascii") if _KIND.fullmatch(word) else ""


def _old_laser(word: str, line: bytes) -> _Sweep:
    """Take a FLASER or RLASER line apart; the beams of 180 readings start at -90 deg."""
    _, count, rest = line.split(None, 2)
    text, *poses, stamp, _host, _logger = rest.rsplit(None, 9)
    n_beams = int(count)
    if text.count(b" ") != n_beams - 1:
        text = b" ".join(text.split())
    if n_beams < 1 or len(poses) != 6 or text.count(b" ") != n_beams - 1:
        msg = "beam count"
        raise ValueError(msg)
    return _Sweep(word, stamp_of_word(stamp), flaser_shape(n_beams), text, n_beams, _finite(poses))


def _new_laser(word: str, line: bytes) -> _Sweep:
    """Take a ROBOTLASER line apart, which states its geometry."""
    *header, rest = line.split(None, 9)
    text, *poses, _tv, _rv, _forward, _side, _turn, stamp, _host, _logger = rest.rsplit(None, 14)
    start_rad, fov_rad, step_rad, reach_m = _finite(header[2:6])
    n_beams = int(header[8])
    words = text.split()
    if n_beams < 1 or len(poses) != 6 or len(words) != n_beams + 1 + int(words[n_beams]):
        msg = "beam count"
        raise ValueError(msg)
    if step_rad == 0.0:
        step_rad = fov_rad / max(n_beams - 1, 1)
    if not is_sweep(start_rad, step_rad, n_beams):
        msg = "angles"
        raise ValueError(msg)
    is_stated = 0.0 < reach_m < _SICK_REACH_M
    shape = ScanShape(start_rad, step_rad, n_beams, _SHORTEST_M, reach_m if is_stated else math.inf)
    return _Sweep(word, stamp_of_word(stamp), shape, text, len(words), _finite(poses))


def _odometry_of(line: bytes) -> tuple[int, tuple[float, ...]]:
    """Stamp and pose of an ODOM line; one that is cut off would have its stamp elsewhere."""
    words = line.split()
    if len(words) != _ODOM_WORDS:
        msg = "count of words"
        raise ValueError(msg)
    return stamp_of_word(words[-3]), _finite(words[1:4])


def _finite(words: list[bytes]) -> tuple[float, ...]:
    """Finite numbers of a plausible size."""
    values = tuple(map(float, words))
    if not are_coordinates(values):
        msg = "not a plausible number"
        raise ValueError(msg)
    return values


def _numbers_or_nothing(text: bytes) -> F32:
    """Numbers of one line, none where one of them is no number."""
    try:
        return to_ranges_m(parse_numbers(text))
    except ValueError:
        return np.zeros(0, dtype=np.float32)


@lru_cache(maxsize=64)
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
    offsets[:, 2] = offsets[0, 2] + wrap_angle(offsets[:, 2] - offsets[0, 2])
    middle = np.median(offsets, axis=0)
    spread = np.abs(offsets - middle)
    if np.quantile(spread[:, :2], 0.95) > _FLICKER_M or np.quantile(spread[:, 2], 0.95) > _FLICKER_RAD:
        return None
    return np.where(np.abs(middle) < 1e-6, 0.0, middle)


def replace_lost_stamps(recording: RawRecording) -> None:
    """Give sweeps one second each where all stamps are equal; order is all that is left then."""
    for word, laser in recording.lasers.items():
        if laser.n_scans < 2 or np.ptp(laser.stamps_ns) > 0:
            continue
        stamps = _NO_STAMP_STEP_NS * np.arange(laser.n_scans)
        laser.stamps_ns, laser.logged_ns = stamps, stamps
        recording.odometry[word].stamps_ns = stamps
        recording.odometry.pop("ODOM", None)
        recording.warnings.append(
            f"{word}: all time stamps are the same, so sweeps keep their order and are put 1 s apart; "
            "times and speeds mean nothing"
        )
