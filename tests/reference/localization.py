"""Slow plain twins of room 5, one particle and one beam at a time."""

from __future__ import annotations

import itertools
import math
from statistics import NormalDist

import numpy as np
from scipy import ndimage

from tests.reference.counting import plain_passes


def plain_field_log_likelihood(fields, window, pose, ends):
    """Sum over beams of the field at the end cell; *fields* = (map field, patch field or None).

    *pose* in cells, *window* = first row, first column, rows, columns of the patch.
    """
    whole, patch = fields
    rows, cols = whole.shape
    total = 0.0
    for x, y in ends:
        col = math.floor(min(max(pose[0] + math.cos(pose[2]) * x - math.sin(pose[2]) * y, 0), cols - 1))
        row = math.floor(min(max(pose[1] + math.sin(pose[2]) * x + math.cos(pose[2]) * y, 0), rows - 1))
        own_row, own_col = row - window[0], col - window[1]
        if patch is not None and 0 <= own_row < window[2] and 0 <= own_col < window[3]:
            total += float(patch[own_row, own_col])
        else:
            total += float(whole[row, col])
    return total


def plain_beam_log_likelihood(reflectance, pose, sensor, beams, z_hit, floor, static_prior, outside):
    """Eq. 1.1 with lengths, beam by beam and cell by cell, summed over its two cases of c.

    *reflectance* of a cell (row, col), *outside* that of what is not in it, where there are no cells; *pose*
    in cells; *sensor* in the robot frame, cells; *beams* = (direction, length in cells, zeta: nothing was hit).
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x0, y0 = pose[0] + c * sensor[0] - s * sensor[1], pose[1] + s * sensor[0] + c * sensor[1]
    total = 0.0
    for direction, length, zeta in beams:
        x1, y1 = x0 + length * math.cos(pose[2] + direction), y0 + length * math.sin(pose[2] + direction)
        ways = {cell: way for cell, way in plain_passes(x0, y0, x1, y1).items() if cell in reflectance}
        passed = math.prod((1 - reflectance[cell]) ** way for cell, way in ways.items())
        m = reflectance.get((math.floor(y1), math.floor(x1)))
        if m is None:
            passed *= (1 - outside) ** (length - sum(ways.values()))
            m = outside
        likelihood = {
            case: passed**zeta * ((m**case * (1 - m) ** (1 - case)) * passed) ** (1 - zeta) for case in (0, 1)
        }
        mixture = static_prior * likelihood[1] + (1 - static_prior) * likelihood[0]
        total += math.log(z_hit * mixture + floor)
    return total


def plain_blocks(code, direction, least_sine):
    """Whether a cell is in the way of a beam: 255 of any, 1 + degrees of a surface of those that do not graze it."""
    return code == 255 or (code > 0 and abs(math.sin(direction - math.radians(code - 1))) >= least_sine)


def plain_first_crossing(surfaces, x, y, direction, length, least_sine, step=1e-3):
    """Walk along the ray in tiny steps; entry into the grid and first cell that blocks it."""
    rows, cols = surfaces.shape
    entered = crossed = math.inf
    for k in range(int(length / step)):
        at = (k + 0.5) * step
        col, row = math.floor(x + at * math.cos(direction)), math.floor(y + at * math.sin(direction))
        if not (0 <= row < rows and 0 <= col < cols):
            continue
        entered = min(entered, at)
        if plain_blocks(int(surfaces[row, col]), direction, least_sine):
            crossed = at
            break
    return entered, crossed


def plain_passing_share(surfaces, passes, x, y, direction, length, beyond, least_sine, step=1e-3):
    """Walk along the ray in tiny steps; entry into the grid, and product over the cells of surfaces that it crosses."""
    rows, cols = surfaces.shape
    entered, crossed = math.inf, {}  # cells with their shares, in the order of the way
    for k in range(int(length / step)):
        at = (k + 0.5) * step
        col, row = math.floor(x + at * math.cos(direction)), math.floor(y + at * math.sin(direction))
        if not (0 <= row < rows and 0 <= col < cols):
            continue
        entered = min(entered, at)
        code = int(surfaces[row, col])
        blocks = plain_blocks(code, direction, least_sine)
        if at + beyond <= length and (blocks or (code == 0 and crossed and math.isnan(passes[row, col]))):
            crossed[row, col] = float(passes[row, col]) if blocks else 0.0
    return entered, math.prod(crossed.values())


def plain_state_evidence(surfaces, passes, owned, fields, cell, beams, values, limits, switches, passing):
    """What each state says of the ends, and of beams that went through something; beams that tell states apart."""
    sensor, directions, lengths, ends, hits = beams
    n_states, n = len(surfaces), len(lengths)
    at_ends, through = np.zeros((n_states, n)), np.zeros((n_states, n))
    (x, y), size = (sensor - cell[:2]) / cell[2], cell[2]
    for state, beam in itertools.product(range(n_states), range(n)):
        ahead = math.cos(directions[beam]), math.sin(directions[beam])
        way = (lengths[beam] / size, limits[1] / size, limits[0])
        enter, share = passing(surfaces[state], passes[state], x, y, *ahead, *way)
        if enter * size > limits[2]:
            continue
        col, row = (math.floor(v) for v in (ends[beam] - cell[:2]) / size)
        is_in = 0 <= row < owned.shape[0] and 0 <= col < owned.shape[1] and hits[beam] and owned[row, col]
        end = float(fields[state, row, col]) if is_in else values[0]
        at_ends[state, beam] = end if is_in else 0.0
        through[state, beam] = math.log(share * math.exp(end) + (1.0 - share) * math.exp(values[1])) - end
    said = at_ends + through
    n_beams = int((np.ptp(said, axis=0) >= limits[3]).sum())
    told = []
    for thing in range(2):
        apart = [abs(said[on] - said[off]) >= limits[3] for number, on, off in switches if number == thing]
        told.append(int(np.any(apart, axis=0).sum()))
    return at_ends.sum(axis=1), through.sum(axis=1), n_beams, told


def plain_clips(behind, crossings, through, apart, width):
    """Beams that went through, in groups of those that cross walls near one another; which groups are not wide."""
    clips = [False] * len(behind)
    beams = np.flatnonzero(behind > through)
    steps = np.hypot(*np.diff(crossings[beams], axis=0).T)
    for group in np.split(beams, np.flatnonzero(steps > apart) + 1):
        if group.size and np.hypot(*np.ptp(crossings[group], axis=0)) < width:
            for beam in group:
                clips[beam] = True
    return clips


def plain_staying(points, cell, cells_at_once, now, limits, is_fixed, first, last):
    """Whether each point belongs to what has stayed; cells in view are labelled, notes are taken as in the kernel."""
    around = np.ones((3, 3))
    places = [
        (
            math.floor((y - cell[1]) / cell[2]) // cells_at_once,
            math.floor((x - cell[0]) / cell[2]) // cells_at_once,
        )
        for x, y in points
    ]
    inside = [p for p in places if 0 <= p[0] < first.shape[0] and 0 <= p[1] < first.shape[1]]
    beams = np.zeros(first.shape)
    for place in inside:
        beams[place] += 1
    groups, _ = ndimage.label(beams, around)
    seen = {place for place in inside if beams[groups == groups[place]].sum() >= limits[2]}
    for place in seen:
        if now - last[place] > limits[1]:
            first[place] = now
        last[place] = now
    if not inside:
        return [False] * len(places)
    recent = np.zeros(first.shape, dtype=bool)
    (top, left), (bottom, right) = np.min(inside, axis=0), np.max(inside, axis=0)
    window = np.s_[max(top - 1, 0) : bottom + 2, max(left - 1, 0) : right + 2]
    recent[window] = now - last[window] <= limits[1]
    things, _ = ndimage.label(recent, around)
    if is_fixed:
        starts = {place: first[things == things[place]].min() for place in seen}
        for place, start in starts.items():
            first[place] = start

    def stays(place):
        thing = things == things[place]
        return (last[thing] - first[thing]).max() >= limits[0] and thing.sum() >= limits[3]

    return [place in seen and bool(stays(place)) for place in places]


def plain_odometry_step(pose, step, noise, alphas):
    """Table 5.6 of Probabilistic Robotics, one particle, with AMCL's treatment of reversing."""
    a1, a2, a3, a4 = alphas
    length = math.hypot(step[0], step[1])
    rot1 = math.atan2(step[1], step[0]) if length >= 0.01 else 0.0
    rot2 = (step[2] - rot1 + math.pi) % (2 * math.pi) - math.pi
    n1 = min(abs(rot1), abs(abs(rot1) - math.pi))
    n2 = min(abs(rot2), abs(abs(rot2) - math.pi))
    r1 = rot1 - math.sqrt(a1 * n1**2 + a2 * length**2) * noise[0]
    d = length - math.sqrt(a3 * length**2 + a4 * (n1**2 + n2**2)) * noise[1]
    r2 = rot2 - math.sqrt(a1 * n2**2 + a2 * length**2) * noise[2]
    x, y, yaw = pose
    return x + d * math.cos(yaw + r1), y + d * math.sin(yaw + r1), yaw + r1 + r2


