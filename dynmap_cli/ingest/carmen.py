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
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynmap_cli.arrays import F32, F64
from dynmap_cli.domain.poses import between, wrap_angle
from dynmap_cli.ingest.decimals import parse_decimals, parse_numbers
from dynmap_cli.ingest.plausible import FARTHEST_M, are_coordinates, is_sweep, stamps_of_words, to_ranges_m
from dynmap_cli.ingest.raw import RawOdometry, RawRecording, Topic
from dynmap_cli.ingest.raw_laser import ScanShape
from dynmap_cli.ingest.text_lines import text_lines

_OLD_LASERS = (b"FLASER", b"RLASER")
_NEW_LASERS = (b"ROBOTLASER1", b"ROBOTLASER2")
_KIND = re.compile(rb"[A-Za-z_][A-Za-z0-9_]{0,31}")
_ODOM_WORDS = 10
_BATCH, _BATCH_BYTES = 64, 1 << 22
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


class _Line(NamedTuple):
    """A line whose numbers are not parsed yet.

    Attributes
    ----------
    word : str
        First word of the line.
    stamp : bytes
    poses : list of bytes
        Six numbers: laser, robot; of ODOM lines three.
    shape : ScanShape or None
        None = no sweep.
    text : bytes
        Ranges, in new lines followed by the count of remissions and these.
    n_numbers : int
        How many numbers *text* should hold.
    """

    word: str
    stamp: bytes
    poses: list[bytes]
    shape: ScanShape | None = None
    text: bytes = b""
    n_numbers: int = 0


class _Reader:
    """Takes lines one after the other; parses the numbers of many at a time."""

    def __init__(self, recording: RawRecording) -> None:
        self.recording = recording
        self.counts: Counter[str] = Counter()
        self.waiting: dict[str, list[_Line]] = {}
        self.waiting_bytes = 0
        self.laser_poses: dict[str, list[F64]] = {}

    def take(self, word: bytes, line: bytes) -> None:
        """Read one line, if it is of a known kind."""
        name = _name_of(word)
        if not name:
            self.recording.dropped["line of no known kind"] += 1
            return
        self.counts[name] += 1
        try:
            if word in _OLD_LASERS:
                found = _old_laser(name, line)
            elif word in _NEW_LASERS:
                found = _new_laser(name, line)
            elif word == b"ODOM":
                found = _odometry_of(name, line)
            else:
                return
        except (ValueError, IndexError):
            self._lost(name)
            return
        lines = self.waiting.setdefault(name, [])
        lines.append(found)
        self.waiting_bytes += len(found.text)
        if len(lines) >= _BATCH or self.waiting_bytes >= _BATCH_BYTES:
            self._parse_waiting()

    def _parse_waiting(self) -> None:
        """Parse all waiting lines."""
        waiting, self.waiting, self.waiting_bytes = self.waiting, {}, 0
        for name, lines in waiting.items():
            self._parse(name, lines)

    def _parse(self, name: str, lines: list[_Line]) -> None:
        """Parse lines of one kind; one by one where some are malformed."""
        try:
            stamps_ns = stamps_of_words([line.stamp for line in lines])
            width = len(lines[0].poses)
            poses = parse_numbers(b" ".join([b" ".join(line.poses) for line in lines])).reshape(-1, width)
            if poses.shape[0] != len(lines) or not (np.abs(poses) <= FARTHEST_M).all():
                msg = "not a plausible pose"
                raise ValueError(msg)
            runs = [] if lines[0].shape is None else _ranges_of(lines)
        except ValueError:
            if len(lines) == 1:
                self._lost(name)
            else:
                for line in lines:
                    self._parse(name, [line])
            return
        self.recording.n_read += len(lines)
        track = self.recording.odometry.get(name)
        if track is None:
            track = self.recording.odometry[name] = RawOdometry(name)
        track.add_many(stamps_ns, poses[:, -3:])
        start = 0
        for shape, ranges_m in runs:
            run = slice(start, start + ranges_m.shape[0])
            laser = self.recording.laser(name)
            number = np.full(ranges_m.shape[0], laser.number_of(shape), dtype=np.int32)
            laser.add_many(stamps_ns[run], stamps_ns[run], ranges_m, number, np.zeros(number.size))
            start = run.stop
        if runs:
            self.laser_poses.setdefault(name, []).append(poses)

    def _lost(self, word: str) -> None:
        """Count a line that does not parse."""
        self.recording.drop_broken(f"{word} line that does not parse")

    def finish(self) -> None:
        """Parse the rest, find how the lasers are mounted, and replace stamps that were lost."""
        self._parse_waiting()
        self.recording.topics = [Topic(word, "line", count) for word, count in sorted(self.counts.items())]
        for word, laser in self.recording.lasers.items():
            poses = np.concatenate(self.laser_poses[word])
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


