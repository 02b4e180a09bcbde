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

from dynmap_cli.ingest.raw.laser import ScanShape
from dynmap_cli.ingest.raw.plausible import FARTHEST_M, MOST_TURN_RAD, are_coordinates, are_degrees, is_sweep
from dynmap_cli.ingest.text.lost_lines import count_of, fault_of_pose, fault_of_readings, fault_of_time, shown
from dynmap_cli.ingest.text.text_lines import LONGEST_BYTES

OLD_LASERS = (b"FLASER", b"RLASER")
ROBOT_LASERS = (b"ROBOTLASER1", b"ROBOTLASER2")
RAW_LASERS = (b"RAWLASER1", b"RAWLASER2", b"RAWLASER3", b"RAWLASER4", b"RAWLASER5")
_ODOM_WORDS = 10
TIME_WORDS, _POSE_WORDS = 3, 6
_OLD_TAIL_WORDS, _ROBOT_TAIL_WORDS = _POSE_WORDS + TIME_WORDS, _POSE_WORDS + 5 + TIME_WORDS
_OLD_HEADER_WORDS, _HEADER_WORDS = 2, 9
_AROUND_READINGS = {
    **dict.fromkeys(OLD_LASERS, (_OLD_HEADER_WORDS, _OLD_TAIL_WORDS)),
    **dict.fromkeys(ROBOT_LASERS, (_HEADER_WORDS, _ROBOT_TAIL_WORDS)),
    **dict.fromkeys(RAW_LASERS, (_HEADER_WORDS, TIME_WORDS)),
}
"""Words before the readings, up to their count, and behind readings and remissions."""
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
    in_degrees : bool
        Whether the angles that the line states were taken to be in degrees.
    """

    stamp: bytes
    poses: list[bytes]
    shape: ScanShape | None = None
    text: bytes = b""
    n_numbers: int = 0
    in_degrees: bool = False


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
        return _stating_laser(line, TIME_WORDS)
    return _odometry(line) if word == b"ODOM" else None


def _old_laser(line: bytes) -> Line:
    """Take a FLASER or RLASER line apart; the beams of 180 readings start at -90 deg."""
    _, count, rest = line.split(None, 2)
    text, *poses, stamp, _host, _logger = rest.rsplit(None, _OLD_TAIL_WORDS)
    n_beams = int(count)
    if text.count(b" ") != n_beams - 1:
        text = b" ".join(text.split())
    if n_beams < 1 or len(poses) != _POSE_WORDS or text.count(b" ") != n_beams - 1:
        msg = "beam count"
        raise ValueError(msg)
    return Line(stamp, poses, flaser_shape(n_beams), text, n_beams)


def _stating_laser(line: bytes, n_tail: int) -> Line:
    """Take a line apart that states its geometry, ROBOTLASER or RAWLASER, which have that many words after readings."""
    *header, rest = line.split(None, _HEADER_WORDS)
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
    poses = tail[:_POSE_WORDS] if n_tail > TIME_WORDS else []
    shape, in_degrees = _stated_shape(*header[2:6], n_beams)
    return Line(tail[-TIME_WORDS], poses, shape, text, n_numbers, in_degrees)


@lru_cache(maxsize=64)
def _stated_shape(
    start: bytes, fov: bytes, step: bytes, reach: bytes, n_beams: int
) -> tuple[ScanShape, bool]:
    """Directions of readings as a line states them, and whether in degrees; ValueError where no laser has them."""
    words = (start, fov, step, reach)
    try:
        values = tuple(map(float, words))
    except ValueError:
        values = (math.nan,)
    if not are_coordinates(values):
        told = ", ".join(map(shown, words))
        msg = (
            f"start angle, field of view, resolution, range {told}; numbers from {-FARTHEST_M:g} to {FARTHEST_M:g} "
            "are allowed"
        )
        raise ValueError(msg)
    start_rad, fov_rad, step_rad, reach_m = values
    if step_rad == 0.0:
        step_rad = fov_rad / max(n_beams - 1, 1)
    in_degrees = are_degrees(start_rad, step_rad, n_beams)
    if in_degrees:
        start_rad, step_rad = math.radians(start_rad), math.radians(step_rad)
    if not is_sweep(start_rad, step_rad, n_beams):
        msg = (
            f"{n_beams} readings from {start_rad:g} rad on in steps of {step_rad:g} rad; a sweep starts within "
            f"{MOST_TURN_RAD:.1f} rad and turns, by at most as much"
        )
        raise ValueError(msg)
    is_stated = 0.0 < reach_m < _SICK_REACH_M
    shape = ScanShape(start_rad, step_rad, n_beams, _SHORTEST_M, reach_m if is_stated else math.inf)
    return shape, in_degrees


def _odometry(line: bytes) -> Line:
    """Take an ODOM line apart; one that is cut off would have its stamp elsewhere."""
    words = line.split()
    if len(words) != _ODOM_WORDS:
        msg = "count of words"
        raise ValueError(msg)
    return Line(words[-TIME_WORDS], words[1:4])


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


def fault_of(line: bytes) -> str:
    """What is wrong with a line that does not parse."""
    words = line.split()
    if words[0] != b"ODOM":
        return _fault_of_sweep(words)
    if len(words) != _ODOM_WORDS:
        return f"{len(words)} words found, {_ODOM_WORDS} are allowed"
    return fault_of_pose(words[1:4]) or fault_of_time(words[-TIME_WORDS])


def _fault_of_sweep(words: list[bytes]) -> str:
    """What is wrong with the words of a line of readings: their counts, or what stands there."""
    n_header, n_tail = _AROUND_READINGS[words[0]]
    states_shape = n_header > _OLD_HEADER_WORDS
    if len(words) < n_header:
        return f"{len(words)} words found, and word {n_header} is the count of readings"
    n_beams, n_more = count_of(words[n_header - 1]), 0
    if not n_beams:
        return f"count of readings {shown(words[n_header - 1])}; whole numbers from 1 to {LONGEST_BYTES} are allowed"
    announced = f"{n_beams} readings"
    if states_shape:
        n_more = 1
        if len(words) > n_header + n_beams:
            behind = words[n_header + n_beams]
            found = count_of(behind)
            if found is None:
                return f"{announced} announced, and behind them stands {shown(behind)}, not the count of remissions"
            announced, n_more = f"{announced} and {found} remissions", 1 + found
    n_words = n_header + n_beams + n_more + n_tail
    if len(words) != n_words:
        return f"{announced} announced, which takes {n_words} words; {len(words)} found"
    readings, tail = words[n_header:-n_tail], words[-n_tail:]
    return (
        (_fault_of_shape(words[2:6], n_beams) if states_shape else "")
        or fault_of_readings(readings)
        or fault_of_pose(tail[:_POSE_WORDS] if n_tail > TIME_WORDS else [])
        or fault_of_time(tail[-TIME_WORDS])
    )


def _fault_of_shape(words: list[bytes], n_beams: int) -> str:
    """What is wrong with the geometry that a line states; "" where nothing is."""
    start, fov, step, reach = words
    try:
        _stated_shape(start, fov, step, reach, n_beams)
    except ValueError as err:
        return str(err)
    return ""
