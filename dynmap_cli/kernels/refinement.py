"""Point-to-line refinement of a scan on the local map, with a prior (Gauss-Newton on hit centroids)."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F32, F64, I64, U8
from dynmap_cli.kernels.jit import kernel
from dynmap_cli.kernels.matching import FIELD_RADIUS, HIT, MASK, refresh_line

BARE, KNOWN_BOTH_WAYS = 0.01, 0.04
"""Information along a corridor as a share of that across: below the one it is noise, above the other it counts."""


@kernel
def bareness(xx: float, xy: float, yy: float) -> float:
    """How much like a bare corridor the place is, 0 to 1: whether walls fix a position in one direction only.

    Normals are noisy, so that even parallel walls seem to say something along them, some 0.3 % of what they say across.

    Parameters
    ----------
    xx, xy, yy : float
        Information about a position.
    """
    mean, half = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    ratio = (mean - half) / (mean + half + 1e-12)
    return float(min(max((KNOWN_BOTH_WAYS - ratio) / (KNOWN_BOTH_WAYS - BARE), 0.0), 1.0))


@kernel
def point_to_line(
    points: F64,
    weights: F64,
    count: int,
    pose: F64,
    radius_cells: int,
    sigma_m: float,
    cell_m: float,
    sums: I64,
    lines: F32,
    stale: U8,
    field: U8,
    normal_matrix: F64,
    gradient: F64,
) -> float:
    """Fill the normal equations of sum_k w_k rho(n . (R p_k + t - c)) at a pose; return the matched share.

    Each point is paired with the nearest hit centroid c within a few cells, its residual is the distance from
    the line through c with normal n; rho is the Geman-McClure kernel of scale *sigma_m*.

    Parameters
    ----------
    points, weights, count
        As for `insert_points`.
    pose : (3,) float64
    radius_cells : int
    sigma_m, cell_m : float
    sums, lines, stale, field
        The local map.
    normal_matrix : (3, 3) float64
        J^T W J, in 1 / m^2, 1 / m and 1.
    gradient : (3,) float64
        J^T W r.

    Returns
    -------
    float
        Weighted mean of 1 / (1 + (r / sigma)^2)^2 over all points; unmatched points count 0.
    """
    for i in range(3):
        gradient[i] = 0.0
        for j in range(3):
            normal_matrix[i, j] = 0.0
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    total, matched = 1e-12, 0.0
    lone = lone_x = lone_y = lone_squared = pull_x = pull_y = pull_turn = 0.0
    for k in range(count):
        weight = weights[k]
        total += weight
        px = cos * points[k, 0] - sin * points[k, 1]
        py = sin * points[k, 0] + cos * points[k, 1]
        x, y = (pose[0] + px) / cell_m, (pose[1] + py) / cell_m
        col, row = int(math.floor(x)), int(math.floor(y))
        best = (radius_cells + 0.5) ** 2
        best_r = best_c = -1
        best_x = best_y = 0.0
        low_r, high_r, low_c, high_c = -radius_cells, radius_cells, -radius_cells, radius_cells
        r, c = row & MASK, col & MASK
        if field[r, c] == HIT:
            # Nothing is nearer than the centroid of the point's own cell but in the cells that it could reach.
            best_r, best_c = r, c
            best_x, best_y = col + float(lines[r, c, 0]) - x, row + float(lines[r, c, 1]) - y
            best = best_x * best_x + best_y * best_y
            reach = math.sqrt(best)
            low_r, high_r = int(math.floor(y - reach)) - row, int(math.floor(y + reach)) - row
            low_c, high_c = int(math.floor(x - reach)) - col, int(math.floor(x + reach)) - col
        elif radius_cells <= FIELD_RADIUS and field[r, c] == 0:
            continue
        for dr in range(low_r, high_r + 1):
            r = (row + dr) & MASK
            for dc in range(low_c, high_c + 1):
                c = (col + dc) & MASK
                if field[r, c] == HIT:
                    ox = col + dc + float(lines[r, c, 0]) - x
                    oy = row + dr + float(lines[r, c, 1]) - y
                    distance = ox * ox + oy * oy
                    if distance < best:
                        best, best_r, best_c = distance, r, c
                        best_x, best_y = ox, oy
        if best_r < 0:
            continue
        if stale[best_r, best_c]:
            refresh_line(sums, lines, field, best_r, best_c)
            stale[best_r, best_c] = 0
        nx, ny = float(lines[best_r, best_c, 2]), float(lines[best_r, best_c, 3])
        if nx == 0.0 and ny == 0.0:
            # No line here (a leg, a corner): pull towards the centroid itself, as a weak point.
            distance_m = math.sqrt(best) * cell_m
            share = 1.0 / (1.0 + (distance_m / sigma_m) ** 2) ** 2
            matched += weight * share
            w = 0.25 * weight * share
            ex, ey = -best_x * cell_m, -best_y * cell_m
            normal_matrix[0, 0] += w
            normal_matrix[1, 1] += w
            normal_matrix[0, 2] -= w * py
            normal_matrix[1, 2] += w * px
            normal_matrix[2, 2] += w * (px * px + py * py)
            gradient[0] += w * ex
            gradient[1] += w * ey
            gradient[2] += w * (px * ey - py * ex)
            lone += w
            lone_x += w * px
            lone_y += w * py
            lone_squared += w * (px * px + py * py)
            pull_x += w * ex
            pull_y += w * ey
            pull_turn += w * (px * ey - py * ex)
            continue
        residual = -(nx * best_x + ny * best_y) * cell_m
        share = 1.0 / (1.0 + (residual / sigma_m) ** 2) ** 2
        matched += weight * share
        w = weight * share
        turn = -nx * py + ny * px
        normal_matrix[0, 0] += w * nx * nx
        normal_matrix[0, 1] += w * nx * ny
        normal_matrix[1, 1] += w * ny * ny
        normal_matrix[0, 2] += w * nx * turn
        normal_matrix[1, 2] += w * ny * turn
        normal_matrix[2, 2] += w * turn * turn
        gradient[0] += w * nx * residual
        gradient[1] += w * ny * residual
        gradient[2] += w * turn * residual
    # Along a bare corridor the lone points are where beams graze a wall, and come along with the robot.
    doubt = bareness(normal_matrix[0, 0] - lone, normal_matrix[0, 1], normal_matrix[1, 1] - lone)
    if doubt > 0.0:
        normal_matrix[0, 0] -= doubt * lone
        normal_matrix[1, 1] -= doubt * lone
        normal_matrix[0, 2] += doubt * lone_y
        normal_matrix[1, 2] -= doubt * lone_x
        normal_matrix[2, 2] -= doubt * lone_squared
        gradient[0] -= doubt * pull_x
        gradient[1] -= doubt * pull_y
        gradient[2] -= doubt * pull_turn
    normal_matrix[1, 0] = normal_matrix[0, 1]
    normal_matrix[2, 0] = normal_matrix[0, 2]
    normal_matrix[2, 1] = normal_matrix[1, 2]
    return matched / total


@kernel
def copy3(source: F64, target: F64) -> None:
    """Copy three numbers; slices take much longer to compile."""
    for i in range(3):
        target[i] = source[i]


@kernel
def _solve3(a: F64, b: F64, out: F64) -> bool:
    """Solve a 3 x 3 symmetric positive definite system by Cholesky; False where it is not definite."""
    l00 = a[0, 0]
    if l00 <= 0.0:
        return False
    l00 = math.sqrt(l00)
    l10, l20 = a[1, 0] / l00, a[2, 0] / l00
    d1 = a[1, 1] - l10 * l10
    if d1 <= 0.0:
        return False
    l11 = math.sqrt(d1)
    l21 = (a[2, 1] - l20 * l10) / l11
    d2 = a[2, 2] - l20 * l20 - l21 * l21
    if d2 <= 0.0:
        return False
    l22 = math.sqrt(d2)
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    y2 = (b[2] - l20 * y0 - l21 * y1) / l22
    out[2] = y2 / l22
    out[1] = (y1 - l21 * out[2]) / l11
    out[0] = (y0 - l10 * out[1] - l20 * out[2]) / l00
    return True


@kernel
def leave_to_prior(information: F64, gradient: F64) -> None:
    """Take out what the noise of normals feigns along a bare corridor; there the motion prior decides.

    Parameters
    ----------
    information : (3, 3) float64
        J^T W J, changed in place: along its weakest direction of x and y it loses the share `bareness`.
    gradient : (3,) float64
        J^T W r, changed in place alike.
    """
    taken = bareness(information[0, 0], information[0, 1], information[1, 1])
    if taken == 0.0:
        return
    across = 0.5 * math.atan2(2.0 * information[0, 1], information[0, 0] - information[1, 1])
    x, y = -math.sin(across), math.cos(across)
    column = np.empty(3)
    for i in range(3):
        column[i] = taken * (information[i, 0] * x + information[i, 1] * y)
    known = column[0] * x + column[1] * y
    for i in range(3):
        along_i = x if i == 0 else (y if i == 1 else 0.0)
        for j in range(3):
            along_j = x if j == 0 else (y if j == 1 else 0.0)
            information[i, j] += known * along_i * along_j - along_i * column[j] - column[i] * along_j
    slope = taken * (gradient[0] * x + gradient[1] * y)
    gradient[0] -= slope * x
    gradient[1] -= slope * y


@kernel
def fit_loss(
    share: float, points_weight: float, match_weight: float, pose: F64, predicted: F64, prior: F64
) -> float:
    r"""Loss by which two refined poses are compared: misfit of the points and distance from the prediction.

    The prior has a heavy tail, \ln(1 + d^2 / 4) with d in standard deviations, since wheels slip.
    """
    turn = (pose[2] - predicted[2] + math.pi) % (2.0 * math.pi) - math.pi
    squared = (
        prior[0] * ((pose[0] - predicted[0]) ** 2 + (pose[1] - predicted[1]) ** 2) + prior[2] * turn * turn
    )
    return 2.0 * match_weight * points_weight * (1.0 - share) + 2.0 * math.log(1.0 + 0.25 * squared)


@kernel
def refine(
    points: F64,
    weights: F64,
    count: int,
    start: F64,
    predicted: F64,
    prior: F64,
    match_weight: float,
    sigma_m: float,
    cell_m: float,
    sums: I64,
    lines: F32,
    stale: U8,
    field: U8,
    information: F64,
    out: F64,
) -> float:
    r"""Refine a pose by Gauss-Newton on point-to-line residuals and the motion prior (Eq. 1.11).

    .. math::
        \hat x = \arg\min_x \; \frac{\nu}{\sigma^2} \sum_k e_k \, \rho(n_k \cdot (R p_k + t - c_k))
                 + \sum_i P_i (x_i - x_i^{pred})^2

    The association radius and the scale of the robust kernel shrink over the first iterations.

    Parameters
    ----------
    points, weights, count
        Thinned points of the scan, robot frame, with e of their beams.
    start, predicted : (3,) float64
        Where to begin, and where the motion prior has its maximum.
    prior : (3,) float64
        Inverse variances P of x, y (1 / m^2) and yaw (1 / rad^2).
    match_weight : float
        nu, so that neighbouring beams do not count as independent.
    sigma_m, cell_m : float
    sums, lines, stale, field
        The local map.
    information : (3, 3) float64
        On return nu / sigma^2 * J^T W J of the last iteration, without the prior and without what is feigned.
    out : (3,) float64
        Refined pose.

    Returns
    -------
    float
        Matched share at the refined pose, 0 to 1.
    """
    gradient = np.empty(3)
    step = np.empty(3)
    system = np.empty((3, 3))
    copy3(start, out)
    factor = match_weight / (sigma_m * sigma_m)
    share = 0.0
    for iteration in range(15):
        scale = 5.0 * sigma_m if iteration < 2 else (3.0 * sigma_m if iteration < 3 else 2.0 * sigma_m)
        radius = 3 if iteration < 2 else 2
        share = point_to_line(
            points,
            weights,
            count,
            out,
            radius,
            scale,
            cell_m,
            sums,
            lines,
            stale,
            field,
            information,
            gradient,
        )
        leave_to_prior(information, gradient)
        for i in range(3):
            for j in range(3):
                information[i, j] *= factor
                system[i, j] = information[i, j]
            offset = out[i] - predicted[i]
            if i == 2:
                offset = (offset + math.pi) % (2.0 * math.pi) - math.pi
            system[i, i] += prior[i]
            gradient[i] = -(gradient[i] * factor + prior[i] * offset)
        if not _solve3(system, gradient, step):
            break
        for i in range(3):
            out[i] += step[i]
        if iteration >= 3 and abs(step[0]) + abs(step[1]) < 2e-4 and abs(step[2]) < 2e-5:
            break
    return share
