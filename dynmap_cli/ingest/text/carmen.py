"""CARMEN text logs: sweeps of FLASER, RLASER and ROBOTLASER lines, which carry poses, else of RAWLASER lines.

RAWLASER lines hold what the driver sent, without a pose: the robot was where the ODOM lines say. Where other lines
hold the same sweeps with their poses, these are used, and each sweep once.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from functools import lru_cache
from itertools import groupby
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F32, F64
from dynmap_cli.domain.poses import between, wrap_angle
from dynmap_cli.ingest.raw.laser import ScanShape
from dynmap_cli.ingest.raw.plausible import FARTHEST_M, are_coordinates, stamps_of_words, to_ranges_m
from dynmap_cli.ingest.raw.recording import RawOdometry, RawRecording, Topic
from dynmap_cli.ingest.text.carmen_lines import TIME_WORDS, Line, fault_of, take_apart
from dynmap_cli.ingest.text.decimals import parse_decimals, parse_numbers
from dynmap_cli.ingest.text.headings import are_headings_degrees
from dynmap_cli.ingest.text.lost_lines import LostLines
from dynmap_cli.ingest.text.text_lines import text_lines

_SAME_SWEEPS = {"RAWLASER1": ("FLASER", "ROBOTLASER1"), "RAWLASER2": ("RLASER", "ROBOTLASER2")}
"""Lines without a pose, and those that hold the same sweeps with one."""
_OFFSETS = {b"robot_frontlaser_offset": ("RAWLASER1", 0.0), b"robot_rearlaser_offset": ("RAWLASER2", math.pi)}
"""Settings that say how far ahead of the robot's centre a laser sits, and where it looks."""
_LEAST_SHARE = 0.9
"""Lines with a pose that cover less of the time of those without one hold a part of the sweeps only."""
_KIND = re.compile(rb"[A-Za-z_][A-Za-z0-9_]{0,31}")
_BATCH, _BATCH_BYTES = 64, 1 << 22
_NO_STAMP_STEP_NS = 10**9
_FLICKER_M, _FLICKER_RAD = 1e-3, 1e-3


def read_carmen(path: Path, name: str, folder: Path | None = None) -> RawRecording:
    """Read a CARMEN log; lines that do not parse are counted, not fatal."""
    reader = _read(path, _Reader(RawRecording(name, "CARMEN text", folder=folder)))
    partial = reader.partial_twins()
    if partial:
        places = {raw: reader.recording.lasers[twin].robot_from_sensor for raw, twin in partial.items()}
        counts = reader.counts
        reader = _Reader(RawRecording(name, "CARMEN text", folder=folder), frozenset(partial.values()))
        _read(path, reader)
        for raw, twin in partial.items():
            laser = reader.recording.lasers.get(raw)
            if laser is not None and laser.robot_from_sensor is None:
                laser.robot_from_sensor = places[raw]
            reader.recording.notes.append(
                f"{twin}: its {counts[twin]} lines are left out; they hold a part only of the sweeps of the "
                f"{counts[raw]} {raw} lines, which are placed by ODOM"
            )
    return reader.recording


def _read(path: Path, reader: _Reader) -> _Reader:
    """Give all lines of a file to a reader."""
    for number, line in text_lines(path, reader.recording.drop_broken):
        words = line.split(None, 1)
        if words and not words[0].startswith(b"#"):
            reader.take(words[0], number, line)
    reader.finish()
    return reader