def _ranges_of(lines: list[_Line]) -> list[tuple[ScanShape, F32]]:
    """Shapes of sweeps, and the ranges (n, n_beams) of those of each that follow one another.

    Raises
    ------
    ValueError
        If a line has more or fewer numbers than it says.
    """
    values = to_ranges_m(parse_decimals(b" ".join([line.text for line in lines])))
    if values.size != sum(line.n_numbers for line in lines):
        msg = "a line has more or fewer numbers than it says"
        raise ValueError(msg)
    runs = []
    start = 0
    for (shape, n_numbers), run in groupby(lines, key=lambda line: (line.shape, line.n_numbers)):
        end = start + n_numbers * sum(1 for _ in run)
        if shape is not None:
            runs.append((shape, values[start:end].reshape(-1, n_numbers)[:, : shape.n_beams]))
        start = end
    return runs


def _old_laser(word: str, line: bytes) -> _Line:
    """Take a FLASER or RLASER line apart; the beams of 180 readings start at -90 deg."""
    _, count, rest = line.split(None, 2)
    text, *poses, stamp, _host, _logger = rest.rsplit(None, 9)
    n_beams = int(count)
    if text.count(b" ") != n_beams - 1:
        text = b" ".join(text.split())
    if n_beams < 1 or len(poses) != 6 or text.count(b" ") != n_beams - 1:
        msg = "beam count"
        raise ValueError(msg)
    return _Line(word, stamp, poses, flaser_shape(n_beams), text, n_beams)


def _new_laser(word: str, line: bytes) -> _Line:
    """Take a ROBOTLASER line apart, which states its geometry."""
    *header, rest = line.split(None, 9)
    text, *poses, _tv, _rv, _forward, _side, _turn, stamp, _host, _logger = rest.rsplit(None, 14)
    n_beams = int(header[8])
    if text.endswith(b" 0") and text.count(b" ") == n_beams:
        n_numbers = n_beams + 1
    else:
        words = text.split()
        n_numbers = len(words)
        if n_numbers != n_beams + 1 + int(words[n_beams]):
            n_numbers = 0
    if n_beams < 1 or len(poses) != 6 or not n_numbers:
        msg = "beam count"
        raise ValueError(msg)
    return _Line(word, stamp, poses, _stated_shape(*header[2:6], n_beams), text, n_numbers)


@lru_cache(maxsize=64)
def _stated_shape(start: bytes, fov: bytes, step: bytes, reach: bytes, n_beams: int) -> ScanShape:
    """Directions of ROBOTLASER readings; ValueError where they are not those of a laser."""
    start_rad, fov_rad, step_rad, reach_m = map(float, (start, fov, step, reach))
    if not are_coordinates((start_rad, fov_rad, step_rad, reach_m)):
        msg = "not a plausible number"
        raise ValueError(msg)
    if step_rad == 0.0:
        step_rad = fov_rad / max(n_beams - 1, 1)
    if not is_sweep(start_rad, step_rad, n_beams):
        msg = "angles"
        raise ValueError(msg)
    is_stated = 0.0 < reach_m < _SICK_REACH_M
    return ScanShape(start_rad, step_rad, n_beams, _SHORTEST_M, reach_m if is_stated else math.inf)


def _odometry_of(word: str, line: bytes) -> _Line:
    """Take an ODOM line apart; one that is cut off would have its stamp elsewhere."""
    words = line.split()
    if len(words) != _ODOM_WORDS:
        msg = "count of words"
        raise ValueError(msg)
    return _Line(word, words[-3], words[1:4])


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