def plain_places_on_curve(poses, curve):
    """Cell of each pose in a box of three standard deviations around the mean, by its number along the curve."""
    turns = np.array([math.remainder(yaw - poses[0, 2], 2 * math.pi) for yaw in poses[:, 2]])
    away = np.column_stack([poses[:, :2] - poses[0, :2], turns])
    scaled = (away - away.mean(axis=0)) / np.maximum(away.std(axis=0), 1e-9)
    cells = np.clip(curve.shape[0] * (0.5 + scaled / 6.0), 0, curve.shape[0] - 1).astype(int)
    return [int(curve[tuple(cell)]) for cell in cells]


def plain_spread_normals(order, steps, offsets):
    """Quantiles at the points of a shifted lattice, dealt out in an order; of 4096 equal parts the middle."""
    normal, out = NormalDist(), np.empty((4, len(order)))
    for k, particle in enumerate(order):
        for j in range(4):
            part = int(((k * steps[j] + offsets[j]) % 1.0) * 4096)
            out[j, particle] = normal.inv_cdf((part + 0.5) / 4096)
    return out


def plain_motion_moments(step, sigmas):
    """Mean and covariance of turn, drive, turn with normal noise from (0, 0, 0), in closed form.

    With yaw1 ~ N(first, s1^2): E[e^(i yaw1)] = e^(i first) e^(-s1^2 / 2), and the second moments by
    E[cos 2 yaw1], E[sin 2 yaw1] alike; E[yaw noise * e^(i yaw1)] = i s1^2 e^(i first) e^(-s1^2 / 2).
    """
    first, length, last = step
    s1, along, across, s2 = sigmas
    d1, d2 = math.exp(-0.5 * s1**2), math.exp(-2.0 * s1**2)
    mean = [length * d1 * math.cos(first), length * d1 * math.sin(first), first + last]
    c2, s2t = d2 * math.cos(2 * first), d2 * math.sin(2 * first)
    xx = (length**2 + along**2) * (1 + c2) / 2 + across**2 * (1 - c2) / 2 - mean[0] ** 2
    yy = (length**2 + along**2) * (1 - c2) / 2 + across**2 * (1 + c2) / 2 - mean[1] ** 2
    xy = (length**2 + along**2 - across**2) * s2t / 2 - mean[0] * mean[1]
    xt, yt = -mean[1] * s1**2, mean[0] * s1**2
    return mean, np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, s1**2 + s2**2]])


