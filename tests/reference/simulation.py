"""Slow twins of the ray casting: one beam, one primitive at a time."""

import math

import numpy as np


def distance_to_segment_along_ray(origin, direction, start, end):
    """Solve origin + t direction = start + u (end - start); returns t, or inf without a hit."""
    edge = np.subtract(end, start)
    matrix = np.column_stack([direction, -edge])
    if np.linalg.det(matrix) == 0.0:
        return math.inf
    reach, share = np.linalg.solve(matrix, np.subtract(start, origin))
    return reach if reach > 0.0 and 0.0 <= share <= 1.0 else math.inf


def distance_to_circle_along_ray(origin, direction, center, radius):
    """Smaller root of |origin + t direction - center| = radius; inf without one, or from the inside."""
    offset = np.subtract(origin, center)
    b, c = offset @ direction, offset @ offset - radius**2
    if b * b - c < 0.0:
        return math.inf
    reach = -b - math.sqrt(b * b - c)
    return reach if reach > 0.0 else math.inf


def plain_cast(start, end, first_bearing, increment, n_beams, max_range, segments, circles):
    """Distance of each beam to each primitive alone, (n_beams, n_segments + n_circles).

    *segments* is (n, 8) and *circles* (n, 5), both as at the first and at the last beam.
    """
    out = np.full((n_beams, len(segments) + len(circles)), math.inf)
    for k in range(n_beams):
        share = k / max(n_beams - 1, 1)
        x, y, yaw = np.add(start, share * np.subtract(end, start))
        bearing = yaw + first_bearing + k * increment
        direction = np.array([math.cos(bearing), math.sin(bearing)])
        for number, row in enumerate(segments):
            ends = row[:4] + share * (row[4:] - row[:4])
            out[k, number] = distance_to_segment_along_ray((x, y), direction, ends[:2], ends[2:])
        for number, row in enumerate(circles, start=len(segments)):
            center = row[:2] + share * (row[2:4] - row[:2])
            out[k, number] = distance_to_circle_along_ray((x, y), direction, center, row[4])
    out[out > max_range] = math.inf
    return out
