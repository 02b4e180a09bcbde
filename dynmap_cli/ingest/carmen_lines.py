"""Lines of CARMEN text logs taken apart: FLASER, RLASER, ROBOTLASER1 and 2, RAWLASER1 to 5, ODOM.

First pose of FLASER = laser, second = robot, both in the odometry frame:
`FLASER n r1..rn x y theta odom_x odom_y odom_theta ipc_timestamp host logger_timestamp`,
`ODOM x y theta tv rv accel ipc_timestamp host logger_timestamp`,
`RAWLASER1 type start_angle fov resolution max_range accuracy remission_mode n r1..rn n_remission ..
ipc_timestamp host logger_timestamp`, and ROBOTLASER1, which has before its time
`laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv forward_safety side_safety turn_axis`.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

from dynmap_cli.ingest.plausible import are_coordinates, is_sweep
from dynmap_cli.ingest.raw_laser import ScanShape

OLD_LASERS = (b"FLASER", b"RLASER")
ROBOT_LASERS = (b"ROBOTLASER1", b"ROBOTLASER2")
RAW_LASERS = (b"RAWLASER1", b"RAWLASER2", b"RAWLASER3", b"RAWLASER4", b"RAWLASER5")
_ODOM_WORDS = 10
_TIME_WORDS, _POSE_WORDS = 3, 6
_ROBOT_TAIL_WORDS = _POSE_WORDS + 5 + _TIME_WORDS
_SHORTEST_M = 0.01
_SICK_REACH_M = 80.0


class Line(NamedTuple):
    """A line whose numbers are not parsed yet.

    Attributes
    ----------
    stamp : bytes
    poses : list of bytes
        Six numbers: laser, robot; of ODOM lines three, of RAWLASER lines none.
    shape : ScanShape or None
        None = no sweep.
    text : bytes
        Ranges, where remissions follow them with the count of these and these.
    n_numbers : int
        How many numbers *text* should hold.
    """

    stamp: bytes
    poses: list[bytes]
    shape: ScanShape | None = None
    text: bytes = b""
    n_numbers: int = 0


def take_apart(word: bytes, line: bytes) -> Line | None:
    """The parts of a line that begins with a word; None where it is of a kind that is not used.

    Raises
    ------
    ValueError or IndexError
        If the line is malformed.
    """
    if word in OLD_LASERS:
        return _old_laser(line)
    if word in ROBOT_LASERS:
        return _stating_laser(line, _ROBOT_TAIL_WORDS)
    if word in RAW_LASERS:
        return _stating_laser(line, _TIME_WORDS)
    return _odometry(line) if word == b"ODOM" else None


def _old_laser(line: bytes) -> Line:
    """Take a FLASER or RLASER line apart; the beams of 180 readings start at -90 deg."""
    _, count, rest = line.split(None, 2)
    text, *poses, stamp, _host, _logger = rest.rsplit(None, _POSE_WORDS + _TIME_WORDS)
    n_beams = int(count)
    if text.count(b" ") != n_beams - 1:
        text = b" ".join(text.split())
    if n_beams < 1 or len(poses) != _POSE_WORDS or text.count(b" ") != n_beams - 1:
        msg = "beam count"
        raise ValueError(msg)
    return Line(stamp, poses, flaser_shape(n_beams), text, n_beams)


def _stating_laser(line: bytes, n_tail: int) -> Line:
    """Take a line apart that states its geometry, ROBOTLASER or RAWLASER, which have that many words after readings."""
    *header, rest = line.split(None, 9)
    text, *tail = rest.rsplit(None, n_tail)
    n_beams = int(header[8])
    if text.endswith(b" 0") and text.count(b" ") == n_beams:
        n_numbers = n_beams + 1
    else:
        words = text.split()
        n_numbers = len(words)
        if n_numbers != n_beams + 1 + int(words[n_beams]):
            n_numbers = 0
    if n_beams < 1 or len(tail) != n_tail or not n_numbers:
        msg = "beam count"
        raise ValueError(msg)
    poses = tail[:_POSE_WORDS] if n_tail > _TIME_WORDS else []
    return Line(tail[-_TIME_WORDS], poses, _stated_shape(*header[2:6], n_beams), text, n_numbers)


@lru_cache(maxsize=64)
def _stated_shape(start: bytes, fov: bytes, step: bytes, reach: bytes, n_beams: int) -> ScanShape:
    """Directions of readings as a line states them; ValueError where they are not those of a laser."""
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


def _odometry(line: bytes) -> Line:
    """Take an ODOM line apart; one that is cut off would have its stamp elsewhere."""
    words = line.split()
    if len(words) != _ODOM_WORDS:
        msg = "count of words"
        raise ValueError(msg)
    return Line(words[-_TIME_WORDS], words[1:4])


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