def plain_mean_step(before, after, weights):
    """Weighted mean of the steps, each in the frame of its particle before."""
    total = [0.0, 0.0, 0.0]
    for (x0, y0, a0), (x1, y1, a1), w in zip(before, after, weights, strict=True):
        dx, dy = x1 - x0, y1 - y0
        total[0] += w * (math.cos(a0) * dx + math.sin(a0) * dy)
        total[1] += w * (math.cos(a0) * dy - math.sin(a0) * dx)
        total[2] += w * math.remainder(a1 - a0, 2 * math.pi)
    return total


def plain_reweigh(weights, log_likelihoods):
    """Bayes, one particle at a time."""
    products = [w * math.exp(log) for w, log in zip(weights, log_likelihoods, strict=True)]
    return [p / sum(products) for p in products]


def plain_bins(poses, submaps, states, bin_m, bin_rad):
    """Index of the first particle in the same bin."""
    first = {}
    return [
        first.setdefault((math.floor(x / bin_m), math.floor(y / bin_m), math.floor(a / bin_rad), m, s), k)
        for k, ((x, y, a), m, s) in enumerate(zip(poses, submaps, states, strict=True))
    ]


def plain_cluster(poses, weights, bins, near_m, near_rad):
    """Mean pose around the heaviest bin, weight near it, spread of all and of those near; yaw along the shorter arc."""
    heaviest = max(set(bins), key=lambda b: sum(w for w, o in zip(weights, bins, strict=True) if o == b))

    def mean_of(members, yaw):
        inside = [(w, p) for w, p, m in zip(weights, poses, members, strict=True) if m]
        share = sum(w for w, _ in inside)
        x, y = (sum(w * p[axis] for w, p in inside) / share for axis in (0, 1))
        turn = sum(w * math.remainder(p[2] - yaw, 2 * math.pi) for w, p in inside) / share
        return x, y, yaw + turn, share

    x, y, yaw, share = mean_of([b == heaviest for b in bins], poses[heaviest][2])
    for _ in range(3):
        place = [math.hypot(p[0] - x, p[1] - y) <= near_m for p in poses]
        turned = [abs(math.remainder(p[2] - yaw, 2 * math.pi)) <= near_rad for p in poses]
        x, y, yaw, share = mean_of([a and b for a, b in zip(place, turned, strict=True)], yaw)
    squares = [w * math.hypot(p[0] - x, p[1] - y) ** 2 for w, p in zip(weights, poses, strict=True)]
    place = [math.hypot(p[0] - x, p[1] - y) <= near_m for p in poses]
    turned = [abs(math.remainder(p[2] - yaw, 2 * math.pi)) <= near_rad for p in poses]
    near = [k for k in range(len(weights)) if place[k] and turned[k]]
    near_spread = sum(squares[k] for k in near) / max(sum(weights[k] for k in near), 1e-300)
    return x, y, yaw, share, math.sqrt(sum(squares)), math.sqrt(near_spread)


