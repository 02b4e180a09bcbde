"""The front end: every scan against the local map of the last key scans, in one loop over the scans."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64, U8
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.kernels.jit import kernel
from dynmap_cli.kernels.matching import correlate, insert_points, thin_points
from dynmap_cli.kernels.refinement import copy3, fit_loss, refine

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
def _predict_step(
    scan: int, times_s: F64, motion: F64, has_motion: U8, poses: F64, step: F64, twists: F64
) -> None:
    """Fill the expected step to a scan, from the odometry or like the step before, and the velocity during it.

    A velocity that is known is left alone.
    """
    is_known = not math.isnan(twists[scan, 0])
    for k in range(3):
        step[k] = 0.0
        if not is_known:
            twists[scan, k] = 0.0
    if scan > 0:
        if has_motion[scan] > 0:
            copy3(motion[scan], step)
        elif scan > 1:
            cos, sin = math.cos(poses[scan - 2, 2]), math.sin(poses[scan - 2, 2])
            wx, wy = poses[scan - 1, 0] - poses[scan - 2, 0], poses[scan - 1, 1] - poses[scan - 2, 1]
            step[0], step[1] = cos * wx + sin * wy, -sin * wx + cos * wy
            step[2] = (poses[scan - 1, 2] - poses[scan - 2, 2] + math.pi) % (2.0 * math.pi) - math.pi
        elapsed_s = times_s[scan] - times_s[scan - 1]
        if not is_known and SHORTEST_STEP_S < elapsed_s < LONGEST_STEP_S:
            for k in range(3):
                twists[scan, k] = step[k] / elapsed_s
    if not is_known and scan + 1 < motion.shape[0] and has_motion[scan + 1] > 0:
        # A sweep runs after its stamp, so its velocity is that of the step to the next one.
        elapsed_s = times_s[scan + 1] - times_s[scan]
        if SHORTEST_STEP_S < elapsed_s < LONGEST_STEP_S:
            for k in range(3):
                twists[scan, k] = motion[scan + 1, k] / elapsed_s


@kernel
def _points_of(
    ranges_m: F32,
    weights: F32,
    rays: Rays,
    geometry: int,
    twist: F64,
    spacing_m: float,
    points: F64,
    beams: I32,
    point_weights: F64,
) -> int:
    """Fill the thinned points of a scan and their weights; return how many there are."""
    count = thin_points(
        ranges_m,
        rays,
        geometry,
        twist,
        spacing_m,
        points,
        beams,
    )
    for k in range(count):
        e = float(weights[beams[k]])
        point_weights[k] = 1.0 if math.isnan(e) else e
    return count


@kernel
def register_scans(
    first: int,
    last: int,
    ranges_m: F32,
    weights: F32,
    geometry_index: I32,
    rays: Rays,
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
    ring_points: F64,
    ring_weights: F64,
    ring_counts: I64,
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
    ranges_m, weights : (last - first, n_beams) float32
        Ranges of these scans, and e of each beam (NaN counts as 1).
    geometry_index, rays
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
    ring_points, ring_weights, ring_counts : (capacity, n_beams, 2), (capacity, n_beams) float64, (capacity,) int64
        Their points as they were put into it, to be taken out again.
    state : (3,) int64
        Start and length of the ring, lost scans in a row.
    poses : (n_scans, 3) float64
        Filled; row 0 is the start.
    shares : (n_scans,) float64
        Matched share of each scan.
    information : (n_scans, 3, 3) float64
        What the match knows about each pose, map frame.
    twists : (n_scans, 3) float64
        Velocity during each scan, robot frame; where it is NaN, it is filled as counted from there to the next scan,
        or as predicted.
    flags : (n_scans,) uint8
    """
    n_beams = ranges_m.shape[1]
    points, beams, point_weights = np.empty((n_beams, 2)), np.empty(n_beams, np.int32), np.empty(n_beams)
    scores = np.empty((64, 64), np.int32)
    costs = np.empty(2)
    predicted, centre, start, found = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    best, prior, step, trial = np.empty(3), np.empty(3), np.empty(3), np.empty((3, 3))
    cell_m, sigma_m = numbers[CELL], numbers[SIGMA]
    capacity = ring.size
    one = int(np.int64(1))  # a literal would compile the kernel that is called once more
    for scan in range(first, last):
        flags[scan] = 0
        _predict_step(scan, times_s, motion, has_motion, poses, step, twists)
        dx, dy, turn = step[0], step[1], step[2]
        geometry = geometry_index[scan]
        count = _points_of(
            ranges_m[scan - first], weights[scan - first], rays, geometry, twists[scan], numbers[SPACING],
            points, beams, point_weights,
        )  # fmt: skip
        weight_sum = 0.0
        for k in range(count):
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
                copy3(predicted, start)
                copy3(predicted, centre)
                if attempt == REVERSED:
                    if numbers[REVERSIBLE] == 0.0 or shift_m < 0.02:
                        continue
                    start[0] = poses[scan - 1, 0] - cos * dx + sin * dy
                    start[1] = poses[scan - 1, 1] - sin * dx - cos * dy
                    copy3(start, centre)
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
                        copy3(start, centre)
                found_share = refine(
                    points, point_weights, count, start, centre, prior, numbers[INDEPENDENT], sigma_m, cell_m,
                    sums, lines, stale, field, trial, found,
                )  # fmt: skip
                if attempt != REVERSED:
                    copy3(predicted, centre)
                found_loss = fit_loss(found_share, weight_sum, numbers[INDEPENDENT], found, centre, prior)
                if attempt == REVERSED:
                    found_loss += REVERSED_MARGIN
                is_better = attempt == AS_PREDICTED or found_loss < loss
                if attempt == RECOVER and found_share < share + RECOVERY_GAIN:
                    is_better = False
                if is_better:
                    share, loss = found_share, found_loss
                    copy3(found, best)
                    copy3(centre, predicted)
                    for i in range(3):
                        copy3(trial[i], information[scan, i])
            if share < numbers[LOST_SHARE] and not is_first:
                flags[scan] |= LOST
                state[2] += 1
            else:
                state[2] = 0
            copy3(best, poses[scan])
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
        insert_points(points, point_weights, count, poses[scan], one, cell_m, sums, lines, stale, field)
        end = (state[0] + state[1]) % capacity
        ring[end], ring_counts[end] = scan, count
        for k in range(count):
            ring_points[end, k, 0], ring_points[end, k, 1] = points[k, 0], points[k, 1]
            ring_weights[end, k] = point_weights[k]
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
            insert_points(
                ring_points[state[0]], ring_weights[state[0]], ring_counts[state[0]], poses[oldest], -one, cell_m,
                sums, lines, stale, field,
            )  # fmt: skip
            state[0] = (state[0] + 1) % capacity
            state[1] -= 1
