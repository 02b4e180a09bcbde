"""Wean Hall text logs of CMU's course on statistical robotics.

`O x y theta ts` (odometry) and `L x y theta xl yl thetal r1..r180 ts` (odometry of robot and laser, ranges);
centimetres, radians, seconds; beams run from right (-90 deg) to left in steps of 1 deg.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.ingest.raw.laser import ScanShape
from dynmap_cli.ingest.raw.plausible import FARTHEST_M, stamp_of_word, to_ranges_m
from dynmap_cli.ingest.raw.recording import RawOdometry, RawRecording, Topic
from dynmap_cli.ingest.text.carmen import mounting, replace_lost_stamps
from dynmap_cli.ingest.text.decimals import parse_numbers
from dynmap_cli.ingest.text.lost_lines import LostLines, fault_of_pose, fault_of_readings, fault_of_time
from dynmap_cli.ingest.text.text_lines import text_lines

_CM = 0.01
_N_BEAMS = 180
_SHAPE = ScanShape(-math.pi / 2.0, math.radians(1.0), _N_BEAMS, 0.01, math.inf)
_WIDTHS = {b"O": 3, b"L": 6 + _N_BEAMS}
_N_POSES = {b"O": 3, b"L": 6}


def read_wean(path: Path, name: str, folder: Path | None = None) -> RawRecording:
    """Read a Wean Hall log; lines that do not parse are counted, not fatal."""
    recording = RawRecording(name, "Wean Hall text", folder=folder)
    counts: Counter[str] = Counter()
    laser_poses: list[F64] = []
    lost = LostLines(_fault_of)
    for number, line in text_lines(path, recording.drop_broken):
        word = line[:1]
        if word not in _WIDTHS:
            if line.strip():
                recording.dropped["line of no known kind"] += 1
            continue
        counts[word.decode()] += 1
        try:
            _take(recording, word, line, laser_poses)
        except ValueError:
            lost.add(word.decode(), number, line)
    lost.tell(recording)
    recording.topics = [Topic(word, "line", count) for word, count in sorted(counts.items())]
    if laser_poses:
        poses = np.array(laser_poses)
        recording.lasers["L"].robot_from_sensor = mounting(poses[:, :3], poses[:, 3:])
        replace_lost_stamps(recording)
    return recording


def _take(recording: RawRecording, word: bytes, line: bytes, laser_poses: list[F64]) -> None:
    """Read one line."""
    head, stamp = line.rsplit(None, 1)
    values = parse_numbers(head[2:])
    if values.size != _WIDTHS[word]:
        msg = "wrong count of numbers"
        raise ValueError(msg)
    stamp_ns = stamp_of_word(stamp)
    if not (np.abs(values[: _N_POSES[word]]) <= FARTHEST_M).all():
        msg = "a pose out of range"
        raise ValueError(msg)
    values[[0, 1]] *= _CM
    track = recording.odometry.setdefault(word.decode(), RawOdometry(word.decode()))
    track.add(stamp_ns, stamp_ns, (float(values[0]), float(values[1]), float(values[2])))
    recording.n_read += 1
    if word == b"L":
        values[[3, 4]] *= _CM
        laser_poses.append(values[:6])
        recording.laser("L").add(stamp_ns, stamp_ns, to_ranges_m(values[6:] * _CM), _SHAPE)


def _fault_of(line: bytes) -> str:
    """What is wrong with a line that does not parse."""
    word, *words = line[:1], *line[2:].split()
    n_words = _WIDTHS[word] + 1
    if len(words) != n_words:
        return f"{len(words)} numbers found, {n_words} are allowed"
    *values, stamp = words
    n_poses = _N_POSES[word]
    return fault_of_pose(values[:n_poses]) or fault_of_readings(values[n_poses:]) or fault_of_time(stamp)