def plain_low_variance(weights, count, offset):
    """Table 4.4 of Probabilistic Robotics."""
    total, chosen = sum(weights), []
    c, i = weights[0], 0
    for m in range(count):
        u = (m + offset) / count * total
        while u >= c and i < len(weights) - 1:
            i += 1
            c += weights[i]
        chosen.append(i)
    return chosen


def plain_kld_count(bins, error, quantile):
    """Fox (2003), Eq. 7, by the approximation of Wilson and Hilferty."""
    if bins < 2:
        return 1
    k = bins - 1
    return math.ceil(k / (2 * error) * (1 - 2 / (9 * k) + math.sqrt(2 / (9 * k)) * quantile) ** 3)


def plain_resample(weights, bins, offsets, kld, least, most):
    """Indices of the particles drawn: a first draw tells how many bins are occupied, a second one is kept."""
    occupied = {bins[k] for k in plain_low_variance(weights, len(weights), offsets[0])}
    wanted = min(max(plain_kld_count(len(occupied), *kld), least), most)
    return plain_low_variance(weights, wanted, offsets[1])


def exact_state_posterior(prior, stays, log_likelihoods):
    """Bayes by enumeration: sum over all sequences of states, Eq. 1.24 at a known pose.

    *stays*[t] = probability that the state is the same at step t as at t - 1 (ignored at t = 0), another
    one drawn uniformly otherwise; *log_likelihoods*[t][k] of the scan at step t in state k.
    """
    n, steps = len(prior), len(log_likelihoods)
    totals = [0.0] * n
    for sequence in itertools.product(range(n), repeat=steps):
        p = prior[sequence[0]]
        for t in range(1, steps):
            same = sequence[t] == sequence[t - 1]
            p *= stays[t] if same else (1 - stays[t]) / (n - 1)
        for t in range(steps):
            p *= math.exp(log_likelihoods[t][sequence[t]])
        totals[sequence[-1]] += p
    return [value / sum(totals) for value in totals]


def plain_state_prior(was_in, state, now_in, n_states, same, entering):
    """p(m_t | x_t, m_{t-1}) of one particle, as the paper words it; *entering* = what it believes on coming in."""
    if now_in < 0:
        return [1.0]
    if was_in != now_in:
        return list(entering)
    return [same if k == state else (1 - same) / (n_states - 1) for k in range(n_states)]


def exact_joint_posterior(pose_prior, transitions, log_likelihoods):
    """Eq. 1.24 by enumeration: p(path, last state), summed over all sequences of states of every path.

    *transitions*[t][path][before][after], of which t = 0 is read at before = 0; *log_likelihoods*[t][path][state].
    """
    n = len(log_likelihoods[0][0])
    table = [[0.0] * n for _ in pose_prior]
    for path, prior in enumerate(pose_prior):
        for sequence in itertools.product(range(n), repeat=len(log_likelihoods)):
            p, before = prior, 0
            for t, state in enumerate(sequence):
                p *= transitions[t][path][before][state] * math.exp(log_likelihoods[t][path][state])
                before = state
            table[path][sequence[-1]] += p
    total = sum(map(sum, table))
    return [[p / total for p in row] for row in table]
