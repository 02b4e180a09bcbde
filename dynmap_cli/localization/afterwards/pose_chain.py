"""A chain of poses, tied by the odometry between them and by the scan at each: the likeliest chain as a whole."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, solveh_banded

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import between, compose, wrap_angle

_ROUNDS = 20
_LEAST_DAMPING, _MOST_DAMPING = 1e-6, 1e8
_STEP_M, _STEP_RAD = 1e-4, 1e-5
_UPPER = np.triu_indices(3)


ScanFit = Callable[[int, F64], F64]
"""(node, pose) -> (10,): negative log-likelihood, its gradient, the upper triangle of its Gauss-Newton matrix."""


@dataclass(frozen=True, slots=True)
class Link:
    """The motion from one node to the next.

    Attributes
    ----------
    step : (3,) float64
        Pose of the next node seen from this one.
    information : (3, 3) float64
        Inverse covariance of what may be wrong with the step, in its own frame.
    """

    step: F64
    information: F64


def likeliest_chain(poses: F64, links: Sequence[Link], fit: ScanFit) -> F64:
    """Poses (n, 3) that make all scans and all motions likeliest together.

    Damped Gauss-Newton (Levenberg) from *poses*; each step solves a block-tridiagonal system, so the cost grows
    with the length of the chain only. Along a chain this is what a Kalman smoother does (Rauch, Tung, Striebel),
    with the measurements linearized anew in each round. Never worse in likelihood than *poses*.
    """
    damping = 1e-3
    cost, bands, gradient = _normal_equations(poses, links, fit)
    for _ in range(_ROUNDS):
        step = _damped_step(bands, gradient, damping)
        if step is not None:
            tried = poses + step
            tried[:, 2] = wrap_angle(tried[:, 2])
            new_cost, new_bands, new_gradient = _normal_equations(tried, links, fit)
            if new_cost < cost:
                poses, cost, bands, gradient = tried, new_cost, new_bands, new_gradient
                damping = max(0.1 * damping, _LEAST_DAMPING)
                if np.abs(step[:, :2]).max() < _STEP_M and np.abs(step[:, 2]).max() < _STEP_RAD:
                    break
                continue
        damping *= 10.0
        if damping > _MOST_DAMPING:
            break
    return poses


def _damped_step(bands: F64, gradient: F64, damping: float) -> F64 | None:
    """Solve for the step (n, 3); None where the matrix is not positive."""
    damped = bands.copy()
    damped[0] += damping * np.maximum(bands[0], 1e-9)
    try:
        return np.asarray(-solveh_banded(damped, gradient.ravel(), lower=True).reshape(-1, 3))
    except LinAlgError:
        return None


def _normal_equations(poses: F64, links: Sequence[Link], fit: ScanFit) -> tuple[float, F64, F64]:
    """Cost, lower bands (6, 3 n) of the Gauss-Newton matrix, and gradient (n, 3)."""
    n = poses.shape[0]
    cost, gradient = 0.0, np.zeros((n, 3))
    diagonal, below = np.zeros((n, 3, 3)), np.zeros((max(n - 1, 0), 3, 3))
    for node in range(n):
        found = fit(node, poses[node])
        cost += float(found[0])
        gradient[node] += found[1:4]
        block = np.zeros((3, 3))
        block[_UPPER] = found[4:]
        diagonal[node] += block + np.triu(block, 1).T
    if n > 1:
        cost += _add_links(poses, links, gradient, diagonal, below)
    bands = np.zeros((6, 3 * n))
    for row in range(3):
        for col in range(row + 1):
            bands[row - col, col::3] = diagonal[:, row, col]
        for col in range(3):
            bands[3 + row - col, col : 3 * (n - 1) : 3] = below[:, row, col]
    return cost, bands, gradient


def _add_links(poses: F64, links: Sequence[Link], gradient: F64, diagonal: F64, below: F64) -> float:
    """Add the motions to gradient and blocks; returns their cost.

    The error of a link is the pose of the next node seen from where the step leads, e = (x_i step)^-1 x_j.
    """
    steps = np.stack([link.step for link in links])
    information = np.stack([link.information for link in links])
    start, end = poses[:-1], poses[1:]
    reached = compose(start, steps)
    error = between(reached, end)
    cos, sin = np.cos(reached[:, 2]), np.sin(reached[:, 2])
    turn = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], -2)
    by_end = np.zeros((*cos.shape, 3, 3))
    by_end[:, :2, :2] = turn
    by_end[:, 2, 2] = 1.0
    away = end[:, :2] - start[:, :2]
    lever = np.einsum("nab,nb->na", turn, np.stack([-away[:, 1], away[:, 0]], -1))
    by_start = -by_end
    by_start[:, :2, 2] = -lever
    weighted = np.einsum("nab,nb->na", information, error)
    gradient[1:] += np.einsum("nab,na->nb", by_end, weighted)
    gradient[:-1] += np.einsum("nab,na->nb", by_start, weighted)
    times_end = np.einsum("nab,nbc->nac", information, by_end)
    times_start = np.einsum("nab,nbc->nac", information, by_start)
    diagonal[1:] += np.einsum("nab,nac->nbc", by_end, times_end)
    diagonal[:-1] += np.einsum("nab,nac->nbc", by_start, times_start)
    below += np.einsum("nab,nac->nbc", by_end, times_start)
    return 0.5 * float((error * weighted).sum())
