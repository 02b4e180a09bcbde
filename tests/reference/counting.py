"""Slow, plain twins of counting and EM: one beam and one cell at a time, as the equations are printed."""

import itertools
import math

import numpy as np


def plain_passes(x0, y0, x1, y1):
    """Cells that a segment passes before the cell of its end, with the length in each; coordinates in cells.

    The segment is cut at every grid line it crosses; each piece lies in one cell.
    """
    cuts = {0.0, 1.0}
    for a, b in ((x0, x1), (y0, y1)):
        for line in range(math.floor(min(a, b)), math.ceil(max(a, b)) + 1):
            if a != b and 0.0 < (line - a) / (b - a) < 1.0:
                cuts.add((line - a) / (b - a))
    cuts = sorted(cuts)
    length = math.hypot(x1 - x0, y1 - y0)
    passes = {}
    for start, stop in itertools.pairwise(cuts):
        middle = (start + stop) / 2
        cell = math.floor(y0 + middle * (y1 - y0)), math.floor(x0 + middle * (x1 - x0))
        passes[cell] = passes.get(cell, 0.0) + (stop - start) * length
    passes.pop((math.floor(y1), math.floor(x1)), None)
    return passes


def plain_beams(log, poses, frame, usable_range_m):
    """Each beam as (scan, beam, passes, end cell or None)."""
    beams = []
    for scan in range(log.n_scans):
        geometry = log.geometry_index[scan]
        x, y, yaw = poses[scan]
        sx, sy, syaw = log.sensor_poses[geometry]
        x0, y0 = x + math.cos(yaw) * sx - math.sin(yaw) * sy, y + math.sin(yaw) * sx + math.cos(yaw) * sy
        usable = min(log.range_limits_m[geometry, 1], usable_range_m)
        for beam in range(log.n_beams):
            distance = float(log.ranges_m[scan, beam])
            if math.isnan(distance):
                continue
            angle = yaw + syaw + log.bearings_rad[geometry, beam]
            reach = min(distance, usable)
            x1, y1 = x0 + reach * math.cos(angle), y0 + reach * math.sin(angle)
            ends = [
                (a - o) / frame.resolution_m
                for a, o in (
                    (x0, frame.origin_x_m),
                    (y0, frame.origin_y_m),
                    (x1, frame.origin_x_m),
                    (y1, frame.origin_y_m),
                )
            ]
            end = (math.floor(ends[3]), math.floor(ends[2])) if distance <= usable else None
            beams.append((scan, beam, plain_passes(*ends), end))
    return beams


def plain_alpha_beta(beams, weights, shape):
    """alpha and beta of Eq. 1.12 with the length weighting of the end of 1.2."""
    alpha, beta = np.zeros(shape), np.zeros(shape)
    for scan, beam, passes, end in beams:
        for cell, length in passes.items():
            beta[cell] += length
        if end is not None:
            alpha[end] += weights[scan, beam]
            beta[end] += 1 - weights[scan, beam]
    return alpha, beta


def plain_static_probability(m, p):
    """Eq. 1.10, its whole e: the prior times epsilon, with epsilon's p in the numerator."""
    return 0.0 if m == 0.0 else p / (p + (1 - p) * (1 / m - 1))


def plain_log_likelihood(beams, weights, m):
    """Eq. 1.7 without gamma, ray by ray, with lengths."""
    total = 0.0
    for scan, beam, passes, end in beams:
        for cell, length in passes.items():
            total += length * math.log(1 - m[cell])
        if end is not None:
            e = weights[scan, beam]
            total += e * math.log(m[end]) if e > 0 else 0.0
            total += (1 - e) * math.log(1 - m[end]) if e < 1 else 0.0
    return total


def plain_fixed_point(h, p, iterations=20000):
    """m of one cell after many E- and M-steps from e = p."""
    m = p * h
    for _ in range(iterations):
        m = h * plain_static_probability(m, p)
    return m
