"""The front end: every scan against the local map of the last key scans, in one loop over the scans."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64, U8
from dynmap_cli.kernels.jit import kernel
from dynmap_cli.kernels.matching import bareness, correlate, insert_points, point_to_line, thin_points

WIDE, LOST, KEY = 1, 2, 4
"""Flags of a scan: the correlative search was used, nothing fitted, it was put into the local map."""

# Entries of the table of numbers that steer the front end.
CELL, SPACING, SIGMA, PRIOR_SHIFT, PRIOR_SHIFT_SHARE, PRIOR_TURN, PRIOR_TURN_SHARE = 0, 1, 2, 3, 4, 5, 6
KEY_SHIFT, KEY_TURN, RING, RING_REACH, INDEPENDENT = 7, 8, 9, 10, 11
WIDE_TURN, GOOD_SHARE, LOST_SHARE, REVERSIBLE = 12, 13, 14, 15
N_NUMBERS = 16
SHORTEST_STEP_S, LONGEST_STEP_S = 0.005, 2.0
"""The velocity during a scan is taken from the step to it where that lasted this long."""
AS_PREDICTED, REVERSED, SEARCH, RECOVER = 0, 1, 2, 3
"""The attempts at a scan, in order."""
RECOVERY_GAIN = 0.15
"""By how much of the points a lost scan must fit better somewhere else."""
REVERSED_MARGIN = 3.0
"""By how much a step must fit better backwards: along a bare corridor both directions fit alike."""


@kernel
def _copy3(source: F64, target: F64) -> None:
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
    _copy3(start, out)
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


@kernel
def register_scans(
    first: int,
    last: int,
    ranges_m: F32,
    weights: F32,
    geometry_index: I32,
    directions: F64,
    sensor_poses: F64,
    usable_m: F64,
    beam_interval_s: F64,
    times_s: F64,
    motion: F64,
    has_motion: U8,
    numbers: F64,
    sums: I64,
    lines: F32,
    stale: U8,
    field: U8,
    laser_index: I64,
    last_keys: I64,
    ring: I64,
    state: I64,
    poses: F64,
    shares: F64,
    information: F64,
    twists: F64,
    flags: U8,
) -> None:
    """Register scans first..last one after another, each against the key scans before it (Eq. 1.11).

    Parameters
    ----------
    first, last : int
        The scans of this call; the scans before *first* are registered.
    ranges_m, weights : (n_scans, n_beams) float32
        Ranges, and e of each beam (NaN counts as 1).
    geometry_index, directions, sensor_poses, usable_m, beam_interval_s
        As for `count_scans`.
    times_s : (n_scans,) float64
    motion : (n_scans, 3) float64
        Motion since the scan before, in its frame, from the odometry.
    has_motion : (n_scans,) uint8
        0 where the odometry says nothing: constant velocity is used.
    numbers : (N_NUMBERS,) float64
        See the names at the top.
    sums, lines, stale, field
        The local map.
    laser_index : (n_geometries,) int64
        Which laser a geometry belongs to.
    last_keys : (n_lasers,) int64
        Last key scan of each laser, -1 = none yet: what it sees may not be in the local map at all.
    ring : (capacity,) int64
        Key scans in the local map, oldest at state[0], state[1] of them.
    state : (3,) int64
        Start and length of the ring, lost scans in a row.
    poses : (n_scans, 3) float64
        Filled; row 0 is the start.
    shares : (n_scans,) float64
        Matched share of each scan.
    information : (n_scans, 3, 3) float64
        What the match knows about each pose, map frame.
    twists : (n_scans, 3) float64
        Filled: velocity during each scan, as counted from there to the next one or as predicted, robot frame.
    flags : (n_scans,) uint8
    """
    n_beams = ranges_m.shape[1]
    points, beams, point_weights = np.empty((n_beams, 2)), np.empty(n_beams, np.int32), np.empty(n_beams)
    scores = np.empty((64, 64), np.int32)
    costs = np.empty(2)
    predicted, centre, start, found = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    best, prior, trial = np.empty(3), np.empty(3), np.empty((3, 3))
    cell_m, sigma_m = numbers[CELL], numbers[SIGMA]
    capacity = ring.size
    for scan in range(first, last):
        flags[scan] = 0
        # Prediction: odometry, or the motion of the step before.
        dx = dy = turn = 0.0
        twists[scan, 0] = twists[scan, 1] = twists[scan, 2] = 0.0
        if scan > 0:
            if has_motion[scan] > 0:
                dx, dy, turn = motion[scan, 0], motion[scan, 1], motion[scan, 2]
            elif scan > 1:
                cos, sin = math.cos(poses[scan - 2, 2]), math.sin(poses[scan - 2, 2])
                wx, wy = poses[scan - 1, 0] - poses[scan - 2, 0], poses[scan - 1, 1] - poses[scan - 2, 1]
                dx, dy = cos * wx + sin * wy, -sin * wx + cos * wy
                turn = (poses[scan - 1, 2] - poses[scan - 2, 2] + math.pi) % (2.0 * math.pi) - math.pi
            elapsed_s = times_s[scan] - times_s[scan - 1]
            if SHORTEST_STEP_S < elapsed_s < LONGEST_STEP_S:
                twists[scan, 0], twists[scan, 1], twists[scan, 2] = (
                    dx / elapsed_s,
                    dy / elapsed_s,
                    turn / elapsed_s,
                )
        if scan + 1 < motion.shape[0] and has_motion[scan + 1] > 0:
            # A sweep runs after its stamp, so its velocity is that of the step to the next one.
            elapsed_s = times_s[scan + 1] - times_s[scan]
            if SHORTEST_STEP_S < elapsed_s < LONGEST_STEP_S:
                for k in range(3):
                    twists[scan, k] = motion[scan + 1, k] / elapsed_s
        geometry = geometry_index[scan]
        count = thin_points(
            ranges_m[scan],
            directions[geometry],
            sensor_poses[geometry],
            usable_m[geometry],
            beam_interval_s[geometry],
            twists[scan],
            numbers[SPACING],
            points,
            beams,
        )
        weight_sum = 0.0
        for k in range(count):
            e = float(weights[scan, beams[k]])
            point_weights[k] = 1.0 if math.isnan(e) else e
            weight_sum += point_weights[k]
        if scan > 0:
            cos, sin = math.cos(poses[scan - 1, 2]), math.sin(poses[scan - 1, 2])
            predicted[0] = poses[scan - 1, 0] + cos * dx - sin * dy
            predicted[1] = poses[scan - 1, 1] + sin * dx + cos * dy
            predicted[2] = poses[scan - 1, 2] + turn
            shift_m, turn_rad = math.sqrt(dx * dx + dy * dy), abs(turn)
            sigma_shift = numbers[PRIOR_SHIFT] + numbers[PRIOR_SHIFT_SHARE] * shift_m
            sigma_turn = numbers[PRIOR_TURN] + numbers[PRIOR_TURN_SHARE] * turn_rad
            if has_motion[scan] == 0:
                sigma_shift, sigma_turn = 0.05 + 0.3 * shift_m, 0.05 + 0.3 * turn_rad
            prior[0] = prior[1] = 1.0 / sigma_shift**2
            prior[2] = 1.0 / sigma_turn**2
            is_first = last_keys[laser_index[geometry]] < 0
            share = loss = 0.0
            for attempt in range(4):
                # Where to start: as predicted, backwards, by correlation around, or far around when lost.
                _copy3(predicted, start)
                _copy3(predicted, centre)
                if attempt == REVERSED:
                    if numbers[REVERSIBLE] == 0.0 or shift_m < 0.02:
                        continue
                    start[0] = poses[scan - 1, 0] - cos * dx + sin * dy
                    start[1] = poses[scan - 1, 1] - sin * dx - cos * dy
                    _copy3(start, centre)
                elif attempt > REVERSED:
                    needed = share < numbers[LOST_SHARE]
                    if attempt == SEARCH:
                        needed = (
                            2.0 * sigma_turn > numbers[WIDE_TURN]
                            or share < numbers[GOOD_SHARE]
                            or has_motion[scan] == 0
                        )
                    if not needed or is_first or count < 20:
                        continue
                    half, step_rad = min(max(2.0 * sigma_turn, 0.07), 0.35), 0.00873
                    reach, step_cells = int(min(max(2.5 * sigma_shift / cell_m, 4.0), 10.0)), 1
                    costs[0], costs[1] = 0.3, 1.0
                    if attempt == RECOVER:
                        half, step_rad = 1.05 if state[2] < 4 else math.pi, 0.0175
                        reach, step_cells = 24, 2
                        costs[0], costs[1] = 0.02, 0.05
                    correlate(
                        points,
                        count,
                        predicted,
                        half,
                        step_rad,
                        reach,
                        step_cells,
                        cell_m,
                        field,
                        scores,
                        costs,
                        start,
                    )
                    flags[scan] |= WIDE
                    if attempt == RECOVER:
                        _copy3(start, centre)
                found_share = refine(
                    points, point_weights, count, start, centre, prior, numbers[INDEPENDENT], sigma_m, cell_m,
                    sums, lines, stale, field, trial, found,
                )  # fmt: skip
                if attempt != REVERSED:
                    _copy3(predicted, centre)
                found_loss = fit_loss(found_share, weight_sum, numbers[INDEPENDENT], found, centre, prior)
                if attempt == REVERSED:
                    found_loss += REVERSED_MARGIN
                is_better = attempt == AS_PREDICTED or found_loss < loss
                if attempt == RECOVER and found_share < share + RECOVERY_GAIN:
                    is_better = False
                if is_better:
                    share, loss = found_share, found_loss
                    _copy3(found, best)
                    _copy3(centre, predicted)
                    for i in range(3):
                        _copy3(trial[i], information[scan, i])
            if share < numbers[LOST_SHARE] and not is_first:
                flags[scan] |= LOST
                state[2] += 1
            else:
                state[2] = 0
            poses[scan] = best
            shares[scan] = share
        else:
            shares[scan] = 1.0
        # Key scans enter the local map; the oldest leave it.
        key = last_keys[laser_index[geometry]]
        is_key = key < 0
        if not is_key:
            dx, dy = poses[scan, 0] - poses[key, 0], poses[scan, 1] - poses[key, 1]
            turned = abs((poses[scan, 2] - poses[key, 2] + math.pi) % (2.0 * math.pi) - math.pi)
            is_key = math.sqrt(dx * dx + dy * dy) > numbers[KEY_SHIFT] or turned > numbers[KEY_TURN]
        if not is_key:
            continue
        flags[scan] |= KEY
        insert_points(points, point_weights, count, poses[scan], 1, cell_m, sums, lines, stale, field)
        ring[(state[0] + state[1]) % capacity] = scan
        state[1] += 1
        last_keys[laser_index[geometry]] = scan
        while state[1] > 1:
            oldest = ring[state[0]]
            dx, dy = poses[scan, 0] - poses[oldest, 0], poses[scan, 1] - poses[oldest, 1]
            if (
                state[1] < min(int(numbers[RING]), capacity)
                and math.sqrt(dx * dx + dy * dy) < numbers[RING_REACH]
            ):
                break
            geometry = geometry_index[oldest]
            count = thin_points(
                ranges_m[oldest],
                directions[geometry],
                sensor_poses[geometry],
                usable_m[geometry],
                beam_interval_s[geometry],
                twists[oldest],
                numbers[SPACING],
                points,
                beams,
            )
            for k in range(count):
                e = float(weights[oldest, beams[k]])
                point_weights[k] = 1.0 if math.isnan(e) else e
            insert_points(points, point_weights, count, poses[oldest], -1, cell_m, sums, lines, stale, field)
            state[0] = (state[0] + 1) % capacity
            state[1] -= 1
