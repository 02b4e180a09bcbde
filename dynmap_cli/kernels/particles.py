"""The loops over particles: moving, weighing, the pose they stand for, and the draw of the next ones."""

from __future__ import annotations

import math

import numpy as np

from dynmap_cli.arrays import F64, I32, I64, U16
from dynmap_cli.kernels.jit import kernel

TWO_PI = 2.0 * math.pi


@kernel
def wrapped(angle_rad: float) -> float:
    """The angle in [-pi, pi)."""
    return angle_rad - TWO_PI * math.floor((angle_rad + math.pi) / TWO_PI)


@kernel
def move_poses(poses: F64, turns: F64, length_m: float, sigmas: F64, noise: F64, out: F64) -> None:
    r"""Write where each particle comes to: turn, drive, turn, each with noise of its own.

    .. math::
        \theta_1 = \theta + \delta_1 - \sigma_1 n_1, \quad
        (x, y)' = (x, y) + (d - \sigma_\parallel n_2)\, e(\theta_1) + \sigma_\perp n_3\, e_\perp(\theta_1), \quad
        \theta' = \theta_1 + \delta_2 - \sigma_2 n_4

    Table 5.6 of Thrun et al., Probabilistic Robotics, with noise across the way besides.

    Parameters
    ----------
    poses : (n, 3) float64
    turns : (2,) float64
        Before and after the drive, radians.
    length_m : float
    sigmas : (4,) float64
        Standard deviations of the first turn, along and across the way, and of the last turn.
    noise : (4, n) float64
        Standard normal.
    out : (n, 3) float64
    """
    for k in range(poses.shape[0]):
        yaw = poses[k, 2] + turns[0] - sigmas[0] * noise[0, k]
        cos, sin = math.cos(yaw), math.sin(yaw)
        along, across = length_m - sigmas[1] * noise[1, k], sigmas[2] * noise[2, k]
        out[k, 0] = poses[k, 0] + along * cos - across * sin
        out[k, 1] = poses[k, 1] + along * sin + across * cos
        out[k, 2] = wrapped(yaw + turns[1] - sigmas[3] * noise[3, k])


@kernel
def places_on_curve(poses: F64, curve: U16, out: U16) -> None:
    """Write where each particle lies along a curve that fills a box of three standard deviations around their mean.

    Parameters
    ----------
    poses : (n, 3) float64
    curve : (size, size, size) uint16
        Number of each cell of the box in x, y and yaw along the curve.
    out : (n,) uint16
    """
    n, size = poses.shape[0], curve.shape[0]
    x0, y0, yaw0 = poses[0, 0], poses[0, 1], poses[0, 2]
    x = y = yaw = xx = yy = tt = 0.0
    for k in range(n):
        dx, dy, turn = poses[k, 0] - x0, poses[k, 1] - y0, wrapped(poses[k, 2] - yaw0)
        x, y, yaw = x + dx / n, y + dy / n, yaw + turn / n
        xx, yy, tt = xx + dx * dx / n, yy + dy * dy / n, tt + turn * turn / n
    per_x = size / 6.0 / math.sqrt(max(xx - x * x, 1e-18))
    per_y = size / 6.0 / math.sqrt(max(yy - y * y, 1e-18))
    per_yaw = size / 6.0 / math.sqrt(max(tt - yaw * yaw, 1e-18))
    middle, last = 0.5 * size, size - 1.0
    for k in range(n):
        dx, dy, turn = poses[k, 0] - x0 - x, poses[k, 1] - y0 - y, wrapped(poses[k, 2] - yaw0) - yaw
        col = int(min(max(middle + dx * per_x, 0.0), last))
        row = int(min(max(middle + dy * per_y, 0.0), last))
        out[k] = curve[col, row, int(min(max(middle + turn * per_yaw, 0.0), last))]


@kernel
def spread_normals(order: I64, steps: F64, offsets: F64, quantiles: F64, out: F64) -> None:
    r"""Write standard normal numbers that are spread evenly, the k-th point of a lattice for particle order[k].

    .. math:: u_{kj} = (k a_j + o_j) \bmod 1, \qquad z_{kj} = \Phi^{-1}(u_{kj})

    Parameters
    ----------
    order : (n,) int64
    steps, offsets : (4,) float64
        a and o, in [0, 1).
    quantiles : (m,) float64
        Of the normal distribution, in the middle of m equal parts.
    out : (4, n) float64
    """
    for k in range(order.size):
        for j in range(steps.size):
            u = k * steps[j] + offsets[j]
            out[j, order[k]] = quantiles[int((u - math.floor(u)) * quantiles.size)]


@kernel
def mean_step(before: F64, after: F64, weights: F64, out: F64) -> None:
    """Write the weighted mean (3,) of the steps of single particles, each seen from its pose before."""
    x = y = turn = 0.0
    for k in range(weights.size):
        cos, sin = math.cos(before[k, 2]), math.sin(before[k, 2])
        dx, dy = after[k, 0] - before[k, 0], after[k, 1] - before[k, 1]
        x += weights[k] * (cos * dx + sin * dy)
        y += weights[k] * (cos * dy - sin * dx)
        turn += weights[k] * wrapped(after[k, 2] - before[k, 2])
    out[0], out[1], out[2] = x, y, turn


