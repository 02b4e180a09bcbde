"""Slow, plain twins of scan matching and of the pose graph."""

import math

import numpy as np


def plain_local_map(points, weights, cell_m):
    """Hits and hit centroid of each cell (row, col) -> (weight, x, y), in metres."""
    cells = {}
    for (x, y), w in zip(points, weights, strict=True):
        key = (math.floor(y / cell_m), math.floor(x / cell_m))
        total, sx, sy = cells.get(key, (0.0, 0.0, 0.0))
        cells[key] = (total + w, sx + w * x, sy + w * y)
    return {key: (w, sx / w, sy / w) for key, (w, sx, sy) in cells.items() if w > 0}


def plain_normal(cells, key, cell_m, radius=3):
    """Normal of the line through the centroids around a cell, None where there is no line."""
    around = [
        (min(cells[key[0] + dr, key[1] + dc][0], 4.0), *cells[key[0] + dr, key[1] + dc][1:])
        for dr in range(-radius, radius + 1)
        for dc in range(-radius, radius + 1)
        if (key[0] + dr, key[1] + dc) in cells
    ]
    if len(around) < 3:
        return None
    w = np.array([a[0] for a in around])
    p = np.array([a[1:] for a in around]) / cell_m
    centred = p - (w[:, None] * p).sum(axis=0) / w.sum()
    values, vectors = np.linalg.eigh((w[:, None] * centred).T @ centred / w.sum())
    if values[0] > 0.25 * values[1] or values[1] < 0.3:
        return None
    return vectors[:, 0]


def plain_point_to_line(points, weights, pose, radius, sigma, cell_m, cells):
    """Normal matrix, gradient and matched share of the Geman-McClure point-to-line cost, point by point."""
    normal_matrix, gradient = np.zeros((3, 3)), np.zeros(3)
    lone_matrix, lone_gradient = np.zeros((3, 3)), np.zeros(3)
    matched = 0.0
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for p, w in zip(points, weights, strict=True):
        turned = np.array([c * p[0] - s * p[1], s * p[0] + c * p[1]])
        q = np.array(pose[:2]) + turned
        row, col = math.floor(q[1] / cell_m), math.floor(q[0] / cell_m)
        near = [
            (np.hypot(*(np.array(cells[row + dr, col + dc][1:]) - q)), (row + dr, col + dc))
            for dr in range(-radius, radius + 1)
            for dc in range(-radius, radius + 1)
            if (row + dr, col + dc) in cells
        ]
        near = [one for one in near if one[0] < (radius + 0.5) * cell_m]
        if not near:
            continue
        distance, key = min(near)
        centroid = np.array(cells[key][1:])
        perpendicular = np.array([-turned[1], turned[0]])
        normal = plain_normal(cells, key, cell_m)
        if normal is None:
            share = 1 / (1 + (distance / sigma) ** 2) ** 2
            jac = np.column_stack([np.eye(2), perpendicular])
            lone_matrix += 0.25 * w * share * jac.T @ jac
            lone_gradient += 0.25 * w * share * jac.T @ (q - centroid)
        else:
            r = normal @ (q - centroid)
            share = 1 / (1 + (r / sigma) ** 2) ** 2
            jac = np.array([normal[0], normal[1], normal @ perpendicular])
            normal_matrix += w * share * np.outer(jac, jac)
            gradient += w * share * jac * r
        matched += w * share
    trust = 1 - plain_bareness(normal_matrix)
    return normal_matrix + trust * lone_matrix, gradient + trust * lone_gradient, matched / sum(weights)


def plain_bareness(normal_matrix):
    """0 where both directions of a position are known, 1 where one is not, by its eigenvalues."""
    smaller, larger = np.linalg.eigvalsh(normal_matrix[:2, :2])
    return float(np.clip((0.04 - smaller / max(larger, 1e-12)) / (0.04 - 0.01), 0, 1))


def plain_field(cells):
    """Score of each cell for the correlative search."""
    field = {}
    for row, col in cells:
        for dr in range(-2, 3):
            for dc in range(-2, 3):
                value = int(255 * math.exp(-0.35 * (dr * dr + dc * dc)))
                field[row + dr, col + dc] = max(field.get((row + dr, col + dc), 0), value)
    return field


