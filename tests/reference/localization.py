"""Slow plain twins of room 5, one particle and one beam at a time."""

from __future__ import annotations

import itertools
import math


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
        code = int(surfaces[row, col])
        if code == 255 or (code > 0 and abs(math.sin(direction - math.radians(code - 1))) >= least_sine):
            crossed = at
            break
    return entered, crossed


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