@kernel
def multiply_weights(weights: F64, log_likelihoods: F64, out: F64) -> None:
    """Write weights times likelihoods, normalized to the sum 1.

    Parameters
    ----------
    weights : (n,) float64
    log_likelihoods : (n,) float64
    out : (n,) float64
    """
    most = -math.inf
    for k in range(weights.size):
        out[k] = (math.log(weights[k]) if weights[k] > 0.0 else -math.inf) + log_likelihoods[k]
        most = max(most, out[k])
    total = 0.0
    for k in range(weights.size):
        out[k] = math.exp(out[k] - most)
        total += out[k]
    for k in range(weights.size):
        out[k] /= total


@kernel
def is_same(keys: I32, one: int, other: int) -> bool:
    """Whether two rows of keys (n, 5) are equal."""
    return bool(
        keys[one, 0] == keys[other, 0]
        and keys[one, 1] == keys[other, 1]
        and keys[one, 2] == keys[other, 2]
        and keys[one, 3] == keys[other, 3]
        and keys[one, 4] == keys[other, 4]
    )


@kernel
def slot_of(keys: I32, entry: int, table: I32) -> int:
    """Slot of a hash table that holds an entry with the same key as this one, or the empty one (-1) for it.

    Parameters
    ----------
    keys : (n, 5) int32
        Keys of the entries.
    entry : int
    table : (power of two,) int32
        Index into *keys*, -1 = empty.
    """
    mixed = np.int64(0)
    for part in range(5):
        mixed = (mixed * 1_000_003 + keys[entry, part]) & 0xFFFF_FFFF
        mixed ^= mixed >> 15
    mask = table.size - 1
    slot = int(mixed) & mask
    while table[slot] >= 0 and not is_same(keys, int(np.int64(table[slot])), entry):
        slot = (slot + 1) & mask
    return slot


@kernel
def sort_into_bins(poses: F64, submaps: I32, states: I32, bin_m: float, bin_rad: float, out: I32) -> None:
    """Write for each particle the first particle that is in the same bin of place, yaw, sub-map and state.

    Parameters
    ----------
    poses : (n, 3) float64
    submaps, states : (n,) int32
    bin_m, bin_rad : float
        Edges of a bin.
    out : (n,) int32
    """
    n, size = poses.shape[0], 2
    while size < 2 * n:
        size *= 2
    keys, table = np.empty((n, 5), dtype=np.int32), np.full(size, -1, dtype=np.int32)
    for k in range(n):
        keys[k, 0] = np.int32(math.floor(poses[k, 0] / bin_m))
        keys[k, 1] = np.int32(math.floor(poses[k, 1] / bin_m))
        keys[k, 2] = np.int32(math.floor(poses[k, 2] / bin_rad))
        keys[k, 3], keys[k, 4] = submaps[k], states[k]
        if k > 0 and is_same(keys, k, k - 1):
            out[k] = out[k - 1]
            continue
        slot = slot_of(keys, k, table)
        if table[slot] < 0:
            table[slot] = k
        out[k] = table[slot]


@kernel
def draw_low_variance(weights: F64, count: int, offset: float, out: I64) -> None:
    """Write the indices of *count* draws: one comb with equal gaps, shifted by *offset* in [0, 1).

    Table 4.4 of Thrun et al., Probabilistic Robotics.
    """
    total = 0.0
    for k in range(weights.size):
        total += weights[k]
    index, reached, last = 0, weights[0], weights.size - 1
    for tooth in range(count):
        at = (tooth + offset) / count * total
        while reached <= at and index < last:
            index += 1
            reached += weights[index]
        out[tooth] = index


@kernel
def count_bins(bins: I32, drawn: I64) -> int:
    """How many different bins the drawn particles lie in."""
    seen, count = np.zeros(bins.size, dtype=np.int32), 0
    for k in range(drawn.size):
        of = bins[drawn[k]]
        count += 1 - seen[of]
        seen[of] = 1
    return count


@kernel
def kld_count(bins: int, error: float, quantile: float) -> int:
    """Samples needed so that the error stays below *error* with the *quantile* (Fox 2003, Eq. 7)."""
    if bins < 2:
        return 1
    a = 2.0 / (9.0 * (bins - 1))
    return int(math.ceil((bins - 1) / (2.0 * error) * (1.0 - a + math.sqrt(a) * quantile) ** 3))


