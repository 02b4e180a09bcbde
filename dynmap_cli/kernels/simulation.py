"""Rays of a sweeping laser against line segments and circles that may move during the sweep."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F64, I32
from dynmap_cli.kernels.jit import kernel

_TWO_PI = 2.0 * math.pi
_GOLDEN = 0.6180339887498949


@kernel
def cast_scans(
    sensor_start: F64,
    sensor_end: F64,
    first_bearing_rad: float,
    increment_rad: float,
    max_range_m: float,
    segments: F64,
    segment_gates: I32,
    segment_returns: F64,
    circles: F64,
    circle_gates: I32,
    object_states: I32,
    moving_segments: F64,
    moving_circles: F64,
    draws: F64,
    out_ranges: F64,
    out_hits: I32,
    out_cosines: F64,
) -> None:
    r"""Write where each beam of each sweep ends, and on what.

    Sensor and movers go in a straight line at constant speed from the first beam to the last, so beam k
    of K sees a primitive with relative end points :math:`a(s) = a_0 + s\,(a_1 - a_0)`, s = k / (K - 1).
    Bearings of a point in straight relative motion are monotone: the bearings of its two ends, minus the
    span of the yaw, bound the beams that a primitive can touch, and only those are tried.

    Parameters
    ----------
    sensor_start, sensor_end : (n_scans, 3) float64
        world_from_sensor at the first and at the last beam; yaw not wrapped between the two.
    first_bearing_rad, increment_rad : float
        Bearing of beam 0 and step to the next; negative = clockwise.
    max_range_m : float
    segments : (n_segments, 4) float64
        x, y of both ends, world frame.
    segment_gates : (n_segments, 2) int32
        Object and state in which the segment is there; object -1 = always.
    segment_returns : (n_segments,) float64
        Share of beams that are reflected; the others pass (glass).
    circles : (n_circles, 3) float64
        x, y, radius.
    circle_gates : (n_circles, 2) int32
    object_states : (n_scans, n_objects) int32
    moving_segments : (n_scans, n_moving, 8) float64
        x, y of both ends at the first beam, then at the last; NaN = not there.
    moving_circles : (n_scans, n_moving, 5) float64
        x, y at the first beam, x, y at the last, radius; NaN = not there.
    draws : (n_scans, n_beams) float64
        Uniform in [0, 1): decides at glass.
    out_ranges : (n_scans, n_beams) float64
        Distance; inf = nothing within reach.
    out_hits : (n_scans, n_beams) int32
        Number of the primitive: segments, circles, moving segments, moving circles in this order; -1 = none.
    out_cosines : (n_scans, n_beams) float64
        Cosine of the angle of incidence, 1 = along the normal.
    """
    n_scans, n_beams = out_ranges.shape
    n_segments, n_circles = segments.shape[0], circles.shape[0]
    n_moving = moving_segments.shape[1]
    directions = np.empty((n_beams, 2))
    for i in range(n_scans):
        x0, y0, yaw0 = sensor_start[i, 0], sensor_start[i, 1], sensor_start[i, 2]
        x1, y1, yaw1 = sensor_end[i, 0], sensor_end[i, 1], sensor_end[i, 2]
        step = (yaw1 - yaw0) / max(n_beams - 1, 1)
        for k in range(n_beams):
            angle = yaw0 + first_bearing_rad + k * (increment_rad + step)
            directions[k, 0] = math.cos(angle)
            directions[k, 1] = math.sin(angle)
            out_ranges[i, k] = math.inf
            out_hits[i, k] = -1
            out_cosines[i, k] = 1.0
        for j in range(n_segments):
            owner = segment_gates[j, 0]
            if owner >= 0 and object_states[i, owner] != segment_gates[j, 1]:
                continue
            ax, ay, bx, by = segments[j, 0], segments[j, 1], segments[j, 2], segments[j, 3]
            _cast_segment(
                ax - x0, ay - y0, bx - x0, by - y0, ax - x1, ay - y1, bx - x1, by - y1,
                yaw0, yaw1, first_bearing_rad, increment_rad, max_range_m, segment_returns[j], j,
                directions, draws[i], out_ranges[i], out_hits[i], out_cosines[i],
            )  # fmt: skip
        for j in range(n_circles):
            owner = circle_gates[j, 0]
            if owner >= 0 and object_states[i, owner] != circle_gates[j, 1]:
                continue
            cx, cy = circles[j, 0], circles[j, 1]
            _cast_circle(
                cx - x0, cy - y0, cx - x1, cy - y1, circles[j, 2],
                yaw0, yaw1, first_bearing_rad, increment_rad, max_range_m, n_segments + j,
                directions, out_ranges[i], out_hits[i], out_cosines[i],
            )  # fmt: skip
        for j in range(n_moving):
            m = moving_segments[i, j]
            if math.isnan(m[0]):
                continue
            _cast_segment(
                m[0] - x0, m[1] - y0, m[2] - x0, m[3] - y0, m[4] - x1, m[5] - y1, m[6] - x1, m[7] - y1,
                yaw0, yaw1, first_bearing_rad, increment_rad, max_range_m, 1.0, n_segments + n_circles + j,
                directions, draws[i], out_ranges[i], out_hits[i], out_cosines[i],
            )  # fmt: skip
        for j in range(moving_circles.shape[1]):
            c = moving_circles[i, j]
            if math.isnan(c[0]):
                continue
            _cast_circle(
                c[0] - x0, c[1] - y0, c[2] - x1, c[3] - y1, c[4],
                yaw0, yaw1, first_bearing_rad, increment_rad, max_range_m, n_segments + n_circles + n_moving + j,
                directions, out_ranges[i], out_hits[i], out_cosines[i],
            )  # fmt: skip


@kernel
def _cast_segment(
    ax0: float,
    ay0: float,
    bx0: float,
    by0: float,
    ax1: float,
    ay1: float,
    bx1: float,
    by1: float,
    yaw0: float,
    yaw1: float,
    first_bearing_rad: float,
    increment_rad: float,
    max_range_m: float,
    returns: float,
    number: int,
    directions: F64,
    draws: F64,
    ranges: F64,
    hits: I32,
    cosines: F64,
) -> None:
    """Shorten the beams of one sweep that a segment reflects; ends relative to the sensor, world axes."""
    n_beams = ranges.size
    distance = _distance_to_segment(ax0, ay0, bx0, by0)
    travel = max(math.hypot(ax1 - ax0, ay1 - ay0), math.hypot(bx1 - bx0, by1 - by0))
    if distance - travel > max_range_m:
        return
    width = _TWO_PI
    low = 0.0
    if distance > travel + 1e-9:
        a0 = math.atan2(ay0, ax0)
        b0 = a0 + _turn(ax0, ay0, bx0, by0)
        a1, b1 = a0, b0
        if travel > 0.0:
            a1 = a0 + _turn(ax0, ay0, ax1, ay1)
            b1 = b0 + _turn(bx0, by0, bx1, by1)
        low = min(a0, b0, a1, b1) - max(yaw0, yaw1)
        width = max(a0, b0, a1, b1) - min(yaw0, yaw1) - low
    shares = 1.0 / max(n_beams - 1, 1)
    for turn in range(2):
        begin, end = _beams_towards(low, width, first_bearing_rad, increment_rad, n_beams, turn)
        for k in range(begin, end):
            s = k * shares
            ax, ay = ax0 + s * (ax1 - ax0), ay0 + s * (ay1 - ay0)
            ex, ey = bx0 + s * (bx1 - bx0) - ax, by0 + s * (by1 - by0) - ay
            dx, dy = directions[k, 0], directions[k, 1]
            determinant = dx * ey - dy * ex
            if determinant == 0.0:
                continue
            along = (ax * dy - ay * dx) / determinant
            if along < 0.0 or along > 1.0:
                continue
            reach = (ax * ey - ay * ex) / determinant
            if reach <= 0.0 or reach >= ranges[k] or reach > max_range_m:
                continue
            if returns < 1.0:
                draw = draws[k] + number * _GOLDEN
                if draw - math.floor(draw) >= returns:
                    continue
            ranges[k] = reach
            hits[k] = number
            cosines[k] = abs(determinant) / math.hypot(ex, ey)


@kernel
def _cast_circle(
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    radius: float,
    yaw0: float,
    yaw1: float,
    first_bearing_rad: float,
    increment_rad: float,
    max_range_m: float,
    number: int,
    directions: F64,
    ranges: F64,
    hits: I32,
    cosines: F64,
) -> None:
    """Shorten the beams of one sweep that a circle reflects; centre relative to the sensor, world axes."""
    n_beams = ranges.size
    distance = math.hypot(x0, y0)
    travel = math.hypot(x1 - x0, y1 - y0)
    if distance - radius - travel > max_range_m:
        return
    width = _TWO_PI
    low = 0.0
    if distance > travel + radius + 1e-9:
        a0 = math.atan2(y0, x0)
        a1 = a0 + _turn(x0, y0, x1, y1)
        half = math.asin(min(radius / (distance - travel), 1.0))
        low = min(a0, a1) - half - max(yaw0, yaw1)
        width = max(a0, a1) + half - min(yaw0, yaw1) - low
    shares = 1.0 / max(n_beams - 1, 1)
    for turn in range(2):
        begin, end = _beams_towards(low, width, first_bearing_rad, increment_rad, n_beams, turn)
        for k in range(begin, end):
            s = k * shares
            x, y = x0 + s * (x1 - x0), y0 + s * (y1 - y0)
            dx, dy = directions[k, 0], directions[k, 1]
            across = x * dy - y * dx
            inside = radius * radius - across * across
            if inside < 0.0:
                continue
            reach = x * dx + y * dy - math.sqrt(inside)
            if reach <= 0.0 or reach >= ranges[k] or reach > max_range_m:
                continue
            ranges[k] = reach
            hits[k] = number
            cosines[k] = math.sqrt(inside) / radius


@kernel
def _beams_towards(
    low: float, width: float, first_bearing_rad: float, increment_rad: float, n_beams: int, turn: int
) -> tuple[int, int]:
    """First beam, and the one after the last, that point between angles low and low + width in a turn of a sweep."""
    size = abs(increment_rad)
    offset = low - first_bearing_rad if increment_rad > 0.0 else first_bearing_rad - low - width
    base = offset - _TWO_PI * math.floor(offset / _TWO_PI) - turn * _TWO_PI
    begin = max(int(math.ceil(base / size - 1e-6)), 0)
    end = min(int(math.floor((base + width) / size + 1e-6)), n_beams - 1)
    return begin, end + 1


@kernel
def _turn(x0: float, y0: float, x1: float, y1: float) -> float:
    """Signed angle from one direction to another, the shorter way."""
    return math.atan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)


@kernel
def _distance_to_segment(ax: float, ay: float, bx: float, by: float) -> float:
    """Distance of the origin from a segment."""
    ex, ey = bx - ax, by - ay
    length2 = ex * ex + ey * ey
    share = 0.0 if length2 == 0.0 else min(max(-(ax * ex + ay * ey) / length2, 0.0), 1.0)
    return math.hypot(ax + share * ex, ay + share * ey)
