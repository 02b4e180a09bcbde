"""What sweeps show of motion, beam by beam."""

import numpy as np

from dynmap_cli.domain.poses import wrap_angle

SHIFT_CAP_M, OVERLAP = 0.5, 0.3
LAID_CAP_M, NEARER_M = 0.2, 0.05
ROUNDS, OUTLIERS, MOST_SLOPE_M, MOST_CHANGE_M = 3, 3.0, 0.3, 0.6
LEAST_BEAMS, ABOVE_NOISE, LEAST_KNOWN, SIGMA_OF_MEDIAN = 20, 3.0, 0.03, 1.4826


def best_shift(before, after, n_shifts):
    """The shift of the least mean difference of one pair of sweeps, over all beams that both have."""
    costs = {}
    for shift in range(-n_shifts, n_shifts + 1):
        off_m = [
            min(abs(before[beam + shift] - after[beam]), SHIFT_CAP_M)
            for beam in range(after.size)
            if 0 <= beam + shift < before.size and np.isfinite(before[beam + shift] - after[beam])
        ]
        if len(off_m) >= OVERLAP * before.size:
            costs[shift] = sum(off_m) / len(off_m)
    return min(costs, key=costs.get)


def apart_m(before, after, bearings, motion):
    """What is between the two sweeps of one pair at each beam of the second, laid on the first; NaN = unknown."""
    apart = np.full(len(after), np.nan)
    for beam, (bearing, range_m) in enumerate(zip(bearings, after, strict=True)):
        if not np.isfinite(range_m):
            continue
        x = motion[0] + range_m * np.cos(motion[2] + bearing)
        y = motion[1] + range_m * np.sin(motion[2] + bearing)
        off = np.abs(wrap_angle(bearings - np.arctan2(y, x)))
        nearest = int(np.argmin(off))
        if off[nearest] <= abs(bearings[1] - bearings[0]) / 2 and np.isfinite(before[nearest]):
            apart[beam] = min(abs(np.hypot(x, y) - before[nearest]), LAID_CAP_M)
    return apart


def left_m(before, after, bearings, motion):
    """Mean of what is between them."""
    apart = apart_m(before, after, bearings, motion)
    return np.nanmean(apart) if np.isfinite(apart).any() else np.nan


def share_nearer(befores, afters, bearings, motions, others):
    """Beams that motions lay nearer than others do, less those that others lay nearer, of those that both lay."""
    n_known = n_more = 0
    for before, after, motion, other in zip(befores, afters, motions, others, strict=True):
        own, foreign = (apart_m(before, after, bearings, one) for one in (motion, other))
        for gain_m in foreign - own:
            if np.isfinite(gain_m):
                n_known += 1
                n_more += int(gain_m > NEARER_M) - int(gain_m < -NEARER_M)
    return n_more / n_known if n_known else 0.0


def range_flow(before, after, bearings, reach):
    """Motion x, y, turn of one pair of sweeps by the range flow, and whether it stands out of the noise.

    *reach* is how many beams before and after one its slope is taken over.
    """
    equations = []
    for beam in range(reach, len(bearings) - reach):
        middle = [(before[k] + after[k]) / 2.0 for k in (beam - reach, beam, beam + reach)]
        span_rad = bearings[beam + reach] - bearings[beam - reach]
        rise, change = middle[2] - middle[0], after[beam] - before[beam]
        is_known = np.isfinite([*middle, change]).all() and (rise != 0.0 or change != 0.0)
        if is_known and abs(rise) < MOST_SLOPE_M and abs(change) < MOST_CHANGE_M:
            u = np.array([np.cos(bearings[beam]), np.sin(bearings[beam])])
            v = np.array([-u[1], u[0]])
            slope = rise / span_rad
            equations.append((*(-u + slope / middle[1] * v), slope, change, *(v / middle[1]), 1.0, span_rad))
    if len(equations) < LEAST_BEAMS:
        return np.full(3, np.nan), False
    table = np.array(equations)
    factors, changes, of_slope, spans_rad = table[:, :3], table[:, 3], table[:, 4:7], table[:, 7]
    is_inlier = np.ones(len(table), dtype=bool)
    for _ in range(ROUNDS):
        motion, *_ = np.linalg.lstsq(factors[is_inlier], changes[is_inlier], rcond=None)
        used = is_inlier
        off_m = np.abs(changes - factors @ motion)
        is_inlier = off_m <= OUTLIERS * np.median(off_m)
    sigma_m = SIGMA_OF_MEDIAN * np.median(off_m)
    sure = np.zeros((3, 3))
    for factor, by_slope, span_rad, is_used in zip(factors, of_slope, spans_rad, used, strict=True):
        if is_used:
            sure += np.outer(factor, factor)
            # The slope is of the middle of two sweeps, at two bearings: half the variance of one range.
            sure -= ABOVE_NOISE * (sigma_m / span_rad) ** 2 / 2.0 * np.outer(by_slope, by_slope)
    if sure[2, 2] <= 0.0:
        return motion, False
    left = sure[:2, :2] - np.outer(sure[:2, 2], sure[2, :2]) / sure[2, 2]
    return motion, bool(np.linalg.eigvalsh(left)[0] > LEAST_KNOWN * len(table))
