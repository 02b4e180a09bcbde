"""Slow twins of the evidence kernels: plain geometry, one beam and one cell at a time."""

import math

import numpy as np


def plain_evidence(beams, surface, sine, beyond_m, usable_m):
    """Hits and crossed lengths by clipping every beam against every cell; beams = [(x0, y0, angle, range)], metres."""
    size = surface.frame.resolution_m
    low = surface.cells[:, ::-1] * size + [surface.frame.origin_x_m, surface.frame.origin_y_m]
    has_normal = surface.normals.any(axis=1)
    hits, crossed = np.zeros(len(low)), np.zeros(len(low))
    for x0, y0, angle, distance in beams:
        if math.isnan(distance):
            continue
        start, direction = np.array([x0, y0]), np.array([math.cos(angle), math.sin(angle)])
        if distance <= usable_m:
            end = start + distance * direction
            hits += ((low <= end) & (end < low + size)).all(axis=1)
        stop = distance - beyond_m if distance <= usable_m else usable_m
        a, b = (low - start) / direction, (low + size - start) / direction
        enter = np.minimum(a, b).max(axis=1, initial=0.0)
        leave = np.maximum(a, b).min(axis=1, initial=max(stop, 0.0))
        crosses = ~has_normal | (np.abs(surface.normals @ direction) >= sine)
        crossed += np.where(crosses, np.maximum(leave - enter, 0.0), 0.0) / size
    return hits, crossed


def plain_states(hits, crossed, shape, cells, rule):
    """Tri-state of each surface cell with the hit share on a whole grid."""
    share, hit_grid = np.zeros(shape), np.zeros(shape)
    for (row, col), h, c in zip(cells, hits, crossed, strict=True):
        share[row, col] = h / (h + c) if h > 0 else 0.0
        hit_grid[row, col] = h
    states = []
    reach = rule.support_cells
    for (row, col), h, c in zip(cells, hits, crossed, strict=True):
        around = share[
            max(row - reach, 0) : row + reach + 1,
            max(col - reach, 0) : col + reach + 1,
        ]
        if h >= rule.occupied_hits and share[row, col] >= rule.occupied_share:
            states.append(1)
        elif c >= rule.free_cells and around.max() < rule.free_share:
            states.append(0)
        else:
            states.append(-1)
    return np.array(states)


def plain_normal(points):
    """Normal of the line through points (n, 2) by principal axes, with the ratio of the eigenvalues."""
    values, vectors = np.linalg.eigh(np.cov(np.asarray(points).T, bias=True))
    return vectors[:, 0], values[0] / values[1]