@kernel
def draw_particles(
    poses: F64,
    weights: F64,
    submaps: I32,
    states: I32,
    offsets: F64,
    bins: F64,
    kld: F64,
    least: int,
    out_poses: F64,
    out_submaps: I32,
    out_states: I32,
) -> int:
    """Write particles drawn by weight, as many as a first draw of n occupies bins for; return how many.

    Parameters
    ----------
    poses : (n, 3) float64
    weights : (n,) float64
    submaps, states : (n,) int32
    offsets : (2,) float64
        Of the combs of the first and the final draw, in [0, 1).
    bins : (2,) float64
        Edges of a bin in metres and radians.
    kld : (2,) float64
        Error and quantile for `kld_count`.
    least : int
        Particles at least.
    out_poses, out_submaps, out_states : (most, 3) float64 and (most,) int32
    """
    n, most = weights.size, out_states.size
    wanted = most
    if least < most:
        own, first = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int64)
        sort_into_bins(poses, submaps, states, bins[0], bins[1], own)
        draw_low_variance(weights, n, offsets[0], first)
        wanted = min(max(kld_count(count_bins(own, first), kld[0], kld[1]), least), most)
    drawn = np.empty(wanted, dtype=np.int64)
    draw_low_variance(weights, wanted, offsets[1], drawn)
    for k in range(wanted):
        of = drawn[k]
        out_poses[k, 0], out_poses[k, 1], out_poses[k, 2] = poses[of, 0], poses[of, 1], poses[of, 2]
        out_submaps[k], out_states[k] = submaps[of], states[of]
    return wanted


@kernel
def heaviest_cluster(
    poses: F64, weights: F64, bin_m: float, bin_rad: float, near_m: float, near_rad: float, out: F64
) -> None:
    """Write the weighted mean pose around the heaviest bin, the weight near it, and the spread of all and of those.

    The mean is that of the bin at first, then three times that of all particles near the last one.

    Parameters
    ----------
    poses : (n, 3) float64
    weights : (n,) float64
        Sum 1.
    bin_m, bin_rad : float
        Edges of a bin.
    near_m, near_rad : float
        How far from the mean a member may be.
    out : (6,) float64
        x, y in metres, yaw in radians; weight of the last members; standard deviation in metres of all particles, and
        of those near the mean.
    """
    n = weights.size
    nowhere, bins, bin_weights = np.zeros(n, dtype=np.int32), np.empty(n, dtype=np.int32), np.zeros(n)
    sort_into_bins(poses, nowhere, nowhere, bin_m, bin_rad, bins)
    for k in range(weights.size):
        bin_weights[bins[k]] += weights[k]
    heaviest = 0
    for k in range(weights.size):
        if bin_weights[k] > bin_weights[heaviest]:
            heaviest = k
    x, y, yaw = poses[heaviest, 0], poses[heaviest, 1], poses[heaviest, 2]
    share = 1.0
    for turn in range(4):
        total = sum_x = sum_y = sum_yaw = 0.0
        for k in range(weights.size):
            dx, dy, away = poses[k, 0] - x, poses[k, 1] - y, wrapped(poses[k, 2] - yaw)
            if turn == 0:
                member = bins[k] == heaviest
            else:
                member = dx * dx + dy * dy <= near_m * near_m and abs(away) <= near_rad
            if member:
                total += weights[k]
                sum_x += weights[k] * dx
                sum_y += weights[k] * dy
                sum_yaw += weights[k] * away
        share = total
        total = max(total, 1e-300)
        x, y, yaw = x + sum_x / total, y + sum_y / total, wrapped(yaw + sum_yaw / total)
    variance = near_variance = near_weight = 0.0
    for k in range(weights.size):
        dx, dy = poses[k, 0] - x, poses[k, 1] - y
        squared = dx * dx + dy * dy
        variance += weights[k] * squared
        if squared <= near_m * near_m and abs(wrapped(poses[k, 2] - yaw)) <= near_rad:
            near_weight += weights[k]
            near_variance += weights[k] * squared
    near_variance /= max(near_weight, 1e-300)
    out[0], out[1], out[2], out[3] = x, y, yaw, share
    out[4], out[5] = math.sqrt(variance), math.sqrt(near_variance)


@kernel
def covariance_near(poses: F64, weights: F64, centre: F64, near_m: float, near_rad: float, out: F64) -> None:
    """Fill the weighted covariance of the particles near a pose, around it, yaw along the shorter arc.

    Parameters
    ----------
    poses : (n, 3) float64
    weights : (n,) float64
    centre : (3,) float64
    near_m, near_rad : float
        Particles farther away than either are left out.
    out : (3, 3) float64
        m^2, m rad, rad^2; zero where no particle is near.
    """
    total = xx = xy = yy = xt = yt = tt = 0.0
    for k in range(weights.size):
        x, y = poses[k, 0] - centre[0], poses[k, 1] - centre[1]
        turn = (poses[k, 2] - centre[2] + math.pi) % (2.0 * math.pi) - math.pi
        if x * x + y * y > near_m * near_m or abs(turn) > near_rad:
            continue
        weight = weights[k]
        total += weight
        xx += weight * x * x
        xy += weight * x * y
        yy += weight * y * y
        xt += weight * x * turn
        yt += weight * y * turn
        tt += weight * turn * turn
    share = 1.0 / max(total, 1e-300)
    out[0, 0], out[1, 1], out[2, 2] = xx * share, yy * share, tt * share
    out[0, 1] = out[1, 0] = xy * share
    out[0, 2] = out[2, 0] = xt * share
    out[1, 2] = out[2, 1] = yt * share