def plain_correlate(points, pose, angles, shifts, cell_m, field, costs):
    """Best pose and its mean score by trying every shift and turn."""
    best = (-1e9, None, None)
    for angle in angles:
        c, s = math.cos(pose[2] + angle), math.sin(pose[2] + angle)
        cells = [
            (
                math.floor((pose[1] + s * p[0] + c * p[1]) / cell_m),
                math.floor((pose[0] + c * p[0] - s * p[1]) / cell_m),
            )
            for p in points
        ]
        for i in shifts:
            for j in shifts:
                score = sum(field.get((row + i, col + j), 0) for row, col in cells) / (255 * len(cells))
                value = score - costs[0] * cell_m**2 * (i * i + j * j) - costs[1] * angle**2
                if value > best[0] + 1e-12:
                    best = (value, score, (pose[0] + j * cell_m, pose[1] + i * cell_m, pose[2] + angle))
    return best


def plain_residual(a, b, measured):
    """Residual of one edge: estimated minus measured pose of b in the frame of a."""
    c, s = math.cos(a[2]), math.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    turn = b[2] - a[2] - measured[2]
    return np.array(
        [
            c * dx + s * dy - measured[0],
            -s * dx + c * dy - measured[1],
            math.atan2(math.sin(turn), math.cos(turn)),
        ]
    )


def plain_coarse_field(points, coarse_m):
    """Score of each coarse cell of a drawn local map: 255 at points, 120 next to them."""
    field = {}
    for x, y in points:
        row, col = math.floor(y / coarse_m), math.floor(x / coarse_m)
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                value = 255 if dr == dc == 0 else 120
                field[row + dr, col + dc] = max(field.get((row + dr, col + dc), 0), value)
    return field


def plain_judge(points, normals, pose, drawn_points, drawn_normals, free, cell_m, free_cell_m):
    """Shares matched, seen and in free space of moved points, point by point."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    matched = in_free = 0
    half = free.shape[0] // 2
    drawn_cells = {}
    for k, (x, y) in enumerate(drawn_points):
        drawn_cells[math.floor(y / cell_m), math.floor(x / cell_m)] = k
    for (px, py), normal in zip(points, normals, strict=True):
        x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
        row, col = math.floor(y / cell_m), math.floor(x / cell_m)
        turned = np.array([c * normal[0] - s * normal[1], s * normal[0] + c * normal[1]])
        fits = fits_behind = False
        for dr in range(-2, 3):
            for dc in range(-2, 3):
                k = drawn_cells.get((row + dr, col + dc))
                if k is None:
                    continue
                offset = np.array([x, y]) - drawn_points[k]
                if drawn_normals[k].any():
                    fits_line = abs(drawn_normals[k] @ offset) < 0.08
                else:
                    fits_line = np.hypot(*offset) < 0.08
                if turned @ drawn_normals[k] < -0.5:
                    fits_behind |= fits_line
                else:
                    fits |= fits_line
        if fits or fits_behind:
            matched += fits
            continue
        row, col = math.floor(y / free_cell_m) + half, math.floor(x / free_cell_m) + half
        if 0 <= row < free.shape[0] and 0 <= col < free.shape[1] and free[row, col]:
            in_free += 1
    n = len(points)
    return matched / n, (matched + in_free) / n, in_free / n


def plain_bridged(points, weights, cell_m):
    """A scan's points and those between neighbours on a smooth wall, with their weights."""
    out, out_weights = [], []
    for k, point in enumerate(points):
        out.append(point)
        out_weights.append(weights[k])
        if not 1 <= k < len(points) - 2:
            continue
        before, step, after = np.diff(points[k - 1 : k + 3], axis=0)
        gap = np.hypot(*step)
        is_flat = all(
            gap / 2 < np.hypot(*other) < 2 * gap
            and step @ other >= 0
            and abs(step[0] * other[1] - step[1] * other[0]) / gap <= 0.03
            for other in (before, after)
        )
        if is_flat and 3 * cell_m <= gap <= 0.5:
            n = math.ceil(gap / cell_m)
            out += [point + step * j / n for j in range(1, n)]
            out_weights += (n - 1) * [0.25 * min(weights[k], weights[k + 1])]
    return np.array(out), np.array(out_weights)