class _Reader:
    """Takes lines one after the other; parses the numbers of many at a time; of some kinds none."""

    def __init__(self, recording: RawRecording, unwanted: frozenset[str] = frozenset()) -> None:
        self.recording, self.unwanted = recording, unwanted
        self.counts: Counter[str] = Counter()
        self.lost = LostLines(fault_of)
        self.waiting: dict[str, list[tuple[Line, int, bytes]]] = {}
        """Parts, number and text of lines, by kind."""
        self.waiting_bytes = 0
        self.laser_poses: dict[str, list[F64]] = {}
        self.offsets_m: dict[bytes, float] = {}
        self.ends: dict[str, tuple[bytes, bytes]] = {}
        """First and last line without a pose, by kind."""

    def take(self, word: bytes, number: int, line: bytes) -> None:
        """Read one line, if it is of a known kind."""
        name = _name_of(word)
        if not name:
            self.recording.dropped["line of no known kind"] += 1
            return
        self.counts[name] += 1
        if word == b"PARAM":
            self._take_setting(line)
        if name in _SAME_SWEEPS:
            self.ends[name] = (self.ends.get(name, (line,))[0], line)
        if name in self.unwanted or self._twin_of(name):
            return
        try:
            found = take_apart(word, line)
        except (ValueError, IndexError):
            self.lost.add(name, number, line)
            return
        if found is None:
            return
        lines = self.waiting.setdefault(name, [])
        lines.append((found, number, line))
        self.waiting_bytes += len(found.text)
        if len(lines) >= _BATCH or self.waiting_bytes >= _BATCH_BYTES:
            self._parse_waiting()

    def _take_setting(self, line: bytes) -> None:
        """Remember how far ahead of the robot's centre a laser sits, metres."""
        words = line.split()
        if len(words) > 2 and words[1] in _OFFSETS:
            try:
                offset_m = float(words[2])
            except ValueError:
                return
            if are_coordinates((offset_m,)):
                self.offsets_m[words[1]] = offset_m

    def _twin_of(self, name: str) -> str:
        """The lines that hold the same sweeps with their poses, of which some were read; "" where there are none."""
        return next((twin for twin in _SAME_SWEEPS.get(name, ()) if twin in self.recording.lasers), "")

    def _parse_waiting(self) -> None:
        """Parse all waiting lines."""
        waiting, self.waiting, self.waiting_bytes = self.waiting, {}, 0
        for name, lines in waiting.items():
            self._parse(name, lines)

    def _parse(self, name: str, waiting: list[tuple[Line, int, bytes]]) -> None:
        """Parse lines of one kind; one by one where some are malformed."""
        lines = [line for line, _, _ in waiting]
        try:
            stamps_ns = stamps_of_words([line.stamp for line in lines])
            poses = _poses_of(lines)
            runs = [] if lines[0].shape is None else _ranges_of(lines)
        except ValueError:
            if len(waiting) == 1:
                self.lost.add(name, *waiting[0][1:])
            else:
                for line in waiting:
                    self._parse(name, [line])
            return
        self.recording.n_read += len(lines)
        if any(line.in_degrees for line in lines):
            self.recording.say_degrees(name)
        if poses.size:
            track = self.recording.odometry.get(name)
            if track is None:
                track = self.recording.odometry[name] = RawOdometry(name)
            track.add_many(stamps_ns, stamps_ns, poses[:, -3:])
        # Without a pose the laser is not at the robot's centre, but in a frame that nothing joins to it.
        frame = "" if poses.size else name
        start = 0
        for shape, ranges_m in runs:
            run = slice(start, start + ranges_m.shape[0])
            laser = self.recording.laser(name, frame)
            number = np.full(ranges_m.shape[0], laser.number_of(shape), dtype=np.int32)
            laser.add_many(stamps_ns[run], stamps_ns[run], ranges_m, number, np.zeros(number.size))
            start = run.stop
        if runs and poses.size:
            self.laser_poses.setdefault(name, []).append(poses)

    def finish(self) -> None:
        """Parse the rest, find how the lasers are mounted, and replace stamps that were lost."""
        self._parse_waiting()
        self.lost.tell(self.recording)
        self.recording.topics = [Topic(word, "line", count) for word, count in sorted(self.counts.items())]
        self._leave_out_twins()
        in_degrees = self._mend_headings()
        for word, parts in self.laser_poses.items():
            laser, poses = self.recording.lasers[word], np.concatenate(parts)
            if word in in_degrees:
                poses[:, [2, 5]] = np.radians(poses[:, [2, 5]])
            laser.robot_from_sensor = mounting(poses[:, 3:6], poses[:, 0:3])
            if laser.robot_from_sensor is None:
                self.recording.warnings.append(
                    f"{word}: laser and robot pose of a line differ by no fixed amount, as in logs whose first pose "
                    "was corrected; the second one is used"
                )
        for setting, offset_m in self.offsets_m.items():
            name, yaw_rad = _OFFSETS[setting]
            if name in self.recording.lasers:
                self.recording.lasers[name].robot_from_sensor = np.array([offset_m, 0.0, yaw_rad])
        replace_lost_stamps(self.recording)

    def _mend_headings(self) -> set[str]:
        """Bring headings that are in degrees to radians, and say so; kinds of lines that had them."""
        found = {name for name, track in self.recording.odometry.items() if are_headings_degrees(track.poses)}
        for name in sorted(found):
            poses = self.recording.odometry[name].poses.copy()
            poses[:, 2] = np.radians(poses[:, 2])
            self.recording.odometry[name].poses = poses
            self.recording.warnings.append(
                f"{name}: the robot drives along its headings if they are degrees: taken so"
            )
        return found

    def partial_twins(self) -> dict[str, str]:
        """Lines without a pose that go on for longer than those with one, and the latter."""
        found = {}
        for name, lines in self.ends.items():
            twin = self._twin_of(name)
            if not twin or self.counts["ODOM"] < 2:
                continue
            covered_ns = np.ptp(self.recording.lasers[twin].stamps_ns)
            try:
                first_ns, last_ns = stamps_of_words([line.split()[-TIME_WORDS] for line in lines])
            except (ValueError, IndexError):
                continue
            if covered_ns < _LEAST_SHARE * (last_ns - first_ns):
                found[name] = twin
        return found

    def _leave_out_twins(self) -> None:
        """Leave out sweeps without a pose that other lines hold with one, and say so."""
        for name in _SAME_SWEEPS:
            twin = self._twin_of(name)
            if twin and self.counts[name]:
                self.recording.lasers.pop(name, None)
                self.recording.notes.append(
                    f"{name}: its {self.counts[name]} lines are left out; the {self.counts[twin]} {twin} lines hold "
                    "the same sweeps with their poses"
                )


@lru_cache(maxsize=64)
def _name_of(word: bytes) -> str:
    """Name of a kind of line; "" where the first word is none."""
    return word.decode("ascii") if _KIND.fullmatch(word) else ""


def _poses_of(lines: list[Line]) -> F64:
    """Poses (n, 6), (n, 3) or (n, 0) of lines.

    Raises
    ------
    ValueError
        If one is none.
    """
    width = len(lines[0].poses)
    if not width:
        return np.empty((len(lines), 0))
    values = parse_numbers(b" ".join([b" ".join(line.poses) for line in lines]))
    if values.size != width * len(lines) or not (np.abs(values) <= FARTHEST_M).all():
        msg = "not a plausible pose"
        raise ValueError(msg)
    return values.reshape(len(lines), width)


def _ranges_of(lines: list[Line]) -> list[tuple[ScanShape, F32]]:
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
        if word in recording.odometry:
            recording.odometry[word].stamps_ns = stamps
        recording.odometry.pop("ODOM", None)
        recording.warnings.append(
            f"{word}: all time stamps are the same, so sweeps keep their order and are put 1 s apart; "
            "times and speeds mean nothing"
        )
